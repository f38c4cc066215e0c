"""Learning runs of some seconds."""

from dataclasses import replace
from pathlib import Path

from steerkit.learning.experiment import Experiment
from steerkit.learning.learn import learn
from steerkit.learning.nfq.iterate import FitSetting
from steerkit.learning.settings import DEFAULT, PAPER
from steerkit.scenario import Scenario

FAST = replace(DEFAULT, fit=FitSetting(epochs=20, mirror=True, n_step=3, nets=2))
SHORT = Experiment(setting=FAST, minutes=0.8, seed=3)


def published_on_a_circle(directory: Path) -> Path:
    """The directory, with a run in the manner of 2007."""
    setting = replace(PAPER, fit=FitSetting(epochs=20))
    learn(Experiment(setting=setting, scenario=Scenario(course="circle"), minutes=0.3, seed=2), directory)
    return directory
