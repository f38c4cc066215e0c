"""Tune Stanley's gains by gradient on a recorded lap: the whole run is differentiated, in one pass next to itself.

    python examples/tune_stanley_by_gradient.py [--seconds 90] [--iterations 15] [--out tuned.png]

The car is a VW Passat on the real lap `genesis` (3.7 km), with a lag of 0.1 s and a delay of 0.2 s in the steering.
The cost is the mean of (e/0.01 m)^2, e at the front axle, plus a price on the speed of the steering wheel; its
gradient with respect to the gains comes from `steerkit.compiled.gradient`, and L-BFGS-B does the rest. The gains are
tuned on the first `--seconds` of the lap and judged on the stretch after it, which they have not seen.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import minimize

from steerkit.compiled import compile
from steerkit.compiled.gradient import gradient
from steerkit.controllers.stanley import Stanley
from steerkit.diagram.loop import Loop
from steerkit.paths.courses import course
from steerkit.plants.nonlinear_single_track import NonlinearSingleTrack
from steerkit.plants.speed_driver import ConstantSpeed
from steerkit.plants.steering_actuator import SteeringActuator
from steerkit.scenario.assembly import placed, steering_loop
from steerkit.vehicles import vehicle

GAINS = {"controller.k": (0.3, 8.0), "controller.k_d_yaw": (0.0, 0.6), "controller.k_d_steer": (0.0, 0.9)}
SPEED = 6.0


def lap_loop(s: float) -> Loop:
    """The car on the recorded lap from arc length s [m] on, steered by Stanley."""
    path, car = course("genesis"), vehicle("vw-passat")
    return steering_loop(
        car=placed(NonlinearSingleTrack(vehicle=car, dt=0.05, substeps=5, v0=SPEED), path, s=s),
        path=path,
        driver=ConstantSpeed(speed=SPEED),
        controller=Stanley.of(car),
        actuator=SteeringActuator(delay=0.2, dt=0.05),
    )


def cost(sample: Any) -> Any:
    """Of one sample: 1 for 1 cm beside the path, or for 5 rad/s at the steering wheel."""
    return (sample["controller_path.e"] / 0.01) ** 2 + (sample["actuator.rate"] / 5.0) ** 2


def tuned(loop: Loop, seconds: float, iterations: int) -> tuple[np.ndarray, np.ndarray, list[float]]:
    """(first gains, tuned gains, cost after each iteration)."""
    evaluate = gradient(loop, seconds, parameters=tuple(GAINS), cost=cost)
    stanley = loop.blocks["controller"]
    first = np.array([getattr(stanley, name.split(".")[1]) for name in GAINS])
    history = [evaluate(first.tolist())[0]]
    found = minimize(
        evaluate,
        first,
        jac=True,
        method="L-BFGS-B",
        bounds=list(GAINS.values()),
        options={"maxiter": iterations},
        callback=lambda p: history.append(evaluate(p)[0]),
    )
    return first, found.x, history


def main(arguments: list[str] | None = None) -> float:
    """Tune, print what it brought, plot; returns cost after over cost before, on the unseen stretch."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="15 s and 2 iterations: shows that it runs")
    parser.add_argument("--seconds", type=float, default=90.0, help="length of the tuning run")
    parser.add_argument("--iterations", type=int, default=15)
    parser.add_argument("--out", default="", help="file for the picture")
    options = parser.parse_args(arguments)
    seconds, iterations = (15.0, 2) if options.quick else (options.seconds, options.iterations)
    begin = time.perf_counter()
    first, best, history = tuned(lap_loop(1.0), seconds, iterations)
    took = time.perf_counter() - begin
    print(f"{len(history) - 1} iterations in {took:.1f} s, cost {history[0]:.4f} -> {history[-1]:.4f}")
    for name, a, b in zip(GAINS, first, best):
        print(f"  {name.split('.')[1]:10} {a:.3f} -> {b:.3f}")
    unseen = lap_loop(1.0 + SPEED * seconds)
    logs = []
    for gains in (first, best):
        fields = {name.split(".")[1]: float(value) for name, value in zip(GAINS, gains)}
        trial: Any = replace(unseen.blocks["controller"], **fields)
        logs.append(compile(unseen.with_block("controller", trial), backend="python").run(seconds))
    costs = [float(np.mean(cost(log))) for log in logs]
    rms = [1000.0 * float(np.sqrt(np.mean(log["controller_path.e"][100:] ** 2))) for log in logs]
    less = 100.0 * (1.0 - costs[1] / costs[0])
    print(
        f"on the next {seconds:g} s, unseen: cost {costs[0]:.4f} -> {costs[1]:.4f} ({less:.0f} % less), "
        f"RMS e after 5 s {rms[0]:.1f} -> {rms[1]:.1f} mm"
    )
    if options.out:
        picture(logs, history, options.out)
    return costs[1] / costs[0]


def picture(logs: list[Any], history: list[float], file: str) -> None:
    """Cross-track error and wheel speed before and after, and the cost over the iterations."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 7.0), layout="constrained")
    axes = figure.subplots(3, 1)
    for log, label in zip(logs, ("first gains", "tuned by gradient")):
        axes[0].plot(log.t, log["controller_path.e"], label=label)
        axes[1].plot(log.t, log["actuator.rate"], label=label, linewidth=0.8)
    axes[0].set_ylabel("cross-track error [m]")
    axes[0].legend()
    axes[1].set_ylabel("wheel speed [rad/s]")
    axes[1].set_xlabel("t [s], on a stretch not used for tuning")
    axes[2].plot(history, marker="o")
    axes[2].set_ylabel("cost")
    axes[2].set_xlabel("iteration")
    figure.savefig(file, dpi=120)
    print(f"wrote {file}")


if __name__ == "__main__":
    main()
