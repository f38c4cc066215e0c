"""What the vehicle-state estimator is worth: closed loop, its deviations, outages and jumps.

`hard` sensors without measured sideslip, seeds and courses that nothing was tuned on, judged by the simulated truth.

* Closed loop: each controller with the sensors themselves, behind the estimator, and with perfect sensors. rms_x,
  wheel_x: RMS e and RMS wheel speed behind it over those without it, mean of all courses. Most of the wheel's speed is
  the course's bends; wheel_noise_x is that of what goes beyond perfect sensors, in squares.
* Deviations: 40 drives. A drive counts where the share of samples whose normalised innovations (position, heading,
  gyro: four a sample) are within the 95 % bound of chi-squared is 93 to 97 %: `innovation_ok_pct`. nis_mean is their
  mean, 1 if the deviations are right.
* Outages: all but the wheel's angle is lost for 2 s, again and again; a position jumps by 0.3 m for 0.3 s.
* Wrong belief: --cars cars about which estimator and controllers believe nothing that is true
  (`benchmarks.wrong_belief`); RMS e, wheel, error to the side and of the heading with `steering` found, over those
  without and with no estimator: medians over the cars. `wrong_belief_innovation_ok_pct`, `wrong_belief_nis_mean`: as
  above, from half of the drive on.

    python -m benchmarks study vehicle_state [--controllers NAME ...] [--cars CARS] [--first N]
        [--parts closed_loop wrong_belief ...] [--quick] [--json]
"""

import argparse
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from benchmarks.tables import as_line, say, show
from benchmarks.wrong_belief import driven
from benchmarks.wrong_belief import unlike as unlike_car
from steerkit.compiled import Backend, compile
from steerkit.diagram.maths import Array
from steerkit.diagram.simulation import Log
from steerkit.diagram.units import degrees_of
from steerkit.estimators.vehicle_state import VehicleState
from steerkit.metrics.signals import rates, rms
from steerkit.scenario import Scenario
from steerkit.scenario.drive import controller, drive, drive_loop

CONTROLLERS = ("mpc", "stanley", "lqr")
DRIVES = (("paper", 101), ("random-2101", 102), ("random-2102", 103), ("genesis-rfs", 104), ("sweeping-2103", 105))
"""Course and seed of each drive."""
PARTS = ("closed_loop", "wrong_belief", "innovations", "outages")
KINDS = ("none", "vehicle-state", "adaptive-state")
"""What stands between sensors and controllers."""
ADAPTIVE = ("stanley-adaptive", "mpc-adaptive")
"""Controllers of the cars about which every belief is wrong."""
BEGIN = 5.0
"""Seconds at the start of a drive that are not judged: the car comes from rest relative to the course."""
OUTAGE, EVERY = 2.0, 12.0
JUMP, JUMP_TIME = 0.3, 0.3
_INPUTS = ("x", "y", "psi", "age", "v", "r", "age")


