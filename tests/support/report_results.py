"""A small results directory of known numbers, for tests of what reads results: drives, a grid, a learner, failures."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.run.results import Case, Results, Store, load_results
from steerkit.metrics import measures
from steerkit.paths.courses import course

CONTROLLERS = {"stanley": 1.0, "pure-pursuit": 3.0, "nfq-idoe": 1.6}
"""Name and how wide it swings."""
SEEDS = (0, 1, 2, 3, 4, 5)
PROVENANCE: dict[str, Any] = {
    "suites": dict.fromkeys(("tracking", "robustness", "paper"), "made up"),
    "controllers": {n: {"kind": "learned" if "nfq" in n else "analytic", "about": f"about {n}"} for n in CONTROLLERS},
    "versions": {"python": "3.11.0", "numpy": "2.0.0"},
} | {"scenarios": {}, "seeds": [], "planned": [], "source": "0" * 40, "commit": "0" * 40}


def scenario(name: str, **changes: Any) -> dict[str, Any]:
    drives = {"driver.v_min": 4.0, "driver.v_max": 7.5, "steering.delay": 0.0}
    return {"name": name, "course.name": "paper", "vehicle.plant": "nonlinear"} | drives | changes


def scenarios() -> dict[str, dict[str, Any]]:
    found = {"paper": scenario("paper"), "genesis": scenario("genesis", **{"course.name": "genesis"})}
    for delay in (0.0, 0.1, 0.2, 0.3):
        for v in (4.0, 6.0, 9.0):
            name = f"delay {delay:g} v {v:g}"
            found[name] = scenario(name, **{"driver.v_min": v, "driver.v_max": v, "steering.delay": delay})
    return found


def drive(controller: str, fields: dict[str, Any], seed: int) -> dict[str, np.ndarray]:
    """The course, with a wave of known size about it."""
    path, rng = course(fields["course.name"]), np.random.default_rng(seed)
    v = 0.5 * (fields["driver.v_min"] + fields["driver.v_max"])
    t = np.arange(0.0, min(path.length / v, 60.0), 0.1)
    s = np.clip(v * t, 0.0, path.length)
    swing = 0.02 * CONTROLLERS[controller] * (1.0 + 9.0 * fields["steering.delay"]) * (v / 6.0) * rng.uniform(0.8, 1.2)
    e = swing * np.sin(0.8 * t + seed)
    frames = np.column_stack(np.broadcast_arrays(*path.frame(s)))
    psi_e = 0.02 * np.cos(0.8 * t + seed)
    x, y = frames[:, 0] - e * frames[:, 3], frames[:, 1] + e * frames[:, 2]
    kappa = frames[:, 2] * frames[:, 5] - frames[:, 3] * frames[:, 4]
    delta_sw = 15.6 * (2.7 * kappa + 0.3 * e)
    here = dict(t=t, s=s, x=x, y=y, e=e, psi_e=psi_e, v=np.full_like(t, v))
    return here | {"delta_sw": delta_sw, "a_y": v * v * kappa + 0.3 * np.sin(5.0 * t)}


def driven(suite: str, name: str, controller: str, seed: int) -> tuple[Case, dict[str, np.ndarray]]:
    log = drive(controller, scenarios()[name], seed)
    found = measures(**{key: log[key] for key in ("t", "e", "psi_e", "delta_sw", "a_y")})
    found |= {"rms_e_front": found["rms_e"], "max_e_front": found["max_e"]}
    found |= {
        "held": float(found["max_e"] <= 0.15),
        "rounds": 1.0,
        "step_p50_us": 12.0 * CONTROLLERS[controller],
        "step_p99_us": 30.0 * CONTROLLERS[controller],
    }
    return Case(suite=suite, scenario=name, controller=controller, seed=seed, metrics=found, cpu_seconds=1.5), log


def learnt(seed: int) -> tuple[Case, dict[str, np.ndarray]]:
    """Nets every 10 s for five minutes; good from minute 1 + seed/2 on, but never for the last seed."""
    t = np.arange(10.0, 300.0, 10.0)
    ready = 60.0 + 30.0 * seed if seed < SEEDS[-1] else math.inf
    good = t >= ready
    rms_e = np.where(good, 0.02, np.where(t > 0.5 * ready, 0.15, math.nan))
    curve = dict(t=t, transitions=20.0 * t, failures=t / 20.0, rms_e=rms_e, max_e=3.0 * rms_e)
    curve |= {"held": np.isfinite(rms_e) * 1.0, "rounds": np.where(good, 1.0, 0.4)}
    curve |= {"rms_wheel_rate_deg": np.full_like(t, 60.0), "max_a_y": np.full_like(t, 3.0)}
    curve |= {"max_jerk": np.full_like(t, 3.0)}
    metrics = {f"{what}_minutes": ready / 60.0 for what in ("round", "good")}
    metrics |= {"round_episodes": ready / 20.0, "good_episodes": ready / 20.0, "transitions": 6000.0}
    about = dict(suite="training", scenario="train-clean", controller="nfq-idoe", kind="learn")
    return Case(**about, seed=seed, metrics=metrics), curve


def write(place: Path, *, seeds: tuple[int, ...] = SEEDS, grid: bool = True) -> Results:
    """The directory, whole: a suite of drives, one of a grid, one of learning, an error and an absent peer."""
    store, fields = Store(place), scenarios()
    cases: list[tuple[Case, dict[str, np.ndarray] | None, dict[str, np.ndarray] | None]] = []
    for controller in CONTROLLERS:
        for seed in seeds:
            cases += [(*driven("tracking", name, controller, seed), None) for name in ("paper", "genesis")]
        for seed in seeds[:1] if grid else ():
            conditions = [n for n in fields if n.startswith("delay")]
            cases += [(*driven("robustness", name, controller, seed), None) for name in conditions]
    for seed in seeds:
        case, curve = learnt(seed)
        cases.append((case, None, curve))
        cases.append((*driven("paper", "paper", "nfq-idoe", seed), None))
    broken = Case(suite="tracking", scenario="paper", controller="mpc", seed=0, status="error", error="solver <failed>")
    absent = Case(suite="tracking", scenario="paper", controller="sac", seed=0, status="not installed", error="no sb3")
    planned = [c.id for c, *_ in cases] + [broken.id, absent.id, "tracking--paper--mpc--s1"]
    store.open(PROVENANCE | {"seeds": [*seeds], "scenarios": fields, "planned": planned})
    for case, trajectory, curve in cases:
        store.keep(case, trajectory=trajectory, curve=curve)
    store.keep(broken)
    store.keep(absent)
    return load_results(place)


def changed(case: Case, **metrics: float) -> Case:
    """The case with other numbers, if it has any."""
    return replace(case, metrics={**case.metrics, **metrics}) if case.status == "done" else case
