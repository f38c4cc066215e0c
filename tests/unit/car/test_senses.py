"""What the frames say: values, ages, and what is wrong although each frame is well."""

import math
from dataclasses import replace

import pytest

from steerkit.car.senses import BEHIND, BEHIND_TIME, Punctuality, Senses
from steerkit.diagram.units import radians_of
from steerkit.paths.courses import course, straight
from steerkit.paths.path import Path
from tests.support.car_messages import config

LINE = straight(length=400.0)
POSE = {"x": 10.0, "y": 0.0, "psi": 0.0, "v": 5.0, "r": 0.0, "beta": 0.0, "a_y": 0.0, "quality": 4.0}
REPORT = {"delta_sw": 0.0, "v_kit": 5.0, "torque": 0.2, "echo": 0.0, "enabled": 1.0}


class Bench:
    """Senses, and the frames of a car for them."""

    def __init__(self, path: Path = LINE) -> None:
        self.senses = Senses(replace(config(), course=path))
        self.encoders = {reader.name: reader for reader in config().readers}
        self.counts = dict.fromkeys(self.encoders, 0)

    def send(
        self,
        name: str,
        t: float,
        arrived: float | None = None,
        sent: tuple[tuple[float, float], ...] = (),
        **values: float,
    ) -> None:
        """One frame, with all values but these as usual."""
        self.counts[name] += 1
        data = self.encoders[name].write(POSE | REPORT | values, count=self.counts[name])
        frame_id = self.encoders[name].frame_id
        self.senses.frame(t, t if arrived is None else arrived, frame_id, data, sent)

    def pose(self, t: float, **values: float) -> None:
        """The three frames of a pose."""
        for name in ("POSE_MOTION", "POSE_DYNAMICS", "POSE_POSITION"):
            self.send(name, t, **values)


def test_a_value_that_is_not_available_is_an_error_and_changes_nothing() -> None:
    bench = Bench()
    bench.send("STEERING_REPORT", 1.0, delta_sw=0.3)
    before = dict(bench.senses.values)
    bench.send("STEERING_REPORT", 1.02, delta_sw=math.nan, v_kit=7.0)
    assert bench.senses.values == before
    assert "delta_sw not available" in bench.senses.errors[-1][1]
    assert bench.senses.age(1.02, config().report_frames) == pytest.approx(0.02)


def test_strong_reports_make_a_hand_on_the_wheel_and_each_weak_one_takes_a_third_off() -> None:
    """So that the weak reports of another sender between them do not hide a hand."""
    bench, seen = Bench(), []
    for k, torque in enumerate((5.0, -5.0, 0.5, 5.0, 2.5, 2.6)):  # the limit is 2.5 N m, to either side
        bench.send("STEERING_REPORT", 1.0 + 0.02 * k, torque=torque)
        seen.append(bench.senses.torque_reports)
    assert seen == pytest.approx([1.0, 2.0, 5 / 3, 8 / 3, 7 / 3, 10 / 3])
    for k in range(20):
        bench.send("STEERING_REPORT", 1.2 + 0.02 * k)
    assert bench.senses.torque_reports == 0.0


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("gap", [0.02, 0.1])
def test_one_jump_of_the_wheel_is_enough_to_end_driving(gap: float, side: float) -> None:
    bench, most = Bench(), 25.0 * gap + 0.2  # a quick hand turns it by less
    bench.send("STEERING_REPORT", 1.0, delta_sw=-side * 0.5 * most)
    bench.send("STEERING_REPORT", 1.0 + gap, delta_sw=side * (0.5 * most - 0.01))
    assert not bench.senses.errors
    bench.send("STEERING_REPORT", 1.0 + 2.0 * gap, delta_sw=-side * (0.5 * most + 0.02))
    assert len(bench.senses.errors) >= config().states.integrity_errors
    assert "the wheel jumped by" in bench.senses.errors[-1][1]
    assert bench.senses.error_count == 1


@pytest.mark.parametrize(("t", "arrived", "age"), [(1.08, 1.0, 0.08), (1.0, 1.5, 0.0)])
def test_the_age_counts_from_the_arrival_and_never_from_the_future(t: float, arrived: float, age: float) -> None:
    bench = Bench()
    bench.send("STEERING_REPORT", t, arrived)
    assert bench.senses.age(t, config().report_frames) == pytest.approx(age, abs=1e-6)


def test_the_oldest_frame_of_a_pose_tells_its_age() -> None:
    bench = Bench()
    assert bench.senses.age(1.0, config().pose_frames) == math.inf
    bench.pose(1.0)
    bench.send("POSE_MOTION", 1.1)
    assert bench.senses.age(1.1, config().pose_frames) == pytest.approx(0.1, abs=1e-6)


