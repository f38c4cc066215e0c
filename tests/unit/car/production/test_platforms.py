"""Which production cars there are, what is refused, and the limits of a port: what keeps within them passes opendbc's
safety code."""

import math
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("opendbc")

from benchmarks.run.production import config_of
from benchmarks.studies import production_cars as study
from steerkit._support.files import toml_of
from steerkit.car.config import Reading, shipped
from steerkit.car.gate import gate
from steerkit.car.production import platforms
from steerkit.car.production.platforms import OFF, limits_of, platform, taken_over_from
from steerkit.car.state_machine import StateLimits
from steerkit.vehicles import vehicle
from steerkit.vehicles.rollout import yaw_gain
from tests.support.production import judged, ported, steered


def test_the_table_lists_each_platform_once_and_writes_a_file_that_is_sound(tmp_path: Path) -> None:
    rows = platforms.rows()
    assert len({row["name"] for row in rows}) == len(rows) == 243
    assert {row["by"] for row in rows} == {"angle", "curvature", "torque"}
    assert sum(not row["obstacle"] for row in rows) == 208
    text = "\n".join(platforms.lines(rows))
    assert "TESLA_MODEL_3" in text
    assert "208 of 243" in text
    platforms.write("NISSAN_ROGUE", tmp_path / "car.toml")
    assert 'opendbc = "NISSAN_ROGUE"' in (tmp_path / "car.toml").read_text(encoding="utf-8")
    with pytest.raises(ValueError, match="exists already"):
        platforms.write("NISSAN_ROGUE", tmp_path / "car.toml")


def test_a_platform_that_is_unknown_or_never_steered_is_refused_by_name() -> None:
    with pytest.raises(ValueError, match="did you mean 'TESLA_MODEL_3'"):
        config_of("TESLA_MODEL_33")
    with pytest.raises(ValueError, match=r"PSA_PEUGEOT_208.*dashcam"):
        config_of("PSA_PEUGEOT_208")
    with pytest.raises(ValueError, match="SecOC"):
        config_of("TOYOTA_RAV4_PRIME")
    with pytest.raises(ValueError, match="cruise control"):
        config_of("AUDI_Q5_MK1")


def test_without_opendbc_a_port_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "opendbc.car.car_helpers", None)  # type: ignore[arg-type]
    platforms.listed.cache_clear()
    try:
        with pytest.raises(ValueError, match=r"pip install 'steerkit-control\[production\]'"):
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
    with pytest.raises(ValueError, match=rf"\[{table}\] {said}"):
        Reading("car", data, {}, file.parent).config(None)


def test_the_gate_of_a_port_is_no_wider_than_the_file_says() -> None:
    car = config_of("TESLA_MODEL_3", a_y_max=1.0, rate_max_deg=20.0)
    assert car.gate.a_y_max == 1.0
    assert math.degrees(car.gate.rate_max) == pytest.approx(20.0)
    assert car.gate.jerk_max == pytest.approx(0.95 * (3.0 + 0.06 * 9.81), rel=1e-3)


NAMES = ("TESLA_MODEL_3", "NISSAN_LEAF", "TOYOTA_RAV4_TSS2_2023", "FORD_MUSTANG_MACH_E_MK1", "TOYOTA_COROLLA")


@pytest.mark.parametrize("name", NAMES)
def test_the_gate_itself_keeps_within_the_limits_of_its_port(name: str) -> None:
    """The port behind it clips once more: a gate that let through too much would not be seen there."""
    limits, port = config_of(name).gate, limits_of(platform(name), config_of(name).vehicle)
    for v in (8.0, 15.0, 28.0):
        rate = np.interp(v, *zip(*port.rates)) if port.rates else port.rate_max
        last = felt = 0.0
        for wish in np.repeat([12.0, -12.0], 150):
            now = gate(limits, wish, last, (v,), 0.02).delta_sw
            a_y = v * v * math.tan(now / limits.steer_ratio) / limits.length(v)
            assert abs(now - last) <= 0.02 * rate
            assert abs(a_y - felt) <= 0.02 * port.jerk_max
            assert abs(a_y) <= port.a_y_max
            last, felt = now, a_y


@judged
@settings(max_examples=5)
@given(
    st.sampled_from(NAMES),
    st.lists(st.floats(-12.0, 12.0) | st.just(math.nan) | st.just(math.inf), min_size=4, max_size=8),
    st.floats(8.0, 28.0),
)
def test_nothing_that_passes_the_gate_is_rejected_by_the_safety_code(name: str, wishes: list[float], v: float) -> None:
    car = ported(name, v_min=v, v_max=v)
    car.advance(1.2)
    last = 0.0
    for wish in wishes:
        for _ in range(4):
            verdict = gate(car.config.gate, wish, last, (v, v), 0.02)
            if verdict.send:
                last = verdict.delta_sw
            steered(car, 0.02, last)
    assert car.car.counts.sent > 10
    assert car.car.counts.rejected == 0


