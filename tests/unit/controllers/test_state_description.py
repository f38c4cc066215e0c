"""What the learner's state is made of: scaled, seen in a mirror, and refused where that has no meaning."""

from __future__ import annotations

import numpy as np
import pytest

from steerkit.controllers.state_description import StateDescription

STANDARD = StateDescription()


def test_ranges_are_centres_and_half_widths() -> None:
    np.testing.assert_allclose(STANDARD.mid - STANDARD.half, STANDARD.low, atol=1e-15)
    np.testing.assert_allclose(STANDARD.mid + STANDARD.half, STANDARD.high, atol=1e-15)


def test_the_scale_of_actions_is_the_largest_unless_it_is_given() -> None:
    assert STANDARD.scale_of((0.1, -0.5, 0.3)) == 0.5
    assert STANDARD.scale_of((0.0,)) == 1.0
    assert StateDescription(action_scale=2.0).scale_of((0.1, -0.5)) == 2.0


def test_the_mirror_turns_all_but_the_speed_and_undoes_itself() -> None:
    s, a = np.array([[0.1, 0.2, 5.0, 0.3, 0.4, 6.0]]), np.array([0.5])
    there, action = STANDARD.mirror(s, a)
    assert there.tolist() == [[-0.1, -0.2, 5.0, -0.3, -0.4, -6.0]]
    assert action.tolist() == [-0.5]
    again = STANDARD.mirror(there, action)
    np.testing.assert_array_equal(again[0], s)
    np.testing.assert_array_equal(again[1], a)


def test_descriptions_say_what_is_wrong() -> None:
    with pytest.raises(ValueError, match="low has 2 entries, expected 6"):
        StateDescription(low=(0.0, 1.0))
    with pytest.raises(ValueError, match=r"e: low 1\.0 and high 1\.0"):
        StateDescription(low=(1.0, *STANDARD.low[1:]))
    with pytest.raises(ValueError, match="sign -1 and range"):
        StateDescription(low=(-2.0, *STANDARD.low[1:]))
    with pytest.raises(ValueError, match="valid: -1, 1"):
        StateDescription(mirror_signs=(0.0, -1.0, 1.0, -1.0, -1.0, -1.0))
    with pytest.raises(ValueError, match=r"action_scale = 0.0 \[rad\], expected > 0 or None"):
        StateDescription(action_scale=0.0)
    with pytest.raises(ValueError, match="expected finite numbers"):
        StateDescription(goal=(float("nan"), *STANDARD.goal[1:]))
