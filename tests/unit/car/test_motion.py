"""The witness of the pose: closed forms of what is noticed and when; a sound car passes; what no lie can do."""

import math
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from steerkit.car.motion import ASTRAY, HORIZON, READ_LATE, SPACING, MotionCheck, MotionLimits
from steerkit.diagram.units import radians_of
from steerkit.estimators.estimate import Estimated
from steerkit.vehicles import VW_PASSAT
from steerkit.vehicles.rollout import Rollout

CAR, DT, LIMITS = Rollout.of(VW_PASSAT), 0.01, MotionLimits()
JUMP = LIMITS.pose_jump + 4.0 * LIMITS.position_noise
HEADING = LIMITS.heading_jump + 4.0 * LIMITS.heading_noise
SIGMAS = 2.5


def drive(
    seconds: float,
    motion: MotionCheck | None = None,
    *,
    v: float = 5.0,
    kappa: float = 0.0,
    aside: Callable[[float], float] = lambda t: 0.0,
    along: float = 0.0,
    psi_rate: float = 0.0,
    r_off: float = 0.0,
    wheel_off: float = 0.0,
    ratio: float = 1.0,
    v_off: float = 0.0,
    late: float = 0.0,
    since: float = 0.0,
) -> tuple[float, str]:
    """(when it was noticed [s], what was said) of a steady drive round a circle, whose pose lies after `since`.

    aside: of the time, moves the position across and turns heading and yaw rate with it, as another car's path would;
    along [m/s]; psi_rate turns the heading alone [rad/s]; r_off [rad/s] is a gyro's; wheel_off [rad] and ratio are the
    car's own, from the beginning; v_off [m/s] is the pose's speed.
    """
    motion, small = motion or MotionCheck(LIMITS, CAR), 1e-3
    L, K = float(CAR.wheelbase), float(CAR.understeer)
    delta_sw = CAR.steer_ratio * ratio * math.atan((L + K * v * v) * kappa) - wheel_off
    beta = (CAR.l_r - CAR.rear_slip * v * v) * kappa
    psi, x, y = 0.3, 1.0, 2.0
    for k in range(round(seconds / DT)):
        t = k * DT
        lied, r = max(0.0, t - since), v * kappa
        off, near = aside(lied), [aside(lied + h * small) for h in (-1.0, 1.0)] if lied > small else [0.0, 0.0]
        lie = {"psi": (near[1] - near[0]) / (2.0 * small * v or 1.0), "r": sum(near) - 2.0 * off}
        seen = psi + lie["psi"] + psi_rate * lied
        x_told, y_told = x - off * math.sin(psi + beta), y + off * math.cos(psi + beta)
        r_told = r + (lie["r"] / small**2 / v if v and lied > small else 0.0) + r_off * (lied > 0.0)
        read = t + (late if k % 37 == 36 else 0.0)
        motion.moves(
            read, psi=math.remainder(seen, math.tau), v=v + v_off * (lied > 0.0), r=r_told, delta_sw=delta_sw, v_kit=v
        )
        if what := motion.pose(read, x_told, y_told):
            return t, what
        middle = psi + beta + 0.5 * r * DT
        far = v + (along if t >= since else 0.0)
        x, y, psi = x + DT * far * math.cos(middle), y + DT * far * math.sin(middle), psi + r * DT
    return math.inf, ""


@given(v=st.floats(-1.0, 12.0), kappa=st.floats(-0.08, 0.08))
@settings(max_examples=30)
def test_a_sound_car_is_not_accused(v: float, kappa: float) -> None:
    assert drive(6.0, v=v, kappa=kappa) == (math.inf, "")


@pytest.mark.parametrize("more", [{"late": 0.05}, {"ratio": 1.2}, {"ratio": 0.8}, {"wheel_off": radians_of(3.0)}])
@pytest.mark.parametrize("kappa", [0.0, 0.05, -0.05])
def test_nor_is_one_that_is_read_late_now_and_then_or_is_not_as_its_data_sheet_says(kappa: float, more: Any) -> None:
    assert drive(25.0, kappa=kappa, **more) == (math.inf, "")


def root(lie: Callable[[float], float], bound: Callable[[float], float]) -> float:
    """When a lie exceeds its bound [s], sample by sample."""
    return next(k * DT for k in range(1, 2000) if lie(k * DT) > bound(k * DT))


