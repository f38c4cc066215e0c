"""Learns in a minute: neural fitted Q iteration from the first second, 60 s of driving on the 800 m course.

Every second counts: recovery, waiting and training are in it. The picture shows e, shaded where Stanley steers.
"""

from steerkit import Experiment, learn
from steerkit.scenario.drive import drive
from steerkit.plots.drive import learning
from steerkit.scenario import Scenario
from steerkit.metrics import of_log

scenario = Scenario(course="paper")
run = learn(Experiment(scenario=scenario, minutes=1.0, seed=1))
learning(run.recorder.log(), title="From the first second", seconds=60.0).savefig("learns_in_a_minute.png")
log = drive(scenario, run.policy, doe=run.experiment.setting.element(scenario.nominal))
print(f"{run.counts.failures} failures; then a whole round with RMS e {of_log(log).rms_e:.3f} m")
