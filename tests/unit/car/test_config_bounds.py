"""Every limit of a car's file has bounds to both sides, and its default lies between them."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import pytest

from steerkit.car.config import ANGLES, BOUNDS, DERIVED, ConfigError, load, shipped
from steerkit.car.gate import GateLimits
from steerkit.car.motion import MotionLimits
from steerkit.car.state_machine import StateLimits
from steerkit.diagram.units import degrees_of

DEFAULTS = {
    f"{f.name}_deg" if f.name in ANGLES else f.name: degrees_of(f.default) if f.name in ANGLES else f.default
    for kind in (GateLimits, StateLimits, MotionLimits)
    for f in fields(kind)
    if f.name not in DERIVED
}


def test_no_limit_is_without_bounds_and_no_bounds_without_a_limit() -> None:
    assert BOUNDS.keys() == DEFAULTS.keys()


@pytest.mark.parametrize("key", BOUNDS)
def test_the_default_lies_between_them(key: str) -> None:
    low, high = BOUNDS[key]
    assert low <= DEFAULTS[key] * (1.0 + 1e-12)
    assert DEFAULTS[key] <= high * (1.0 + 1e-12)
    assert 0.0 < low < high


@pytest.mark.parametrize("key", BOUNDS)
@pytest.mark.parametrize("side", [0, 1])
def test_beyond_them_a_file_is_refused(key: str, side: int, tmp_path: Path) -> None:
    value = BOUNDS[key][side] * (0.9, 1.1)[side]
    text = shipped("dbw-kit.toml").read_text(encoding="utf-8").split("[limits]")[0]
    whole = isinstance(BOUNDS[key][0], int)
    number = f"{[0, 99][side]}" if whole else f"{value!r}"
    file = tmp_path / "car.toml"
    file.write_text(f"{text}[limits]\n{key} = {number}\n")
    with pytest.raises(ConfigError, match=rf"\[limits\] {key} = .*, expected "):
        load(file)
