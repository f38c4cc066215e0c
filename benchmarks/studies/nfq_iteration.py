"""The time of one NFQ iteration: targets and 300 Rprop epochs on 20,000 transitions, against torch.optim.Rprop.

Both engines do the same work on one thread, in turns, in one run: the same transitions, the same start weights, the
same targets. A figure counts only when both arrive at the same error (the equal-work gate). The times of an iteration
grow with the transitions, to a million; `memory_x_data` is the most memory that the largest of them takes, the
transitions themselves included, over that of the transitions (NumPy's arrays; the C code asks for none).

    python -m benchmarks study nfq_iteration [--quick] [--json]
"""

import argparse
import os
import platform
import statistics
import tracemalloc
from collections.abc import Callable, Mapping
from timeit import repeat, timeit
from typing import Any

import numpy as np

from benchmarks.tables import show_figures
from steerkit.controllers.nfq_policy import IDOE_ACTIONS, NfqPolicy
from steerkit.controllers.policy import COLUMNS, DOE
from steerkit.learning.costs import TanhCost
from steerkit.learning.data.transitions import Transitions
from steerkit.learning.nfq import rprop
from steerkit.learning.nfq.iterate import STANDARD, FitSetting, Problem, fresh_nets, iterate, patterns, targets
from steerkit.learning.nfq.rprop import new_net
from steerkit.task import DT, TRIP

TOLERANCE = {10: 1e-4, 300: 0.1}
"""Largest relative difference of the errors after so many epochs. Weights move by signs, so both engines take the very
same path until rounding turns one sign; after 10 epochs every start must agree, after 300 the median over the starts
(PyTorch in single and in double precision differ by up to a tenth there)."""


