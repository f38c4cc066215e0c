"""Plants: symmetries, one formula for floats, batches and symbols; actuator, drivers, sensors; teaching errors."""

import math
from dataclasses import replace

import casadi
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from steerkit.maths import Table
from steerkit.plants.human_driver import ConstantSpeed, HumanDriver, RecordedDriver, SpeedProfile
from steerkit.plants.linear_single_track import LinearSingleTrack
from steerkit.plants.nonlinear_single_track import NonlinearSingleTrack
from steerkit.plants.sensors import Sensors
from steerkit.plants.steering_actuator import SteeringActuator
from steerkit.units import radians_of
from steerkit.vehicles import BMW_320I, VW_PASSAT, Vehicle, vehicle

CARS = pytest.mark.parametrize("cls", [LinearSingleTrack, NonlinearSingleTrack])
TRUTH = (10.0, -3.0, 0.4, 6.0, 0.02, 0.3)


def run(block, inputs, x=None):
    """Outputs at each sample, then the last state; inputs: one tuple a sample."""
    x = block.init() if x is None else x
    ys = []
    for k, values in enumerate(inputs):
        u = block.U(*values)
        d = block.D(*[getattr(u, name) for name in block.D._fields])
        x = block.settle(0.0, x, d) if k == 0 else x
        y = block.output(k * block.dt, x, d)
        x = block.update(k * block.dt, x, u, y)
        ys.append(y)
    return ys, x


steering = st.lists(st.tuples(st.floats(-9.0, 9.0), st.floats(0.0, 12.0)), min_size=5, max_size=40)


# ---- cars -----------------------------------------------------------------------------------------------------


@CARS
@settings(max_examples=25, deadline=None)
@given(inputs=steering)
def test_mirror_symmetry(cls, inputs):
    car = cls(vehicle=VW_PASSAT)
    left = run(car, inputs)[0][-1]
    right = run(car, [(-delta, v) for delta, v in inputs])[0][-1]
    mirrored = (right.x, -right.y, -right.psi, right.v, -right.beta, -right.r, -right.a_y, -right.delta_sw)
    assert left == pytest.approx(mirrored, rel=1e-12, abs=1e-12)


@CARS
@settings(max_examples=25, deadline=None)
@given(inputs=steering, x0=st.floats(-50, 50), y0=st.floats(-50, 50), psi0=st.floats(-7, 7))
def test_where_and_whereto_do_not_matter(cls, inputs, x0, y0, psi0):
    here = run(cls(vehicle=VW_PASSAT), inputs)[0][-1]
    there = run(cls(vehicle=VW_PASSAT, x0=x0, y0=y0, psi0=psi0), inputs)[0][-1]
    c, s = math.cos(psi0), math.sin(psi0)
    moved = here._replace(x=x0 + c * here.x - s * here.y, y=y0 + s * here.x + c * here.y, psi=psi0 + here.psi)
    assert there == pytest.approx(moved, rel=1e-9, abs=1e-9)


@CARS
def test_batch_is_the_single_cars(cls):
    rng = np.random.default_rng(0)
    n, steps = 5, 60
    delta, v = np.cumsum(rng.normal(0, 0.5, (steps, n)), axis=0), rng.uniform(0.0, 12.0, (steps, n))
    mass = np.array([1400.0, 1639.0, 1700.0, 1800.0, 1500.0])
    start = dict(x0=rng.normal(size=n), y0=rng.normal(size=n), psi0=rng.normal(size=n), v0=v[0])
    batch = cls(vehicle=replace(VW_PASSAT, m=mass), **start)
    ys, _ = run(batch, list(zip(delta, v)), batch.init((n,)))
    for i in range(n):
        single = cls(vehicle=replace(VW_PASSAT, m=mass[i].item()), **{k: a[i].item() for k, a in start.items()})
        alone, x = run(single, list(zip(delta[:, i].tolist(), v[:, i].tolist())))
        assert all(value.__class__ is float for value in (*x, *alone[-1]))
        assert [y[i] for y in ys[-1]] == pytest.approx(alone[-1], rel=1e-12, abs=1e-12)