def test_how_soon_a_lie_leads_astray_is_told_once_a_second_for_the_tightest_bend_of_four_seconds_ahead() -> None:
    bench = Bench(Path.from_waypoints([[0.0, 0.0], [100.0, 0.0], [130.0, 15.0], [130.0, 60.0]], closed=False))
    assert math.isnan(bench.senses.astray(0.5))
    told = []
    for k in range(1500):
        if k % 2 == 0:
            bench.send("STEERING_REPORT", 1.0 + 0.01 * k)
        bench.pose(1.0 + 0.01 * k, x=10.0 + 0.05 * k)
        told.append(bench.senses.astray(1.0 + 0.01 * k))
    assert not bench.senses.errors
    assert len(set(told)) <= 15
    assert told[0] < told[800] > 1.2 * told[-1]  # learned, and then the bend comes near


def test_the_delay_of_the_pose_is_told_from_the_quickest_so_far() -> None:
    """Its clock differs from ours by a constant that nobody knows; the first pose is 30 ms late, then one is not."""
    for offset in (0.0, 12.345, 64.1):  # the last wraps on the way: 16 bits of milliseconds
        bench, delays = Bench(), []
        for k, late in enumerate((0.03, 0.0, 0.05, 0.0)):
            measured = 1.0 + 0.3 * k
            stamp = (measured + offset) % 65.536
            bench.send("POSE_DYNAMICS", measured + late, stamp=stamp)
            delays.append(bench.senses.delay)
        assert delays == pytest.approx([0.0, 0.0, 0.05, 0.0], abs=2e-3)
    bench.senses.forget_delay()
    assert bench.senses.delay == 0.0


def test_a_command_is_echoed_until_a_newer_one_should_be() -> None:
    """An echo of the command of 1.00 s is good until 1.02 s, when the next was sent."""
    sent = ((1.0, 0.1), (1.02, 0.2), (1.04, 0.3))
    step = config().writer.quantum  # rounding may cost one
    for echo, good_until in ((0.3, 1.06), (0.3 - step, 1.06), (0.2, 1.04), (0.1 + step, 1.02), (0.1 + 2 * step, 0.0)):
        bench = Bench()
        bench.send("STEERING_REPORT", 1.06, sent=sent, echo=echo)
        assert bench.senses.echo_ok == pytest.approx(good_until)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_wheel_is_where_the_commands_of_the_last_third_of_a_second_sent_it(side: float) -> None:
    far = 1.2 * config().states.follow_angle * side
    bench = Bench()
    for t, sent, good_until in (
        (1.0, ((0.9, far), (0.98, 0.0)), 1.0),  # it is there
        (1.1, ((0.9, 0.0), (1.08, far)), 1.1),  # it was told to leave just now
        (1.5, ((0.9, 0.0), (1.2, far), (1.48, far)), 1.1),  # it was told so 0.3 s ago, and before that long ago
        (1.6, ((1.3, far), (1.58, -far)), 1.6),  # on the way from one side to the other
        (2.0, ((1.66, 0.0), (1.7, far)), 2.0),  # there until 0.34 s ago
        (2.1, ((1.74, 0.0), (1.8, far)), 2.0),  # until 0.36 s ago
        (2.2, ((1.0, far / 1.2),), 2.2),  # exactly as far off as it may be
    ):
        bench.send("STEERING_REPORT", t, sent=sent)
        assert bench.senses.follow_ok == good_until


def test_after_a_gap_the_place_on_the_path_is_looked_for_again() -> None:
    path, lead = course("paper"), config().vehicle.l_f
    bench = Bench(path)
    for t, s, e in ((1.0, 20.0, 0.2), (31.0, 300.0, -0.3), (61.0, 150.0, 0.1)):
        (x, y), psi = path.point(s), float(path.psi(s))
        cos, sin = math.cos(psi), math.sin(psi)
        bench.pose(t, x=x - e * sin - lead * cos, y=y + e * cos - lead * sin, psi=math.remainder(psi, math.tau))
        assert bench.senses.e == pytest.approx(e, abs=2e-3)
    for gap, anew in ((0.14, 0), (0.16, 2)):  # with each of its two frames
        before, known = bench.senses.places, bench.senses.values
        t += gap
        bench.pose(t, x=known["x"] + 5.0 * gap * cos, y=known["y"] + 5.0 * gap * sin, psi=known["psi"])
        assert bench.senses.places == before + anew