def add_options(parser: argparse.ArgumentParser) -> None:
    """Its own command line options; --quick drives one controller for seconds."""
    parser.add_argument("--controllers", nargs="+", default=list(CONTROLLERS), metavar="NAME")
    parser.add_argument("--cars", type=int, default=20, help="how many with wrong beliefs (20)")
    parser.add_argument("--first", type=int, default=4000, help="number of the first of these (4000)")
    parser.add_argument("--parts", nargs="+", default=list(PARTS), choices=PARTS, help="which parts (all)")


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Measure all parts, or those asked for, and print them."""
    quick, parts = options.quick, options.parts
    names = options.controllers[-1:] if quick else options.controllers
    backend: Backend = "python" if quick else "c"
    report: dict[str, Any] = {}
    if "closed_loop" in parts:
        report |= closed_loop(names, DRIVES[:1] if quick else DRIVES, 0.03 if quick else 1.0)
    if "wrong_belief" in parts:
        cars, seconds = (1, 7.0) if quick else (options.cars, 60.0)
        report |= wrong_belief(ADAPTIVE[:1] if quick else ADAPTIVE, options.first, cars, seconds)
    if "innovations" in parts:
        report |= innovations(2 if quick else 20, 8.0 if quick else 100.0, backend)
    if "outages" in parts:
        report |= outages(20.0 if quick else 120.0, backend)
    return report


def scene(estimator: str, course: str, **others: Any) -> Scenario:
    """The scenario of a drive; estimator `truth`: perfect sensors."""
    sensors: dict[str, Any] = {"kind": "no sideslip", "estimator": estimator}
    if estimator == "truth":
        sensors |= {"estimator": "none", "noise": 0.0, "latency": 0.0}
    return Scenario.under("hard", course=course, sensors=sensors, reference="own", **others)


def judged(log: Log) -> tuple[float, float]:
    """RMS e [m] and RMS wheel speed [deg/s]."""
    late = log.t > BEGIN if log.t[-1] > 2.0 * BEGIN else log.t >= 0.0
    return rms(log["path.e"][late]), rms(degrees_of(rates(log.t[late], log["car.delta_sw"][late])))


def closed_loop(names: list[str], drives: tuple[tuple[str, int], ...], rounds: float) -> dict[str, Any]:
    """Drives of each controller with the sensors, behind the estimator and with the truth."""
    rows: list[dict[str, Any]] = []
    for name in names:
        for course, seed in drives:
            e, wheel = {}, {}
            for kind in ("none", "vehicle-state", "truth"):
                scenario = scene(kind, course).with_(course={"rounds": rounds})
                e[kind], wheel[kind] = judged(drive(scenario, controller(name, scenario), seed=seed))
            row = {"controller": name, "course": course, "seed": seed} | _ratios(e, wheel)
            rows.append(row | {f"rms_e, {kind}": value for kind, value in e.items()})
            say(as_line(rows[-1]))
    means = {
        key: {name: float(np.mean([row[key] for row in rows if row["controller"] == name])) for name in names}
        for key in ("rms_x", "wheel_x", "wheel_noise_x")
    }
    show("behind the estimator, over without it", rows)
    show("means over the courses", [{"figure": key} | by_name for key, by_name in means.items()])
    return means | {"drives": rows}


def _ratios(e: dict[str, float], wheel: dict[str, float]) -> dict[str, float]:
    """What is left behind the estimator, over what there is without it."""
    floor = wheel["truth"] ** 2
    beyond = [max(wheel[kind] ** 2 - floor, 0.0) for kind in ("vehicle-state", "none")]
    return {
        "rms_x": e["vehicle-state"] / e["none"],
        "wheel_x": wheel["vehicle-state"] / wheel["none"],
        "wheel_noise_x": float(np.sqrt(beyond[0] / beyond[1])) if beyond[1] > 0.0 else float("nan"),
    }


def wrong_belief(names: tuple[str, ...], first: int, cars: int, seconds: float) -> dict[str, Any]:
    """Cars about which every belief is wrong, with either estimator and without one."""
    report: dict[str, Any] = {"wrong_belief_cars": []}
    shown: list[dict[str, Any]] = []
    for name in names:
        rows: list[dict[str, Any]] = []
        for number in range(first, first + cars):
            row = {kind: asdict(driven(name, unlike_car(number, kind), seed=number, seconds=seconds)) for kind in KINDS}
            rows.append(row)
            report["wrong_belief_cars"].append({"controller": name, "car": number, **row})
            for kind, one in row.items():
                say(f"{name}, car {number}, {kind}: {as_line(one)}")
        for other, key in (("vehicle-state", "wrong_belief_x"), ("none", "wrong_belief_x_raw")):
            found = report.setdefault(key, {}).setdefault(name, {})
            for what in ("rms_e", "rms_wheel_deg", "rms_side", "rms_heading", "max_e"):
                ratios = [row["adaptive-state"][what] / row[other][what] for row in rows]
                found[what] = {"median": float(np.median(ratios)), "worst": max(ratios)}
                shown.append({"controller": name, "over": other, "figure": what} | found[what])
        for kind in KINDS[1:]:
            shares = [0.93 <= row[kind]["nis_share"] <= 0.97 for row in rows]
            figures = {
                "wrong_belief_innovation_ok_pct": 100.0 * float(np.mean(shares)),
                "wrong_belief_nis_mean": float(np.mean([row[kind]["nis_mean"] for row in rows])),
                "wrong_belief_max_e_m": max(row[kind]["max_e"] for row in rows),
            }
            print(f"{name}, {kind}: {as_line(figures)}")
            for key, value in figures.items():
                report.setdefault(key, {}).setdefault(name, {})[kind] = value
    show("wrong belief: with what is found, over the others", shown)
    return report


def recorded(course: str, seconds: float, cars: int, seed: int, backend: Backend) -> Log:
    """Drives of Stanley behind the estimator, one a car, compiled."""
    scenario = scene("vehicle-state", course)
    names = [f"sensors.{name}" for name in ("x", "y", "psi", "age", "v", "r")] + ["actuator.delta_sw"]
    names += [f"car.{name}" for name in ("x", "y", "psi", "beta", "r", "v")]
    names += [f"estimator.{name}" for name in ("x", "y", "psi", "side_deviation", "psi_deviation", "nis", "nis_count")]
    loop = drive_loop(scenario, controller("stanley", scenario), seed=seed)
    return compile(loop, record=names, every=5, backend=backend).run(seconds, batch=cars)


def aside(log: Log, x: Array, y: Array) -> Array:
    """How far a position is to the left of the true car [m]."""
    c, s = np.cos(log["car.psi"]), np.sin(log["car.psi"])
    return -s * (x - log["car.x"]) + c * (y - log["car.y"])


def innovations(cars: int, seconds: float, backend: Backend) -> dict[str, Any]:
    """Are the innovations as large as the filter says, and the errors?"""
    shares, means, side, heading = [], [], [], []
    for course, seed in (("random-2104", 300), ("paper", 400)):
        log = recorded(course, seconds, cars, seed, backend)
        late = log.t > BEGIN
        nis, count = log["estimator.nis"][late], log["estimator.nis_count"][late]
        shares += list((nis <= chdtri(4, 0.05)).mean(axis=0))
        means += list(nis.sum(axis=0) / count.sum(axis=0))
        error = aside(log, log["estimator.x"], log["estimator.y"])
        turned = np.angle(np.exp(1j * (log["estimator.psi"] - log["car.psi"])))
        side += list((np.abs(error) <= 1.96 * log["estimator.side_deviation"])[late].mean(axis=0))
        heading += list((np.abs(turned) <= 1.96 * log["estimator.psi_deviation"])[late].mean(axis=0))
    fine = [0.93 <= share <= 0.97 for share in shares]
    report = {
        "innovation_ok_pct": 100.0 * float(np.mean(fine)),
        "innovation_share_pct": [100.0 * min(shares), 100.0 * max(shares)],
        "nis_mean": float(np.mean(means)),
        "side_coverage_pct": 100.0 * float(np.mean(side)),
        "heading_coverage_pct": 100.0 * float(np.mean(heading)),
    }
    print(f"innovations of {len(shares)} drives: {as_line(report)}")
    return report


def replayed(block: VehicleState, log: Log, lost: NDArray[np.bool_], jumped: NDArray[np.bool_]) -> Array:
    """The estimator's outputs (T, outputs) on the drive of one car, with samples lost and positions moved."""
    columns = [log[f"sensors.{name}"][:, 0] for name in _INPUTS] + [log["actuator.delta_sw"][:, 0]]
    rows = np.column_stack(columns)
    rows[lost, :7] = np.nan
    rows[jumped, 0] += JUMP
    first = block.D(*[float(value) for name, value in zip(block.U._fields, rows[0]) if name in block.D._fields])
    x, outputs = block.settle(0.0, block.init(), first), []
    for row in rows.tolist():
        u = block.U(*row)
        y = block.output(0.0, x, block.D(*[getattr(u, name) for name in block.D._fields]))
        x = block.update(0.0, x, u, y)
        outputs.append(y)
    return np.array(outputs)


