"""Cost of following a target of lateral acceleration, as comma's controls challenge has it, on a car steered by torque.

The car is `benchmarks.plants.torque_car`, with gains and wander of its own for every seed; the challenge's simulator is
not shipped, so these costs and those of its leaderboard are no measure of each other. Targets last 60 s at 10 Hz, and
controllers see 5 s ahead.

* lat_cost: mean total_cost (50 times 100 mean square error, and 100 mean square jerk) over drawn targets, one a seed.
* lat_cost_laps: the same over the pieces of a recorded lap's own lateral acceleration, within +-1.8 m/s^2 and driven at
  no less than 8 m/s, for which the car is made.
* lat_interval, lat_interval_laps: their 95 % bootstrap intervals.

Controllers: `pid`, a PID with feed-forward, in the file format of the challenge, tuned by --draws draws on other seeds;
`lqr` and `mpc`, told the car's dead time and lag; `lqr-learned` and `mpc-learned`, with the response that is fitted to
drives on those other seeds; `sac`, Stable-Baselines3's SAC on `steerkit/LateralAcceleration-v0`, trained for
--lateral-minutes of driving on targets and cars drawn anew in each episode, the mean over --trainings.

    python -m benchmarks study scoreboard --parts lateral [--targets N] [--lateral-minutes M] [--quick] [--json]
"""

import argparse
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.foreign_cars import CARS
from benchmarks.peers.lateral_pid import Controller
from benchmarks.statistics import interval
from benchmarks.tables import show
from steerkit.controllers.lateral import ChallengeController, LateralMpc
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block
from steerkit.diagram.maths import Array
from steerkit.diagram.simulation import Log
from steerkit.scenario import Scenario
from steerkit.scenario.lateral import MOVES, LateralTarget, lateral_controller, lateral_cost_of, lateral_drive

CAR = Scenario(
    name="torque",
    vehicle={**CARS["torque"].vehicle, "plant": CARS["torque"].plant},
    steering=dict(CARS["torque"].steering),
)
TUNED_ON = range(1000, 1008)
"""Seeds of targets and cars for tuning and fitting."""
HELD_OUT = 2000
"""The first of those that all are measured on."""
TAPS = 25
"""Samples of a fitted response."""


def add_options(parser: argparse._ActionsContainer) -> None:
    """How many targets, and how long is tuned and trained."""
    parser.add_argument("--targets", type=int, default=20, help="drawn targets (default 20)")
    parser.add_argument("--pid-draws", type=int, default=60, help="gains that are tried for the PID (default 60)")
    parser.add_argument("--lateral-minutes", type=float, default=60.0, help="driving of a training (default 60 min)")
    parser.add_argument("--trainings", type=int, default=1, help="of SAC (default 1; 0: without)")


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Tune, fit and train; drive all after the same targets; print the table; return its figures."""
    quick, seconds = options.quick, 8.0 if options.quick else 60.0
    tuned_on = [(LateralTarget.drawn(seed, seconds=seconds), seed) for seed in (TUNED_ON[:1] if quick else TUNED_ON)]
    held_out = range(HELD_OUT, HELD_OUT + (2 if quick else options.targets))
    drawn = [(LateralTarget.drawn(seed, seconds=seconds), seed) for seed in held_out]
    laps = [(piece, HELD_OUT + i) for i, piece in enumerate(lap_pieces(seconds))][: 1 if quick else None]
    makes: dict[str, Sequence[Block]] = {"pid": [tuned_pid(tuned_on, 2 if quick else options.pid_draws)]}
    told: dict[str, Any] = {name: lateral_controller(name, CAR) for name in MOVES}
    response, gain = fitted([lateral_drive(CAR, target, told["lqr"], seed=seed) for target, seed in tuned_on])
    makes |= {name: [block] for name, block in told.items()}
    makes |= {f"{name}-learned": [replace(block, response=response, gain=gain)] for name, block in told.items()}
    if trainings := min(options.trainings, 1) if quick else options.trainings:
        minutes = 0.2 if quick else options.lateral_minutes
        makes["sac"] = [trained(seed, minutes) for seed in range(trainings)]
    figures: dict[str, Any] = {}
    rows = []
    for name, blocks in makes.items():
        row: dict[str, Any] = {"controller": name}
        for kind, targets in (("", drawn), ("_laps", laps)):
            found = interval([np.mean([cost(block, *one) for block in blocks]) for one in targets])
            figures.setdefault(f"lat_cost{kind}", {})[name] = found.value
            figures.setdefault(f"lat_interval{kind}", {})[name] = [found.low, found.high]
            row[f"lat_cost{kind}"] = str(found)
        rows.append(row)
    show("total_cost, mean and 95 % interval", rows)
    return figures


def cost(block: Block, target: LateralTarget, seed: int) -> float:
    """Of a drive after that target, with the car of that seed."""
    return lateral_cost_of(lateral_drive(CAR, target, block, seed=seed))["total_cost"]


def lap_pieces(seconds: float) -> list[LateralTarget]:
    """A recorded lap's lateral acceleration in pieces, each from straight ahead, within what the car can do."""
    rows = LateralTarget.lap(Scenario(course="genesis", driver={"speed": "recorded"})).table.rows
    n = round(10.0 * seconds)
    begins = np.clip(np.arange(n) / 30.0, 0.0, 1.0)
    pieces = [rows[i : i + n] for i in range(0, len(rows) - n + 1, n)]
    return [LateralTarget.of(np.clip(p[:, 0], -1.8, 1.8) * begins, np.maximum(p[:, 2], 8.0)) for p in pieces]


