"""One drive of a benchmark: compiled as interpreted, judged where it says."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmarks.entries import controller
from benchmarks.peers.agents import SETTINGS
from benchmarks.run.drives import Policy, drive, judged
from benchmarks.run.results import TRAJECTORY
from benchmarks.scenarios import scene, suite_loop
from steerkit.controllers.network_policy import PolicyBlock
from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.controllers.pure_pursuit import PurePursuit
from steerkit.controllers.stanley import Stanley
from steerkit.diagram.simulation import Log, simulate
from steerkit.scenario import Scenario
from steerkit.vehicles import VW_PASSAT as PASSAT

SCENARIO = scene(name="straight", course="straight")
PATH = SCENARIO.path()
LENGTH = SCENARIO.length
LOOP = suite_loop(SCENARIO, Stanley.of(SCENARIO.nominal))
V = 5.0

STEP = scene(name="step", course="curvature-step", driver={"v_min": 7.0, "v_max": 7.0})


def test_compiled_with_open_parameters_is_the_interpreted_drive() -> None:
    scenario = STEP.with_(
        vehicle={"tyres": 0.8},
        steering={"offset_deg": 1.0},
        disturbances={"wind": 0.2, "gust": 0.1},
        sensors={"noise": 1.0, "latency": 0.05},
    )
    block = controller("stanley").make(scenario)  # type: ignore[misc]
    driven = drive(scenario, "stanley", seed=3, timed_steps=50)
    log = simulate(suite_loop(scenario, block, seed=3), 15.0, record=["path.e", "car.a_y"], every=5)
    e = driven.trajectory["e"][:300]
    assert np.abs(e - log["path.e"][:300]).max() < 1e-9
    assert driven.metrics["max_e"] == pytest.approx(np.abs(driven.trajectory["e"]).max(), rel=1e-12)
    assert driven.metrics["held"] == 1.0
    assert 0.0 < driven.metrics["step_p50_us"] <= driven.metrics["step_p99_us"]


def test_a_drive_that_leaves_the_road_says_how_far_it_came() -> None:
    driven = drive(STEP.with_(vehicle={"friction": 0.12}), "pure-pursuit")
    assert driven.metrics["held"] == 0.0
    assert 0.1 < driven.metrics["rounds"] < 0.9
    assert np.abs(driven.trajectory["e"]).max() <= 3.0
    assert driven.metrics["max_e"] > 0.5


@pytest.mark.parametrize("setting", ["default", "sb3-dqn"])
def test_the_output_element_ends_at_the_cars_stops(setting: str) -> None:
    learned: Any = PolicyBlock if setting in SETTINGS else NfqPolicy
    policy = Policy(object.__new__(learned), setting)
    assert policy.element(replace(PASSAT, delta_sw_max=9.9)).limit == 9.9  # type: ignore[attr-defined]


def test_a_learned_controller_needs_its_training() -> None:
    with pytest.raises(ValueError, match="give the policy of a training"):
        drive(STEP, "nfq-idoe")


def log_of(metres: float, *, learned: bool = False, **changes: Any) -> Log:
    """A drive of so many metres at 5 m/s and 20 Hz, straight on at e = 0.1 m; changes: functions of progress."""
    t = np.arange(round(20.0 * metres / V) + 1) * 0.05
    progress = V * t
    zero = ("path.psi_e", "car.psi", "car.delta_sw", "actuator.rate", "car.a_y")
    signals = {
        "path.s": progress + 5.0,
        "path.progress": progress,
        "car.x": progress + 5.0,
        "car.v": np.full_like(t, V),
    }
    signals |= dict.fromkeys(("path.e", "car.y"), np.full_like(t, 0.1)) | dict.fromkeys(zero, np.zeros_like(t))
    if learned:
        signals["supervisor.learning"] = np.ones_like(t)
    signals |= {name.replace("__", "."): change(progress) for name, change in changes.items()}
    return Log(t, signals, dict.fromkeys(signals, "1"))


def outcome(log: Log, scenario: Scenario = SCENARIO) -> dict[str, float]:
    return judged(log, scenario, PATH, LOOP)[0]


def from_200(e: float) -> Any:
    return lambda progress: np.where(progress > 200.0, e, 0.1)


def caught(progress: Any) -> Any:
    """Recovery takes over at 100 m, and lets go again at 150 m."""
    return np.where((progress > 100.0) & (progress < 150.0), 0.0, 1.0)


@pytest.mark.parametrize(
    ("metres", "learned", "changes", "held", "until"),
    [
        *((LENGTH + 1.0, learned, {}, 1.0, LENGTH) for learned in (False, True)),
        *((share * LENGTH, False, {}, 0.0, share * LENGTH) for share in (0.0, 0.5, 0.999)),
        (0.5 * LENGTH, True, {}, 0.0, 0.5 * LENGTH),
        (LENGTH + 1.0, True, {"supervisor__learning": caught}, 0.0, 100.0),
        (LENGTH + 1.0, True, {"path__e": from_200(0.6)}, 0.0, 200.0),
        *((LENGTH + 1.0, False, {"path__e": from_200(e)}, 0.0, 200.0) for e in (3.1, -3.1, math.nan)),
        *((LENGTH + 1.0, False, {"path__e": from_200(e)}, held, LENGTH) for e, held in ((0.5, 1.0), (-0.51, 0.0))),
        (LENGTH + 30.0, False, {"path__e": lambda p: np.where(p > LENGTH + 1.0, 2.0, 0.1)}, 1.0, LENGTH),
    ],
)
def test_a_drive_is_judged_until_its_end_or_until_it_is_lost(
    metres: float, learned: bool, changes: dict[str, Any], held: float, until: float
) -> None:
    """An analytic one beyond half a metre goes on; a learned one that was caught is lost, whoever brought it home."""
    metrics = outcome(log_of(metres, learned=learned, **changes))
    assert metrics["held"] == held
    assert metrics["rounds"] == pytest.approx(until / LENGTH, abs=0.001)
    assert metrics["duration"] == pytest.approx(until / V, abs=0.06)
    if held and not changes:
        assert (metrics["rms_e"], metrics["max_e"]) == (pytest.approx(0.1), pytest.approx(0.1))


def test_of_several_rounds_their_number_is_told() -> None:
    twice = SCENARIO.with_(course={"rounds": 2.0})
    assert outcome(log_of(2.0 * LENGTH + 1.0), twice)["rounds"] == 2.0
    assert outcome(log_of(1.5 * LENGTH), twice)["rounds"] == pytest.approx(1.5, abs=0.002)
    assert outcome(log_of(1.5 * LENGTH), twice)["held"] == 0.0


def test_too_short_a_drive_has_no_metrics_but_what_became_of_it() -> None:
    assert set(outcome(log_of(5.0))) == {"held", "rounds", "duration"}


def test_the_front_axle_is_judged_where_it_is() -> None:
    """A car at y = 0.1 m that points 0.05 rad to the left has its front axle l_f sin(0.05) further left."""
    at_front = outcome(log_of(LENGTH + 1.0))
    assert at_front["rms_e_front"] == pytest.approx(at_front["rms_e"])
    own = suite_loop(SCENARIO, PurePursuit.of(SCENARIO.nominal, PATH))
    assert own.blocks["path"].reference != SCENARIO.nominal.l_f  # type: ignore[attr-defined]
    log = log_of(LENGTH + 1.0, car__psi=lambda p: np.full_like(p, 0.05))
    metrics, _ = judged(log, SCENARIO, PATH, own)
    expected = 0.1 + SCENARIO.nominal.l_f * math.sin(0.05)
    assert metrics["rms_e_front"] == pytest.approx(expected, abs=1e-6)
    assert metrics["rms_e"] == pytest.approx(0.1)


def test_a_trajectory_is_thinned_out_from_its_start_to_its_end() -> None:
    log = log_of(LENGTH + 1.0)
    _, trajectory = judged(log, SCENARIO, PATH, LOOP)
    assert set(trajectory) == set(TRAJECTORY)
    t = trajectory["t"]
    assert 700 < len(t) <= 1500
    assert (t[0], t[-1]) == (0.0, pytest.approx(LENGTH / V, abs=0.2))
    np.testing.assert_allclose(np.diff(t), t[1], atol=1e-9)
    np.testing.assert_allclose(trajectory["x"], 5.0 + V * t, atol=1e-9)
