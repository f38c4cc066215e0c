"""Train DQN and SAC of Stable-Baselines3 on a course, then drive them as controller blocks beside Stanley.

    python examples/train_with_stable_baselines3.py [--quick] [--steps 40000] [--course paper] [--seed 0] [--out DIR]

Each agent learns in the Gymnasium environment, is turned into a block of plain arrays (no torch any more), written to
a file, loaded again and driven one round in the usual steering loop; Stanley recovers when |e| > 0.5 m.
`--quick` trains for 20 s of driving, to show that it runs; docs/measured.md has the results of the default.
No car was driven.
Needs stable-baselines3 (extra `gym`).
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import gymnasium

from steerkit.controllers.stanley import Stanley
from steerkit.diagram.simulation import Log
from steerkit.gym import PolicyBlock, Task, from_stable_baselines
from steerkit.metrics import of_log
from steerkit.scenario.drive import drive, held_all_along

FAILURE = 4.0  # above what staying anywhere may cost a learner who looks 1/(1 - 0.98) = 50 samples ahead: 0.05 a sample
AGENTS: dict[str, dict[str, Any]] = {
    "DQN": {
        "id": "steerkit/TrackSteering-v0",
        "learning_rate": 5e-4,
        "buffer_size": 100_000,
        "learning_starts": 300,
        "batch_size": 128,
        "gamma": 0.98,
        "train_freq": 4,
        "gradient_steps": 2,
        "target_update_interval": 500,
        "exploration_fraction": 0.3,
        "exploration_final_eps": 0.02,
    },
    "SAC": {
        "id": "steerkit/TrackSteeringContinuous-v0",
        "learning_rate": 5e-4,
        "buffer_size": 100_000,
        "learning_starts": 300,
        "batch_size": 128,
        "gamma": 0.98,
        "train_freq": 4,
        "gradient_steps": 2,
    },
}


def trained(name: str, options: dict[str, Any], steps: int, seed: int) -> PolicyBlock:
    """The block of an agent that drove `steps` samples."""
    import stable_baselines3
    import torch

    torch.set_num_threads(1)  # nets as small as these are slower with more
    settings = dict(AGENTS[name])
    env = gymnasium.make(settings.pop("id"), **options)
    task = env.unwrapped.task  # type: ignore[attr-defined]
    net = {"policy_kwargs": {"net_arch": [64, 64]}}
    model = getattr(stable_baselines3, name)("MlpPolicy", env, seed=seed, verbose=0, **net, **settings)
    try:
        model.learn(steps, progress_bar=sys.stderr.isatty())
    except ImportError:  # its bar needs tqdm
        model.learn(steps)
    return from_stable_baselines(model, task)


def judged(name: str, log: Log, rounds: float) -> str:
    """A row of the table."""
    s = asdict(of_log(log))
    own = 100.0 * float((log["supervisor.learning"] > 0.5).mean()) if "supervisor.learning" in log else 100.0
    whole = "yes" if held_all_along(log) and rounds >= 1.0 else "no"
    return (
        f"{name:9}{own:9.0f} %{whole:>12}{s['rms_e']:11.3f}{s['max_e']:11.3f}{s['rms_wheel_rate_deg']:15.0f}"
        f"{s['max_a_y']:12.1f}{s['max_jerk']:12.1f}"
    )


def main(arguments: list[str] | None = None) -> None:
    """Train, save, load, drive, compare."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="400 samples: the agents learn nothing of use")
    parser.add_argument("--steps", type=int, default=40_000, help="samples that each agent drives (20 a second)")
    parser.add_argument("--agents", nargs="*", default=[*AGENTS], choices=[*AGENTS])
    parser.add_argument("--course", default="paper", help="course to learn and to be judged on")
    parser.add_argument("--conditions", default="clean", choices=["clean", "hard"])
    parser.add_argument("--backend", default="python", choices=["python", "c"], help="c: faster, after some seconds")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=None, help="directory for the policies")
    options = parser.parse_args(arguments)
    try:
        import stable_baselines3  # noqa: F401
    except ImportError:
        raise SystemExit("this example needs stable-baselines3; pip install 'steerkit-control[gym]'") from None
    steps = 400 if options.quick else options.steps
    folder = options.out or Path(tempfile.mkdtemp())
    folder.mkdir(parents=True, exist_ok=True)
    task = Task(course=options.course, conditions=options.conditions)
    scenario, length = task.place, task.place.round_length
    rows = []
    for name in options.agents:
        begin = time.process_time()
        chosen = {"course": options.course, "conditions": options.conditions, "failure": FAILURE}
        trained(name, chosen | {"backend": options.backend}, steps, options.seed).save(folder / f"{name}.npz")
        took = time.process_time() - begin
        block = PolicyBlock.load(folder / f"{name}.npz")
        log = drive(scenario, block, doe=task.element, seed=options.seed)
        rows.append(judged(name, log, float(log["path.progress"][-1]) / length))
        print(
            f"{name}: {steps} samples ({steps * task.dt / 60.0:.1f} min of driving) learned in "
            f"{took:.0f} s of computing; block in {folder / name}.npz",
            flush=True,
        )
    log = drive(scenario, Stanley.of(scenario.nominal), seed=options.seed)
    rows.append(judged("Stanley", log, float(log["path.progress"][-1]) / length))
    print(f"\none round of {options.course}, {options.conditions}; recovery by Stanley when |e| > 0.5 m\n")
    print("          at the wheel  whole round  RMS e [m]  max e [m]  wheel [deg/s]  a_y [m/s²]  jerk [m/s³]")
    print("\n".join(rows))


if __name__ == "__main__":
    main()