def tuned_pid(targets: Sequence[tuple[LateralTarget, int]], draws: int) -> Block:
    """The PID with the best of some drawn gains."""
    rng = np.random.default_rng(0)
    best: tuple[float, Block] | None = None
    for _ in range(draws):
        ff, p, i, d = rng.uniform((0.4, 0.0, 0.0, -0.03), (0.7, 0.15, 0.2, 0.06)).tolist()
        ahead = int(rng.integers(5, 9))
        block = ChallengeController(make=_made(ff, p, i, d, ahead), name="pid")
        total = float(np.mean([cost(block, *one) for one in targets]))
        if best is None or total < best[0]:
            best = total, block
    assert best is not None
    return best[1]


def _made(*gains: Any) -> Callable[[], Controller]:
    return lambda: Controller(*gains)


def fitted(logs: Sequence[Log]) -> tuple[tuple[float, ...], float]:
    """The response of `LateralMpc`, over its last value, and that value, by least squares.

    Commands and answers are freed of the wander's memory as in `LateralMpc`: x_k - rho x_{k-1}.
    """
    rho, parts, answers = float(np.exp(-0.1 / LateralMpc.wander_time)), list[Array](), list[Array]()
    for log in logs:
        a = log["target.a_y"] - log["target.a_roll"]
        u = np.concatenate((np.zeros(TAPS), log["controller.a_y_cmd"]))
        late = np.column_stack([u[TAPS - i : len(u) - i] for i in range(1, TAPS + 1)])
        parts.append(late[1:] - rho * late[:-1])
        answers.append(a[1:] - rho * a[:-1])
    pulses = np.linalg.lstsq(np.concatenate(parts), np.concatenate(answers), rcond=None)[0]
    steps = np.cumsum(pulses)
    return tuple((steps / steps[-1]).tolist()), float(steps[-1])


def trained(seed: int, minutes: float) -> Block:
    """SAC's greedy policy after so many minutes of driving."""
    from stable_baselines3 import SAC

    from steerkit.gym.vector_env import LateralAcceleration

    env = LateralAcceleration(scenario=CAR)
    net = {"net_arch": [64, 64]}
    model = SAC("MlpPolicy", env, learning_rate=1e-3, gamma=0.95, batch_size=128, policy_kwargs=net, seed=seed)
    model.learn(round(600 * minutes))
    return ChallengeController(make=lambda: _Greedy(model), name="sac")


class _Greedy:
    """A trained model as a controller of the challenge: it sees what the environment shows."""

    def __init__(self, model: Any):
        from steerkit.gym.vector_env import LateralAcceleration

        self.model, self.past, self.seen = model, LateralAcceleration.NO_COMMANDS, LateralAcceleration.seen

    def update(self, target: float, now: float, state: Any, plan: Any) -> float:
        """The steer of this sample."""
        seen = self.seen(target, now, state.roll_lataccel, state.v_ego, plan.lataccel, plan.roll_lataccel, self.past)
        steer = 2.0 * float(self.model.predict(seen, deterministic=True)[0][0])
        self.past = (*self.past[1:], steer)
        return m.clip(steer, -2.0, 2.0)
