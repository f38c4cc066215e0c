"""The catalogue: one recipe a controller, and what it is told is what it gets."""

import json
import logging
from dataclasses import replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.entries import controller as entry
from steerkit.car.config import load, shipped
from steerkit.car.loop import controller_named, design_model_of
from steerkit.controllers.adaptive import Adaptive
from steerkit.controllers.margins import Doubt, SteeredCar, least_damping
from steerkit.controllers.pure_pursuit import PurePursuit
from steerkit.controllers.stanley import Stanley
from steerkit.diagram.block import Block
from steerkit.diagram.simulation import simulate
from steerkit.diagram.units import radians_of
from steerkit.doe import WithElement
from steerkit.paths.courses import course
from steerkit.plants.single_track import LinearSingleTrack
from steerkit.scenario import Scenario, catalogue
from steerkit.scenario.catalogue import CONTROLLERS, DesignModel, make_controller, make_element, make_recovery
from steerkit.scenario.drive import assembled
from steerkit.vehicles import vehicle
from steerkit.vehicles.rollout import Rollout
from tests.support.own_controller import own_controller
from tests.support.places import ROOT

BELIEF = DesignModel(vehicle=vehicle("vw-passat"), path=course("circle"), delay=0.1, lag=0.12)
NARROW = replace(BELIEF, vehicle=replace(BELIEF.vehicle, delta_sw_max=radians_of(300.0)), rate_limit=radians_of(200.0))


def limits(block: Any, name: str) -> list[float]:
    """The limit of that name of a block and of those inside it."""
    inner = [getattr(block, part) for part in ("block", "fallback") if isinstance(getattr(block, part, None), Block)]
    here = [float(getattr(block, name))] if hasattr(block, name) else []
    return here + [value for one in inner for value in limits(one, name)]


@pytest.mark.parametrize("name", CONTROLLERS)
def test_every_controller_keeps_to_the_car_and_the_motor_that_it_is_told(name: str) -> None:
    block = make_controller(name, NARROW)
    stops = [block.vehicle.delta_sw_max] if isinstance(block, PurePursuit) else limits(block, "limit")
    assert set(stops) == {radians_of(300.0)}
    if name != "stanley-textbook":  # which has no limits but the stop
        assert set(limits(block, "rate_limit")) <= {radians_of(200.0)}


@pytest.mark.parametrize("name", catalogue.ELEMENTS)
def test_an_element_ends_at_the_stops(name: str) -> None:
    doe = make_element(name, NARROW.vehicle)
    assert doe.output(0.0, doe.init(), doe.D(action=9.0)).delta_sw <= radians_of(300.0)
    assert make_element(name).limit == radians_of(520.0)


def test_a_safety_filter_is_told_what_the_others_are() -> None:
    filter = catalogue.make_safety(replace(NARROW, delay=0.15, lag=0.07, rate_limit=3.0))
    model, law = filter.backup.model, filter.backup.block
    assert (model.delay, model.lag, model.rate_limit, law.rate_limit) == (0.15, 0.07, 3.0, 3.0)
    assert (law.limit, model.steer_ratio) == (radians_of(300.0), NARROW.vehicle.steer_ratio)


@pytest.mark.parametrize("name", CONTROLLERS)
def test_whoever_asks_gets_the_same_controller_but_for_hold_and_budget(name: str) -> None:
    config = replace(load("dbw-kit.toml"), delay=0.1, lag=0.12)
    scenario = Scenario(name="x", steering={"delay": 0.1, "lag": 0.12})
    car, bench = controller_named(name, config).block, entry(name).make(scenario)  # type: ignore[misc]
    assert unhurried(parameters(car)) == unhurried(parameters(bench))
    design_model = design_model_of(config)
    assert (design_model.hold, design_model.delay, design_model.rate_limit) == (0.0, 0.1, radians_of(550.0))


def unhurried(numbers: dict[str, Any]) -> dict[str, Any]:
    """Without what hold and budget make different: of a predictive controller, wherever it is."""
    own = {"delay", "budget", "preview_points"} if "horizon" in numbers else set()
    return {
        key: unhurried(value) if isinstance(value, dict) else value for key, value in numbers.items() if key not in own
    }


def parameters(block: Any) -> dict[str, Any]:
    """The numbers and words in a block and in those inside it."""
    known = {k: v for k, v in vars(block).items() if not isinstance(getattr(type(block), k, None), cached_property)}
    own = {key: value for key, value in known.items() if isinstance(value, int | float | str)}
    inner = {key: parameters(value) for key, value in known.items() if isinstance(value, Block | Rollout)}
    several = known.get("blocks", ())
    return own | inner | {f"block {k}": parameters(one) for k, one in enumerate(several) if isinstance(one, Block)}


