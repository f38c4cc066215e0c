"""What the learner's state is made of: scaled, seen in a mirror, and refused where that has no meaning."""

from typing import Any

import pytest

from steerkit.controllers.policy import StateDescription

STANDARD = StateDescription()


def test_a_fast_car_and_a_slow_one_give_the_net_the_same_numbers() -> None:
    """The same e_dot, and the same lateral acceleration of wheel and yaw rate, at 4, 8 and 16 m/s."""
    fast = StateDescription(scaled_from=4.0)
    told = [fast.scaled((0.1, 0.2, v, 0.2 / v, 0.8 / v, 3.0 / v**2)) for v in (4.0, 8.0, 16.0)]
    for s, v in zip(told, (4.0, 8.0, 16.0), strict=True):
        assert s[:2] == (0.1, 0.2)
        assert s[2] == pytest.approx(4.0 * (v / 4.0) ** 0.5)
        assert s[3:] == pytest.approx(told[0][3:], rel=1e-12)
    s = (0.1, 0.2, 3.9, 0.3, 0.4, 6.0)
    assert fast.scaled(s) == s
    assert STANDARD.scaled(s) == s


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"low": (0.0, 1.0)}, "low has 2 entries, expected 6"),
        ({"low": (1.0, *STANDARD.low[1:])}, r"e: low 1\.0 and high 1\.0"),
        ({"low": (-2.0, *STANDARD.low[1:])}, "sign -1 and range"),
        ({"mirror_signs": (0.0, -1.0, 1.0, -1.0, -1.0, -1.0)}, "valid: -1, 1"),
        ({"goal": (float("nan"), *STANDARD.goal[1:])}, "expected finite numbers"),
    ],
)
def test_descriptions_say_what_is_wrong(wrong: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        StateDescription(**wrong)