def traced(block, steps, update_inputs):
    """Outputs and states of `block` through a CasADi function of one sample; inputs as in `run`."""
    start = block.init()
    x, u = casadi.SX.sym("x", len(start)), casadi.SX.sym("u", max(1, len(block.U._fields)))
    state = casadi.vertsplit(x)
    state = type(start)._make(state) if hasattr(start, "_make") else tuple(state)
    inputs = block.U(*casadi.vertsplit(u)[: len(block.U._fields)])
    direct = block.D(*[getattr(inputs, name) for name in block.D._fields])
    y = block.output(0.0, state, direct)
    sample = casadi.Function(
        "sample", [x, u], [casadi.vertcat(*y), casadi.vertcat(*block.update(0.0, state, inputs, y))]
    )
    values = block.settle(0.0, start, block.D(*update_inputs[0][: len(block.D._fields)]))
    ys = []
    for k in range(steps):
        y, values = sample(casadi.DM(values), casadi.DM(update_inputs[k] or [0.0]))
        ys.append(np.array(y).ravel())
    return ys, np.array(values).ravel()


BLOCKS = {
    "linear": (LinearSingleTrack(vehicle=VW_PASSAT, v0=4.0), 2),
    "nonlinear": (NonlinearSingleTrack(vehicle=VW_PASSAT, v0=4.0, substeps=2), 2),
    "actuator": (SteeringActuator(delay=0.05, gain=1.1, offset=0.1), 1),
    "driver": (HumanDriver(seed=4), 0),
    "constant": (ConstantSpeed(), 0),
    "sensors": (Sensors.hard(3), 6),
}


@pytest.mark.parametrize("name", BLOCKS)
def test_symbols_give_what_floats_give(name):
    block, n = BLOCKS[name]
    inputs = [tuple(row) for row in (np.random.default_rng(2).normal(0, 3, (50, n)) + 3.0).tolist()]
    ys, x = run(block, inputs)
    symbolic, last = traced(block, 50, inputs)
    assert np.array(symbolic) == pytest.approx(np.array([tuple(y) for y in ys]), rel=1e-12, abs=1e-12)
    assert last == pytest.approx(np.array(x), rel=1e-12, abs=1e-12)


@CARS
def test_outputs_belong_to_the_inputs_last_applied(cls):
    ys, _ = run(cls(vehicle=VW_PASSAT, v0=2.0), [(1.0, 5.0), (2.0, 6.0), (3.0, 7.0)])
    assert [y.delta_sw for y in ys] == [0.0, 1.0, 2.0]
    assert [y.v for y in ys] == pytest.approx([2.0, 5.0, 6.0], rel=1e-3)


@CARS
def test_the_wheel_has_a_stop(cls):
    ys, _ = run(cls(vehicle=VW_PASSAT), [(99.0, 5.0), (-99.0, 5.0), (0.0, 5.0)])
    assert [y.delta_sw for y in ys] == [0.0, radians_of(520.0), -radians_of(520.0)]


@CARS
@pytest.mark.parametrize("inputs", [(math.nan, 5.0), (1.0, math.nan)])
def test_nan_is_not_hidden(cls, inputs):
    _, x = run(cls(vehicle=VW_PASSAT), [(0.1, 5.0), inputs, (0.1, 5.0)])
    assert math.isnan(x.sway)
    assert math.isnan(x.r)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (dict(c_f=-1e5), r"Vehicle 'vw-passat': c_f = -100000.0 \[N/rad\], expected .* positive, per axle"),
        (dict(c_r=3446.0), "per radian and not per degree"),
        (dict(steer_ratio=radians_of(15.6)), r"steer_ratio = 0.27.* \[1\], expected 1 to 50; a pure number"),
        (dict(delta_sw_max=520.0), r"delta_sw_max = 520.0 \[rad\], .*radians_of\(520\)"),
        (dict(m=1.6), "c_f = .*expected"),
        (dict(m=math.nan), r"m = nan \[kg\]"),
        (dict(i_z=3e5), r"i_z = 300000.0 \[kg m\^2\], expected .*0.2 to 5 times m l_f l_r"),
        (dict(l_f="1.2"), r"l_f = '1.2', expected a number \[m\]"),
        (dict(mu=np.array([0.9, -0.9])), "mu = .*ice"),
    ],
)
def test_teaching_errors_of_vehicle(change, message):
    with pytest.raises(ValueError, match=message):
        replace(VW_PASSAT, **change)


