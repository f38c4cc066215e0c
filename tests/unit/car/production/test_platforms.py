"""Which production cars there are, and what is refused."""

import math
import sys
from typing import Any

import pytest

pytest.importorskip("opendbc")

from benchmarks.run.production import config_of
from steerkit._support.files import toml_of
from steerkit.car.config import ConfigError, Reading, shipped
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


@pytest.mark.parametrize(
    ("table", "key", "value", "said"),
    [
        ("read", "delta_sw", {"frame": "POSE_MOTION", "signal": "PSI"}, "delta_sw: the port of TESLA_MODEL_3 gives it"),
        ("files", "dbc", 3, "dbc = 3, expected"),
        ("port", "line", "python-can", r"line 'python-can' is not known.*; valid: panda, socket"),
        ("port", "line", 3, "line '3' is not known"),
        ("port", "channel", 7, "channel = 7, expected"),
        ("port", "interface", "socketcan", "key 'interface' is not known"),
    ],
)
def test_a_mistake_in_the_file_of_a_production_car_is_named(table: str, key: str, value: Any, said: str) -> None:
    """No line leads to a bus past a safety code, either."""
    file = shipped("production-car.toml")
    data = toml_of(file.read_text(encoding="utf-8"), "car")
    data[table][key] = value
    with pytest.raises(ConfigError, match=rf"\[{table}\] {said}"):
        Reading("car", data, {}, file.parent).config(None)


def test_the_gate_of_a_port_is_no_wider_than_the_file_says() -> None:
    car = config_of("TESLA_MODEL_3", a_y_max=1.0, rate_max_deg=20.0)
    assert car.gate.a_y_max == 1.0
    assert math.degrees(car.gate.rate_max) == pytest.approx(20.0)
    assert car.gate.jerk_max == pytest.approx(0.95 * (3.0 + 0.06 * 9.81), rel=1e-3)
