"""What is driven: course, car, disturbances, what controllers believe; one drive or many."""

from steerkit.scenario.fleet import fleet_scenario
from steerkit.scenario.scenario import CONDITIONS, END_MARGIN, Scenario

__all__ = ["CONDITIONS", "END_MARGIN", "Scenario", "fleet_scenario"]
