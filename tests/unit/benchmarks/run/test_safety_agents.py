"""Agents of another library behind the safety filter."""

from __future__ import annotations

import importlib.util

import pytest

from benchmarks.run.safety_agents import AGENTS, agents, furthest
from steerkit.scenario import Scenario

SLOW = Scenario.under(
    "hard",
    course="paper",
    driver={"v_min": 5.0, "v_max": 5.0},
    vehicle={"tyres": 0.7},
    steering={"delay": 0.1},
    knowledge={"delay": 0.05},
)


def test_without_the_library_there_is_no_figure(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert agents(1, (5.0,), 0.1, {}) == {"agent_max_e": None, "agent_steps_corrected_pct": None}


@pytest.mark.parametrize("kind", AGENTS)
def test_an_agent_on_its_first_steps_stays_within_the_bound_because_it_is_corrected(kind: str) -> None:
    pytest.importorskip("stable_baselines3")
    e, share = furthest(kind, SLOW, 0.1, 200)
    assert 0.0 < e <= 0.5
    assert share > 0.1