def test_named_cars():
    assert vehicle("vw-passat") is vehicle("VW Passat") is vehicle("vw_passat") is VW_PASSAT
    assert isinstance(BMW_320I, Vehicle)
    assert VW_PASSAT.wheelbase == pytest.approx(2.71)
    with pytest.raises(ValueError, match=r"'pasat' is not known \(did you mean 'vw-passat'\?\); valid: vw-passat, bmw"):
        vehicle("pasat")
    with pytest.raises(ValueError, match="'zzz' is not known; valid: vw-passat"):
        vehicle("zzz")


@CARS
@pytest.mark.parametrize(
    ("change", "message"),
    [
        (dict(vehicle="vw-passat"), r"give a Vehicle, vehicle\('...'\)"),
        (dict(dt=0.1), r"dt = 0.1 \[s\], expected .*raise substeps"),
        (dict(dt=0.0), r"dt = 0.0 \[s\]"),
        (dict(substeps=0), "substeps = 0"),
        (dict(v0=-1.0), r"v0 = -1.0 \[m/s\]"),
        (dict(x0=math.inf), r"x0 = inf \[m\]"),
    ],
)
def test_teaching_errors_of_cars(cls, change, message):
    with pytest.raises(ValueError, match=f"{cls.__name__}: .*{message}"):
        cls(**{"vehicle": VW_PASSAT, **change})
    assert cls(vehicle=VW_PASSAT, dt=0.05, substeps=5).dt == 0.05


# ---- actuator -------------------------------------------------------------------------------------------------


def test_first_order_lag_is_exact():
    actuator = SteeringActuator(lag=0.13, rate_limit=200.0)
    ys, _ = run(actuator, [(1.0,)] * 60)
    exact = 1.0 - np.exp(-np.arange(60) * actuator.dt / 0.13)
    assert [y.delta_sw for y in ys] == pytest.approx(exact, abs=1e-14)
    assert ys[-1].rate == pytest.approx((exact[-1] - exact[-2]) / actuator.dt, rel=1e-9)


@pytest.mark.parametrize("delay", [0.0, 0.01, 0.13])
def test_delay_is_exact(delay):
    commands = np.random.default_rng(0).normal(0.0, 0.3, 50).tolist()
    ys, x = run(SteeringActuator(lag=0.0, delay=delay, rate_limit=200.0), [(c,) for c in commands])
    n = round(delay / 0.01) + 1  # one sample more: a command acts from its sample to the next
    assert [y.delta_sw for y in ys] == pytest.approx([0.0] * n + commands[: 50 - n], abs=1e-12)
    assert len(x) == 2 + n - 1


def test_rate_limit_and_stops_are_exact():
    actuator = SteeringActuator(lag=0.0)
    ys, _ = run(actuator, [(99.0,)] * 120)
    ramp = np.minimum(radians_of(550.0) * 0.01 * np.arange(120), radians_of(520.0))
    assert [y.delta_sw for y in ys] == pytest.approx(ramp, rel=1e-12)
    assert max(y.rate for y in ys) == pytest.approx(radians_of(550.0), rel=1e-12)


