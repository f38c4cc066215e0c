"""Scenarios, the plants that only benchmarks drive, the courses made for them, and drives."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.entries import CONTROLLERS, controller
from benchmarks.peers import agents as peers
from benchmarks.peers.commonroad import CommonRoadMultiBody
from benchmarks.run.drives import drive
from benchmarks.run.trainings import TRAININGS
from benchmarks.scenarios import Scenario
from benchmarks.suites import SUITES, jobs, suite
from steerkit.block import Block
from steerkit.courses import course, curvature_step, lane_change, slalom
from steerkit.learning.settings import SETTINGS
from steerkit.plants.linear_single_track import LinearSingleTrack
from steerkit.plants.nonlinear_single_track import NonlinearSingleTrack
from steerkit.plants.pushed import Pushed
from steerkit.units import radians_of
from steerkit.vehicles import G, vehicle

STEP = Scenario(name="step", course="curvature-step", v_min=7.0, v_max=7.0)
PASSAT = vehicle("vw-passat")


# ---- courses


@pytest.mark.parametrize("part", [1, 2])
@pytest.mark.parametrize("speed", [4.0, 9.0])
def test_lane_changes_ask_the_lateral_acceleration_they_are_made_for(part: int, speed: float) -> None:
    path = lane_change(part, speed=speed, a_y=3.0)
    s = np.linspace(0.0, path.length, 4000)
    assert speed**2 * np.abs(path.kappa(s)).max() == pytest.approx(3.0, rel=0.1)
    x, y = path.point(s).T
    offset = {1: 3.5, 2: 1.0 + 0.5 * (1.1 * 1.82 + 0.25 + 1.82 + 1.0)}[part]
    assert (y.min(), y.max()) == (pytest.approx(0.0, abs=1e-3), pytest.approx(offset, abs=1e-3))
    sections = {1: (15.0, 30.0, 25.0, 25.0, 30.0), 2: (12.0, 13.5, 11.0, 12.5, 12.0)}[part]
    whole = x.max() - x.min() - 60.0
    there = x[y > offset - 1e-6]
    assert (there.max() - there.min()) / whole == pytest.approx(sections[2] / sum(sections), rel=0.15)


def test_slalom_and_step() -> None:
    path = slalom(5, spacing=20.0, offset=1.5)
    s = np.linspace(0.0, path.length, 4000)
    _, y = path.point(s).T
    assert (y.min(), y.max()) == (pytest.approx(-1.5, abs=1e-3), pytest.approx(1.5, abs=1e-3))
    path = curvature_step(20.0, turn_deg=90.0)
    bend = 0.5 * math.pi * 20.0
    assert path.length == pytest.approx(60.0 + bend, rel=1e-3)
    assert path.kappa(30.0 + 0.5 * bend) == pytest.approx(0.05, rel=1e-3)
    assert abs(path.kappa(28.0)) < 2e-3
    assert abs(path.kappa(path.length - 28.0)) < 2e-3


@pytest.mark.parametrize(
    "make",
    [
        lambda: lane_change(3),
        lambda: lane_change(1, speed=0.0),
        lambda: slalom(0),
        lambda: slalom(spacing=-1.0),
        lambda: curvature_step(0.1),
        lambda: curvature_step(turn_deg=350.0),
    ],
)
def test_bad_courses(make) -> None:
    with pytest.raises(ValueError, match=r"expected|valid|> 0"):
        make()


# ---- plants


def straight_on(car: Block, seconds: float, delta_sw: float = 0.0, v: float = 7.0) -> tuple[list, list]:
    x, outputs = car.init(), []
    for k in range(round(seconds / car.dt)):
        outputs.append(car.output(k * car.dt, x, ()))
        x = car.update(k * car.dt, x, car.U(delta_sw, v), outputs[-1])
    return list(x), outputs


@pytest.mark.parametrize("kind", [LinearSingleTrack, NonlinearSingleTrack])
def test_a_bank_turns_the_car_as_its_steady_state_says(kind) -> None:
    """Steady, wheels straight: m v r = F_f + F_r + m a and l_f F_f = l_r F_r, linear in (beta, r)."""
    a, v, p = 0.3, 7.0, PASSAT
    inner = kind(vehicle=p, v0=v)
    _, ys = straight_on(Pushed(block=inner, bank=a), 6.0, v=v)
    matrix = np.array(
        [
            [-(p.c_f + p.c_r), (p.c_r * p.l_r - p.c_f * p.l_f) / v - p.m * v],
            [p.c_r * p.l_r - p.c_f * p.l_f, -(p.c_f * p.l_f**2 + p.c_r * p.l_r**2) / v],
        ]
    )
    beta, r = np.linalg.solve(matrix, [-p.m * a, 0.0])
    assert ys[-1].beta == pytest.approx(beta, rel=0.03)  # what is left of the splitting at dt = 10 ms
    assert ys[-1].r == pytest.approx(r, rel=0.03)
    assert ys[-1].a_y == pytest.approx(v * r, abs=0.03 * a)


def test_no_push_is_the_car_itself_and_gusts_follow_their_seed() -> None:
    inner = NonlinearSingleTrack(vehicle=PASSAT, v0=7.0)
    (*x, _, _, _, _, _, _, _), _ = straight_on(Pushed(block=inner), 1.0, 0.5)
    assert x == straight_on(inner, 1.0, 0.5)[0]
    gusty = Pushed(block=inner, gust=0.2, seed=1)
    assert straight_on(gusty, 2.0)[0] == straight_on(gusty, 2.0)[0] != straight_on(replace(gusty, seed=2), 2.0)[0]
    _, ys = straight_on(Pushed(block=inner, gust=0.2, gust_time=0.05), 60.0)
    pushes = np.diff([y.r for y in ys])
    assert abs(np.mean(pushes)) < 0.1 * np.std(pushes)
    with pytest.raises(ValueError, match="gust = -1"):
        Pushed(block=inner, gust=-1.0)


def test_the_multi_body_car_corners_like_its_single_track_where_that_holds() -> None:
    pytest.importorskip("vehiclemodels")
    v, delta_sw = 5.0, 0.4
    _, ours = straight_on(NonlinearSingleTrack(vehicle=vehicle("bmw-320i"), v0=v), 3.0, delta_sw, v)
    body = CommonRoadMultiBody(v0=v)
    _, theirs = straight_on(body, 3.0, delta_sw, v)
    assert theirs[-1].r == pytest.approx(ours[-1].r, rel=0.05)
    assert theirs[-1].a_y == pytest.approx(ours[-1].a_y, rel=0.05)
    assert theirs[-1].v == pytest.approx(v, rel=0.02)
    assert theirs[-1].delta_sw == delta_sw
    assert math.isnan(body.update(0.0, (math.nan, *body.init()[1:]), body.U(0.0, v), None)[3])
    with pytest.raises(ValueError, match="cannot be batched"):
        body.init((2,))
    with pytest.raises(ValueError, match="valid: bmw-320i, ford-escort"):
        CommonRoadMultiBody(name="vw-passat")


# ---- scenarios and suites


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"course": "papr"}, "did you mean 'paper'"),
        ({"plant": "bicycle"}, "valid: nonlinear, linear, commonroad-mb"),
        ({"speed": "fast"}, "valid: wander, recorded"),
        ({"v_min": 9.0}, "v_min = 9.0, v_max = 7.5"),
        ({"tyres": 0.0}, "tyres = 0.0"),
        ({"noise": -1.0}, "noise -1.0"),
        ({"name": "a--b"}, "holds '--'"),
        ({"plant": "commonroad-mb", "vehicle_name": "bmw-320i", "wind": 1.0}, "multi-body car has no other"),
    ],
)
def test_bad_scenarios(changes: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Scenario(**({"name": "x"} | changes))


def test_what_is_wrong_with_the_car_is_not_told() -> None:
    scenario = Scenario(name="x", tyres=0.7, friction=0.5, ratio=1.1, delay=0.2, told_delay=0.0)
    true = scenario.true_vehicle
    assert (true.c_f, true.mu, true.steer_ratio) == (0.7 * PASSAT.c_f, 0.5 * PASSAT.mu, 1.1 * PASSAT.steer_ratio)
    assert scenario.nominal == PASSAT
    assert scenario.told_dead_time == 0.0
    assert Scenario(name="x", delay=0.2, latency=0.05).told_dead_time == 0.25
    banked = Scenario(name="y", bank_deg=2.0)
    car = banked.loop(banked.path(), controller("stanley").make(banked, banked.path())).blocks["car"]  # type: ignore[misc]
    assert car.bank == pytest.approx(G * math.sin(radians_of(2.0)))


def test_suites_hang_together() -> None:
    for one in SUITES.values():
        planned = jobs([one])
        assert len({job.id for job in planned}) == len(planned)
        for scenario in one.scenarios:
            assert scenario.path().length > 10.0
        for name in one.controllers:
            learner = controller(name)
            assert (learner.make is None) == learner.learns
            assert not learner.learns or learner.setting in {*SETTINGS, *peers.SETTINGS}
            assert learner.training in TRAININGS
        needed = {
            job.training for job in planned if job.kind == "drive" and CONTROLLERS[job.controller].kind == "learned"
        }
        assert needed <= {job.id for job in planned if job.kind == "learn"}
    both = jobs([suite("paper"), suite("tracking")])
    assert sum(job.kind == "learn" for job in both) == 60  # shared, not learned twice
    assert len(jobs([suite("tracking")], 1)) == 3 + 14 * 10
    assert {job.scenario for job in jobs([suite("tracking")], only=["slalom-9"])} == {"slalom-9", "train-clean"}


@pytest.mark.parametrize(
    ("ask", "message"),
    [
        (lambda: suite("trackin"), "did you mean 'tracking'"),
        (lambda: controller("stanly"), "did you mean 'stanley'"),
        (lambda: jobs([suite("golden")], only=["nothing"]), "--only nothing: no scenario or controller"),
    ],
)
def test_unknown_names(ask, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        ask()


# ---- drives


def test_compiled_with_open_parameters_is_the_interpreted_drive() -> None:
    from steerkit.simulation import simulate

    scenario = replace(STEP, tyres=0.8, offset_deg=1.0, wind=0.2, gust=0.1, noise=1.0, latency=0.05)
    path = scenario.path()
    block = controller("stanley").make(scenario, path)  # type: ignore[misc]
    driven = drive(scenario, "stanley", seed=3)
    log = simulate(scenario.loop(path, block, seed=3), 15.0, record=["path.e", "car.a_y"], every=5)
    e = driven.trajectory["e"][:300]
    assert np.abs(e - log["path.e"][:300]).max() < 1e-9
    assert driven.metrics["max_e"] == pytest.approx(np.abs(driven.trajectory["e"]).max(), rel=1e-12)
    assert driven.metrics["held"] == 1.0


def test_a_drive_that_leaves_the_road_says_how_far_it_came() -> None:
    driven = drive(replace(STEP, friction=0.12), "pure-pursuit")
    assert driven.metrics["held"] == 0.0
    assert 0.1 < driven.metrics["rounds"] < 0.9
    assert np.abs(driven.trajectory["e"]).max() <= 3.0
    assert driven.metrics["max_e"] > 0.5


def test_errors_are_judged_at_the_own_point_and_at_the_front_axle() -> None:
    front = drive(STEP, "stanley").metrics
    assert front["rms_e_front"] == front["rms_e"]
    rear = drive(STEP, "pure-pursuit", timed_steps=50).metrics
    # with the rear axle on an arc, the front one runs sqrt(R^2 + L^2) - R outside it
    outside = math.hypot(27.0, PASSAT.wheelbase) - 27.0
    assert rear["max_e_front"] == pytest.approx(outside + rear["rms_e"], abs=0.08)
    assert rear["max_e"] < 0.1
    assert 0.0 < rear["step_p50_us"] <= rear["step_p99_us"]


def test_a_learned_controller_needs_its_training() -> None:
    with pytest.raises(ValueError, match="give the policy of a training"):
        drive(STEP, "nfq-idoe")


def test_course_names_include_the_manoeuvres() -> None:
    for name in ("iso3888-1", "iso3888-2", "slalom", "curvature-step"):
        assert not course(name).closed


# ---- peers


def test_a_missing_peer_is_a_row_of_its_own(monkeypatch: pytest.MonkeyPatch, tmp_path) -> None:
    from benchmarks import entries as controllers
    from benchmarks.run import runner
    from benchmarks.suites import Suite

    absent = replace(controller("do-mpc"), needs="no_such_package")
    monkeypatch.setitem(controllers.CONTROLLERS, "do-mpc", absent)  # type: ignore[arg-type]
    one = Suite(name="golden", about="", scenarios=(STEP,), controllers=("do-mpc",))
    (case,) = runner.run([one], tmp_path / "x", workers=1, quiet=True).cases
    assert case.status == "not installed"
    assert case.error == "no-such-package is not installed: pip install 'steerkit-control[peers]'"


def test_do_mpc_holds_a_steady_bend_and_steers_back_onto_the_path() -> None:
    pytest.importorskip("do_mpc")
    block = controller("do-mpc").make(STEP, STEP.path())  # type: ignore[misc]
    p, v, kappa = PASSAT, 7.0, 1.0 / 27.0
    # the front axle on the circle: v_front = r/kappa, sideways of it against the path 0
    delta = (p.wheelbase + p.understeer_gradient * v**2) * kappa
    beta = p.l_r * kappa - p.m * p.l_f * v**2 * kappa / (p.c_r * p.wheelbase)
    psi_e = -math.atan2(math.sin(beta) + p.l_f * kappa, math.cos(beta))
    steady = block.U(0.0, psi_e, v, beta, v * kappa, p.steer_ratio * delta, (kappa,) * 21)
    command = block.output(0.0, (p.steer_ratio * delta,), steady).delta_sw
    assert command == pytest.approx(p.steer_ratio * delta, rel=0.05)
    left = block.U(0.1, 0.0, v, 0.0, 0.0, 0.0, (0.0,) * 21)
    assert block.output(0.0, (0.0,), left) == block.output(0.0, (0.0,), left)
    right = block.output(0.0, (0.0,), left._replace(e=-0.1)).delta_sw
    assert block.output(0.0, (0.0,), left).delta_sw == pytest.approx(-right, rel=1e-3)
    assert right > 0.01
    with pytest.raises(ValueError, match="cannot be batched"):
        block.init((2,))


def test_an_agent_learns_the_same_again_and_its_net_drives() -> None:
    pytest.importorskip("stable_baselines3")
    from benchmarks.run.drives import Policy

    one, two = (peers.stable_baselines("DQN", steps=400, seed=1, judge=lambda block: {"held": 0.0}) for _ in range(2))
    assert list(one[1]["iterations"]) == list(range(1, 11))
    assert one[1]["transitions"][-1] >= 400.0
    first, again = (np.concatenate([w.ravel() for w, _ in block.policy.layers]) for block, _ in (one, two))  # type: ignore[attr-defined]
    assert (first == again).all()
    driven = drive(STEP, "sb3-dqn", policy=Policy(one[0], "sb3-dqn"))
    assert 0.0 < driven.metrics["rounds"] <= 1.0


def test_d3rlpy_learns_from_a_record(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("d3rlpy")
    from steerkit.learning.data.transitions import Transitions
    from steerkit.learning.settings import DEFAULT

    rng = np.random.default_rng(0)
    record = Transitions()
    s = rng.normal(size=(301, 6)) * 0.1
    record.extend(s[:-1], rng.choice(DEFAULT.actions, 300), s[1:], np.arange(300) // 100)
    asked = []
    block, curve = peers.d3rlpy_nfq(
        record,
        DEFAULT,
        steps=50,
        seed=0,
        judge=lambda b: asked.append(b) or {"held": 0.0},  # type: ignore[func-returns-value]
    )
    assert len(asked) == 10
    assert set(block.policy(rng.normal(size=(50, 6)))) <= set(range(7))  # type: ignore[attr-defined]
    assert (curve["transitions"] == 300.0).all()