def outages(seconds: float, backend: Backend) -> dict[str, Any]:
    """What 2 s without sensors and jumps of a position do."""
    log = recorded("paper", seconds, 1, 500, backend)
    scenario = scene("vehicle-state", "paper")
    block = scenario.sensors.state_estimator(scenario.nominal)
    assert isinstance(block, VehicleState)
    phase = log.t % EVERY
    lost, jumped = (log.t > EVERY) & (phase < OUTAGE), (log.t > EVERY) & (phase > 7.0) & (phase < 7.0 + JUMP_TIME)
    y = replayed(block, log, lost, jumped)
    names = list(block.Y._fields)
    one = {name: y[:, i] for i, name in enumerate(names)}
    side = aside(log, one["x"][:, None], one["y"][:, None])[:, 0]
    ends = lost & (phase > OUTAGE - 0.3)
    calm = (log.t > EVERY) & (phase > 5.0) & (phase < 7.0)
    report = {
        "outage_side_m": rms(side[ends]),
        "outage_side_deviation_m": rms(one["side_deviation"][ends]),
        "outage_coverage_pct": 100.0 * float(np.mean(np.abs(side[ends]) <= 1.96 * one["side_deviation"][ends])),
        "outage_said_pct": 100.0 * float(np.mean(one["outage"][lost & (phase > 0.6)])),
        "outage_false_pct": 100.0 * float(np.mean(one["outage"][calm])),
        "jump_side_m": rms(side[jumped]),
        "usual_side_m": rms(side[calm]),
        "jump_said_pct": 100.0 * float(np.mean(one["rejected"][jumped & (phase > 7.2)])),
    }
    print(f"outages of {OUTAGE:g} s, jumps of {JUMP:g} m for {JUMP_TIME:g} s: {as_line(report)}")
    return report
