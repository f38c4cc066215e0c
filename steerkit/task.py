"""The numbers of the task, each named once: what must be kept, what the car may do, and how often it is asked.

Source: Riedmiller, Montemerlo, Dahlkamp 2007, but for `A_Y_MAX` and `JERK_MAX`.
"""

from steerkit.diagram.units import radians_of

TRIP = 0.5
"""|e| that must not be exceeded [m]: beyond it a learner loses the wheel and a drive is not held."""
RELEASE = 0.1
"""|e| below which a learner gets the wheel back [m]."""
GOAL = 0.05
"""|e| of the goal band [m]."""
STOP_DEG = 520.0
"""Largest |steering-wheel angle| [degrees], for names that end in `_deg`."""
STOP = radians_of(STOP_DEG)
"""Largest |steering-wheel angle| [rad]."""
DT = 0.05
"""Time between two decisions [s]: 20 Hz."""
A_Y_MAX = 3.0
"""Lateral acceleration that a lane keeping system stays within [m/s^2]; ISO 11270:2014."""
JERK_MAX = 5.0
"""Its fastest change [m/s^3]; ISO 11270:2014."""
