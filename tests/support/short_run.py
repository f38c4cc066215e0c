"""A learning run of some seconds."""

from __future__ import annotations

from dataclasses import replace

from steerkit.learning.experiment import Experiment
from steerkit.learning.nfq.iterate import FitSetting
from steerkit.learning.settings import DEFAULT

FAST = replace(DEFAULT, fit=FitSetting(epochs=20, mirror=True, n_step=3, nets=2))
SHORT = Experiment(setting=FAST, minutes=0.8, seed=3)
