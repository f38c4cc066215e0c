"""Drives in C are those of the interpreted loop to the last bit, and what cannot be so is interpreted and says why."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from steerkit._support.native import compiler
from steerkit.compiled import exact
from steerkit.controllers import nfq_native
from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.controllers.supervisor import ExceptionGuard
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, In, Out
from steerkit.diagram.loop import Loop
from steerkit.diagram.simulation import simulate
from steerkit.learning.experiment import Experiment, LearningRun
from steerkit.learning.learner_state import untrained
from steerkit.learning.settings import DEFAULT, SETTINGS, Setting
from steerkit.scenario import Scenario, ahead
from steerkit.scenario.ahead import Driver, PolicyProgram, Refused, driven, program_of
from steerkit.scenario.assembly import with_controller
from steerkit.scenario.drive import drive_loop

pytestmark = pytest.mark.skipif(compiler() is None, reason="needs a C compiler")

QUICK = replace(DEFAULT.fit, epochs=15, imagined=200, nets=2, iterations=1, window=500)
SETTING = replace(DEFAULT, fit=QUICK, retrain_every_m=20.0, fit_seconds=1.0)
PAPER = replace(SETTINGS["paper"], fit=replace(SETTINGS["paper"].fit, epochs=15), retrain_every_m=20.0)


def quick(setting: Setting, **changes: Any) -> Setting:
    fit = replace(setting.fit, epochs=15, imagined=min(200, setting.fit.imagined), iterations=1)
    return replace(setting, fit=fit, retrain_every_m=20.0, fit_seconds=1.0, **changes)


def loop_of(policy: NfqPolicy | None = None, *, course: str = "circle", setting: Setting = SETTING) -> Loop:
    scenario = Scenario.under("hard", course=course)
    return drive_loop(scenario, policy or untrained(setting, 1), doe=setting.element(scenario.nominal), seed=4)


def learned(experiment: Experiment, backend: Any) -> tuple[LearningRun, list[Any]]:
    told: list[Any] = []
    run = LearningRun(experiment, lambda what, run: told.append((what, run.t, run.counts.k)), backend=backend)
    run.each = lambda now: told.append(
        (now.t, now["car.x"], now["path.e"], tuple(now["preview.preview"][:2]) if "preview.preview" in now else ())
    )
    while not run.done():
        run.drive()
    return run, told


CASES = {
    "default": (quick(DEFAULT), Scenario(course="paper")),
    "hard sensors": (quick(DEFAULT), Scenario.under("hard", course="genesis")),
    "poor sensors": (quick(DEFAULT), Scenario.under("real")),
    "low-pass": (quick(SETTINGS["low-pass"]), Scenario()),
    "plain": (quick(SETTINGS["bang-bang"]), Scenario()),
    "moved target": (quick(SETTINGS["paper"], after_failure="shift"), Scenario()),
    "put back": (quick(SETTINGS["model-free"], after_failure="reset", reset_seconds=3.0), Scenario()),
    "open course": (quick(DEFAULT), Scenario(course="straight", start=450.0)),
    "dead time": (quick(DEFAULT), Scenario(delay=0.2, believed_delay=0.2)),
}


@pytest.mark.parametrize("name", CASES)
def test_a_learning_run_is_the_same_to_the_last_bit(name: str) -> None:
    setting, scenario = CASES[name]
    experiment = Experiment(setting=setting, scenario=scenario, minutes=0.4, seed=3)
    (plain, plainly), (fast, told) = learned(experiment, "python"), learned(experiment, "c")
    logs = fast.recorder.log(), plain.recorder.log()
    assert fast.driver.in_c == len(logs[0].t) > (60 if name == "put back" else 470)
    assert plain.driver.in_c == 0
    assert told == plainly
    for column in ("s", "a", "s_next", "episode"):
        assert getattr(fast.transitions, column).tobytes() == getattr(plain.transitions, column).tobytes()
    ours, theirs = (replace(run.counts, train_seconds=0.0) for run in (fast, plain))
    assert ours == theirs
    assert ours.updates > 1
    assert fast.state == plain.state
    assert all(logs[0][signal].tobytes() == logs[1][signal].tobytes() for signal in logs[1])
    assert [p.tobytes() for net in fast.nets for p in net] == [p.tobytes() for net in plain.nets for p in net]
    if name == "open course":
        assert [row[1] for row in told if not isinstance(row[0], str)] != sorted(
            row[1] for row in told if not isinstance(row[0], str)
        )  # it came to the end, and was put back


def test_a_run_goes_over_to_c_when_it_has_lasted(monkeypatch: pytest.MonkeyPatch) -> None:
    """In between, at a moment that the compiler decides, and the numbers are the same."""
    experiment = Experiment(setting=SETTING, minutes=0.5, seed=1)
    short = LearningRun(replace(experiment, minutes=0.2))
    while not short.done():
        short.drive()
    assert short.driver._program is None
    assert short.driver.in_c == 0
    monkeypatch.setattr("steerkit.learning.experiment.WORTH_COMPILING", 40)
    run = LearningRun(experiment)
    while not run.done():
        run.drive()
        if run.driver._building is not None:
            run.driver._building.join()
    assert 400 < run.driver.in_c < 570
    plain, _ = learned(experiment, "python")
    assert run.transitions.s.tobytes() == plain.transitions.s.tobytes()


def test_whoever_changes_the_state_is_heeded() -> None:
    """In place, as between any two samples: what was computed ahead is forgotten."""
    plain, fast = Driver(loop_of(), backend="python"), Driver(loop_of(), backend="c")
    for number in range(40):
        for one in (plain, fast):
            if number == 25:
                car = one.loop.names.index("car")
                one.x[car] = one.x[car]._replace(y=one.x[car].y + 0.3)
            if number == 30:
                one.y = list(one.y)
            if number == 33:
                one.x = list(one.x)
            one.begin(5 * number)
            assert one.value("path.e") == one.outputs[one.loop.names.index("path")].e
            one.end(5 * number)
        assert fast.state(0) == plain.state(0), number
    assert fast.in_c == 40
    assert (fast.x, fast.y) == (plain.x, plain.y)


def test_one_program_serves_every_net_and_dead_time() -> None:
    first = untrained(SETTING, 1)
    program = program_of(loop_of(first))
    assert program is not None
    more = replace(first, nets=untrained(SETTING, 7).nets + (first.nets or ())[:1])
    for policy in (first, more, replace(first, ready_from=math.inf), replace(first, combine="max")):
        plain, fast = Driver(loop_of(policy), backend="python"), Driver(loop_of(policy), program=program)
        for one in (plain, fast):
            for number in range(90):
                one.begin(5 * number)
                one.end(5 * number)
        assert fast.in_c == 90
        assert fast.state(0) == plain.state(0)


def test_a_sample_with_a_fault_is_interpreted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where C stops, Python judges; it may go on, or raise."""
    whole = PolicyProgram.run
    monkeypatch.setattr(PolicyProgram, "run", lambda self, *given: [rows[:25] for rows in whole(self, *given)])
    plain, fast = Driver(loop_of(), backend="python"), Driver(loop_of(), backend="c")
    for number in range(90):
        for one in (plain, fast):
            one.begin(5 * number)
            one.end(5 * number)
    assert fast.in_c == 90
    monkeypatch.setattr(PolicyProgram, "run", lambda self, *given: [rows[:0] for rows in whole(self, *given)])
    for number in range(90, 140):
        for one in (plain, fast):
            one.begin(5 * number)
            one.end(5 * number)
    assert 90 < fast.in_c < 115
    assert fast.state(0) == plain.state(0)


