"""Cars that are told wrong: by as much as is said, with all signs, and nothing else differs from the truth told."""

from __future__ import annotations

from dataclasses import replace

import pytest

from benchmarks.calibration_loop import driven, mistold


def test_eight_cars_in_a_row_are_wrong_by_the_same_with_all_signs() -> None:
    signs = set()
    for number in range(3000, 3008):
        wrong, true = mistold(number)
        late = wrong.believed_dead_time - true.believed_dead_time
        assert (abs(late), abs(true.offset_deg)) == pytest.approx((0.2, 3.0))
        assert true.ratio in (0.8, 1.25)
        assert wrong.design_model().delay >= 0.0
        assert (wrong.design_model().offset, true.design_model().offset) == (
            0.0,
            pytest.approx(true.offset_deg * 0.0174532925),
        )
        assert wrong.design_model().vehicle.steer_ratio * true.ratio == pytest.approx(
            true.design_model().vehicle.steer_ratio
        )
        assert replace(wrong, told="truth", believed_delay=None) == true
        signs.add((late > 0.0, true.offset_deg > 0.0, true.ratio > 1.0))
    assert len(signs) == 8


def test_a_controller_that_is_told_wrong_drives_worse() -> None:
    wrong, true = mistold(3004)
    told, not_told = (driven("lqr", scenario, seed=1, seconds=16.0) for scenario in (true, wrong))
    assert told.rms_e < 0.03 < 0.5 * not_told.rms_e
    assert told.max_e < not_told.max_e
    assert told.rms_wheel_deg > 1.0