LATE = replace(BELIEF, delay=0.55, lag=0.0, hold=0.01, slew=5.0, a_y_limit=1.5, offset=0.03, gain=0.8)


@pytest.mark.parametrize("name", [*CONTROLLERS, *(f"recovery {name}" for name in catalogue.RECOVERIES), "safety"])
def test_each_name_makes_what_is_written_down(name: str) -> None:
    """For an angle and for a torque; who changes it on purpose renews its line in tests/golden/catalogue.json."""
    makes = catalogue.make_safety if name == "safety" else partial(make_controller, name)
    makes = partial(make_recovery, name.removeprefix("recovery ")) if name.startswith("recovery") else makes
    models = (BELIEF, replace(BELIEF, delay=0.0)) if name == "safety" else (BELIEF, LATE)
    found = json.loads(
        json.dumps([parameters(makes(model)) for model in models]), parse_float=lambda x: f"{float(x):.6g}"
    )
    assert found == json.loads((ROOT / "tests/golden/catalogue.json").read_text()).get(name), json.dumps({name: found})


@pytest.mark.parametrize(
    ("ask", "message"),
    [
        (lambda: catalogue.make_safety(replace(BELIEF, slew=5.0)), "slew = 5.0 .*expected none: the filter is for"),
        (lambda: make_recovery("lqr", BELIEF), "recovery 'lqr' is not known.*; valid: auto, adaptive, stanley"),
        (lambda: make_element("integral"), "did you mean 'integrator'"),
        (lambda: replace(BELIEF, lag=-1.0), r"lag = -1.0 \[s\], expected 0 to 10"),
        (lambda: replace(BELIEF, delay=3.0), r"delay = 3.0 \[s\], expected 0 to 2"),
        (lambda: replace(BELIEF, rate_limit=0.0), "rate_limit = 0.0"),
    ],
)
def test_what_cannot_be_made_says_what_can(ask: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        ask()


def test_a_recovery_that_drives_alone_watches_nobodys_commands() -> None:
    alone = make_recovery("auto", BELIEF, alone=True)
    assert "doe" not in {port.name for port in alone.inputs}


@pytest.mark.parametrize(("delay", "longest"), [(0.4, 0.8), (0.71, 0.9), (0.8, 0.9), (2.0, 2.0)])
def test_the_recovery_is_made_for_a_longer_dead_time_than_is_believed(delay: float, longest: float) -> None:
    block = make_recovery("auto", replace(BELIEF, delay=delay, lag=0.1))
    assert isinstance(block, Adaptive)
    assert block.delays[-1] == pytest.approx(longest)
    assert block.prior_delay == pytest.approx(min(delay + 0.1, 2.0))
    assert min(block.delay.longest, block.steering.longest) >= longest - 1e-9


@pytest.mark.parametrize("name", ["stanley-adaptive", "lqr-adaptive", "auto"])
def test_an_adaptive_controller_does_not_hang_on_the_lag_told(name: str) -> None:
    """Its drive begins later where a long one is told, that of a recovery with all that is told."""
    make = make_recovery if name == "auto" else make_controller
    one, other, late = (make(name, replace(BELIEF, delay=0.2, lag=lag)) for lag in (0.02, 0.2, 0.35))
    assert isinstance(one, Adaptive)
    assert isinstance(late, Adaptive)
    begins = dict(prior_delay=0.1, delay=replace(one.delay, prior_delay=0.1))
    assert (
        parameters(replace(one, **begins))
        == parameters(replace(other, **begins))
        == parameters(replace(late, **begins))
    )
    assert (one.prior_delay, other.prior_delay, late.prior_delay) == (
        pytest.approx((0.22, 0.4, 0.55) if name == "auto" else (0.3, 0.3, 0.45))
    )


def test_by_torque_the_fastest_law_is_taken_that_is_damped_at_all_corners_of_the_doubt() -> None:
    belief = replace(BELIEF, delay=0.5, lag=0.1, slew=5.0, a_y_limit=3.0)
    car = SteeredCar(
        vehicle=belief.vehicle, matrices=LinearSingleTrack(vehicle=belief.vehicle).matrices, delay=0.5, lag=0.1
    )

    def damped(block: Any) -> float:
        return least_damping(block, car, Doubt(gain=1.35, delay=0.1), (5.0, 10.0, 20.0, 30.0))

    recovery: Any = make_recovery("auto", belief)
    law = recovery.blocks[5]
    assert damped(law) >= 0.02
    assert damped(replace(law, time=20.0)) < 0.02 < damped(replace(law, time=30.0))
    faster = replace(law.block.block, v_full=None)
    assert damped(replace(law.block, block=faster)) < 0.02 < damped(law.block)
    lqr: Any = make_controller("lqr-adaptive", belief)
    assert damped(lqr.blocks[5].block) >= 0.02
    assert damped(make_controller("lqr", belief)) < 0.0, "made for what is told alone"


def test_that_a_slower_law_is_taken_or_none_is_slow_enough_is_said(monkeypatch: Any, caplog: Any) -> None:
    """Of laws of which the fastest two are damped too little, and then of which all are."""
    belief, ratios = replace(BELIEF, delay=0.2, lag=0.1, slew=5.0), {1.0: -0.1, 0.5: 0.01, 0.2: 0.03, 0.1: 0.3}
    monkeypatch.setattr(catalogue, "least_damping", lambda block, *_: ratios[block.k])

    def chosen(*numbers: float) -> float:
        caplog.clear()
        with caplog.at_level(logging.INFO, logger="steerkit.scenario.catalogue"):
            return catalogue._fastest(numbers, lambda k: replace(Stanley.of(belief.vehicle), k=k), belief)

    assert chosen(0.2, 0.1) == 0.2
    assert not caplog.records
    assert chosen(1.0, 0.5, 0.2, 0.1) == 0.2
    assert "by torque: law 3 of 4, as faster ones have no margin for what is doubted" in caplog.text
    assert caplog.records[0].levelno == logging.INFO
    assert chosen(1.0, 0.5) == 0.5
    assert "damping ratio 0.010 within gain 0.74 to 1.35, +-0.1 s, expected 0.02 or more" in caplog.text
    assert caplog.records[0].levelno == logging.WARNING


# ---- a user's own -----------------------------------------------------------------------------------------------


def test_a_controller_of_ones_own_is_told_what_the_others_are(tmp_path: Path) -> None:
    name = own_controller(tmp_path)
    block = make_controller(name, replace(BELIEF, vehicle=vehicle("bmw-320i")))
    assert (block.steer_ratio, block.reference) == (16.0, vehicle("bmw-320i").l_f)  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("thing", "message"),
    [
        ("nothing", "returned None, expected a Block with an output delta_sw"),
        ("kind", "returned the class Mine, expected a Block"),
        ("unlucky", "failed: AttributeError: 'DesignModel' object has no attribute 'colour'"),
        ("element", r"PathTracker has the outputs s \[m\].*expected a Block with an output delta_sw \[rad\]"),
        ("number", "of type int, expected a function of a DesignModel"),
    ],
)
def test_what_is_no_controller_is_said_in_one_line(thing: str, message: str, tmp_path: Path) -> None:
    name = own_controller(tmp_path).replace(":make", f":{thing}")
    with pytest.raises(ValueError, match=message) as refused:
        make_controller(name, BELIEF)
    assert "\n" not in str(refused.value)
    assert str(refused.value).startswith(f"controller '{name}'")


