"""Makes a built-in course of a recorded lap: `python -m steerkit.paths.courses.make_courses LAP.mat genesis.csv`.

Not needed at run time. The lap is a MATLAB file of the genesis_path_follower recordings: lat, lon [degrees], x, y [m],
v [m/s], 100 Hz. Checked against one another: psi follows atan2(dy, dx) to 0.01 rad and the yaw rate v*kappa, so the
recordings are ISO 8855 already. Their x, y come from a spherical Earth (up to 1.6 m off over a kilometre) and are only
used to measure steps; positions come from lat, lon.
"""

from __future__ import annotations

import sys

import numpy as np

from steerkit.paths.path import Path

STEP = 0.5  # [m] the 100 Hz samples are closer together than their noise, and repeat themselves when the car rests
NOISE = 0.01  # [m] at which the path's curvature fits yaw rate / speed best, of 0.01, 0.03, 0.05, 0.1
SPACING = 2.0  # [m] the tightest bend has a radius of 18 m

HEADER = """\
# {name}: a real drive by a person, open: the recording ends {gap:.0f} m from where it starts, at rest.
# Hyundai Genesis, recorded 2018, {lap} of MPC-Berkeley/genesis_path_follower,
# MIT License, (c) 2018 Vijay Govindarajan: see LICENSE.genesis.
# Repaired by make_courses.py: {dropped} of {all} samples less than {step} m from the one before dropped (a car at rest
# repeats its position), smoothed by {noise} m RMS, resampled every {spacing} m.
# x, y: metres east and north of the first sample; v: recorded speed [m/s].
x,y,v
"""


def main(lap: str, out: str) -> None:
    """Write x, y and the recorded v of the lap, evenly spaced."""
    from scipy.io import loadmat

    data = {key: np.asarray(value).ravel() for key, value in loadmat(lap).items()}
    chosen = [0]
    for k in range(1, len(data["x"])):
        if np.hypot(data["x"][k] - data["x"][chosen[-1]], data["y"][k] - data["y"][chosen[-1]]) >= STEP:
            chosen.append(k)
    lat, lon, x, y, v = (data[key][chosen] for key in ("lat", "lon", "x", "y", "v"))
    name = out.replace("\\", "/").rsplit("/", 1)[-1].removesuffix(".csv").replace("_", "-")
    path = Path.from_gps(lat, lon, closed=False, smoothing=NOISE, spacing=SPACING, name=name)
    driven = np.concatenate(([0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))))
    knots = path.samples
    speed = np.interp(knots.s, driven * path.length / driven[-1], v)
    head = HEADER.format(
        name=name,
        gap=np.hypot(*(knots.xy[-1] - knots.xy[0])),
        lap=lap.replace("\\", "/").rsplit("/", 1)[-1],
        dropped=len(data["x"]) - len(chosen),
        all=len(data["x"]),
        step=STEP,
        noise=NOISE,
        spacing=SPACING,
    )
    # 1e-5 m: rounding to millimetres would show in the curvature
    np.savetxt(out, np.column_stack((knots.xy, speed)), fmt="%.5f,%.5f,%.3f", header=head.rstrip(), comments="")


if __name__ == "__main__":
    main(*sys.argv[1:])
