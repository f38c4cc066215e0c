"""Manoeuvres on a simulated car: conditions, consent, the wave through the gate, aborts, and the recording."""

import json
import math
from collections.abc import Callable
from dataclasses import replace
from functools import partialmethod
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from steerkit.car import loop as loops
from steerkit.car import panel, prove
from steerkit.car import recording as recordings
from steerkit.car import replay as replays
from steerkit.car.config import CarConfig
from steerkit.car.loop import Steers
from steerkit.car.prove import CONSENT, RECORDING_ENDS, TRIES, WARNING, Proving, check, most, runs_in, straight
from steerkit.car.session import Options
from steerkit.car.state_machine import Mode, Order
from steerkit.paths.courses import circle
from steerkit.paths.path import Path as Course
from steerkit.proving.manoeuvre import Abort, Input, manoeuvre
from tests.support.proved_car import ProvingWorld, V, config_on, oval, small
from tests.unit.car.test_panel import pressed


def long_oval() -> Course:
    """With room for two runs on a straight: no run waits until a bend is over."""
    return oval(800.0)


@pytest.fixture(scope="module")
def kit(tmp_path_factory: pytest.TempPathFactory) -> CarConfig:
    return config_on(long_oval(), tmp_path_factory.mktemp("kit"))


@pytest.fixture(scope="module")
def driven(kit: CarConfig, tmp_path_factory: pytest.TempPathFactory) -> tuple[ProvingWorld, Path]:
    """A step to each side, one more that was aborted by the brake's kin, recorded."""
    file = tmp_path_factory.mktemp("driven") / "drive.mcap"
    record = recordings.Recording(file, recordings.described(kit))
    world = ProvingWorld(small(a_y=0.06, repeats=1), kit, recorder=record)
    world.begin()
    world.until(world.t + 1.0)
    world.fault("override", length=0.1, then=1.0)
    for _ in range(2):
        run = world.begin()
        world.go_on(lambda run=run: run["end"] is not None)
    world.go_on(lambda: world.over)
    record.close()
    return world, file


def world_of(kit: CarConfig, **more: Any) -> ProvingWorld:
    return ProvingWorld(small(a_y=0.06, repeats=1), kit, **more)


def test_the_wave_gets_to_the_wheel_through_the_gate_and_turns_the_car(driven: Any) -> None:
    world, _ = driven
    world.check_bus()
    car, m = world.config.vehicle, small(a_y=0.06)
    for run, sign in zip((run for run in world.runs if run["cause"] == ""), (1.0, -1.0), strict=True):
        held = [s for s in world.seen if run["begin"] + 2.0 < s.t < run["end"]]
        before = [s.delta_sw for s in world.seen if run["begin"] - 1.0 < s.t < run["begin"]]
        turned = np.mean([s.delta_sw for s in held]) - np.mean(before)
        assert turned == pytest.approx(sign * m.required.angle(car, V), rel=0.05)
        assert np.mean([s.a_y for s in held]) == pytest.approx(sign * 0.06, abs=0.015)
        assert np.std([s.command for s in held]) < 1e-3, "nobody else steers"


def test_a_key_before_the_question_is_no_consent(kit: CarConfig) -> None:
    world = world_of(kit)
    assert world.proving is not None
    world.engage()
    while "press g" not in world.status:
        world.proving.consent()
        world.until(world.t + 0.05)
        assert world.t < 60.0
    world.until(world.t + WARNING + 0.5)
    assert world.runs == []


def consented(kit: CarConfig) -> tuple[ProvingWorld, Proving, float]:
    """A kit whose human has just consented to a run, and when [s]."""
    world = world_of(kit)
    assert world.proving is not None
    world.engage()
    world.go_on(lambda: "press g" in world.status)
    world.proving.consent()
    return world, world.proving, world.t


