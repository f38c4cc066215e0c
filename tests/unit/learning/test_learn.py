"""Updates from a record alone, without driving."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from steerkit.learning import report, rundir
from steerkit.learning.experiment import Experiment
from steerkit.learning.learn import from_log, learn, offline
from steerkit.learning.nfq import iterate as nfq
from steerkit.learning.nfq.iterate import FitSetting
from steerkit.learning.settings import DEFAULT, MODEL_FREE
from steerkit.scenario import Scenario
from tests.support.modelled_car import driven
from tests.unit.learning.data.test_from_log import T, slalom, steered

QUICK = replace(DEFAULT, fit=replace(DEFAULT.fit, epochs=10, nets=1, iterations=1))


def test_offline_updates_start_from_the_nets_before() -> None:
    setting = replace(DEFAULT, fit=FitSetting(epochs=30, nets=1, hints=0, discount=0.95))
    first, second = (policy.nets for policy in offline(driven(), setting, 2, seed=4))
    alone = nfq.iterate(driven(), setting.problem, first or (), seed=4 * 100_003 + 1)
    assert np.array_equal(second[0][0], alone[0][0])


@pytest.mark.usefixtures("undrawn")
def test_a_log_makes_a_run_that_can_be_shown_and_goes_on(tmp_path: Path) -> None:
    scenario = Scenario().with_(course={"name": "circle", "rounds": 0.2})  # of its test drives
    experiment = Experiment(setting=QUICK, scenario=scenario, seed=3)
    place = tmp_path / "run"
    run = from_log(steered(slalom(T[:1200])), experiment, place, updates=2)
    assert len(run.policy.nets) == 2  # the best of all updates, and its mirror image
    kept = rundir.load(place)
    assert kept.source == run.source
    assert kept.done()
    assert kept.counts.updates == 2
    np.testing.assert_array_equal(rundir.final_policy(place).nets[0][0], run.policy.nets[0][0])
    assert len(rundir.drive_log(place).t) == 1200
    figures = report.show(place, quiet=True)
    assert figures["log"] == "made up"
    assert {file.name for file in place.glob("*.png")} == {"round.png", "data.png"}
    longer = learn(replace(run.experiment, minutes=1.02), place)
    assert longer.t == pytest.approx(61.2, abs=0.1)
    assert len(longer.transitions) > len(run.transitions)
    with pytest.raises(ValueError, match="not an empty directory"):
        from_log(steered(slalom()), experiment, place)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: from_log(steered(slalom()), Experiment(setting=MODEL_FREE)), "'model-free' learns no model .*default"),
        (lambda: from_log(steered(slalom()), Experiment(setting=QUICK), updates=0), "updates = 0"),
        (lambda: from_log(steered(np.zeros(2400)), Experiment(setting=QUICK)), "made up: shows too little of the car"),
        (lambda: next(offline(driven(), QUICK, 0)), "updates = 0"),
    ],
)
def test_what_makes_no_driver_is_refused(make: Any, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        make()
