"""What is driven: course, car, disturbances, what controllers believe; one drive or many."""

from steerkit.scenario.scenario import CONDITIONS, END_MARGIN, Scenario, fleet_scenario

__all__ = ["CONDITIONS", "END_MARGIN", "Scenario", "fleet_scenario"]
