"""The vehicle-state estimator against the truth of a simulated car: late, lost, swapped, broken and jumping samples."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
import pytest

from steerkit.diagram.units import radians_of
from steerkit.estimators.single_track_filter import SingleTrackFilter
from steerkit.estimators.vehicle_state import VehicleState
from steerkit.metrics.signals import rms
from steerkit.plants.sensors import Sensors
from steerkit.plants.single_track import LinearSingleTrack, NonlinearSingleTrack
from steerkit.vehicles import VW_PASSAT
from tests.support.steered_car import quantities
from tests.support.stepped import run_fast

DT = 0.05
NAN = math.nan
PLANT = NonlinearSingleTrack(vehicle=VW_PASSAT)
FILTER = VehicleState.of(PLANT, heading_drift=0.0)


@dataclass(frozen=True)
class Tape:
    """A drive: the true x, y, psi, v, beta, r (T, 6), the wheel's angle (T,) [rad], and what was measured (T, 6)."""

    truth: np.ndarray
    wheel: np.ndarray
    seen: np.ndarray

    def rows(self, late: int = 1) -> list[list[float]]:
        """The estimator's inputs, what is measured arriving so many samples late."""
        rows = []
        for k, wheel in enumerate(self.wheel):
            x, y, psi, v, _, r = self.seen[max(k - late, 0)]
            age = late * DT
            rows.append([float(a) for a in (x, y, psi, age, v, r, age, wheel)])
        return rows


@lru_cache(maxsize=16)
def driven(seed: int | None = 1, seconds: float = 40.0, v: float = 6.0, wheel: float = 1.0) -> Tape:
    """A car that winds along, with `hard` sensors of a seed, or perfect ones."""
    car = replace(PLANT, v0=v)
    sensors = Sensors() if seed is None else replace(Sensors.hard(seed), latency=0.0)
    x: Any = car.init()
    state: Any = None
    truth, wheels, seen = [], [], []
    for k in range(round(seconds / DT)):
        y = car.output(0.0, x, None)
        now = (y.x, y.y, y.psi, y.v, y.beta, y.r)
        d = sensors.D(*now)
        state = sensors.settle(0.0, sensors.init(), d) if state is None else state
        measured = sensors.output(0.0, state, d)
        state = sensors.update(0.0, state, sensors.U(*now), measured)
        truth.append(now)
        wheels.append(y.delta_sw)
        seen.append(measured[:6])
        for n in range(5):
            t = k * DT + n * car.dt
            angle = wheel * (1.2 * math.sin(0.9 * t) + 0.8 * math.sin(0.23 * t + 1.0))
            x = car.update(t, x, car.U(delta_sw_cmd=angle, v_cmd=v), y)
    return Tape(np.array(truth), np.array(wheels), np.array(seen))


def outputs(block: VehicleState, rows: list[list[float]]) -> dict[str, np.ndarray]:
    return dict(zip(FILTER.Y._fields, run_fast(block, rows)[0].T))


