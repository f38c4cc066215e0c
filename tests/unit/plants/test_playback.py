"""A recorded drive comes back as it was: the angle late, the speed not."""

from __future__ import annotations

import numpy as np
import pytest

from steerkit.plants.playback import Playback

ANGLES = (0.0, 0.1, 0.4, -0.2, -0.3)
SPEEDS = (4.0, 5.0, 5.5, 5.0, 6.0)


@pytest.mark.parametrize("delay", [0.0, 0.02, 0.013, -0.007])
def test_it_is_the_record_between_its_samples_and_holds_its_ends(delay: float) -> None:
    drive = Playback(angles=ANGLES, speeds=SPEEDS, delay=delay, dt=0.01)
    at = 0.01 * np.arange(len(ANGLES))
    for t in np.arange(-3.0, 10.0, 0.25) * 0.01:
        y = drive.output(float(t), (), ())
        assert y.delta_sw == pytest.approx(np.interp(t - delay, at, ANGLES), abs=1e-6)
        assert y.v == pytest.approx(np.interp(t, at, SPEEDS), abs=1e-6)


def test_a_record_has_as_many_angles_as_speeds() -> None:
    with pytest.raises(ValueError, match="5 angles, 4 speeds"):
        Playback(angles=ANGLES, speeds=SPEEDS[:-1])


def test_a_record_given_as_lists_or_arrays_is_the_same() -> None:
    plain, (angles, speeds) = Playback(angles=ANGLES, speeds=SPEEDS), (list(ANGLES), np.array(SPEEDS))
    other = Playback(angles=angles, speeds=speeds)  # type: ignore[arg-type]
    assert other.output(0.012, (), ()) == plain.output(0.012, (), ())
