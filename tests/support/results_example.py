"""A small results directory with made-up numbers, for tests of what reads results."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks.run.results import CURVE, EPISODES, Case, Results, Store, case_id

SCENARIOS = {
    f"paper-delay-{delay:g}": {
        "course.name": "paper",
        "vehicle.plant": "nonlinear",
        "driver.v_min": 4.0,
        "driver.v_max": 7.5,
        "steering.delay": delay,
        "steering.lag": 0.12,
        "vehicle.tyres": 1.0,
        "vehicle.friction": 1.0,
        "vehicle.ratio": 1.0,
        "steering.offset_deg": 0.0,
        "disturbances.wind": 0.0,
        "disturbances.bank_deg": 0.0,
        "sensors.noise": 0.0,
        "reference": "front",
        "course.rounds": 1.0,
    }
    for delay in (0.0, 0.2)
}
CONTROLLERS = {
    "stanley": {"kind": "analytic", "about": "Stanley, complete"},
    "nfq": {"kind": "learned", "about": "NFQ, integrating DOE"},
}


def example_results(place: Path, *, seeds: int = 3) -> Results:
    """Two controllers on two scenarios, an error, a peer that is not installed, learning curves."""
    ids = [case_id("tracking", s, c, n) for s in SCENARIOS for c in (*CONTROLLERS, "sb3-sac") for n in range(seeds)]
    ids += [case_id("learning-curve", "paper-delay-0", "nfq", n) for n in range(seeds)]
    store = Store(place)
    store.open(
        {
            "suites": {"tracking": "made up", "learning-curve": "made up"},
            "seeds": [*range(seeds)],
            "scenarios": SCENARIOS,
            "controllers": {**CONTROLLERS, "sb3-sac": {"kind": "peer", "about": "SAC of stable-baselines3"}},
            "source": "0" * 16,
            "planned": ids,
            "commit": "0123abc",
            "dirty": False,
            "versions": {"steerkit": "0.1.0", "python": "3.11.0", "numpy": "2.0.0"},
            "platform": "made up",
            "command": "python -m benchmarks run tracking",
            "config": {"jobs": 2},
        }
    )
    for name in ids:
        suite, scenario, controller, seed = name.split("--")
        common = dict(suite=suite, scenario=scenario, controller=controller, seed=int(seed[1:]), digest="ab" * 8)
        if controller == "sb3-sac":
            store.keep(Case(**common, status="not installed", error="stable-baselines3 is not installed"))
        elif suite == "learning-curve":
            store.keep(_learned(common), trajectory=_drive(int(seed[1:]), 0.05), curve=_curve(int(seed[1:])))
        elif name == ids[0]:
            store.keep(Case(**common, status="error", error="ValueError: made up"))
        else:
            drive = _drive(int(seed[1:]), 0.02 if controller == "stanley" else 0.03)
            store.keep(_driven(common, drive), trajectory=drive)
    return store.merge()


def _drive(seed: int, size: float) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 60.0, 0.1)
    angle = 2.0 * np.pi * t / 60.0
    e = size * np.sin(7.0 * angle + rng.uniform(0.0, 6.0))
    delta = 0.5 * np.sin(angle)
    return {
        "t": t,
        "s": 5.0 * t,
        "x": 47.7 * np.sin(angle),
        "y": 47.7 * (1.0 - np.cos(angle)),
        "e": e,
        "psi_e": 0.1 * e,
        "v": np.full_like(t, 5.0),
        "delta_sw": delta,
        "delta_sw_rate": np.gradient(delta, t),
        "a_y": np.full_like(t, 0.52) + 2.0 * e,
        "learning": np.ones_like(t),
    }


def _driven(common: dict, drive: dict[str, np.ndarray]) -> Case:
    e = drive["e"]
    metrics = {
        "held": 1.0,
        "course.rounds": 1.0,
        "duration": 60.0,
        "rms_e": float(np.sqrt(np.mean(e**2))),
        "max_e": float(np.abs(e).max()),
        "share_within_5cm": float(np.mean(np.abs(e) < 0.05)),
        "rms_wheel_rate_deg": 3.0 + common["seed"],
        "max_a_y": float(np.abs(drive["a_y"]).max()),
        "rms_jerk": 0.3,
        "max_jerk": float("nan"),
        "step_p50_us": 20.0,
        "step_p99_us": 31.0,
    }
    return Case(**common, metrics=metrics, cpu_seconds=1.5)


def _learned(common: dict) -> Case:
    times = {"round_minutes": 3.0 + common["seed"], "good_minutes": float("inf"), "transitions": 9000.0}
    return Case(**common, kind="learn", metrics={"held": 1.0, "rms_e": 0.04, **times})


def _curve(seed: int) -> dict[str, np.ndarray]:
    n = 12
    t = np.linspace(10.0, 300.0, n) + seed
    curve = {name: np.zeros(n) for name in CURVE}
    curve |= {
        "t": t,
        "transitions": 20.0 * t,
        "failures": np.minimum(np.arange(n), 6),
        "held": (t > 150.0) * 1.0,
        "course.rounds": np.minimum(1.0, t / 150.0),
        "rms_e": 0.3 * np.exp(-t / 80.0),
    }
    curve["rms_e"][0] = np.nan
    return curve | {name: np.arange(6.0) + 1.0 for name in EPISODES}
