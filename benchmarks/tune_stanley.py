"""Stanley's gains, by a procedure that anyone can repeat: a grid, many cars, the worst case counts.

Every car drives one round of the 795 m course (nonlinear single track, 0.1 s steering lag, a human at 4 to 9 m/s who
slows to 3 m/s^2 in bends), starting 0.5 m off. The controller is `Predicted` around `Stanley`, told a delay of 0, 0.1,
0.2 or 0.3 s; the true delay is that, or 0.05 s less or more. Each is driven with the right car and with tyres and
steering ratio off in the four ways that +-30 % and +-10 % allow together.

The choice: of all gains whose worst RMS e is within 20 % of the best, those with the least worst wheel speed (RMS).
Beside it: the same for Stanley without prediction at delays 0, 0.1 and 0.2 s, beyond which it swings.

    python -m benchmarks.tune_stanley [--quick] [--json]
"""

from __future__ import annotations

import argparse
import itertools
import json
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.driving import CAR, LAG, drive_loop, driven, rms
from steerkit.block import Block
from steerkit.controllers.delay import Predicted
from steerkit.controllers.stanley import Stanley
from steerkit.courses import course
from steerkit.units import degrees_of

GAINS = {"k": (1.5, 2.0, 2.5, 3.0, 4.0), "k_d_yaw": (0.0, 0.05, 0.1, 0.15), "k_d_steer": (0.0, 0.1, 0.2, 0.3, 0.5)}
CARS = [(1.0, 1.0), *itertools.product((0.7, 1.3), (0.9, 1.1))]
"""Tyre stiffness and steering ratio, times the nominal."""
TOLD = (0.0, 0.1, 0.2, 0.3)
OFF = (-0.05, 0.0, 0.05)
SECONDS = 200.0
NEAR_BEST = 1.2


@dataclass
class Result:
    """Worst case of every point of the grid, (gains,): RMS e [m] and RMS wheel speed [rad/s]."""

    e: Any
    rate: Any

    @property
    def chosen(self) -> int:
        """The number of the chosen gains."""
        good = self.e <= NEAR_BEST * self.e.min()
        return int(np.argmin(np.where(good, self.rate, np.inf)))


def judged(controller: Block, prefix: str, delays: list[float], grid: Any, cars: Any) -> Result:
    """Worst over cars and delays, for every gain."""
    length = course("paper").length
    n, count = len(grid), len(cars)
    values = {f"{prefix}.{name}": np.repeat(grid[:, i], count) for i, name in enumerate(GAINS)}
    values |= {f"car.vehicle.{name}": np.tile(cars[:, 0] * getattr(CAR, name), n) for name in ("c_f", "c_r")}
    values["car.vehicle.steer_ratio"] = np.tile(cars[:, 1] * CAR.steer_ratio, n)
    e, rate = np.zeros(n), np.zeros(n)
    for delay in delays:
        log = driven(drive_loop(controller, delay=delay, e=0.5), SECONDS, values)
        for total, signal in ((e, "path.e"), (rate, "actuator.rate")):
            worst = rms(log, signal, length).reshape(n, count)
            np.maximum(total, np.where(np.isfinite(worst), worst, np.inf).max(axis=1), out=total)
    return Result(e, rate)


def tuned(quick: bool) -> dict[str, Any]:
    """Both searches: the chosen gains and what they and the present defaults reach."""
    grid = np.array(list(itertools.product(*(values[::2] if quick else values for values in GAINS.values()))))
    present = np.array([[getattr(Stanley.of(CAR), name) for name in GAINS]])
    grid, cars = np.vstack((grid, present)), np.array(CARS[:1] if quick else CARS)
    stanley = Stanley.of(CAR)
    results = []
    for told in TOLD:
        controller = Predicted.around(stanley, CAR, delay=told, lag=LAG)
        delays = sorted({max(0.0, round(told + off, 3)) for off in OFF})
        results.append(judged(controller, "controller.block", delays, grid, cars))
    predicted = Result(np.max([r.e for r in results], axis=0), np.max([r.rate for r in results], axis=0))
    plain = judged(stanley, "controller", [0.0, 0.1, 0.2], grid, cars)
    report = {}
    for name, result in (("predicted", predicted), ("plain", plain)):
        report[name] = {
            which: {
                **dict(zip(GAINS, grid[i].tolist())),
                "rms_e_m": float(result.e[i]),
                "rms_rate_deg_s": float(degrees_of(result.rate[i])),
            }
            for which, i in (("best", int(np.argmin(result.e))), ("chosen", result.chosen), ("default", len(grid) - 1))
        }
    return report


def main() -> None:
    """Search, print what was found, and with --json one object last."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="every other gain, the right car only")
    parser.add_argument("--json", action="store_true", help="print one JSON object last")
    arguments = parser.parse_args()
    report = tuned(arguments.quick)
    for name, rows in report.items():
        print(f"\nStanley, {name}: worst case over delays and cars")
        print(f"{'':9}{'k':>6}{'k_d_yaw':>9}{'k_d_steer':>11}{'RMS e':>9}{'RMS wheel speed':>18}")
        for which, row in rows.items():
            print(f"{which:9}{row['k']:6.2f}{row['k_d_yaw']:9.2f}{row['k_d_steer']:11.2f}{row['rms_e_m']:7.3f} m"
                  f"{row['rms_rate_deg_s']:12.1f} deg/s")  # fmt: skip
    if arguments.json:
        print(json.dumps(report))


if __name__ == "__main__":
    main()
