"""The suites hang together, and unknown names are answered with the known ones."""

from __future__ import annotations

import pytest

from benchmarks.entries import CONTROLLERS, controller
from benchmarks.peers import agents as peers
from benchmarks.run.trainings import TRAININGS
from benchmarks.suites import SUITES, jobs, suite
from steerkit.learning.settings import SETTINGS


def test_suites_hang_together() -> None:
    for one in SUITES.values():
        planned = jobs([one])
        assert len({job.id for job in planned}) == len(planned)
        for scenario in one.scenarios:
            assert scenario.path().length > 10.0
        for name in one.controllers:
            learner = controller(name)
            assert (learner.make is None) == learner.learns
            assert not learner.learns or learner.setting in {*SETTINGS, *peers.SETTINGS}
            assert learner.training in TRAININGS
        needed = {
            job.training for job in planned if job.kind == "drive" and CONTROLLERS[job.controller].kind == "learned"
        }
        assert needed <= {job.id for job in planned if job.kind == "learn"}
    both = jobs([suite("paper"), suite("tracking")])
    assert sum(job.kind == "learn" for job in both) == 60  # shared, not learned twice
    assert len(jobs([suite("tracking")], 1)) == 3 + 14 * 10
    assert {job.scenario for job in jobs([suite("tracking")], only=["slalom-9"])} == {"slalom-9", "train-clean"}


@pytest.mark.parametrize(
    ("ask", "message"),
    [
        (lambda: suite("trackin"), "did you mean 'tracking'"),
        (lambda: controller("stanly"), "did you mean 'stanley'"),
        (lambda: jobs([suite("golden")], only=["nothing"]), "--only nothing: no scenario or controller"),
    ],
)
def test_unknown_names(ask, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        ask()