def test_a_car_that_is_nowhere_is_so_in_both() -> None:
    plain, fast = Driver(loop_of(), backend="python"), Driver(loop_of(), backend="c")
    for number in range(60):
        for one in (plain, fast):
            if number in (20, 40):
                i = one.loop.names.index("controller" if number == 20 else "car")
                one.x[i] = getattr(type(one.x[i]), "_make", tuple)([math.nan] * len(one.x[i]))
            one.begin(5 * number)
            one.end(5 * number)
        assert repr(fast.state(0)) == repr(plain.state(0))


@dataclass(frozen=True, eq=False, kw_only=True)
class Crooked(Block):
    """Another number on symbols than on floats, as no block may be."""

    action = In("rad")
    applied = In("rad", direct=False)
    state = Out("rad", direct=())
    delta_sw = Out("rad")

    def init(self, batch: tuple[int, ...] = ()) -> Any:
        return (m.filled(0.0, batch),)

    def output(self, t: Any, x: Any, u: Any) -> Any:
        off = 1e-12 if m.is_symbol(u.action) else 0.0
        return self.Y(state=x[0], delta_sw=x[0] + u.action + off)

    def update(self, t: Any, x: Any, u: Any, y: Any) -> Any:
        return (u.applied,)


@dataclass(frozen=True, eq=False, kw_only=True)
class Untraceable(Crooked):
    """Asks a number what it is."""

    def output(self, t: Any, x: Any, u: Any) -> Any:
        return self.Y(state=x[0], delta_sw=x[0] if u.action > 0.0 else u.action)


