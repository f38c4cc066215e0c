"""Policy map: the action of a net and the cost it expects, over e and heading, at three wheel angles.

Dots are recorded states: far from them the net extrapolates. How to read it: see Learning.
"""

from steerkit import Experiment, learn
from steerkit.learning.pictures import policy_map
from steerkit.scenario import Scenario

run = learn(Experiment(scenario=Scenario(course="paper"), minutes=0.5, seed=1))
policy_map(run.policy, run.experiment.scenario, visited=run.transitions).savefig("policy_map.png")
print(f"a Q-function of {len(run.policy.nets)} nets, from {len(run.transitions)} transitions")
