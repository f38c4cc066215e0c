"""Which production cars there are, and what is refused."""

import math
import sys
from typing import Any

import pytest

pytest.importorskip("opendbc")

from benchmarks.run.production import config_of
from steerkit.car.config import ConfigError
from steerkit.car.production import platforms


def test_a_platform_that_is_unknown_or_never_steered_is_refused_by_name() -> None:
    with pytest.raises(ConfigError, match="did you mean 'TESLA_MODEL_3'"):
        config_of("TESLA_MODEL_33")
    with pytest.raises(ConfigError, match=r"PSA_PEUGEOT_208.*dashcam"):
        config_of("PSA_PEUGEOT_208")
    with pytest.raises(ConfigError, match="SecOC"):
        config_of("TOYOTA_RAV4_PRIME")
    with pytest.raises(ConfigError, match="cruise control"):
        config_of("AUDI_Q5_MK1")


def test_without_opendbc_a_port_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "opendbc.car.car_helpers", None)  # type: ignore[arg-type]
    platforms.listed.cache_clear()
    try:
        with pytest.raises(ConfigError, match=r"pip install 'steerkit-control\[production\]'"):
            config_of.__wrapped__("TESLA_MODEL_3")
    finally:
        platforms.listed.cache_clear()


def test_what_the_port_gives_may_not_be_given_by_the_file_too() -> None:
    from steerkit._support.files import toml_of
    from steerkit.car.config import Reading, shipped

    text = shipped("production-car.toml").read_text(encoding="utf-8")
    data = toml_of(text, "car")
    data["read"]["delta_sw"] = {"frame": "POSE_MOTION", "signal": "PSI"}
    with pytest.raises(ConfigError, match=r"\[read\] delta_sw: the port of TESLA_MODEL_3 gives it"):
        Reading("car", data, {}, shipped("production-car.toml").parent).config(None)


def test_dbc_files_of_a_production_car_that_are_no_list_are_a_mistake_of_the_file() -> None:
    from steerkit._support.files import toml_of
    from steerkit.car.config import Reading, shipped

    data = toml_of(shipped("production-car.toml").read_text(encoding="utf-8"), "car")
    data["files"]["dbc"] = 3
    with pytest.raises(ConfigError, match=r"\[files\] dbc = 3, expected"):
        Reading("car", data, {}, shipped("production-car.toml").parent).config(None)


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        (
            "line",
            "python-can",
            r"\[port\] line 'python-can' is not known.*; valid: panda, socket",
        ),  # no safety code there
        ("line", 3, r"\[port\] line '3' is not known"),
        ("channel", 7, r"\[port\] channel = 7, expected"),
        ("interface", "socketcan", r"\[port\] key 'interface' is not known"),
    ],
)
def test_a_line_that_is_none_is_a_mistake_of_the_file(key: str, value: Any, said: str) -> None:
    """None leads to a bus past a safety code, either."""
    from steerkit._support.files import toml_of
    from steerkit.car.config import Reading, shipped

    data = toml_of(shipped("production-car.toml").read_text(encoding="utf-8"), "car")
    data["port"][key] = value
    with pytest.raises(ConfigError, match=said):
        Reading("car", data, {}, shipped("production-car.toml").parent).config(None)


def test_the_gate_of_a_port_is_no_wider_than_the_file_says() -> None:
    car = config_of("TESLA_MODEL_3", a_y_max=1.0, rate_max_deg=20.0)
    assert car.gate.a_y_max == 1.0
    assert math.degrees(car.gate.rate_max) == pytest.approx(20.0)
    assert car.gate.jerk_max == pytest.approx(0.95 * (3.0 + 0.06 * 9.81), rel=1e-3)
