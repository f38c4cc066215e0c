"""Agents of another library on their first steps, behind the safety filter: part of the study `safety`."""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from typing import Any

from benchmarks.run.safety_adversary import by_speed
from steerkit.scenario import Scenario

AGENTS = {"DQN": "steerkit/TrackSteering-v0", "SAC": "steerkit/TrackSteeringContinuous-v0"}
"""Agents of Stable-Baselines3, with the environment of each."""


def installed() -> bool:
    """Is Stable-Baselines3 there?"""
    return importlib.util.find_spec("stable_baselines3") is not None


def furthest(kind: str, scenario: Scenario, late: float, steps: int, seed: int = 0) -> tuple[float, float]:
    """Largest |e| of an agent that learns from its first step on [m], and the share of its steps that were corrected.

    kind: one of `AGENTS`. late: what the filter is told of delay that nobody else is told [s]. The agent has the
    settings of its library, but for a buffer that learning begins to draw from after 100 steps.
    """
    import gymnasium
    import stable_baselines3
    import torch
    from stable_baselines3.common.callbacks import BaseCallback

    import steerkit.gym  # noqa: F401  registers the environments

    told: list[tuple[float, bool]] = []

    class Listener(BaseCallback):
        """Takes down what the environment tells of each step."""

        def _on_step(self) -> bool:
            told.extend((abs(info["e"]), info["share"] > 0.0) for info in self.locals["infos"])
            return True

    torch.set_num_threads(1)
    env = gymnasium.make(AGENTS[kind], scenario=scenario, safe={"delay_doubt": late}, start="beginning", start_e=0.0)
    model = getattr(stable_baselines3, kind)("MlpPolicy", env, seed=seed, device="cpu", learning_starts=100)
    model.learn(steps, callback=Listener())
    return max(e for e, _ in told), sum(corrected for _, corrected in told) / len(told)


def agents(steps: int, speeds: Sequence[float], late: float, changes: dict[str, Any]) -> dict[str, Any]:
    """Largest |e| of each agent at each speed, the worse of both ratios, and the largest share corrected [%].

    changes: fields of the scenario. None where Stable-Baselines3 is not installed.
    """
    if not installed():
        return {"agent_max_e": None, "agent_steps_corrected_pct": None}
    shares: list[float] = []

    def driven(kind: str, scenario: Scenario) -> float:
        e, share = furthest(kind, scenario, late, steps)
        shares.append(share)
        return e

    worst, table = by_speed(AGENTS, speeds, changes, driven)
    return {"agent_max_e": worst, "agent_steps_corrected_pct": 100.0 * max(shares), "agents": table}