def test_a_policy_with_its_element_steers_as_both_do_apart(tmp_path: Path) -> None:
    """In one block or in two; and from the angle that the wheel has, wherever it sets out."""
    scenario = Scenario.under("clean", course="genesis-rfs", steering={"lag": 0.15})
    one: Any = make_controller(own_controller(tmp_path).replace(":make", ":agent"), scenario.design_model())
    apart = assembled(scenario, one.block, doe=one.element)
    logs = [simulate(loop, 20.0) for loop in (assembled(scenario, one), apart)]
    assert (logs[0]["controller.delta_sw"] == logs[1]["doe.delta_sw"]).all()
    assert np.ptp(logs[0]["path.e"]) > 1e-3
    begun = one.settle(0.0, one.init(), one.D(*[0.3 if name == "delta_sw_meas" else 0.0 for name in one.D._fields]))
    assert begun[-1] == 0.3
    with pytest.raises(ValueError, match="WithElement: Mine with outputs delta_sw; expected among them action"):
        WithElement(block=make_controller(own_controller(tmp_path), BELIEF))


def test_a_car_refuses_what_its_file_does_not_allow(tmp_path: Path) -> None:
    name, config = own_controller(tmp_path), load("dbw-kit.toml")
    with pytest.raises(ValueError, match=r"not allowed; .*\[controllers\] allow = .*; allowed are: none"):
        controller_named(name, config)
    assert controller_named(name, replace(config, controllers=(name,))).steers.name == name
    with pytest.raises(ValueError, match="not allowed"):
        controller_named(name.replace(":make", ":nothing"), replace(config, controllers=(name,)))
    text = shipped("dbw-kit.toml").read_text()
    (tmp_path / "car.toml").write_text(f'{text}\n[controllers]\nallow = ["my_file.py:make"]\n')
    assert load(tmp_path / "car.toml").controllers == ("my_file.py:make",)
    (tmp_path / "car.toml").write_text(f'{text}\n[controllers]\nallow = ["stanley"]\n')
    with pytest.raises(ValueError, match=r"\[controllers\] allow: 'stanley', expected names such as 'my_file.py:make'"):
        load(tmp_path / "car.toml")