def test_consent_is_for_one_run_after_a_warning_and_expires(kit: CarConfig) -> None:
    world, proving, given = consented(kit)
    world.until(world.t + 0.1)
    assert "HANDS ON THE WHEEL: it begins in 1.9 s" in world.status
    fast = world.car.pedals
    _slower(world)
    world.go_on(lambda: world.status.partition(": ")[2].startswith("drive at 8"))
    assert world.runs == []
    world.until(given + CONSENT + 1.0)
    world.car.pedals = fast
    world.go_on(lambda: "press g" in world.status)
    world.until(world.t + WARNING + 0.5)
    assert world.runs == [], "the consent was too old"
    proving.consent()
    asked = world.t
    world.go_on(lambda: bool(world.runs))
    assert world.runs[0]["begin"] - asked == pytest.approx(WARNING, abs=0.15)
    world.go_on(lambda: "press g" in world.status)
    world.until(world.t + WARNING + 0.5)
    assert len(world.runs) == 1


def test_who_lets_go_takes_the_consent_back(kit: CarConfig) -> None:
    world, _, given = consented(kit)
    world.until(world.t + 0.2)
    assert "it begins in" in world.status
    world.order(Order.DISENGAGE, then=0.3)
    world.engage()
    world.go_on(lambda: "press g" in world.status)
    assert world.t < given + 0.7 * CONSENT, "the consent would still be young enough"
    world.until(given + CONSENT + WARNING + 1.0)
    assert world.runs == []


def _silent(world: ProvingWorld) -> None:
    """The controller asks for nothing for half a second."""
    world.due = world.t + 0.5


def _slower(world: ProvingWorld) -> None:
    driver = replace(world.car.pedals.driver, v_min=V - 0.95, v_max=V - 0.9)
    world.car.pedals = replace(world.car.pedals, driver=driver)


def _fault(kind: str, target: str = "report", **more: Any) -> Callable[[ProvingWorld], None]:
    return lambda world: world.fault(kind, target, length=0.3, **more)


@pytest.mark.parametrize(
    ("happens", "abort", "cause", "mode"),
    [
        (_fault("override"), {}, "OVERRIDE: override", Mode.OVERRIDE),
        (_fault("torque", amount=5.0), {}, "OVERRIDE: ", Mode.OVERRIDE),
        (_fault("drop", "pose"), {}, "FAULT: ", Mode.FAULT),
        (_fault("kit_fault"), {}, "FAULT: ", Mode.FAULT),
        (_silent, {}, "FAULT: controller silent", Mode.FAULT),
        (lambda world: world.order(Order.DISENGAGE), {}, "STANDBY: operator: disengage", Mode.READY),
        (lambda world: setattr(world, "beats_until", world.t), {}, "FAULT: operator silent", Mode.FAULT),
        (_slower, {}, "v - 8 m/s: -0.", Mode.ENGAGED),
        (lambda world: None, {"a_y": 0.6}, "a_y: ", Mode.ENGAGED),
        (lambda world: None, {"e": 0.4}, "e: ", Mode.ENGAGED),
        (lambda world: None, {"r": 0.06}, "r: ", Mode.ENGAGED),
    ],
)
def test_what_aborts_a_run(kit: CarConfig, happens: Any, abort: Any, cause: str, mode: Mode) -> None:
    wanted = small("sine", a_y=1.0, repeats=1, sides=("left",))
    world = ProvingWorld(wanted, kit)
    assert world.proving is not None
    run = world.begin()
    world.until(world.t + 0.3)
    happens(world)
    world.proving.manoeuvre = replace(wanted, abort=replace(Abort(), **abort))  # tighter than it was checked with
    world.go_on(lambda: run["end"] is not None, 5.0)
    assert run["cause"].startswith(cause)
    assert run["end"] - run["begin"] < wanted.seconds
    world.until(world.t + 0.1)
    block: Any = world.run.loop.blocks["controller"]
    assert block.amplitude == 0.0, "no wave any more"
    world.until(world.t + 0.2)
    assert world.mode is mode
    assert cause.split(":")[0] in world.status, "the cause is told"
    assert world.core.machine.cause.split(":")[0] in (run["cause"] + world.core.machine.cause)
    if mode is Mode.ENGAGED:  # the controller has the car, and brings it back
        for _ in range(45):
            world.until(world.t + 0.1)
        assert world.mode is Mode.ENGAGED
        assert abs(world.core.senses.e) < 0.3
    else:
        last = max(s.t for s in world.sent if s.enable)
        assert last - run["end"] < 0.2
    world.check_bus()