@given(commands=st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=60), lag=st.floats(0.0, 1.0))
def test_limits_hold_whatever_is_commanded(commands, lag):
    ys, _ = run(SteeringActuator(lag=lag, delay=0.02, gain=1.2, offset=-0.3), [(c,) for c in commands])
    assert all(abs(y.delta_sw) <= radians_of(520.0) * (1.0 + 1e-12) for y in ys)
    assert all(abs(y.rate) <= radians_of(550.0) * (1.0 + 1e-12) for y in ys)


def test_ratio_error():
    ys, _ = run(SteeringActuator(gain=1.1, offset=0.2), [(1.0,)] * 300)
    assert ys[-1].delta_sw == pytest.approx(1.3, rel=1e-9)


def test_nan_command_arrives_and_stays():
    ys, _ = run(SteeringActuator(delay=0.02), [(0.0,), (math.nan,), (0.0,), (0.0,), (0.0,), (0.0,)])
    assert [math.isnan(y.delta_sw) for y in ys] == [False] * 4 + [True] * 2


def test_batch_of_different_actuators():
    batch = SteeringActuator(lag=np.array([0.0, 0.1]), offset=np.array([0.0, 0.05]), delay=0.01)
    y = run(batch, [(np.array([1.0, 1.0]),)] * 20, batch.init((2,)))[0][-1]
    alone = [SteeringActuator(lag=lag, offset=offset, delay=0.01) for lag, offset in ((0.0, 0.0), (0.1, 0.05))]
    expected = [run(a, [(1.0,)] * 20)[0][-1].delta_sw for a in alone]
    assert y.delta_sw == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            dict(delay=0.025),
            r"delay = 0.025 \[s\], expected a multiple of dt = 0.01 s; valid: 0.02 or 0.03, or a finer",
        ),
        (dict(delay=-0.01), r"delay = -0.01 \[s\]"),
        (dict(delay=np.array([0.01, 0.02])), "delay .* expected one number for all cars"),
        (dict(limit=520.0), r"limit = 520.0 \[rad\].*radians_of\(520\)"),
        (dict(rate_limit=550.0), r"rate_limit = 550.0 \[rad/s\].*radians_of\(550\)"),
        (dict(lag=-0.1), r"lag = -0.1 \[s\]"),
        (dict(gain=0.0), "gain = 0.0"),
    ],
)
def test_teaching_errors_of_actuator(change, message):
    with pytest.raises(ValueError, match=f"SteeringActuator: {message}"):
        SteeringActuator(**change)


# ---- drivers --------------------------------------------------------------------------------------------------


def speeds(driver, steps, batch=()):
    x, v = driver.init(batch), []
    for k in range(steps):
        y = driver.output(k * driver.dt, x, driver.D())
        x = driver.update(k * driver.dt, x, driver.U(), y)
        v.append(y.v)
    return np.array(v)


def test_human_driver_wanders_smoothly_over_the_whole_range():
    driver = HumanDriver(seed=1)
    v = speeds(driver, 1200, (64,))
    assert 4.0 < v.min() < 4.2
    assert 7.3 < v.max() < 7.5
    assert v.mean() == pytest.approx(5.75, abs=0.1)
    pace = np.diff(v, axis=0) / driver.dt
    assert 0.1 < pace.std() < 0.4
    assert np.abs(pace).max() < 2.5
    assert np.abs(np.diff(pace, axis=0)).max() < 0.5  # the pace itself does not jump


def test_human_driver_is_stationary_from_the_start():
    x = HumanDriver(seed=9).init((20_000,))
    z, g = np.array(x[:2])
    moments = [np.cov(z, g)]
    driver = HumanDriver(seed=9)
    for _ in range(100):
        x = driver.update(0.0, x, None, None)
    moments.append(np.cov(np.array(x[:2])))
    assert moments[0] == pytest.approx(moments[1], abs=0.04)
    assert moments[0][0, 0] == pytest.approx(1.0, abs=0.03)


