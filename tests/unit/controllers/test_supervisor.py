"""Who steers: trip and release, faults, and hand-overs without a jump."""

import logging
import math
from dataclasses import dataclass
from typing import Any

import casadi
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from steerkit.controllers.supervisor import ExceptionGuard, Supervisor, SupervisorState
from steerkit.diagram.block import Block, In, Out
from steerkit.diagram.loop import Loop
from steerkit.diagram.simulation import Log, simulate
from steerkit.diagram.units import radians_of
from steerkit.doe import Integrator
from tests.support.parts import Script

ON = (1.0,)


def drive(e: Any = (0.0,), learner: Any = ON, ready: Any = ON, recovery: Any = (3.0,)) -> Log:
    """The supervisor's answers to signals written down sample by sample, each of which holds its last value."""
    supervisor, signals = Supervisor(), dict(e=e, learner=learner, recovery=recovery, ready=ready)
    scripts = {name: Script(values=tuple(map(float, values))) for name, values in signals.items()}
    ports = dict(e="length", learner="angle", recovery="angle", ready="flag")
    wires = [(getattr(scripts[name], port), getattr(supervisor, name)) for name, port in ports.items()]
    record = [f"supervisor.{name}" for name in ("delta_sw", "learning", "tripped", "fault", "within")]
    loop = Loop(blocks={**scripts, "supervisor": supervisor}, wires=wires)
    return simulate(loop, max(map(len, (e, learner, ready))) * 0.05, record=record, allow_nonfinite=True)


NAN = math.nan
LOCK, MORE = radians_of(520.0), radians_of(521.0)
LATCHED = dict(learning=[1, 1, 0, 0, 0, 0, 1], fault=[0, 0, 1, 1, 1, 0, 0], tripped=[0] * 7)


@pytest.mark.parametrize(
    ("given", "answers"),
    [
        (  # trip at half a metre, release at ten centimetres
            dict(e=[0.3, 0.10, 0.09, 0.4, -0.5, -0.51, -0.2, 0.1, -0.099]),
            dict(learning=[0, 0, 1, 1, 1, 0, 0, 0, 1], tripped=[0, 0, 0, 0, 0, 1, 0, 0, 0], fault=[0] * 9),
        ),
        (  # it waits until it is ready and gives up when it is not
            dict(ready=[0, 0, 1, 1, 0, 1]),
            dict(learning=[0, 0, 1, 1, 0, 1], tripped=[0] * 6),
        ),
        *[  # a fault takes the wheel at once and is latched until the learner was not ready
            (dict(learner=[1.0, 1.0, bad, 1.0, 1.0, 1.0, 1.0], ready=[1, 1, 1, 1, 1, 0, 1]), LATCHED)
            for bad in (NAN, math.inf, -math.inf, MORE, -MORE)
        ],
        (  # one that cannot say whether it is ready is faulty
            dict(learner=[1.0, NAN, 1.0, 1.0, 1.0], ready=[1, NAN, 1, 0, 1]),
            dict(learning=[1, 0, 0, 0, 1], fault=[0, 1, 1, 0, 0]),
        ),
        (dict(ready=[NAN]), dict(fault=[1])),
        (dict(e=[0.3, 0.3, 0.0], learner=[NAN, 1.0]), dict(learning=[0, 0, 0], fault=[1, 1, 1])),  # while waiting
        (dict(learner=[LOCK, -LOCK]), dict(learning=[1, 1])),  # the full lock itself is none
        (  # a lost position takes the wheel
            dict(e=[0.0, NAN, NAN, 0.2, 0.0]),
            dict(learning=[1, 0, 0, 0, 1], tripped=[0, 1, 0, 0, 0]),
        ),
    ],
)
def test_who_steers(given: dict[str, list[float]], answers: dict[str, list[int]]) -> None:
    log = drive(**given)
    for name, expected in answers.items():
        assert log[f"supervisor.{name}"].tolist() == expected, name
    learner = np.resize(given.get("learner", ON), len(log.t))
    assert log["supervisor.delta_sw"].tolist() == np.where(log["supervisor.learning"] > 0.5, learner, 3.0).tolist()


def test_a_broken_recovery_is_not_hidden_while_it_steers() -> None:
    assert math.isnan(drive(e=[0.3, 0.0], recovery=[NAN])["supervisor.delta_sw"][0])


@given(
    e=st.floats(-1.0, 1.0) | st.just(math.nan),
    learner=st.floats(-15.0, 15.0) | st.sampled_from([math.nan, math.inf]),
    recovery=st.floats(-9.0, 9.0),
    ready=st.sampled_from([0.0, 1.0]),
    before=st.sampled_from([0.0, 1.0]),
    fault=st.sampled_from([0.0, 1.0]),
    waited=st.floats(0.0, 100.0),
)
def test_what_is_steered_is_always_sane(
    e: float, learner: float, recovery: float, ready: float, before: float, fault: float, waited: float
) -> None:
    supervisor = Supervisor()
    y = supervisor.output(0.0, SupervisorState(before, fault, waited), supervisor.D(e, learner, recovery, ready))
    assert abs(y.delta_sw) <= radians_of(520.0) * (1.0 + 1e-9)
    assert y.delta_sw == (learner if y.learning == 1.0 else recovery)
    if y.learning == 1.0:
        assert ready == 1.0
        assert y.fault == 0.0
        assert abs(e) <= 0.5
    assert {y.learning, y.tripped, y.fault} <= {0.0, 1.0}