def test_e_is_that_of_the_front_axle() -> None:
    bench = Bench()
    psi = radians_of(10.0)
    bench.pose(1.0, y=0.1, psi=psi)
    assert bench.senses.e == pytest.approx(0.1 + config().vehicle.l_f * math.sin(psi), abs=1e-3)
    assert bench.senses.psi_e == pytest.approx(psi, abs=1e-3)


def test_a_frame_of_another_kind_with_the_number_of_a_report_is_none_nor_is_what_cannot_be_read() -> None:
    bench = Bench()
    bench.send("STEERING_REPORT", 1.0, delta_sw=0.1)
    data = bench.encoders["STEERING_REPORT"].write(POSE | REPORT | {"delta_sw": 0.2})
    for kind in ("x", "fd"):
        bench.senses.frame(1.02, 1.02, 0x65, data, (), kind)
    assert not bench.senses.errors
    bench.senses.frame(1.03, 1.03, -1, b"T0", (), "bad")
    assert "no frame" in bench.senses.errors[-1][1]
    assert bench.senses.values["delta_sw"] == pytest.approx(0.1, abs=1e-3)
    assert bench.senses.age(1.05, config().report_frames) == pytest.approx(0.05)


@pytest.mark.parametrize(("last", "foreign"), [(1.5, "78 times a second, expected 50"), (1.5001, "")])
def test_too_many_reports_have_a_second_sender(last: float, foreign: str) -> None:
    """Within 0.5 s, 1.4 times as many as expected and three more are still one sender's."""
    bench = Bench()
    for k in range(38):
        bench.send("STEERING_REPORT", 1.0 + k / 128)
    assert bench.senses.foreign[1] == ""
    bench.send("STEERING_REPORT", last)
    assert bench.senses.foreign[1] == (foreign and f"STEERING_REPORT comes {foreign}")


def stamped(clock: float, seconds: float = 8.0, jump: float = 0.0, at: float = 4.0, gap: float = 0.0) -> Senses:
    """Poses every 10 ms whose clock runs `clock` times as fast; after `at` [s] it jumps, and nothing came for `gap`."""
    bench = Bench()
    for t in (0.01 * k for k in range(round(seconds / 0.01))):
        after = t > at
        bench.send("POSE_DYNAMICS", 1.0 + t + gap * after, stamp=(clock * t + (jump + gap) * after) % 65.536)
    return bench.senses


@pytest.mark.parametrize(
    ("clock", "jump", "at", "gap", "what"),
    [
        (1.012, 0.0, 4.0, 0.0, ""),  # by 36 ms in 3 s
        (1.015, 0.0, 4.0, 0.0, "run ahead by 4"),
        (1.0, 0.28, 0.0, 0.0, ""),  # the first pose came late
        (1.0, 0.28, 2.9, 0.0, "run ahead by 28"),
        (1.0, 0.32, 2.9, 0.0, "0.32 s ahead"),
        (1.0, 5.0, 4.0, 0.9, "5.00 s ahead"),
        (1.0, 5.0, 4.0, 1.1, ""),  # a pause: nobody knows
    ],
)
def test_time_stamps_that_run_fast_or_jump_ahead_are_noticed(
    clock: float, jump: float, at: float, gap: float, what: str
) -> None:
    texts = [text for _, text in stamped(clock, 8.0, jump, at, gap).errors if "stamp" in text]
    assert what in texts[0] if what else not texts


def test_a_clock_that_drifts_is_allowed_for() -> None:
    assert not stamped(1.0001).errors
    assert stamped(0.9996, 40.0).delay == pytest.approx(8e-3, abs=1.5e-3)  # half of it
    assert stamped(1.0, jump=5.0).delay == pytest.approx(0.0, abs=2e-3)  # and is forgotten when it is back
    assert stamped(1.0, jump=-1.0).delay == pytest.approx(1.0, abs=1e-2)


def queued(share: float, *, seconds: float = 12.0, halt: float = 0.0) -> list[tuple[float, str]]:
    """Errors of frames of 100 Hz that come later by `share` of the time, stamps and all: (when, what).

    In the middle nothing comes for so long; what was sent meanwhile then comes at once.
    """
    bench, middle = Bench(), round(50.0 * seconds)
    for k in range(round(100.0 * seconds)):
        t = 1.0 + 0.01 * k * (1.0 + share)
        late = max(0.0, 1.0 + 0.01 * middle + halt - t) if k >= middle else 0.0
        bench.send("POSE_DYNAMICS", t + late, stamp=t % 65.536)
    return list(bench.senses.errors)


