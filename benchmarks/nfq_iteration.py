"""How fast is one NFQ iteration? Targets and 300 Rprop epochs on 20,000 transitions, against torch.optim.Rprop.

Both engines do the same work on one thread, in turns, in one run: the same transitions, the same start weights, the
same targets. A figure counts only when both arrive at the same error (the equal-work gate).

    python -m benchmarks.nfq_iteration [--quick] [--json]
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import platform
import statistics
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from steerkit.controllers.nfq_policy import IDOE_ACTIONS, NfqPolicy
from steerkit.learning import rprop
from steerkit.learning.costs import TanhCost
from steerkit.learning.nfq import FitSetting, fresh_nets, iterate, targets
from steerkit.learning.qnetwork import Net, new_net
from steerkit.learning.state import STANDARD, patterns
from steerkit.learning.transitions import Transitions

TOLERANCE_10 = 1e-3
"""Largest relative difference of the errors after 10 epochs: single precision, the same path."""
TOLERANCE_300 = 0.25
"""The same after 300: Rprop acts on signs, which magnify the last bit; the median over the starts must be this near."""


def drives(n: int, seed: int = 0) -> Transitions:
    """n transitions of a kinematic car (wheelbase 2.71 m, ratio 15.6) under random I-DOE actions, in short episodes.

    A thousand cars at most go side by side over paths of random curvature; each starts anew at |e| > 0.5 m.
    """
    rng, dt, cars = np.random.default_rng(seed), 0.05, min(n, 1000)
    record = Transitions()
    e, psi_e, doe, kappa, v, episode = (np.zeros(cars) for _ in range(6))
    fresh, count = np.ones(cars, dtype=bool), 0
    rows: list[Any] = []
    for _ in range(-(-n // cars)):
        k = int(fresh.sum())
        e[fresh], psi_e[fresh] = rng.uniform(-0.3, 0.3, k), rng.uniform(-0.1, 0.1, k)
        kappa[fresh], v[fresh] = rng.uniform(-0.05, 0.05, k), rng.uniform(4.0, 7.5, k)
        doe[fresh] = np.arctan(2.71 * kappa[fresh]) * 15.6 + rng.normal(0.0, 0.3, k)
        episode[fresh] = count + np.arange(k)
        count += k

        def state() -> np.ndarray:
            r = v * np.tan(doe / 15.6) / 2.71  # noqa: B023
            return np.column_stack([e, v * np.sin(psi_e), v, psi_e, r - v * kappa, doe])  # noqa: B023

        s, a = state(), rng.choice(np.array(IDOE_ACTIONS), cars)
        doe = np.clip(doe + a, STANDARD.low[5], STANDARD.high[5])
        psi_e = psi_e + dt * (v * np.tan(doe / 15.6) / 2.71 - v * kappa)
        e = e + dt * v * np.sin(psi_e)
        rows.append((s, a, state(), episode.astype(int)))
        fresh = np.abs(e) > 0.5
    s, a, s_next, number = (np.stack(part, axis=1) for part in zip(*rows, strict=True))  # a car's samples in a row
    flat = (s.reshape(-1, 6), a.ravel(), s_next.reshape(-1, 6), number.ravel())
    record.extend(*(part[:n] for part in flat))
    return record


def seconds(work: Callable[[], Any]) -> float:
    """Wall-clock time of one call [s]."""
    began = time.perf_counter()
    work()
    return time.perf_counter() - began


def in_turns(works: dict[str, Callable[[], Any]], repeats: int) -> dict[str, float]:
    """Median time of each [s]; they take turns, so that a slow spell of the machine meets them all."""
    times: dict[str, list[float]] = {name: [] for name in works}
    for _ in range(repeats):
        for name, work in works.items():
            times[name].append(seconds(work))
    return {name: statistics.median(values) for name, values in times.items()}


def equal_work(record: Transitions, nets: tuple[Net, ...], starts: int) -> dict[str, float]:
    """Medians over the starts of our error relative to PyTorch's, after 10 and after 300 epochs."""
    x = patterns(STANDARD, record.s, record.a, STANDARD.scale_of(IDOE_ACTIONS))
    y = targets(record, IDOE_ACTIONS, TanhCost(), nets=nets)
    ours = [rprop.fit(new_net(seed=k), x, y, engine="c").errors for k in range(starts)]
    torch = [rprop.fit(new_net(seed=k), x, y, engine="torch").errors for k in range(starts)]
    found: dict[str, float] = {"error_start": float(ours[0][0])}
    for epoch in (10, 300):
        found[f"error_{epoch}"] = statistics.median(e[epoch] for e in ours)
        found[f"error_{epoch}_torch"] = statistics.median(e[epoch] for e in torch)
        found[f"error_ratio_{epoch}"] = statistics.median(a[epoch] / b[epoch] for a, b in zip(ours, torch, strict=True))
    return found


