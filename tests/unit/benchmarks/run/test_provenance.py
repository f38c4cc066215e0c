"""What determines a case's numbers is in its digest, and nothing else."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from benchmarks.run import provenance
from benchmarks.scenarios import Scenario
from benchmarks.suites import Job

SCENARIO = Scenario(name="slalom", course="slalom", driver={"v_max": 9.0})
JOB = Job(suite="golden", scenario="slalom", controller="stanley", seed=1)


def digest(job: Job = JOB, scenario: Scenario | None = SCENARIO, timed_steps: int = 0) -> str:
    return provenance.digest(job, scenario, timed_steps)


@pytest.mark.parametrize(
    "other",
    [
        lambda: digest(replace(JOB, seed=2)),
        lambda: digest(replace(JOB, controller="pure-pursuit")),
        lambda: digest(scenario=SCENARIO.with_(steering={"delay": 0.1})),
        lambda: digest(scenario=SCENARIO.with_(knowledge={"delay": 0.1})),
        lambda: digest(scenario=None),
        lambda: digest(timed_steps=5),
    ],
)
def test_other_cases_have_other_digests(other: Callable[[], str]) -> None:
    assert digest() == digest() == digest(replace(JOB, suite="tracking"))
    assert other() != digest()


@pytest.mark.parametrize("what", ["source", "versions"])
def test_other_programs_give_other_digests(what: str, monkeypatch: pytest.MonkeyPatch) -> None:
    before = digest()
    changed: Any = {"source": lambda: "0" * 16, "versions": lambda: {"numpy": "0.1"}}[what]
    monkeypatch.setattr(provenance, what, changed)
    assert digest() != before