@pytest.mark.parametrize("name", ["TESLA_MODEL_3", "TOYOTA_RAV4"])
def test_a_run_of_a_production_car_is_within_its_safety_codes_limits(name: str, tmp_path: Path) -> None:
    """By angle and by torque."""
    pytest.importorskip("opendbc")
    wanted = small("sine", 15.0, 0.3, sides=("left",), repeats=1)
    world = ProvingWorld(wanted, config_on(oval(700.0, 200.0), tmp_path, name), base="mpc")
    run = world.begin()
    world.go_on(lambda: run["end"] is not None)
    assert run["cause"] == ""
    world.check_bus()
    assert world.car.car.counts.rejected == 0


def test_an_invalid_run_is_driven_again_but_not_for_ever(kit: CarConfig) -> None:
    wanted = replace(small(a_y=0.06), repeats=1, sides=("left",))
    world = ProvingWorld(wanted, kit, yes=True)
    for tries in range(1, TRIES + 1):
        world.go_on(lambda tries=tries: len(world.runs) == tries)
        world.until(world.t + 0.3)
        world.fault("override", length=0.1, then=0.3)
    world.go_on(lambda: world.over, 20.0)
    assert [run["side"] for run in world.runs] == TRIES * ["left"]
    assert not any(run["cause"] == "" for run in world.runs)


def test_a_long_wave_is_steered_on_top_of_the_controller(kit: CarConfig) -> None:
    wave = replace(manoeuvre("weave").at(V, 1.0), repeats=1)
    wave = replace(wave, input=replace(wave.required, periods=2.0))
    world = ProvingWorld(wave, kit, yes=True)
    world.go_on(lambda: bool(world.runs) and world.runs[-1]["end"] is not None)
    (run,) = world.runs
    assert run["cause"] == ""
    assert run["end"] - run["begin"] == pytest.approx(10.05, abs=0.06)
    seen = [s for s in world.seen if run["begin"] < s.t < run["end"]]
    assert max(s.a_y for s in seen) > 0.15, "Stanley steers against so slow a wave"
    assert max(abs(s.e) for s in seen) < 0.4, "alone it leads 0.7 m off"


def test_a_manoeuvre_on_a_course_is_a_round_of_the_cars_own_course(tmp_path: Path) -> None:
    path = circle(10.0)
    kit = config_on(path, tmp_path)
    world = ProvingWorld(replace(manoeuvre("lane-keeping-bend").at(4.0), repeats=1), kit)
    world.engage()
    world.go_on(lambda: world.over, 400.0)
    (run,) = world.runs
    assert (run["cause"], run["side"]) == ("", "course")
    way = sum(s.v * 0.05 for s in world.seen if run["begin"] < s.t < run["end"])
    assert way == pytest.approx(path.length, rel=0.03)
    again = ProvingWorld(manoeuvre("steady-state-circle").at(4.0), kit, minutes=0.05)
    again.engage()
    again.go_on(lambda: bool(again.runs) and again.runs[-1]["end"] is not None)
    assert again.runs[0]["end"] - again.runs[0]["begin"] == pytest.approx(3.0, abs=0.1)