def drives(n: int, seed: int = 0) -> Transitions:
    """n transitions of a kinematic car (wheelbase 2.71 m, ratio 15.6) under random I-DOE actions, in short episodes.

    A thousand cars at most go side by side over paths of random curvature; each starts anew at |e| > 0.5 m.
    """
    rng, dt, cars = np.random.default_rng(seed), DT, min(1000, 1 + n // 100)
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
        doe = np.clip(doe + a, STANDARD.low[DOE], STANDARD.high[DOE])
        psi_e = psi_e + dt * (v * np.tan(doe / 15.6) / 2.71 - v * kappa)
        e = e + dt * v * np.sin(psi_e)
        rows.append((s, a, state(), episode.astype(int)))
        fresh = np.abs(e) > TRIP
    s, a, s_next, number = (np.stack(part, axis=1) for part in zip(*rows, strict=True))  # a car's samples in a row
    flat = (s.reshape(-1, len(COLUMNS)), a.ravel(), s_next.reshape(-1, len(COLUMNS)), number.ravel())
    record.extend(*(part[:n] for part in flat))
    return record


def in_turns(works: dict[str, Callable[[], Any]], repeats: int) -> dict[str, float]:
    """Median time of each [s]; they take turns, so that a slow spell of the machine meets them all."""
    times: dict[str, list[float]] = {name: [] for name in works}
    for _ in range(repeats):
        for name, work in works.items():
            times[name].append(timeit(work, number=1))
    return {name: statistics.median(values) for name, values in times.items()}


def equal_work(x: np.ndarray, y: np.ndarray, starts: int) -> dict[str, Any]:
    """Our error relative to PyTorch's after 10 and 300 epochs: medians and extremes over the starts."""
    ours = [rprop.fit(new_net(seed=k), x, y, engine="c").errors for k in range(starts)]
    torch = [rprop.fit(new_net(seed=k), x, y, engine="torch").errors for k in range(starts)]
    numbers: dict[str, Any] = {"starts": starts}
    for epoch in (10, 300):
        ratios = [float(a[epoch] / b[epoch]) for a, b in zip(ours, torch, strict=True)]
        numbers[f"error_ratio_{epoch}"] = statistics.median(ratios)
        numbers[f"error_ratio_{epoch}_span"] = [min(ratios), max(ratios)]
    every_start = max(abs(ratio - 1.0) for ratio in numbers["error_ratio_10_span"]) <= TOLERANCE[10]
    numbers["equal_work"] = every_start and abs(numbers["error_ratio_300"] - 1.0) <= TOLERANCE[300]
    return numbers


def decision(batch: int = 0, count: int = 2000) -> float:
    """Time of one greedy decision of three nets over five actions, the best of five; of a batch, per car [us]."""
    policy = NfqPolicy(nets=fresh_nets(FitSetting(nets=3)))
    rng, x = np.random.default_rng(0), policy.init()
    values = rng.uniform(-0.3, 0.3, (6, batch)) if batch else rng.uniform(-0.3, 0.3, 6).tolist()
    u = policy.D(*values)
    policy.output(0.0, x, u)
    best = min(repeat(lambda: policy.output(0.0, x, u), number=count, repeat=5))
    return best / count / max(1, batch) * 1e6


def memory(work: Callable[[], Any], record: Transitions) -> float:
    """The most memory that the work takes beside the record, and the record, over the record."""
    data = sum(part.nbytes for part in (record.s, record.a, record.s_next, record.episode))
    tracemalloc.start()
    try:
        work()
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    return (data + peak) / data


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Measure and print; all figures, as one flat dictionary."""
    import torch

    quick = options.quick
    torch.set_num_threads(1)
    rprop.engine_of("auto")  # compile first
    n, sizes, repeats = (500, (250, 500), 1) if quick else (20_000, (2_000, 20_000, 200_000, 1_000_000), 7)
    record, nets, start = drives(n), fresh_nets(seed=1), new_net(seed=0)
    x = patterns(STANDARD, record.s, record.a, STANDARD.scale_of(IDOE_ACTIONS))
    problem = Problem(actions=IDOE_ACTIONS, cost=TanhCost(), fit=FitSetting(hints=0))
    y = targets(problem, record, nets)

    def whole(data: Transitions) -> Callable[[], Any]:
        return lambda: iterate(data, problem, nets)

    works: dict[str, Callable[[], Any]] = {
        "ours": whole(record),
        "fit": lambda: rprop.fit(start, x, y, engine="c"),
        "torch": lambda: rprop.fit(start, x, y, engine="torch"),
    }
    if not quick:
        in_turns(works, 1)  # caches are warm then
    times = in_turns(works, repeats)
    rest = max(0.0, times["ours"] - times["fit"])  # patterns and targets: granted to PyTorch at our speed
    numbers: dict[str, Any] = {
        "transitions": n,
        "epochs": 300,
        "seconds": times["ours"],
        "seconds_torch": times["torch"] + rest,
        "vs_torch_rprop_x": (times["torch"] + rest) / times["ours"],
        "seconds_fit": times["fit"],
        "seconds_fit_torch": times["torch"],
        **equal_work(x, y, 1 if quick else 7),
    }
    records = {size: drives(size) for size in sizes}
    grown = in_turns({str(size): whole(data) for size, data in records.items()}, 3)
    most = records[sizes[-1]]
    numbers |= {f"linear_seconds_{size}": grown[str(size)] for size in sizes}
    numbers |= {"memory_x_data": memory(whole(most), most), "memory_transitions": len(most)}
    numbers |= {"decision_numpy_us": decision(count=50 if quick else 2000)}
    numbers |= {"decision_numpy_us_per_car_of_1000": decision(1000, 2 if quick else 50)}
    versions = {"torch": torch.__version__, "numpy": np.__version__, "python": platform.python_version()}
    numbers |= {"versions": versions, "machine": platform.machine(), "cores": os.cpu_count()}
    print("one NFQ iteration on one thread: targets, then 300 epochs of full-batch Rprop of a 7-10-10-1 net, 5 actions")
    show_figures(numbers)
    return numbers


def objection(figures: Mapping[str, Any]) -> str:
    """Why the times do not count, if they do not."""
    return "" if figures["equal_work"] else "the engines did not do equal work: see the error ratios"
