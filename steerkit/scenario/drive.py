"""The loop of a drive, assembled in one place; test drives over whole rounds, and their table."""

import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, fields, replace
from typing import Any, cast

from rich.markup import escape
from rich.table import Table

from steerkit.controllers.supervisor import Supervisor
from steerkit.diagram.block import Block
from steerkit.diagram.loop import Loop
from steerkit.diagram.simulation import Log, Sample, simulate
from steerkit.estimators.steering_sign import SteeringSigns
from steerkit.metrics import TABLE, of_log, r79_acceleration, r79_jerk
from steerkit.metrics.signals import largest
from steerkit.scenario.assembly import bare, steering_loop
from steerkit.scenario.catalogue import make_controller
from steerkit.scenario.scenario import Scenario
from steerkit.task import TRIP
from steerkit.vehicles.rollout import Rollout


def assembled(
    scenario: Scenario,
    controller: Block,
    *,
    doe: Block | None = None,
    recovery: Block | None = None,
    safety: Block | None = None,
    seed: int = 0,
    s: float | None = None,
) -> Loop:
    """The loop of a drive in simulation, whoever drives: learner, test drive, suite or environment.

    controller, doe, recovery, safety: as for `steering_loop`. seed: of driver, sensors, gusts and the link's delays. s:
    where the car starts [m]; None: where the scenario says. Raises what `steering_loop` raises.
    """
    path, law = scenario.path(), cast(Any, bare(controller))
    own = scenario.reference == "own" and hasattr(law, "reference")
    blocks: dict[str, Any] = dict(scenario.blocks(path, scenario.course.start if s is None else s, seed))
    return steering_loop(
        path=path,
        controller=controller,
        doe=doe,
        recovery=recovery,
        supervisor=None if recovery is None else Supervisor(limit=scenario.nominal.delta_sw_max, dt=controller.dt),
        reference=law.reference if own else scenario.ahead,
        safety=safety,
        **blocks,
    )


_STEADY = 0.05
"""A wheel that is so near its command follows it [rad]."""


class SignCheck:
    """Does the car of a loop turn where it is steered? `look` at its samples: see `SteeringSigns`."""

    def __init__(self, scenario: Scenario, loop: Loop, dt: float):
        self._plant, self._signs = scenario.vehicle.plant, SteeringSigns(Rollout.of(scenario.nominal), dt)
        self._steady = False
        chain = [name for name in ("link", "actuator", "column", "car") if name in loop.blocks]
        into = loop.inputs_of(chain[0])
        self._command = next(into[name] for name in ("delta_sw_cmd", "delta_sw_in") if name in into)
        last = chain[-2] if len(chain) > 1 else "car"
        outputs = [port.name for port in loop.blocks[last].outputs]
        self._wheel = f"{last}.{'delta_sw_meas' if 'delta_sw_meas' in outputs else 'delta_sw'}"

    def look(self, sample: Sample) -> None:
        """At a sample; raises ValueError where the steering is wired the wrong way round."""
        signs = self._signs
        v, r, psi = (sample[f"car.{name}"] for name in ("v", "r", "psi"))
        command, wheel = sample[self._command], sample[self._wheel]
        # where a run goes on, commands from before are on their way: their answer would be taken for that to the next
        self._steady |= sample.t < 1.0 or abs(command - wheel) < _STEADY
        if not self._steady:
            return
        signs.add(sample.t, command=command, wheel=wheel, v=v, r=r, psi=psi)
        if wrong := signs.wrong():
            plant = f"plant '{self._plant}': at {sample.t:.1f} s it is steered the wrong way round"
            raise ValueError(f"{plant} (+ is left, ISO 8855): {wrong}")


def controller(name: str, scenario: Scenario) -> Block:
    """The controller of that name for that scenario, or your own: `steerkit.scenario.catalogue.make_controller`.

    Raises ValueError with the valid names.
    """
    return make_controller(name, scenario.design_model(clock=time.perf_counter))


