"""Ports: what a block class makes of its declarations."""

from __future__ import annotations

from dataclasses import dataclass

import pytest

from steerkit.block import Block, In, Out


@dataclass(frozen=True, eq=False, kw_only=True)
class Mixed(Block):
    """Two inputs, one of them direct."""

    now = In("m")
    later = In("rad", direct=False)
    y = Out("m")


def test_output_sees_the_direct_inputs_and_update_all() -> None:
    assert Mixed.D._fields == ("now",)
    assert Mixed.U._fields == ("now", "later")
    assert Mixed.Y._fields == ("y",)


@pytest.mark.parametrize("kind", [In, Out])
@pytest.mark.parametrize("unit", ["deg", "km/h", "", "M"])
def test_a_port_has_a_unit_of_the_si(kind: type, unit: str) -> None:
    with pytest.raises(ValueError, match=f"unit {unit!r} is not known; SI and radians only"):
        kind(unit)
