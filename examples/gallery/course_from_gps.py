"""A course from GPS: latitude and longitude of one drive become a smooth path that can be steered.

The positions carry 2 cm of noise; curvature, which the steering wheel has to follow, amplifies it.
"""

import numpy as np

from steerkit import Path
from steerkit.plots.drive import plot_course

rng = np.random.default_rng(0)
turn = np.linspace(0.0, 2.0 * np.pi, 240, endpoint=False)
east = 60.0 * np.cos(turn) + 8.0 * np.cos(3.0 * turn) + 0.02 * rng.normal(size=turn.size)
north = 35.0 * np.sin(turn) + 0.02 * rng.normal(size=turn.size)
lat_deg, lon_deg = 52.28 + north / 111_230.0, 8.02 + east / (111_320.0 * np.cos(np.radians(52.28)))

path = Path.from_gps(lat_deg, lon_deg, closed=True, smoothing=0.03, name="yard")
plot_course(path).savefig("course_from_gps.png")
print(path, f"tightest radius {1.0 / abs(path.samples.kappa).max():.1f} m")
