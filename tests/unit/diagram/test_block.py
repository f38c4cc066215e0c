"""Ports: what a block class makes of its declarations."""

import copy
import pickle
from dataclasses import replace
from typing import Any

import pytest

from steerkit.diagram.block import Block, In, Out
from steerkit.learning.learner_state import untrained
from steerkit.learning.settings import DEFAULT
from steerkit.plants.speed_driver import SpeedProfile
from tests.support.parts import Gain

FOREIGN = In("m")


@pytest.mark.parametrize("direct", [("now",), "now", FOREIGN, (FOREIGN,), [FOREIGN]])
def test_direct_names_own_inputs(direct: Any) -> None:
    """By their objects: a name was met as an AttributeError deep in the wiring."""
    parts = {"now": In("m"), "y": Out("m", direct=direct)}
    with pytest.raises(TypeError, match=r"^Own\.y: direct = .*own In ports.*: direct=\(now,\) \(inputs: now\)$"):
        type("Own", (Block,), parts)


def test_a_block_is_printed_in_a_few_lines_however_many_numbers_it_holds() -> None:
    for printed in (repr(untrained(DEFAULT, 0)), repr(SpeedProfile(speeds=(5.0,) * 4000, spacing=1.0))):
        assert len(printed) < 900
    assert repr(Gain(dt=0.1)) == "Gain(dt=0.1, k=1.0)"
    assert "speeds=(5.0, 5.0, 5.0, 5.0, 5.0, 5.0, 5.0, 5.0, ... 4000 in all)" in printed


def test_a_copy_has_its_parameters() -> None:
    assert copy.copy(Gain(k=3.0)).k == pickle.loads(pickle.dumps(Gain(k=3.0))).k == replace(Gain(), k=3.0).k