TELLTALES: dict[str, tuple[Any, Callable[[float, float], float], str]] = {
    # what the first window allows after T [s], by the deviations of the data sheet: speed, zeros, noise of its level
    "along": (
        {"along": 1.0},
        lambda T, v: JUMP + 0.01 * v + SIGMAS * math.hypot(0.02 * v * T, 0.08),
        "along from where",
    ),
    "speed": ({"v_off": 0.8}, lambda T, v: JUMP + 0.01 * v + SIGMAS * math.hypot(0.02 * v * T, 0.03), "further than"),
    "gyro": (
        {"psi_rate": radians_of(1.0), "wheel_off": 0.0},
        lambda T, v: HEADING + SIGMAS * math.hypot(LIMITS.rate_zero * T, 2.0 * LIMITS.heading_noise),
        "from where the yaw rate",
    ),
}


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("name", TELLTALES)
def test_a_lie_is_noticed_when_it_exceeds_what_data_sheet_and_noise_explain(name: str, side: float) -> None:
    """Not before jump and noise alone are exceeded, and not later than the first window's bound is."""
    lie, bound, said = TELLTALES[name]
    lie = {key: side * value for key, value in lie.items()}
    rate = abs(next(iter(lie.values())))
    when, what = drive(8.0, **lie)
    assert root(lambda T: rate * T, lambda T: JUMP if name != "gyro" else HEADING) <= when
    assert when <= root(lambda T: rate * T, lambda T: bound(T, 5.0)) + 0.1
    assert said in what


@pytest.mark.parametrize("rate", [2.0, -3.0, 10.0])
def test_a_car_that_turns_as_its_wheel_does_not_say_is_noticed(rate: float) -> None:
    """By the wheel's zero: its share of the yaw rate is v sigma/(n (L + K v^2))."""
    zero = 5.0 * LIMITS.wheel_zero / (CAR.steer_ratio * (CAR.wheelbase + CAR.understeer * 25.0))
    turning = radians_of(rate)
    expected = root(
        lambda T: abs(turning) * T,
        lambda T: HEADING + SIGMAS * math.sqrt((zero * T) ** 2 + 5 * LIMITS.turn_wander**2 * T + 1.8e-5),
    )
    when, what = drive(8.0, aside=lambda t: 0.5 * 5.0 * turning * t * t)
    assert root(lambda T: abs(turning) * T, lambda T: HEADING) <= when <= expected + 0.1
    assert "than its wheel says" in what


@given(v=st.floats(1.0, 10.0), kappa=st.floats(-0.05, 0.05), rate=st.floats(-0.5, 0.5), off=st.floats(-0.05, 0.05))
@settings(max_examples=20)
def test_left_and_right_are_alike(v: float, kappa: float, rate: float, off: float) -> None:
    found = []
    for side in (1.0, -1.0):
        motion = MotionCheck(LIMITS, CAR)
        turned = {"psi_rate": side * off, "wheel_off": 0.3 * side * off, "r_off": 0.2 * side * off}
        when, _ = drive(5.0, motion, v=v, kappa=side * kappa, aside=lambda t, s=side: s * rate * t, **turned)  # type: ignore[misc]
        found.append((when, motion.astray(v, side * kappa)))
    assert found[1] == pytest.approx(found[0], rel=1e-6, abs=DT + 1e-9)


def learned(seconds: float, v: float = 5.0, known: dict[str, Estimated] | None = None) -> MotionCheck:
    """The witness of a car that has been driven so long, and then straight for some seconds more."""
    motion = MotionCheck(LIMITS, CAR, known)
    assert drive(seconds, motion, v=v, kappa=0.03)[1] == ""
    motion.forget()
    return motion


KNOWN = {"offset": Estimated(0.0, radians_of(0.1), 1.0), "steer_ratio": Estimated(15.6, 0.1, 1.0)}
KNOWN |= {"rate_zero": Estimated(0.0, 1e-4, 1.0)}


@pytest.mark.parametrize(("v", "kappa"), [(2.0, 0.04), (5.0, 0.0), (7.0, 0.04)])
def test_what_is_learned_and_what_is_calibrated_tighten_the_bounds(v: float, kappa: float) -> None:
    fresh = MotionCheck(LIMITS, CAR).astray(v, kappa)
    assert 0.1 < fresh <= MotionCheck(LIMITS, CAR, KNOWN).astray(v, kappa)
    assert (1.3 if kappa else 0.99) * fresh < learned(60.0, v).astray(v, kappa)  # straight on, the jumps are most of it
    doubted = learned(60.0, v)
    doubted.doubt()
    assert doubted.astray(v, kappa) == pytest.approx(fresh)