def test_human_driver_of_a_batch_is_the_single_ones():
    batch = speeds(HumanDriver(seed=5), 100, (3,))
    for i in range(3):
        assert batch[:, i] == pytest.approx(speeds(HumanDriver(seed=5 + i), 100), rel=1e-12)
    assert not np.allclose(batch[:, 0], batch[:, 1])


def test_constant_speed():
    assert speeds(ConstantSpeed(speed=6.5), 3).tolist() == [6.5] * 3
    assert speeds(ConstantSpeed(speed=np.array([4.0, 5.0])), 2, (2,)).tolist() == [[4.0, 5.0]] * 2


def test_recorded_driver():
    driver = RecordedDriver(speeds=(4.0, 6.0, 5.0), spacing=0.1)
    assert speeds(driver, 7) == pytest.approx([4.0, 5.0, 6.0, 5.5, 5.0, 5.0, 5.0])
    again = replace(driver, repeat=True, start=0.1)
    assert speeds(again, 4) == pytest.approx([6.0, 5.5, 4.0, 5.0])
    assert speeds(replace(driver, start=np.array([-1.0, 0.05])), 2, (2,)) == pytest.approx(np.array([[4, 5], [4, 6]]))


def test_speed_profile_over_progress():
    profile = SpeedProfile.from_samples([10.0, 20.0, 50.0], [4.0, 5.0, 8.0], spacing=5.0)
    assert profile.speeds == pytest.approx((4.0, 4.5, 5.0, 5.5, 6.0, 6.5, 7.0, 7.5, 8.0))
    ask = [(-5.0,), (0.0,), (7.5,), (40.0,), (99.0,), (math.nan,)]
    found = [y.v for y in run(profile, ask)[0]]
    assert found == pytest.approx([4.0, 4.0, 4.75, 8.0, 8.0, math.nan], nan_ok=True)
    rounds = SpeedProfile(speeds=(4.0, 6.0, 4.0), spacing=10.0, repeat=True)
    assert rounds.output(0.0, (), rounds.D(np.array([45.0, -5.0]))).v == pytest.approx([5.0, 5.0])


def test_speed_profile_is_traced_through_a_table(monkeypatch):
    profile = SpeedProfile(speeds=(4.0, 6.0, 5.0), spacing=10.0)
    monkeypatch.setattr(
        Table,
        "tracer",
        lambda table, i: casadi.vertsplit(casadi.SX(table.rows[0]) * (i < 1) + table.rows[1] * (i >= 1)),
    )
    p = casadi.SX.sym("p")
    traced = casadi.Function("v", [p], [profile.output(0.0, (), profile.D(p)).v])
    for at in (-3.0, 2.0, 10.0, 19.0, 30.0):
        assert float(traced(at)) == pytest.approx(profile.output(0.0, (), profile.D(at)).v, rel=1e-14)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: HumanDriver(v_min=8.0, v_max=7.0),
            r"HumanDriver: v_max = 7.0 \[m/s\], expected 8 to 60; at least v_min",
        ),
        (lambda: HumanDriver(foot_time=0.01), r"foot_time = 0.01 \[s\]"),
        (lambda: HumanDriver(seed=-1), "seed = -1, expected a whole number"),
        (lambda: ConstantSpeed(speed=-5.0), r"speed = -5.0 \[m/s\]"),
        (lambda: RecordedDriver(speeds=(4.0,), spacing=1.0), "two numbers or more"),
        (lambda: RecordedDriver(speeds=(4.0, math.nan), spacing=1.0), r"speeds = .* \[m/s\]"),
        (lambda: SpeedProfile(speeds=(4.0, 5.0), spacing=0.0), "SpeedProfile: spacing = 0.0"),
        (lambda: SpeedProfile.from_samples([0.0, 0.0], [4.0, 5.0]), "at rising strictly"),
    ],
)
def test_teaching_errors_of_drivers(make, message):
    with pytest.raises(ValueError, match=message):
        make()


