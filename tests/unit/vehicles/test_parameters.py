"""A car's numbers are checked when they are given."""

import math
from dataclasses import replace

import numpy as np
import pytest

from steerkit.units import radians_of
from steerkit.vehicles import VW_PASSAT


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (dict(c_f=-1e5), r"Vehicle 'vw-passat': c_f = -100000.0 \[N/rad\], expected .* positive, per axle"),
        (dict(c_r=3446.0), "per radian and not per degree"),
        (dict(steer_ratio=radians_of(15.6)), r"steer_ratio = 0.27.* \[1\], expected 1 to 50; a pure number"),
        (dict(delta_sw_max=520.0), r"delta_sw_max = 520.0 \[rad\], .*radians_of\(520\)"),
        (dict(m=1.6), "c_f = .*expected"),
        (dict(m=math.nan), r"m = nan \[kg\]"),
        (dict(i_z=3e5), r"i_z = 300000.0 \[kg m\^2\], expected .*0.2 to 5 times m l_f l_r"),
        (dict(l_f="1.2"), r"l_f = '1.2', expected a number \[m\]"),
        (dict(mu=np.array([0.9, -0.9])), "mu = .*ice"),
    ],
)
def test_teaching_errors_of_vehicle(change, message):
    with pytest.raises(ValueError, match=message):
        replace(VW_PASSAT, **change)