def decision(batch: int = 0) -> float:
    """Time of one greedy decision of three nets over five actions [us]; of a batch, per car."""
    policy = NfqPolicy(nets=fresh_nets(FitSetting(nets=3)))
    rng, x = np.random.default_rng(0), policy.init()
    values = rng.uniform(-0.3, 0.3, (6, batch)) if batch else rng.uniform(-0.3, 0.3, 6).tolist()
    u, count = policy.D(*values), 50 if batch else 2000
    policy.output(0.0, x, u)
    best = min(seconds(lambda: [policy.output(0.0, x, u) for _ in range(count)]) for _ in range(5))
    return best / count / max(1, batch) * 1e6


def measure(quick: bool) -> dict[str, Any]:
    """All figures, as one flat dictionary."""
    import torch

    torch.set_num_threads(1)
    rprop.engine_of("auto")  # compile first
    n, sizes, repeats = (2_000, (500, 2_000), 3) if quick else (20_000, (2_000, 20_000, 200_000), 7)
    record, nets = drives(n), fresh_nets(FitSetting(), seed=1)

    def iteration(engine: rprop.Engine, data: Transitions) -> Callable[[], Any]:
        setting = FitSetting(engine=engine, hints=0)
        return lambda: iterate(data, IDOE_ACTIONS, TanhCost(), setting, nets_before=nets)

    works = {"torch": iteration("torch", record), "ours": iteration("c", record)}
    in_turns(works, 1)
    times = in_turns(works, repeats)
    found: dict[str, Any] = {
        "transitions": n,
        "epochs": 300,
        "seconds": times["ours"],
        "seconds_torch": times["torch"],
        "vs_torch_rprop_x": times["torch"] / times["ours"],
        "seconds_targets": in_turns({"targets": lambda: targets(record, IDOE_ACTIONS, TanhCost(), nets=nets)}, 5)["targets"],
        **equal_work(record, nets, 3 if quick else 5),
    }  # fmt: skip
    near_10 = abs(found["error_ratio_10"] - 1.0) <= TOLERANCE_10
    found["equal_work"] = near_10 and abs(found["error_ratio_300"] - 1.0) <= TOLERANCE_300
    grown = in_turns({str(size): iteration("c", drives(size)) for size in sizes}, 3)
    found |= {f"linear_seconds_{size}": grown[str(size)] for size in sizes}
    found["linear_us_per_transition"] = [1e6 * grown[str(size)] / size for size in sizes]
    found["linear_worst_x"] = found["linear_us_per_transition"][-1] / found["linear_us_per_transition"][0]
    found |= {"decision_numpy_us": decision(), "decision_numpy_us_per_car_of_1000": decision(1000)}
    versions = {"torch": torch.__version__, "numpy": np.__version__, "python": platform.python_version()}
    return found | {"versions": versions, "machine": platform.machine(), "cores": os.cpu_count()}


def table(found: dict[str, Any]) -> str:
    """The figures for reading."""
    n = found["transitions"]
    lines = [
        f"one NFQ iteration: {n} transitions, 5 actions, targets + 300 epochs of full-batch Rprop, 7-10-10-1, one thread",
        f"  {'steerkit (C)':24}{found['seconds'] * 1e3:10.1f} ms   (targets {found['seconds_targets'] * 1e3:.1f} ms of it)",
        f"  {'torch.optim.Rprop':24}{found['seconds_torch'] * 1e3:10.1f} ms   {found['vs_torch_rprop_x']:.1f} times slower",
    ]  # fmt: skip
    for peer in ("d3rlpy", "psipy"):
        there = importlib.util.find_spec(peer) is not None
        lines.append(f"  {peer:24}{'installed, no full-batch Rprop to compare' if there else 'not installed':>10}")
    for epoch in (10, 300):
        lines.append(
            f"mean squared error after {epoch:3d} epochs (median of starts): {found[f'error_{epoch}']:.6f}, PyTorch "
            f"{found[f'error_{epoch}_torch']:.6f}, ratio {found[f'error_ratio_{epoch}']:.4f}"
        )
    lines.append(f"equal work (ratios within {TOLERANCE_10} and {TOLERANCE_300} of 1): {found['equal_work']}")
    for name, value in found.items():
        if name.startswith("linear_seconds_"):
            lines.append(f"  {name.rsplit('_', 1)[1]:>8} transitions {value * 1e3:10.1f} ms")
    lines.append(
        f"one greedy decision, 3 nets, 5 actions: {found['decision_numpy_us']:.1f} us; "
        f"{found['decision_numpy_us_per_car_of_1000']:.2f} us a car in a batch of 1000"
    )
    return "\n".join(lines)


def main() -> None:
    """Parse the command line, measure, print; exit code 1 when the equal-work gate fails."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="2,000 transitions: a smoke test, not a measurement")
    parser.add_argument("--json", action="store_true", help="one JSON object as the last line")
    choice = parser.parse_args()
    found = measure(choice.quick)
    print(table(found))
    if choice.json:
        print(json.dumps(found))
    if not found["equal_work"]:
        raise SystemExit("the engines did not do equal work: see the error ratios; the times above do not count")


if __name__ == "__main__":
    main()