def errors(tape: Tape, y: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """To the left of the truth [m], and of the heading [rad]."""
    psi = tape.truth[:, 2]
    side = -np.sin(psi) * (y["x"] - tape.truth[:, 0]) + np.cos(psi) * (y["y"] - tape.truth[:, 1])
    return side, np.angle(np.exp(1j * (y["psi"] - psi)))


@pytest.mark.parametrize("plant", [PLANT, LinearSingleTrack(vehicle=VW_PASSAT)])
def test_with_perfect_sensors_it_is_the_truth_of_now(plant: Any) -> None:
    """Though what it sees is two samples old, at 0.4 rad/s and 6 m/s."""
    tape = driven(None)
    y = outputs(VehicleState.of(plant, heading_drift=0.0), tape.rows(late=2))
    for i, (name, near) in enumerate(
        (("x", 0.01), ("y", 0.01), ("psi", 2e-3), ("v", 0.01), ("beta", 5e-3), ("r", 0.01))
    ):
        assert y[name][100:] == pytest.approx(tape.truth[100:, i], abs=near), name
    assert abs(tape.truth[2:, :2] - tape.truth[:-2, :2]).max() > 0.5


def test_it_is_nearer_to_the_truth_than_what_is_measured_and_says_how_near() -> None:
    late, turned, side_in, side_share, turned_share, nis = [], [], [], [], [], []
    for seed in (5, 6):
        tape = driven(seed, 60.0)
        y = outputs(FILTER, tape.rows())
        side, heading = (error[100:] for error in errors(tape, y))
        raw = dict(zip(("x", "y", "psi"), tape.seen[:, :3].T))
        raw_side, raw_heading = (error[100:] for error in errors(tape, raw))
        late.append(rms(np.diff(side)) / rms(np.diff(raw_side)))
        assert rms(side) < 1.03 * rms(raw_side)
        turned.append(rms(heading) / rms(raw_heading))
        side_in.append(rms(y["beta"][100:] - tape.truth[100:, 4]))
        side_share.append(np.mean(abs(side) < 1.96 * y["side_deviation"][100:]))
        turned_share.append(np.mean(abs(heading) < 1.96 * y["psi_deviation"][100:]))
        nis.append(y["nis"][100:].sum() / y["nis_count"][100:].sum())
    assert np.mean(late) < 0.85
    assert np.mean(turned) < 0.6
    assert max(side_in) < radians_of(0.05)
    assert np.mean(side_share) == pytest.approx(0.95, abs=0.05)
    assert np.mean(turned_share) > 0.8  # of two drives
    assert np.mean(nis) == pytest.approx(1.0, abs=0.06)


def shuffled(rows: list[list[float]], late: Callable[[int], int]) -> list[list[float]]:
    """The same measurements, that of sample k arriving late(k) samples later; at most one a sample."""
    arriving: dict[int, list[float]] = {}
    for k, row in enumerate(rows):
        at = k + late(k)
        assert at not in arriving
        age = row[3] + late(k) * DT
        arriving[at] = [*row[:3], age, *row[4:6], age]
    return [[*arriving.get(k, [NAN] * 7), row[7]] for k, row in enumerate(rows)]


def test_order_and_lateness_within_the_horizon_do_not_matter() -> None:
    rows = driven(5).rows(late=0)[:400]
    plain = outputs(FILTER, rows)
    swapped = outputs(FILTER, shuffled(rows, lambda k: 2 if k >= 10 and k % 2 == 0 else 0))
    for name in ("x", "y", "psi", "r", "side_deviation"):
        assert swapped[name][20:] == pytest.approx(plain[name][20:], abs=1e-12), name
    assert not swapped["missing"][20:385].any()


@pytest.mark.parametrize("lost", [slice(0, 4), slice(0, 7)])
def test_an_outage_of_two_seconds_is_ridden_out_and_said(lost: slice) -> None:
    """Of the pose, or of all but the wheel: the deviation grows by what is then not known."""
    side_in, times = [], 0
    for seed in (5, 6, 7):
        tape = driven(seed, 60.0)
        rows = tape.rows()
        out = np.zeros(len(rows), dtype=bool)
        for k in range(200, len(rows) - 60, 160):
            out[k : k + 40] = True
        for k in np.flatnonzero(out):
            rows[k][lost] = [NAN] * (lost.stop - lost.start)
        y = outputs(FILTER, rows)
        side, _ = errors(tape, y)
        ends = np.flatnonzero(out & ~np.roll(out, -1))
        side_in += list(abs(side[ends]) / y["side_deviation"][ends])
        times += len(ends)
        assert (y["outage"][ends] == 1.0).all()
        assert (y["missing"][ends] == 1.0).all()
        assert not y["outage"][100:200].any()
        assert not y["outage"][ends + 10].any()
        assert (y["side_deviation"][ends] > 1.2 * y["side_deviation"][ends - 42]).all()
        assert (y["psi_deviation"][ends].max() > radians_of(1.0)) == (lost.stop == 7)  # a turn is r, and so the speed's
        assert abs(side[ends]).max() < 0.25
        assert abs(side[ends + 20]).max() < 0.05
    assert times > 15
    assert np.mean(np.array(side_in) < 1.96) > 0.8
    assert np.mean(np.array(side_in)) > 0.05  # nor is it said to be much worse than it is


def test_a_jump_is_rejected_and_believed_once_it_has_lasted() -> None:
    tape = driven(5)
    rows = tape.rows()
    for k in range(300, len(rows)):
        if k < 305 or k >= 500:
            rows[k][0] += 0.3 if k < 305 else 0.2
    y = outputs(FILTER, rows)
    plain = outputs(FILTER, tape.rows())
    assert y["rejected"][303:306].all()
    assert not y["rejected"][310:495].any()
    moved = y["x"] - plain["x"]
    assert abs(moved[300:500]).max() < 0.005
    assert abs(moved[500:510]).max() < 0.005
    assert y["rejected"][503:510].all()
    assert moved[650] == pytest.approx(0.2, abs=0.03)
    assert not y["rejected"][530:].any()


@lru_cache(maxsize=40)
def broken(channel: int, value: float) -> dict[str, np.ndarray]:
    """Outputs over 9 s, of which one channel holds that value from 5 s on, for 3 s."""
    rows = driven(5).rows()[:180]
    for row in rows[100:160]:
        row[channel] = value
    return outputs(FILTER, rows)


@pytest.mark.parametrize("value", [NAN, math.inf, -math.inf, 1e200])
@pytest.mark.parametrize("channel", range(8))
def test_nonsense_in_one_channel_is_as_nothing(channel: int, value: float) -> None:
    tape, y = driven(5), broken(channel, value)
    assert np.isfinite(np.array(list(y.values()))).all()
    after = {name: np.pad(y[name], (0, 620), "edge") for name in ("x", "y", "psi")}
    assert abs(errors(tape, after)[0][:180]).max() < 0.5
    if channel != 3:  # where a pose of no age is nothing, one of no place is
        nothing = broken(channel, NAN)
        assert y["side_deviation"][140:] == pytest.approx(nothing["side_deviation"][140:], rel=0.5)


def test_the_wheel_may_go_missing_while_it_turns() -> None:
    """What it turned is not taken for its zero, nor for a turn of the car, once it is heard again."""
    tape = driven(5)
    rows = tape.rows()
    for k in (*range(150, 230), *range(300, 500, 2)):
        rows[k][7] = NAN
    assert abs(tape.wheel[230] - tape.wheel[150]) > 1.5
    y = outputs(FILTER, rows)
    side, heading = errors(tape, y)
    assert abs(side[100:]).max() < 0.05
    assert abs(heading[100:]).max() < radians_of(0.4)
    assert abs(y["wheel_offset"][[149, 240, 600]]).max() < radians_of(3.0)
    assert y["missing"][151:231].all()


def test_before_the_first_position_there_is_none_and_then_it_is_found_however_far_off() -> None:
    tape = driven(5)
    rows = tape.rows()
    for k, row in enumerate(rows):
        row[0] += 60_000.0
        row[1] -= 5_000.0
        if k < 50:
            row[:4] = [NAN] * 4
    y = outputs(FILTER, rows)
    assert np.isnan(y["x"][:50]).all()
    assert (y["outage"][:50] == 1.0).all()
    far = replace(tape, truth=tape.truth + np.array([60_000.0, -5_000.0, 0.0, 0.0, 0.0, 0.0]))
    assert np.isfinite(y["x"][60:]).all()
    assert abs(errors(far, y)[0][100:]).max() < 0.05


def test_at_standstill_nothing_drifts() -> None:
    tape = driven(5, 60.0, v=0.0, wheel=0.0)
    rows = tape.rows()
    y = outputs(FILTER, rows)
    assert np.isfinite(np.array(list(y.values()))).all()
    assert np.ptp(y["psi"][600:]) < radians_of(0.1)
    assert abs(y["r"]).max() < radians_of(0.05)
    assert y["wheel_offset_deviation"][-1] == pytest.approx(y["wheel_offset_deviation"][0], rel=0.01)
    assert abs(y["wheel_offset"][-1]) < radians_of(0.1)
    assert np.hypot(y["x"] - tape.truth[:, 0], y["y"] - tape.truth[:, 1])[200:].max() < 0.03
    assert y["gyro_zero_deviation"][-1] < 0.3 * FILTER.gyro_drift


def test_zeros_are_found_and_said_to_be_known() -> None:
    tape = driven(5, 100.0)
    rows = tape.rows()
    gyro, wheel, heading = radians_of(0.4), radians_of(2.0), radians_of(0.8)
    for row in rows:
        row[5] += gyro
        row[7] -= wheel
        row[2] += heading
    block = VehicleState.of(PLANT, gyro_drift=0.01, wheel_drift=0.05, heading_drift=0.02, heading_time=600.0)
    y = outputs(block, rows)
    for name, truth, near in (("gyro_zero", gyro, 0.05), ("wheel_offset", wheel, 0.4), ("heading_bias", heading, 0.2)):
        assert y[name][-400:].mean() == pytest.approx(truth, abs=radians_of(near)), name
        assert y[f"{name}_valid"][0] == 0.0
        assert y[f"{name}_valid"][-1] == 1.0
    assert quantities(block) == ("gyro_zero", "heading_bias", "wheel_offset")


@pytest.mark.parametrize(
    ("field", "value", "says"),
    [
        ("horizon", 0.07, r"horizon = 0.07 \[s\], expected a multiple of dt"),
        ("horizon", 2.0, "horizon = 2.0"),
        ("dt", 0.5, r"dt = 0.5 \[s\], expected 0.001 to 0.2"),
        ("rhs", 3.0, "a plant's rhs"),
    ],
)
def test_parameters_out_of_range(field: str, value: float, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        replace(FILTER, **{field: value})
    with pytest.raises(ValueError, match="Sensors has no rhs; expected a single-track plant"):
        VehicleState.of(Sensors())
    for settings, message in (({"dt": 0.1}, "dt = 0.05, steering.dt = 0.1"), ({"held": True}, "steering.held = True")):
        with pytest.raises(ValueError, match=message):
            replace(FILTER, steering=SingleTrackFilter(**{"vehicle": VW_PASSAT, "held": False} | settings))