def test_a_gate_with_a_table_of_rates_lets_no_more_through_than_a_line_of_it() -> None:
    limits = config_of("NISSAN_LEAF").gate
    (v_0, rate_0), (v_1, rate_1), (v_2, rate_2) = limits.rates
    assert limits.rate(0.5 * (v_0 + v_1)) == pytest.approx(0.5 * (rate_0 + rate_1))
    assert limits.rate(0.25 * v_1 + 0.75 * v_2) == pytest.approx(0.25 * rate_1 + 0.75 * rate_2)
    assert limits.rate(40.0) == pytest.approx(rate_2)
    assert np.allclose(limits.rate(np.array([v_1, v_2])), [rate_1, rate_2])
    verdict = gate(replace(limits, a_y_max=5.0, jerk_max=10.0), 1.0, 0.0, (v_2,), 0.02)
    assert rate_2 * 0.02 - limits.quantum < verdict.delta_sw <= rate_2 * 0.02
    with pytest.raises(ValueError, match="fall ever more slowly"):
        replace(limits, rates=((0.0, 1.0), (5.0, 2.0)))


@given(st.floats(-0.001, 0.004), st.floats(2.0, 30.0), st.lists(st.floats(-9.0, 9.0), min_size=3, max_size=30))
def test_whichever_way_a_car_steers_the_gate_keeps_to_its_lateral_acceleration(
    understeer: float, v: float, wishes: list[float]
) -> None:
    """One that oversteers feels more of the same wheel; in steady cornering, to a quantum."""
    limits = replace(config_of("FORD_MUSTANG_MACH_E_MK1").gate, understeer=understeer)
    most = limits.steer_ratio * math.atan(limits.a_y_max / (v * yaw_gain(v, limits.wheelbase, understeer)))
    last = min(most, limits.delta_sw_max)  # it turns too slowly to get there from 0 in so few frames
    for wish in wishes * 20:
        last = gate(limits, wish, last, (v,), 0.02).delta_sw
        felt = v * yaw_gain(v, limits.wheelbase, understeer) * math.tan(abs(last) / limits.steer_ratio)
        assert felt <= limits.a_y_max + 2.0 * v * yaw_gain(v, limits.wheelbase, understeer) * limits.quantum / 10.0
    with pytest.raises(ValueError, match="expected L \\+ K v_max\\^2 of a tenth of L or more"):
        replace(limits, understeer=-1.0)


@pytest.mark.parametrize("name", ["TOYOTA_COROLLA_TSS2", "HONDA_CIVIC_BOSCH", "VOLKSWAGEN_GOLF_MK7"])
def test_a_torque_s_limits_are_those_of_its_port(name: str) -> None:
    found = platform(name)
    limits = limits_of(found, vehicle(name.lower().replace("_", "-")))
    per_second = {"TOYOTA_COROLLA_TSS2": 15 * 100 / 1500, "HONDA_CIVIC_BOSCH": 3.0, "VOLKSWAGEN_GOLF_MK7": 4 * 50 / 300}
    assert limits.jerk_max == pytest.approx(min(5.0, per_second[name] * found.lateral.gain))
    assert limits.torque_limit == pytest.approx(found.lateral.gain * (1.0 - found.lateral.friction))


@pytest.mark.parametrize(("slew", "late", "most"), [(1.07, 0.225, 1.6), (0.65, 0.2, 0.83)])
def test_a_torque_takes_over_where_it_brings_the_car_back_in_time(slew: float, late: float, most: float) -> None:
    """Without lateness and bound it comes as far aside while a_y rises to a as until it is back: 2 a^3/(3 slew^2)."""
    assert taken_over_from(slew, 0.0, 5.0) == pytest.approx((1.5 * OFF * slew**2) ** (1 / 3), abs=0.03)
    bend, dt = taken_over_from(slew, late, most), 1e-4
    furthest = []
    for a in (bend, 0.8 * bend):
        t = e = aside = given = 0.0
        while t < late or aside > 0.0:
            t, given = t + dt, min(most, given + slew * dt) if t >= late else 0.0
            aside += (a - given) * dt
            e += aside * dt
        furthest.append(e)
    assert 0.96 * OFF < furthest[0] < 1.005 * OFF
    assert furthest[1] < 0.65 * OFF


def test_a_slow_torque_s_bound_is_that_of_the_state_machine_and_no_angle_has_one() -> None:
    bend = taken_over_from(1.07, 0.225, 1.6)
    limits = limits_of(platform("CHRYSLER_PACIFICA_2020"), vehicle("chrysler-pacifica-2020"))
    assert limits.a_y_engage == pytest.approx(bend, abs=0.02)
    assert config_of("CHRYSLER_PACIFICA_2020").states.a_y_engage == limits.a_y_engage
    assert config_of("NISSAN_LEAF").states.a_y_engage == StateLimits.a_y_engage


@judged
def test_of_frames_that_break_a_limit_none_passes() -> None:
    for name in ("NISSAN_LEAF", "HYUNDAI_ELANTRA_2021"):
        row = study.altered((name, 40, 3))
        assert row["altered"] >= 40
        assert row["passed"] == 0
        assert row["hostile"] > 10
        assert row["hostile_rejected"] == 0