@pytest.mark.parametrize("v", [2.0, 7.0])
@pytest.mark.parametrize("power", [0.0, 1.0, 2.0, 3.0])
@pytest.mark.parametrize("known", [None, KNOWN])
def test_no_lie_leads_astray_sooner_than_is_said_and_some_does_not_much_later(
    v: float, power: float, known: dict[str, Estimated] | None
) -> None:
    """Lies that grow as T^power to half a metre: a jump, another heading, another turn, another change of it."""

    def caught(takes: float) -> float:
        motion = MotionCheck(LIMITS, CAR, known)
        return drive(4.0 + takes, motion, v=v, aside=lambda t: ASTRAY * (t / takes) ** power if t else 0.0, since=4.0)[
            0
        ]

    motion = MotionCheck(LIMITS, CAR, known)
    drive(4.0, motion, v=v)
    said = motion.astray(v, 0.0)
    assert math.isfinite(said)
    assert caught(0.95 * said) < math.inf
    if power in (1.0, 2.0):
        assert caught(4.0 * said) == math.inf


@pytest.mark.parametrize(
    ("lie", "said"),
    [
        ({"psi_rate": radians_of(0.5), "r_off": 0.0}, "yaw rate|heading's zero|gyro's zero"),
        ({"aside": lambda t: 0.05 * t * t}, "than its wheel says|aside|wheel's zero"),
        ({"ratio": 1.6, "kappa": 0.03}, "steering ratio|than its wheel says"),
        ({"wheel_off": radians_of(9.0)}, "wheel's zero|than its wheel says|aside"),
    ],
)
def test_who_lies_from_the_start_teaches_nothing_that_no_data_sheet_allows(lie: Any, said: str) -> None:
    """However slowly it is taught: what is believed stays within three deviations, or the pose is wrong."""
    when, what = drive(40.0, **lie)
    assert when < math.inf
    assert any(words in what for words in said.split("|")), what


def test_a_small_lie_from_the_start_is_not_forgotten_by_a_pause() -> None:
    motion = MotionCheck(LIMITS, CAR)
    drive(20.0, motion, kappa=0.02)
    before = motion.astray(5.0, 0.0)
    motion.forget()
    assert motion.pose(30.0, 70.0, 3.0) == ""  # wherever it is by then
    assert motion.astray(5.0, 0.0) == pytest.approx(before)


def test_a_drift_is_noticed_as_soon_whenever_it_begins() -> None:
    """Windows overlap and never start anew, not even when the oldest sample is dropped."""
    took = [drive(30.0, along=0.6, since=since)[0] - since for since in (12.0, 12.2, 14.6, 21.0)]
    assert max(took) <= min(took) + SPACING


def test_a_position_may_come_a_tenth_of_a_second_before_the_speed_of_its_moment() -> None:
    motion, v = MotionCheck(LIMITS, CAR), 12.0
    for k in range(100):
        motion.moves(k * DT, psi=0.0, v=v, r=0.0, delta_sw=0.0, v_kit=v)
        assert motion.pose(k * DT, v * k * DT, 0.0) == ""
    assert motion.pose(1.09, v * 1.09, 0.0) == ""


def test_a_frame_that_was_read_late_is_no_jump_and_one_in_time_is() -> None:
    """The gap before it says how late it may be, `READ_LATE` at most."""
    for gap, noticed in ((READ_LATE, False), (DT, True)):
        motion, v, t = MotionCheck(LIMITS, CAR), 10.0, 0.0
        for k in range(1000):
            t = k * DT
            motion.moves(t, psi=0.0, v=v, r=0.0, delta_sw=0.0, v_kit=v)
            assert motion.pose(t, v * t, 0.0) == ""
        motion.moves(t + gap, psi=0.0, v=v, r=0.0, delta_sw=0.0, v_kit=v)
        assert bool(motion.pose(t + gap, v * (t + gap) - v * READ_LATE, 0.0)) is noticed


def test_a_value_that_is_no_number_is_a_contradiction() -> None:
    motion = MotionCheck(LIMITS, CAR)
    for k in range(20):
        motion.moves(k * DT, psi=0.0, v=5.0, r=0.0, delta_sw=0.0, v_kit=5.0)
        assert motion.pose(k * DT, 5.0 * k * DT, 0.0) == ""
    assert motion.pose(0.2, math.nan, 0.0) != ""


def test_a_window_is_no_longer_than_it_is_said() -> None:
    """A jump that is forgiven is forgotten after `HORIZON`; then another is forgiven, too, but not before."""
    for second, noticed in ((0.6 * HORIZON + 0.005, True), (1.5 * HORIZON + 0.005, False)):
        jumps = lambda t, second=second: 0.2 * ((t > 0.0) + (t > second))  # noqa: E731
        motion = MotionCheck(LIMITS, CAR, KNOWN)
        when = drive(60.0 + 2.0 * HORIZON, motion, v=3.0, aside=jumps, since=60.0)[0]
        assert (when < math.inf) is noticed
