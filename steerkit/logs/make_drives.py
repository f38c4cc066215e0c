"""Makes a shipped drive of a recorded lap: `python -m steerkit.logs.make_drives LAP.mat OUT.csv.gz`.

Not needed at run time. The lap is a MATLAB file of the genesis_path_follower recordings, 100 Hz: t, df [rad] (the
steering wheel's angle over 15.87, as their state_publisher.py has it: it comes in steps of 0.1 degree), v [m/s],
psi [rad], x, y [m] (of which point of the car nobody says), and in some wz [rad/s]. Every second sample is kept.
"""

from __future__ import annotations

import gzip
import sys
from pathlib import Path

import numpy as np

from steerkit.diagram.units import degrees_of

RATIO = 15.87
HEADER = """\
# A real drive by a person in a Hyundai Genesis, 2018: every second sample of {lap} of
# MPC-Berkeley/genesis_path_follower, MIT License, (c) 2018 Vijay Govindarajan: see LICENSE.genesis.
# t [s], steering wheel delta_sw [deg] = 15.87 * df, speed v [m/s], heading psi [rad], position x, y [m], yaw rate
# wz [rad/s].
"""


def main(lap: str, out: str) -> None:
    """Write the lap's columns, rounded below their own resolution."""
    from scipy.io import loadmat

    data = {key: np.asarray(value).ravel() for key, value in loadmat(lap).items()}
    columns = {
        "t": [f"{x:.3f}" for x in data["t"] - data["t"][0]],
        "delta_sw_deg": [f"{x:.1f}" for x in degrees_of(RATIO * data["df"])],
        "v": [f"{x:.3f}" for x in data["v"]],
        "psi": [f"{x:.5f}" for x in data["psi"]],
        "x": [f"{x:.3f}" for x in data["x"]],
        "y": [f"{x:.3f}" for x in data["y"]],
    }
    if "wz" in data:
        columns["wz"] = [f"{x:.5f}" for x in data["wz"]]
    rows = [",".join(row) for row in zip(*columns.values())][::2]
    text = HEADER.format(lap=Path(lap).name) + "\n".join([",".join(columns), *rows]) + "\n"
    with open(out, "wb") as stream:
        stream.write(gzip.compress(text.encode(), 9, mtime=0))


if __name__ == "__main__":
    main(*sys.argv[1:])