def test_the_longer_recovery_steers_the_further_off_it_hands_over() -> None:
    """Not nearer than 0.25 m: it hands over when it has steered for 12.5 s, and never beyond the trip."""
    log = drive(e=[0.3] * 150 + [0.2505] * 200)
    assert log["supervisor.learning"].tolist() == [0] * 251 + [1] * 99
    np.testing.assert_allclose(log["supervisor.within"][[0, 100, 200, 251, 349]], [0.1, 0.1, 0.2, 0.251, 0.153])
    far = drive(e=[0.51] * 900 + [0.5] * 2 + [0.49])
    assert far["supervisor.within"].max() == 0.5
    assert far["supervisor.learning"].tolist() == [0] * 902 + [1]
    assert drive(e=[NAN] * 900)["supervisor.learning"].max() == 0.0
    waits = drive(e=[0.4] * 200 + [0.05] * 150 + [0.2] * 10, ready=[0.0] * 350 + [1.0])  # nobody was ready to take over
    np.testing.assert_allclose(waits["supervisor.within"][[200, 250, 300, 359]], [0.2, 0.15, 0.1, 0.1])
    assert waits["supervisor.learning"].max() == 0.0


def test_thresholds_are_within_their_ranges() -> None:
    for wrong in ({"release": 0.0}, {"release": 0.51}, {"trip": 0.09}, {"release": math.nan}, {"trip": math.nan}):
        with pytest.raises(ValueError, match=r"Supervisor: release = .* m, trip = .* m, expected 0 < release <= trip"):
            Supervisor(**wrong)


@settings(max_examples=50)
@given(
    e=st.lists(st.floats(-0.7, 0.7), min_size=2, max_size=20),
    steps=st.lists(st.sampled_from([-60.0, -10.0, 0.0, 10.0, 60.0]), min_size=1, max_size=20),
    recovery=st.lists(st.floats(-9.0, 9.0), min_size=1, max_size=20),
)
def test_whenever_the_learner_steers_the_wheel_moves_by_at_most_one_step(
    e: list[float], steps: list[float], recovery: list[float]
) -> None:
    """A learner with an integrator, which goes on from the angle that the recovery controller has applied."""
    supervisor, doe = Supervisor(), Integrator()
    signals = dict(e=e, policy=[radians_of(a) for a in steps], recovery=recovery, ready=ON)
    scripts = {name: Script(values=tuple(values)) for name, values in signals.items()}
    wires = [
        (scripts["e"].length, supervisor.e),
        (scripts["policy"].angle, doe.action),
        (scripts["recovery"].angle, supervisor.recovery),
        (scripts["ready"].flag, supervisor.ready),
        (doe.delta_sw, supervisor.learner),
        (supervisor.delta_sw, doe.applied),
    ]
    log = simulate(Loop(blocks={**scripts, "doe": doe, "supervisor": supervisor}, wires=wires), len(e) * doe.dt)
    jumps, learning = np.diff(log["supervisor.delta_sw"]), log["supervisor.learning"][1:] == 1.0
    assert (np.abs(jumps[learning]) <= radians_of(60.0) + 1e-12).all()


@dataclass(frozen=True, eq=False, kw_only=True)
class Fragile(Block):
    """Steers 1 rad and counts, until t = 0.1 s; then raises, in output or in update."""

    u = In("m")
    delta_sw = Out("rad")
    fan = Out("m", size="rays")
    rays: int = 3
    where: str = "output"

    def init(self, batch: tuple[int, ...] = ()) -> Any:
        return (0.0,)

    def output(self, t: Any, x: Any, u: Any) -> Any:
        if self.where == "output" and t > 0.09:
            raise ZeroDivisionError("no net")
        return self.Y(1.0, (0.0,) * self.rays)

    def update(self, t: Any, x: Any, u: Any, y: Any) -> Any:
        if self.where == "update" and t > 0.09:
            raise ZeroDivisionError("no net")
        return (x[0] + 1.0,)


@pytest.mark.parametrize("where", ["output", "update"])
def test_an_exception_is_nan_on_all_outputs_and_leaves_the_state_as_it_was(
    where: str, caplog: pytest.LogCaptureFixture
) -> None:
    guard: Any = ExceptionGuard(block=Fragile(where=where))
    x = guard.update(0.0, guard.init(), guard.U(0.0), guard.output(0.0, guard.init(), guard.D(0.0)))
    with caplog.at_level(logging.ERROR, logger="steerkit"):
        y = guard.output(0.1, x, guard.D(0.0))
        after = guard.update(0.1, x, guard.U(0.0), y)
    assert (math.isnan(y.delta_sw), np.isnan(y.fan).tolist()) == (where == "output", [where == "output"] * 3)
    assert (x, after) == ((1.0,), (2.0,) if where == "output" else (1.0,))
    assert f"Fragile.{where} failed at t = 0.1 s" in caplog.text
    assert "ZeroDivisionError: no net" in caplog.text
    with pytest.raises(ZeroDivisionError):  # while a loop is traced
        getattr(guard, where)(casadi.SX(0.1), x, guard.D(0.0), *[y] * (where == "update"))
