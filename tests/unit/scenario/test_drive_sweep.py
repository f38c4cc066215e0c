"""A sweep is the drives it stands for, one by one."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import steerkit
from steerkit.compiled import TraceError
from steerkit.diagram.simulation import Log
from steerkit.metrics import measures_of_log
from steerkit.plants.speed_driver import ConstantSpeed, SpeedDriver
from steerkit.scenario.drive import sweep

PASSAT, PATH = steerkit.vehicle("vw-passat"), steerkit.course("circle")


def loop_of(**gains: float) -> steerkit.Loop:
    return steerkit.steering_loop(
        car=steerkit.placed(steerkit.NonlinearSingleTrack(vehicle=PASSAT, v0=5.0), PATH, e=0.3),
        path=PATH,
        driver=ConstantSpeed(speed=5.0),
        actuator=steerkit.SteeringActuator(),
        controller=replace(steerkit.Stanley.of(PASSAT), **gains),
        reference=PASSAT.l_f,
    )


METRICS = ("p95_e", "rms_wheel_rate_deg")


def test_every_combination_is_the_drive_of_a_loop_of_its_own() -> None:
    values = {"controller.k": [0.5, 1.0, 4.0], "controller.k_d_yaw": [0.0, 0.3]}
    found = sweep(loop_of(), values, 3.0, METRICS)
    assert [*found.columns] == [*values, *METRICS]
    for drawn in zip(*found.columns.values(), strict=True):
        row = dict(zip(found.columns, map(float, drawn), strict=True))
        gains = {name.split(".")[1]: row[name] for name in values}
        log = steerkit.simulate(loop_of(**gains), 3.0, every=5)
        assert [row[name] for name in METRICS] == pytest.approx([measures_of_log(log)[name] for name in METRICS])
    assert found.best("p95_e")["p95_e"] == found["p95_e"].min()
    assert len(found.plot().axes) == 4  # two maps and their scales


def test_a_car_that_is_lost_has_gaps_and_is_never_the_best() -> None:
    found = sweep(loop_of(), {"controller.k": np.geomspace(1.0, 4.0, 5)}, 1.0, ["rms_e"])
    panel = found.plot().axes[0]
    assert (panel.get_xscale(), panel.get_ylabel()) == ("log", "rms_e [m]")
    columns = found.columns | {"rms_e": np.array([np.nan, 0.2, np.nan, 0.1, 0.3])}
    assert replace(found, columns=columns).best("rms_e")["controller.k"] == found["controller.k"][3]
    with pytest.raises(ValueError, match="rms_e is NaN for all 5 drives"):
        replace(found, columns=columns | {"rms_e": np.full(5, np.nan)}).best("rms_e")


def test_a_drive_is_over_when_it_has_gone_the_distance() -> None:
    whole = steerkit.simulate(loop_of(), 10.0, every=5)
    there = int((whole["path.progress"] >= 20.0).argmax())
    found = sweep(loop_of(), {"controller.k": [2.5, 3.0]}, 10.0, METRICS, distance=20.0)
    part = Log(whole.t[: there + 1], {name: values[: there + 1] for name, values in whole.items()}, whole.units)
    for name in METRICS:
        assert found[name][0] == pytest.approx(measures_of_log(part)[name])
        assert found[name][0] != pytest.approx(measures_of_log(whole)[name], rel=1e-3)


@pytest.mark.parametrize(
    ("values", "metrics", "says"),
    [
        ({}, ["rms_e"], "no parameters"),
        ({"controller.k": [1.0, np.nan]}, ["rms_e"], r"expected finite numbers \(n,\)"),
        ({"controller.k": [1.0]}, [], "no metrics"),
        ({"controller.k": [1.0]}, ["rms_f"], "metric 'rms_f' is not known"),
    ],
)
def test_what_cannot_be_swept_is_refused(values: Any, metrics: Any, says: str) -> None:
    with pytest.raises((ValueError, TraceError), match=says):
        sweep(loop_of(), values, 1.0, metrics)


def test_a_parameter_of_the_start_alone_is_swept_too() -> None:
    loop = loop_of()
    found = sweep(loop, {"car.v0": [4.0, 6.0]}, 1.0, ["rms_e"])
    for v0, rms_e in zip(found["car.v0"].tolist(), found["rms_e"]):
        car = replace(loop.blocks["car"], v0=v0)  # type: ignore[call-arg]
        log = steerkit.simulate(loop.with_block("car", car), 1.0, every=5)
        assert rms_e == pytest.approx(measures_of_log(log)["rms_e"])
    assert np.ptp(found["rms_e"]) > 1e-4


def test_three_parameters_have_a_table_and_no_picture() -> None:
    values = {f"controller.{name}": [0.1, 0.2] for name in ("k", "k_d_yaw", "k_d_steer")}
    found = sweep(loop_of(), values, 1.0, ["rms_e"])
    assert {len(column) for column in found.columns.values()} == {8}
    with pytest.raises(ValueError, match="expected one or two"):
        found.plot()


def test_speeds_that_bound_each_other_are_swept_together() -> None:
    """Above the speeds of the loop that is swept; a slowest speed above the fastest is refused."""
    loop = loop_of().with_block("driver", SpeedDriver(v_min=4.0, v_max=8.0))
    found = sweep(loop, {"driver.v_min": [9.0], "driver.v_max": [9.0, 10.0]}, 1.0, ["rms_e"])
    assert np.isfinite(found["rms_e"]).all()
    with pytest.raises(ValueError, match=r"v_max = 8.0 .*expected 9 to"):
        sweep(loop, {"driver.v_min": [9.0], "driver.v_max": [8.0]}, 1.0, ["rms_e"])