def test_what_does_not_fit_is_refused_by_name_with_what_would(kit: CarConfig) -> None:
    with pytest.raises(ValueError, match=r"v = 27.8 m/s, its file and port allow 0.5 to 9 .*--speed 9") as error:
        check(manoeuvre("step-steer"), kit)
    for name in ("a_y_max", "rate_max", "jerk_max", "e_max", "e_growth"):
        assert f"{name} " in str(error.value)
    fits = float(str(error.value).split("--a-y ")[1].split(";")[0])
    check(manoeuvre("step-steer").at(9.0, fits), kit)
    with pytest.raises(ValueError, match=f"e_max .*--a-y {fits:g}"):
        check(manoeuvre("step-steer").at(9.0, fits + 0.02), kit)
    near = small(abort=replace(Abort(), e=0.5))
    with pytest.raises(ValueError, match=r"abort\.e 0.04: --a-y 0.04"):  # the smaller of the two
        check(near, kit)
    with pytest.raises(ValueError, match=r"straight on, the course has 0 m: another \[course\]"):
        check(small(a_y=0.1), replace(kit, course=circle(50.0)))
    with pytest.raises(ValueError, match="did you mean 'stanley'"):
        check(small(a_y=0.1), kit, "stanly")
    steep = Input(form="levels", angle_deg=200.0, rise=1.0, hold=0.5)
    with pytest.raises(ValueError, match="a_y_max"):
        check(small(input=steep), kit)
    with pytest.raises(ValueError, match="--yes consents for simulated cars alone"):
        prove.drive(Options(config="dbw-kit.toml"), small(), yes=True)
    with pytest.raises(ValueError, match="cannot be driven with this car"):
        prove.drive(Options(config="dbw-kit.toml", simulated=True), manoeuvre("step-steer"))


def test_the_largest_size_is_the_linear_cars(kit: CarConfig) -> None:
    step = small(input=Input(form="levels", a_y=1.0, rise=0.2, hold=2.8))
    found = most(step, kit, V)
    t = 3.0 - 0.1  # the ramp counts half
    assert found["e_max"] == pytest.approx(0.7 * 2.0 / (0.5 * t**2), rel=0.01)
    assert found["psi_e_max"] == pytest.approx(0.7 * math.radians(45.0) * V / t, rel=0.01)
    length = kit.vehicle.wheelbase + kit.vehicle.understeer_gradient * V**2
    assert found["jerk_max"] == pytest.approx(0.2 * kit.gate.jerk_max * kit.gate.length(V) / length, rel=0.06)
    wheel = kit.vehicle.steer_ratio * length / V**2
    assert found["delta_sw_max"] == pytest.approx(kit.gate.delta_sw_max / wheel)


def test_how_far_a_course_is_straight() -> None:
    free = straight(oval(), 1e-3)
    assert free[0] == pytest.approx(400.0, abs=4.0)
    assert free[100] == pytest.approx(free[0] - 100.0)
    assert free[-1] == pytest.approx(free[0] + 1.0), "it goes on over the end of a closed course"
    assert free[430] == 0.0
    assert straight(circle(200.0), 1e-2).min() == circle(200.0).length


def test_its_recording_replays_bit_for_bit_and_says_each_run(driven: Any) -> None:
    world, file = driven
    recorded = recordings.read(file)
    config = recordings.config_of(recorded)
    (drive,) = replays.drives(recorded)
    same = replays.replayed_requests(drive, config)
    assert same == len(drive.requests) > 500
    names = [steers.name for _, steers in drive.remarks]
    assert names == [
        *("stanley", "stanley+step-steer@8,0.06,left,1", "stanley", "stanley+step-steer@8,0.06,left,2"),
        *("stanley", "stanley+step-steer@8,0.06,right,3", "stanley"),
    ]
    runs = runs_in(file)
    assert [set(run) for run in runs] == 3 * [{"number", "side", "begin", "end", "cause", "v", "a_y", "manoeuvre"}]
    for run, live in zip(runs, world.runs, strict=True):
        assert run == live | {"begin": run["begin"], "end": run["end"]}
        assert run["begin"] == pytest.approx(live["begin"], abs=0.05)
        assert run["end"] == pytest.approx(live["end"], abs=0.05)
    assert [run["cause"].partition(":")[0] for run in runs] == ["OVERRIDE", "", ""]
    count, first = next((n, s) for n, s in drive.remarks if "@" in s.name)
    told = json.loads(first.run)
    told["input"]["a_y"] = 0.0605
    drive.remarks[drive.remarks.index((count, first))] = (count, replace(first, run=json.dumps(told)))
    assert replays.replayed_requests(drive, config) < same, "another wave is noticed"