# ---- sensors --------------------------------------------------------------------------------------------------


def test_sensors_are_transparent_by_default():
    ys, _ = run(Sensors(), [TRUTH, TRUTH[::-1]])
    assert [tuple(y) for y in ys] == [TRUTH, TRUTH[::-1]]


@pytest.mark.parametrize("latency", [0.05, 0.15])
def test_latency_is_exact_and_starts_with_the_first_sample(latency):
    samples = [tuple(row) for row in np.random.default_rng(1).normal(size=(12, 6)).tolist()]
    ys, _ = run(Sensors(latency=latency), samples)
    n = round(latency / 0.05)
    assert [tuple(y) for y in ys] == [samples[0]] * n + samples[: 12 - n]


def test_bias():
    y = run(Sensors(x_bias=0.1, y_bias=-0.2, psi_bias=0.01, v_bias=0.3, beta_bias=-0.01, r_bias=0.02), [TRUTH])[0][0]
    assert np.subtract(y, TRUTH) == pytest.approx([0.1, -0.2, 0.01, 0.3, -0.01, 0.02], abs=1e-12)


def test_noise_and_drift_have_the_stated_statistics():
    n, steps = 4000, 41
    sensors = Sensors(
        position_noise=0.02,
        psi_noise=0.003,
        v_noise=0.05,
        beta_noise=0.004,
        r_noise=0.01,
        position_drift=0.03,
        psi_drift=0.002,
        drift_time=1.0,
        seed=11,
    )
    ys, _ = run(sensors, [tuple(np.full(n, value) for value in TRUTH)] * steps, sensors.init((n,)))
    errors = np.array([np.array(y) - np.array(TRUTH)[:, None] for y in ys])  # (steps, channel, car)
    drift = np.array([0.03, 0.03, 0.002, 0.0, 0.0, 0.0])
    spread = np.hypot(drift, [0.02, 0.02, 0.003, 0.05, 0.004, 0.01])
    for k in (0, 20, 40):  # stationary from the first sample on
        assert errors[k].std(axis=1) == pytest.approx(spread, rel=0.05)
        assert np.abs(errors[k].mean(axis=1) / spread).max() < 4.5 / math.sqrt(n)
    together = (errors[0] * errors[20]).mean(axis=1) / spread**2  # 1 s apart: the drift alone, by exp(-1)
    assert together == pytest.approx((drift / spread) ** 2 * math.exp(-1.0), abs=0.06)
    across = np.corrcoef(errors[40]) - np.eye(6)
    assert np.abs(across).max() < 0.08


def test_sensors_of_a_batch_are_the_single_ones():
    batch = Sensors.hard(3)
    ys, _ = run(batch, [tuple(np.full(2, value) for value in TRUTH)] * 20, batch.init((2,)))
    for i in range(2):
        alone = run(Sensors.hard(3 + i), [TRUTH] * 20)[0][-1]
        assert [y[i] for y in ys[-1]] == pytest.approx(alone, rel=1e-12)
        assert all(value.__class__ is float for value in alone)


def test_sensors_and_driver_of_one_seed_are_unrelated():
    assert Sensors.hard(1).init()[9:15] != HumanDriver(seed=1).init()[2:]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (dict(latency=0.03), r"latency = 0.03 \[s\], expected a multiple of dt = 0.05 s; valid: 0.05 or 0, or a finer"),
        (dict(r_noise=-0.1), r"r_noise = -0.1 \[rad/s\].*a standard deviation"),
        (dict(psi_drift=5.7), r"psi_drift = 5.7 \[rad\]"),
        (dict(drift_time=0.0), r"drift_time = 0.0 \[s\], expected .*at least dt"),
        (dict(x_bias=math.nan), r"x_bias = nan \[m\]"),
        (dict(seed=0.5), "seed = 0.5"),
    ],
)
def test_teaching_errors_of_sensors(change, message):
    with pytest.raises(ValueError, match=message):
        Sensors(**change)