def with_doe(doe: Block) -> Loop:
    scenario = Scenario(course="circle")
    return drive_loop(scenario, untrained(SETTING, 1), doe=doe, seed=4)


@pytest.mark.parametrize(
    ("loop", "why"),
    [
        (lambda: with_doe(Untraceable()), "cannot be compiled"),
        (lambda: with_doe(Crooked()), "differs from the interpreted loop"),
        (lambda: with_controller(loop_of(), nfq_native.OpenPolicy.of(untrained(SETTING, 1))), "OpenPolicy steers"),
    ],
)
def test_what_cannot_be_the_same_is_interpreted_and_says_why(loop: Any, why: str) -> None:
    one = Driver(loop(), worth=0)
    plain = Driver(loop(), backend="python")
    for number in range(40):
        for driver in (one, plain):
            driver.begin(5 * number)
            driver.end(5 * number)
            if driver._building is not None:
                driver._building.join()
    assert one.in_c == 0
    assert why in one.why_interpreted
    assert one.state(0) == plain.state(0)
    with pytest.raises(Refused, match=why):
        Driver(loop(), backend="c").begin(0)


def test_without_a_compiler_it_is_interpreted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ahead, "compiler", lambda: None)
    assert "no C compiler" in Driver(loop_of()).why_interpreted
    assert program_of(loop_of()) is None
    with pytest.raises(Refused, match="no C compiler"):
        Driver(loop_of(), backend="c")


def test_a_compiler_that_refuses_leaves_it_interpreted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(exact, "_HEAD", "#error no\n")
    one = Driver(loop_of(), worth=0)
    for number in range(30):
        one.begin(5 * number)
        one.end(5 * number)
        if one._building is not None:
            one._building.join()
    assert "refused" in one.why_interpreted
    assert one.in_c == 0


def test_exploration_and_solvers_are_interpreted() -> None:
    run = LearningRun(Experiment(setting=replace(SETTING, exploration=0.1)), backend="auto")
    with pytest.raises(Refused, match="Exploring"):
        PolicyProgram(run.loop)
    controller = loop_of().blocks["controller"]
    assert isinstance(controller, ExceptionGuard)


@pytest.mark.parametrize("seconds", [3.0, 2.98])
def test_a_drive_until_is_that_of_simulate(seconds: float) -> None:
    program = program_of(loop_of())
    for limit in (0.001, math.inf):
        logs = [
            driven(loop_of(), seconds, until=lambda now, far=limit: abs(now["path.e"]) > far, program=p)
            for p in (None, program)
        ]
        plain = simulate(
            loop_of(), seconds, every=5, until=lambda now, far=limit: abs(now["path.e"]) > far, allow_nonfinite=True
        )
        for log in logs:
            assert all(np.array_equal(log[name], plain[name]) for name in plain)
            assert log.state == plain.state
            assert np.array_equal(log.t, plain.t)