def test_a_run_whose_end_was_not_noted_ends_where_the_car_let_go_or_with_the_recording(driven: Any) -> None:
    world, file = driven
    recorded = recordings.read(file)
    messages = [m for m in recorded.messages if m.values["t"] < world.runs[1]["begin"] + 2.0]
    cut = recorded._replace(messages=[m for m in messages if '"end' not in m.values.get("what", "")])
    left, ends = runs_in(cut)
    assert left["cause"].startswith("OVERRIDE: override")
    assert left["end"] == pytest.approx(world.runs[0]["end"], abs=0.05)
    assert ends["cause"] == RECORDING_ENDS
    assert ends["end"] - ends["begin"] == pytest.approx(2.0, abs=0.1)


@pytest.mark.parametrize(
    "run",
    [
        *('{"input": {"form": "sine"}}', '{"input": 3}', "[1]", "{", '{"input": {"form": "bump", "a_y": 1}, "v": 8}'),
        '{"input": {"form": "sine", "a_y": 1}, "v": 8, "side": "up", "number": 1, "on_top": false}',
    ],
)
def test_what_is_no_run_is_refused(kit: CarConfig, run: str) -> None:
    with pytest.raises(ValueError, match=r"run|input|JSON|property name"):
        loops.controller_named("stanley", kit, run=run)


def test_a_manoeuvre_is_no_controller_to_drive_with(kit: CarConfig) -> None:
    with pytest.raises(ValueError, match="wave"):
        loops.controller_named("stanley+step-steer@8,0.5,left,3", kit)
    assert Steers.read('{"name": "lqr"}').run == ""


def test_the_key_to_consent_orders_nothing_and_every_other_one_lets_go(monkeypatch: pytest.MonkeyPatch) -> None:
    came: list[str] = []
    made = partialmethod(panel.Panel.__init__, own={"g": lambda: came.append("g")})
    monkeypatch.setattr(panel.Panel, "__init__", made)
    assert pressed(monkeypatch, [Mode.ENGAGED], ["g", "x", "g"])[0].orders == [Order.DISENGAGE]
    assert came == ["g", "g"]


def test_drive_puts_it_together(monkeypatch: pytest.MonkeyPatch) -> None:
    """The panel gets status and key; the simulated human drives at the manoeuvre's speed."""
    seen: list[Any] = []

    def session(options: Options) -> Any:
        seen.append(options)
        raise KeyboardInterrupt

    monkeypatch.setattr(prove.sessions, "session", session)
    with pytest.raises(KeyboardInterrupt):
        prove.drive(Options(config="dbw-kit.toml", simulated=True), small(a_y=0.1), yes=True)
    assert seen[0].simulate == pytest.approx({"v_min": V - 0.2, "v_max": V + 0.2})


@pytest.mark.parametrize(
    "note",
    [
        *("[]", "3", "null", "{", "{}", '{"event": "begin"}', '{"event": "end"}', '{"event": "land"}'),
        '{"event": "begin", "number": 1, "side": "up", "v": 8, "a_y": 1, "manoeuvre": "sine"}',
        '{"event": "begin", "number": 1, "side": "left", "v": "fast", "a_y": 1, "manoeuvre": "sine"}',
    ],
)
def test_a_recording_that_tells_nonsense_of_a_run_is_refused_in_words(note: str) -> None:
    text = Steers(name="stanley", run=note).text()
    told = recordings.Message("/steers", {"t": 1.0, "what": text})
    recorded = recordings.Recorded(metadata={}, messages=[told], gaps=[], size=0)
    with pytest.raises(ValueError, match=r"the recording: .* is no note of a run"):
        runs_in(recorded)
