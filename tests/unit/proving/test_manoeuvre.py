"""Manoeuvres as data: every number has a source, the waves are what they are called, mistakes are named."""

import tomllib
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from steerkit.diagram.units import radians_of
from steerkit.proving.manoeuvre import SPACING, Input, Limit, Manoeuvre, manoeuvre, manoeuvre_of, names, read_limits
from steerkit.vehicles import VW_PASSAT as PASSAT

ALL = [manoeuvre(name) for name in names()]


@pytest.mark.parametrize("one", ALL, ids=names())
def test_every_number_of_a_manoeuvre_has_a_source(one: Manoeuvre) -> None:
    table = tomllib.loads((files("steerkit.proving") / "manoeuvres" / f"{one.name}.toml").read_text())
    numbers = {
        f"{part}.{key}" if part else key
        for part, values in {"": table, **{k: v for k, v in table.items() if isinstance(v, dict)}}.items()
        for key, value in values.items()
        if isinstance(value, int | float) or (isinstance(value, list) and value and isinstance(value[0], float))
    }
    assert numbers - {"sources"} <= one.sources.keys()
    assert one.sources.keys() <= numbers, "a source of a number that is not there"
    assert all(limit.source for limit in one.limits)
    assert one.norm
    assert one.title
    assert one.about.endswith((".", "?"))


def test_waves() -> None:
    t = np.arange(0.0, 10.0, SPACING)
    step = Input(form="levels", a_y=1.0, rise=0.2, hold=1.0).wave
    assert np.interp([0.0, 0.1, 0.2, 1.1], t[: len(step)], step) == pytest.approx([0.0, 0.5, 1.0, 1.0])
    there = Input(form="levels", a_y=1.0, rise=0.0, levels=(1.0, -1.0), seconds=(1.0, 1.5)).wave
    assert there[1] == there[99] == 1.0
    assert there[101] == there[249] == -1.0
    assert len(there) == 251
    sine = Input(form="sine", a_y=1.0, frequency=0.5, periods=1.0, tail=0.5).wave
    assert sine[50] == pytest.approx(1.0)
    assert sine[150] == pytest.approx(-1.0)
    assert not sine[201:].any()
    pulse = Input(form="pulse", a_y=1.0, hold=0.4, tail=1.0).wave
    assert pulse[20] == pytest.approx(1.0)
    assert pulse[10] == pytest.approx(0.5)
    assert not pulse[40:].any()
    dwell = Input(form="dwell", a_y=1.0, frequency=0.7, dwell=0.5).wave
    peak = int(np.argmin(dwell))
    assert dwell.max() == pytest.approx(1.0, abs=1e-3)
    assert np.all(dwell[peak : peak + 50] == -1.0)
    assert len(dwell) == pytest.approx(100 * (1.0 / 0.7 + 0.5), abs=2)


def test_a_random_input_repeats_and_holds_its_frequencies() -> None:
    wanted = Input(form="random", a_y=1.0, low=0.2, high=2.0, period=10.0, periods=4.0, rise=1.0)
    wave = wanted.wave
    assert wave[1000:2000] == pytest.approx(wave[2000:3000], abs=1e-9)
    power = np.abs(np.fft.rfft(wave[1000:2000]))
    assert set(np.flatnonzero(power > 1e-6)) == set(range(2, 21))
    assert np.abs(wave).max() == pytest.approx(1.0)
    assert wave[0] == 0.0
    assert abs(wave[-2]) < 0.02


def test_the_size_gives_the_lateral_acceleration_of_steady_driving() -> None:
    """Rajamani 2012, section 3.3: delta = (L + K v^2) a_y/v^2."""
    v, angle = 20.0, Input(form="levels", a_y=2.0).angle(PASSAT, 20.0)
    gain = v / (PASSAT.wheelbase + PASSAT.understeer_gradient * v * v)
    assert gain * angle / PASSAT.steer_ratio * v == pytest.approx(2.0)
    assert Input(form="levels", angle_deg=90.0).angle(PASSAT, v) == pytest.approx(radians_of(90.0))


def test_another_speed_and_size() -> None:
    one = manoeuvre("step-steer").at(8.0, 1.0)
    assert (one.conditions.v, one.required.a_y) == (8.0, 1.0)
    assert one.at() == one
    assert one.sources["conditions.v"].startswith("as driven or asked for; ISO 7401")
    assert one.sources["input.a_y"].startswith("as asked for")


GOOD = """
title = "T"
norm = "N"
about = "A."
evaluation = "step"
[input]
form = "levels"
a_y = 1.0
"""


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("[input]", "[conditions]\nspeed = 3.0\n[input]", "no key 'speed'.*valid: v, v_tolerance"),
        ("[input]", "[conditions]\nv = -3.0\n[input]", r"v = -3.0 \[m/s\]"),
        ("[input]", "[conditions]\nv = true\n[input]", "v = True, expected a number"),
        ("[input]", "[conditions]\nv = nan\n[input]", "v = nan"),
        ("[input]", "[abort]\na_y = 'much'\n[input]", "a_y = 'much', expected a number"),
        ("[input]", "[[limit]]\nquantity = 'x'\n[input]", "low = -inf, high = inf"),
        ("[input]", "[[limit]]\nhigh = 1.0\n[input]", "lacks quantity"),
        ("[input]", "limit = 3\n[input]", "tables"),
        ("[input]", "course = 'straight'\n[input]", r"either \[input\] or a course"),
        ('"step"', '"stride"', "evaluation 'stride'"),
        ('"levels"', '"spiral"', "form 'spiral' is not known.*valid: levels, sine"),
        ("a_y = 1.0", "", "either a_y or angle_deg"),
        ('title = "T"', "", "lacks title"),
        ('"T"', '"T"\nsides = ["up"]', "side 'up'"),
        ('"T"', '"T"\nrepeats = 0', "repeats = 0"),
        ('"T"', '"T"\nrepeats = 1.5', "repeats = 1.5, expected a whole number"),
    ],
)
def test_a_mistake_in_a_file_is_named(old: str, new: str, said: str) -> None:
    manoeuvre_of(tomllib.loads(GOOD), "good")
    assert old in GOOD
    with pytest.raises(ValueError, match=f"manoeuvre 'bad'.*{said}"):
        manoeuvre_of(tomllib.loads(GOOD.replace(old, new, 1)), "bad")


def test_a_file_of_ones_own_and_limits_of_ones_own(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text(GOOD)
    assert manoeuvre(str(tmp_path / "mine.toml")).name == "mine"
    (tmp_path / "broken.toml").write_text(GOOD.replace('"A."', ""))
    with pytest.raises(ValueError, match=r"broken\.toml: not TOML .Invalid"):
        manoeuvre(str(tmp_path / "broken.toml"))
    with pytest.raises(ValueError, match="cannot be read"):
        manoeuvre(str(tmp_path / "none.toml"))
    with pytest.raises(ValueError, match=r"'step-stear' is not known .did you mean 'step-steer'"):
        manoeuvre("step-stear")
    (tmp_path / "limits.toml").write_text("[[limit]]\nquantity = 'yaw_delay'\nhigh = 0.2\nsource = 'ours'\n")
    assert read_limits(tmp_path / "limits.toml") == [Limit(quantity="yaw_delay", high=0.2, source="ours")]
    (tmp_path / "empty.toml").write_text("")
    with pytest.raises(ValueError, match="no table"):
        read_limits(tmp_path / "empty.toml")