def test_frames_that_come_later_and_later_are_noticed_whatever_their_stamps_say() -> None:
    """A queue that fills up on the way, with stamps to match: their counter tells."""
    errors = queued(0.02, seconds=9.0)
    when, what = errors[0]
    assert 1.0 + BEHIND / 0.02 + BEHIND_TIME < when < 1.0 + BEHIND / 0.018 + BEHIND_TIME
    assert "POSE_DYNAMICS comes 129 ms later than its counter says" in what
    assert len(errors) > config().states.integrity_errors
    assert queued(0.0043, seconds=40.0)
    for share in (0.0, 1e-3, -1e-3, -0.02):  # the sender's quartz is no better; too quick is none of this
        assert queued(share, seconds=40.0) == []


@pytest.mark.parametrize(("modulus", "lost"), [(8, 7), (8, 8), (8, 12), (16, 12), (256, 13)])
def test_lost_frames_are_counted_beyond_a_turn_of_the_counter(modulus: int, lost: int) -> None:
    """A counter of three bits turns within 80 ms; again and again so many frames are lost, none of them is late."""
    frames = Punctuality(0.01, modulus, 0.15)
    assert not any(frames.behind(1.0 + 0.01 * k, k % modulus) for k in range(3000) if k % 50 >= lost)


def test_a_sender_that_pauses_without_counting_is_not_late() -> None:
    """After each pause it begins anew; no number of turns of its counter would explain them."""
    frames = Punctuality(0.01, 16, 0.15)
    assert not any(frames.behind(1.0 + 0.01 * k + 0.23 * (k // 100), k % 16) for k in range(1000))


@pytest.mark.parametrize(("arrived", "counter", "late"), [(1.5, 3, 0.0), (1.75, 1, 0.12425), (1.875, 1, 0.0)])
def test_a_frame_is_late_after_a_while_and_until_a_pause_begins(arrived: float, counter: int, late: float) -> None:
    frames = Punctuality(0.125, 4, patience=0.75)
    assert frames.behind(1.0, 0) == 0.0
    assert frames.behind(arrived, counter) == pytest.approx(late)


@pytest.mark.parametrize("halt", [0.05, 0.11, 0.4])
def test_a_computer_that_reads_late_is_no_delay(halt: float) -> None:
    assert [what for _, what in queued(0.0, halt=halt) if "later" in what] == []


def test_a_delay_that_stays_is_forgotten_with_an_order_only() -> None:
    bench = Bench()
    for k in range(400):
        bench.send("POSE_MOTION", 1.0 + 0.01 * k + 0.065 * (k > 100) + 0.065 * (k > 101))
    errors = len(bench.senses.errors)
    assert errors > 100
    bench.senses.forget_delay()
    for k in range(400, 600):
        bench.send("POSE_MOTION", 1.13 + 0.01 * k)
    assert len(bench.senses.errors) == errors


def test_before_the_first_frame_nothing_has_come_and_nothing_is_wrong() -> None:
    senses = Bench().senses
    assert (senses.delay, senses.places, senses.e_growth(0.0), senses.torque_reports, senses.error_count) == (0,) * 5
    assert (senses.foreign[0], senses.moving, senses.remaining) == (-math.inf, -math.inf, math.inf)


@pytest.mark.parametrize(("v", "moves"), [(0.2, True), (-0.2, True), (0.199, False), (-0.199, False)])
def test_below_a_speed_the_car_stands(v: float, moves: bool) -> None:
    bench = Bench()
    bench.send("POSE_MOTION", 1.0, v=v)
    assert bench.senses.moving == (1.0 if moves else -math.inf)


def test_the_kit_is_enabled_since_its_first_report_of_it() -> None:
    bench, since = Bench(), []
    for k, enabled in enumerate((0.0, 1.0, 1.0, 0.0, 1.0)):
        bench.send("STEERING_REPORT", 1.0 + k, enabled=enabled)
        since.append(bench.senses.enabled_since)
    assert since == [None, 2.0, 2.0, None, 5.0]


def test_how_much_e_has_grown_within_a_second() -> None:
    bench = Bench()
    for k in range(97):
        bench.pose(1.0 + k / 64, y=0.01 * k)
    assert bench.senses.e_growth(0.0) == pytest.approx(0.64, abs=2e-3)
    assert bench.senses.e_growth(2.25) == pytest.approx(0.16, abs=2e-3)


def test_how_far_it_is_to_the_end_of_an_open_course() -> None:
    bench = Bench()
    bench.pose(1.0, x=350.0)
    assert bench.senses.remaining == pytest.approx(50.0 - config().vehicle.l_f, abs=0.1)
    closed = Bench(course("paper"))
    closed.pose(1.0)
    assert closed.senses.remaining == math.inf
