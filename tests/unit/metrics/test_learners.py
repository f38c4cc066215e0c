"""What learning cost, over seeds."""

import math

from steerkit.metrics import Learned, learned

NEVER = math.inf


def test_what_learning_cost_over_four_seeds() -> None:
    seeds = [
        Learned(round_minutes=m, round_episodes=10.0 * m, good_minutes=g, good_episodes=g, transitions=1000)
        for m, g in ((1.0, 2.0), (2.0, NEVER), (3.0, NEVER), (4.0, NEVER))
    ]
    found = learned(seeds)
    assert found["round_minutes"].value == 2.5
    assert found["round_episodes"].value == 25.0
    assert found["good_minutes"].value == NEVER
    assert found["transitions"].value == 1000.0
    assert (found["round_share"].value, found["good_share"].value) == (1.0, 0.25)
    assert set(found) == {*Learned.__dataclass_fields__, "round_share", "good_share"}