def drive_loop(
    scenario: Scenario, steering: Block, *, doe: Block | None = None, seed: int = 0, s: float | None = None
) -> Loop:
    """The loop of a test drive: a policy (with its doe) has the scenario's recovery controller behind it."""
    if "ready" not in [port.name for port in steering.outputs]:
        return assembled(scenario, steering, doe=doe, seed=seed, s=s)
    if "ready_from" in {field.name for field in fields(steering)}:
        steering = replace(steering, ready_from=0.0)  # type: ignore[call-arg]
    return assembled(scenario, steering, doe=doe, recovery=scenario.recovery_controller(), seed=seed, s=s)


def drive(
    scenario: Scenario,
    steering: Block,
    *,
    doe: Block | None = None,
    seed: int = 0,
    rounds: float | None = None,
    s: float | None = None,
    progress: bool = False,
    only_while_held: bool = False,
    each: Callable[[Sample], None] | None = None,
) -> Log:
    """Drive the scenario's rounds of its course (or `rounds`) and return the log, 20 samples a second.

    only_while_held: end at the first sample in which the recovery controller has the wheel. each: called with every
    sample of the log as it is driven, such as a live stream's. The run also ends after the time that the slowest
    driver would need; then the last `path.progress` is short of `rounds` times the course. Raises ValueError where the
    car turns the other way than it is steered: `SignCheck`.
    """
    if rounds is not None:
        scenario = scenario.with_(course={"rounds": rounds})
    loop = drive_loop(scenario, steering, doe=doe, seed=seed, s=s)
    length, signs = scenario.length, SignCheck(scenario, loop, steering.dt)

    def over(sample: Sample) -> bool:
        signs.look(sample)
        if each is not None:
            each(sample)
        lost = only_while_held and sample["supervisor.learning"] < 0.5
        return lost or sample["path.progress"] >= length

    every = round(steering.dt / loop.dt)
    return simulate(loop, scenario.seconds, every=every, until=over, allow_nonfinite=True, progress=progress)


def held_all_along(log: Log, *, limit: float = TRIP) -> bool:
    """Did the controller stay within |e| <= limit [m] and, if learned, keep the wheel from the first sample on?"""
    on_course = bool((abs(log["path.e"]) <= limit).all())
    return on_course and ("supervisor.learning" not in log or bool((log["supervisor.learning"] > 0.5).all()))


_JUDGES = {"iso_11270": ("max_a_y", "max_jerk"), "un_r79": ("max_a_y_r79", "max_jerk_r79")}
"""The norms that a drive is judged by, and the metrics whose limits they set: lateral acceleration and jerk."""


def row_of(name: str, log: Log) -> dict[str, Any]:
    """A drive's figures, for a program: its controller, was it held, `steerkit.metrics.Summary`, and for ISO 11270 and
    UN R79 whether it keeps their limits."""
    a_y, found = log["car.a_y"], asdict(of_log(log))
    r79 = {"max_a_y_r79": largest(r79_acceleration(log.t, a_y)), "max_jerk_r79": largest(r79_jerk(log.t, a_y))}
    limits = {metric.name: metric.limit or 0.0 for metric in TABLE}
    judged = {norm: all((found | r79)[of] <= limits[of] for of in metrics) for norm, metrics in _JUDGES.items()}
    return {"controller": name, "held": held_all_along(log), **found, **judged}


_COLUMNS = {
    "RMS e\n[m]": "{rms_e:.3f}",
    "max e\n[m]": "{max_e:.3f}",
    "RMS wheel\nrate\n[deg/s]": "{rms_wheel_rate_deg:.0f}",
    "max a_y\n[m/s²]": "{max_a_y:.2f}",
    "|e| <\n0.05 m\n[%]": "{percent_within_5cm:.1f}",
    "max jerk\n[m/s³]": "{max_jerk:.1f}",
    "ISO\n11270": "{iso_11270}",
    "UN\nR79": "{un_r79}",
}


def comparison(title: str, logs: Mapping[str, Log]) -> Table:
    """A table with one row a drive."""
    table = Table(*map(escape, ("controller", "held", *_COLUMNS)), title=title)
    table.columns[0].overflow = "fold"
    for name, log in logs.items():
        row = row_of(name, log)
        row["percent_within_5cm"] = 100.0 * row["share_within_5cm"]
        row |= {norm: "kept" if row[norm] else "not" for norm in _JUDGES}
        table.add_row(name, "yes" if row["held"] else "no", *(text.format(**row) for text in _COLUMNS.values()))
    return table
