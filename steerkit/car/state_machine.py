"""Who steers, as a pure function of the state before, what is known, and the time."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

from steerkit._support.errors import check_numbers, number, require
from steerkit.diagram.units import degrees_of, radians_of
from steerkit.task import STOP


class Mode(StrEnum):
    """The six states. Only ENGAGED moves the wheel."""

    OFF = "OFF"
    """Nothing is sent, nothing is judged."""
    STANDBY = "STANDBY"
    """Listening; something stands against engaging."""
    READY = "READY"
    """Listening; the next engage order engages."""
    ENGAGED = "ENGAGED"
    """Gated commands go to the kit."""
    OVERRIDE = "OVERRIDE"
    """The human took the wheel; latched until acknowledged."""
    FAULT = "FAULT"
    """Something was wrong while engaged, or the kit is enabled and not by us; latched until acknowledged."""


class Order(StrEnum):
    """What the operator may ask for; each is an edge and acts once."""

    ARM = "ARM"
    ENGAGE = "ENGAGE"
    DISENGAGE = "DISENGAGE"
    ACKNOWLEDGE = "ACKNOWLEDGE"
    OFF = "OFF"


@dataclass(frozen=True, kw_only=True)
class StateLimits:
    """When the car may be engaged, and what ends it. Ages count from the frame's arrival."""

    report_age: float = number(0.1, "s", low=0.02, high=0.15)
    """Oldest report of the kit [s]."""
    pose_age: float = number(0.15, "s", low=0.02, high=0.15)
    """Oldest pose [s]."""
    request_age: float = number(0.075, "s", low=0.052, high=0.09)
    """Oldest request that is still sent [s]."""
    request_lost: float = number(0.15, "s", low=0.06, high=0.3)
    """Age of a request from which the controller counts as lost [s]."""
    e_max: float = number(2.0, "m", low=0.1, high=5.0)
    """|e| that ends driving [m]."""
    v_max: float = number(10.0, "m/s", low=0.5, high=40.0)
    """Speed that ends driving [m/s]."""
    v_mismatch: float = number(1.0, "m/s", low=0.1, high=3.0)
    """Largest difference between the two speeds [m/s]."""
    torque_max: float = number(2.5, "N m", low=0.3, high=10.0)
    """The human's torque at the wheel that counts as a touch [N m]."""
    torque_reports: int = number(3, low=1, high=10)
    """Reports in a row with such a torque that count as an override."""
    integrity_errors: int = number(2, low=1, high=10)
    """CRC, counter and value errors within a second that end driving."""
    misses: int = number(3, low=1, high=20)
    """Missed deadlines of the controller within a second that end driving."""
    lateness: float = number(0.05, "s", low=0.005, high=0.1)
    """Largest delay of the car server itself [s]."""
    quality: float = number(1.0, low=0.5, high=100.0)
    """Least quality of the pose [1]."""
    echo_age: float = number(0.12, "s", low=0.03, high=0.5)
    """How old the command may be that the kit reports [s]."""
    follow_angle: float = number(radians_of(40.0), "rad", low=radians_of(5.0), high=radians_of(120.0))
    """Largest |command - measured| while driving [rad] ..."""
    follow_time: float = number(0.3, "s", low=0.1, high=2.0)
    """... for so long [s]."""
    enable_time: float = number(0.3, "s", low=0.05, high=2.0)
    """How long the kit may take to report that it is enabled [s]."""
    e_engage: float = number(0.5, "m", low=0.05, high=2.0)
    """Largest |e| to engage at [m]."""
    psi_e_engage: float = number(radians_of(15.0), "rad", low=radians_of(1.0), high=radians_of(60.0))
    """Largest |psi_e| to engage at [rad]."""
    delta_engage: float = number(radians_of(20.0), "rad", low=radians_of(1.0), high=radians_of(90.0))
    """Largest |request - measured| to engage at [rad]."""
    a_y_engage: float = number(20.0, "m/s^2", low=0.1, high=20.0)
    """Largest |a_y| to engage at [m/s^2]; of a car steered by torque, that from which its torque can take over."""
    v_engage_min: float = number(0.5, "m/s", low=0.1, high=20.0)
    """Slowest speed to engage at [m/s]."""
    v_engage_max: float = number(9.0, "m/s", low=0.2, high=40.0)
    """Fastest speed to engage at [m/s]."""
    delta_sw_max: float = number(STOP, "rad", low=radians_of(5.0), high=STOP)
    """Largest |request| [rad]; more is a broken controller."""
    psi_e_max: float = number(radians_of(45.0), "rad", low=radians_of(5.0), high=radians_of(90.0))
    """|psi_e| that ends driving [rad]."""
    e_growth: float = number(1.5, "m", low=0.2, high=2.0)
    """Largest growth of |e| within a second while driving [m]."""
    v_reverse: float = number(0.15, "m/s", low=0.05, high=1.0)
    """Speed backwards that ends driving [m/s]."""
    v_still: float = number(0.2, "m/s", low=0.05, high=1.0)
    """Speed below which the car stands [m/s] ..."""
    still_time: float = number(1.0, "s", low=0.2, high=5.0)
    """... and after so long driving ends, without a fault [s]."""
    heartbeat: float = number(0.3, "s", low=0.15, high=0.5)
    """How long an operator's panel may be silent [s]."""
    end_margin: float = number(5.0, "m", low=0.5, high=50.0)
    """How far before the end of an open course driving ends [m]."""
    end_warning: float = number(5.0, "s", low=1.0, high=20.0)
    """How long before that the operator is warned [s]."""
    astray_min: float = number(0.2, "s", low=0.1, high=10.0)
    """Least time in which a pose that lies unnoticed may lead the car half a metre off, to engage [s]."""
    foreign_enable: float = number(0.1, "s", low=0.05, high=0.5)
    """How long the kit may be enabled without our asking [s]; a break that is no longer does not end it."""

    def __post_init__(self) -> None:
        check_numbers(self, "StateLimits")
        ok = self.request_age < self.request_lost and self.v_engage_min < self.v_engage_max <= self.v_max
        require(ok, "StateLimits", "expected request_age < request_lost and v_engage_min < v_engage_max <= v_max")


class Facts(NamedTuple):
    """What is known at one moment. SI; ages are `inf` for what never came, values NaN."""

    connected: bool = False
    """Is there a controller?"""
    listen_only: bool = False
    report_age: float = math.inf
    pose_age: float = math.inf
    request_age: float = math.inf
    request: float = math.nan
    delta_sw: float = math.nan
    v: float = math.nan
    """Speed of the pose."""
    v_kit: float = math.nan
    """Speed of the kit's report."""
    e: float = math.nan
    psi_e: float = math.nan
    a_y: float = math.nan
    """As measured, or v r of the pose."""
    quality: float = 0.0
    torque_reports: float = 0.0
    """Reports with more than `torque_max`, less a third of those since with less."""
    override: bool = False
    enabled: bool = False
    kit_faults: tuple[str, ...] = ()
    """Names of the fault flags that the kit has set."""
    timeout: bool = False
    """The kit's command watchdog has run out."""
    integrity_errors: int = 0
    """CRC, counter and value errors within the last second."""
    integrity: str = ""
    """The last of them."""
    misses: int = 0
    """Missed deadlines of the controller within the last second."""
    lateness: float = 0.0
    """How late the car server itself was, at most, within the last second."""
    echo_age: float = 0.0
    """For how long the command that the kit reports has been superseded."""
    follow_age: float = 0.0
    """How long |command - measured| has been beyond `follow_angle`."""
    engaged_for: float = 0.0
    e_growth: float = 0.0
    """By how much |e| has grown within the last second [m]."""
    still_for: float = 0.0
    """How long the car has stood [s]."""
    remaining: float = math.inf
    """Way to the end of an open course [m]."""
    pose_late: float = 0.0
    """How much of `pose_age` its time stamp says [s]."""
    heartbeat_age: float = math.inf
    """Time since an operator's panel last read its keys [s]; while engaged, that of `holder`."""
    holder: str = ""
    """The panel that engaged."""
    brake: bool = False
    accelerator: bool = False
    foreign: str = ""
    """Who else sends what only we, or only the kit, may send."""
    foreign_enable: float = 0.0
    """How long the kit has been enabled without our asking [s]; 0 only if it has let go."""
    recording: str = ""
    """What is wrong with a recording that has to be made."""
    wrong_sign: str = ""
    """Which sign of the steering is wrong."""
    astray: float = math.inf
    """The time in which a pose that lies unnoticed could lead the car half a metre off [s]."""


class Machine(NamedTuple):
    """The state: mode, why it was entered, and when [s]."""

    mode: Mode = Mode.OFF
    cause: str = "start"
    since: float = 0.0


# Each of the checks yields what does not hold, as `name: why`. Comparisons are written so that a NaN is broken.


ANEW = "if its clock was set anew, acknowledge (a) while in STANDBY"
"""The way back from a time stamp that misleads."""


def age_ms(age: float) -> str:
    """An age [s] in words."""
    return f"{1e3 * age:.0f} ms" if math.isfinite(age) else "never came"


def human(li: StateLimits, f: Facts) -> Iterator[str]:
    """The human wants the wheel."""
    if f.override:
        yield "override: the kit reports an override"
    if f.torque_reports >= li.torque_reports:
        yield f"torque: human torque above {li.torque_max:g} N m in {f.torque_reports:.0f} reports"
    if f.brake:
        yield "brake: the human brakes"
    if f.accelerator:
        yield "accelerator: the human accelerates"


def steering_reversed(f: Facts) -> Iterator[str]:
    """A command to the left, or what is measured of one, goes to the right."""
    if f.wrong_sign:
        yield f"steering reversed: {f.wrong_sign}"


def always(li: StateLimits, f: Facts) -> Iterator[str]:
    """What must hold to engage, and at all times while engaged."""
    yield from steering_reversed(f)
    if not f.connected:
        yield "controller gone: no controller is connected"
    if not f.report_age < li.report_age:
        yield f"report stale: report {age_ms(f.report_age)}"
    if not f.pose_age < li.pose_age:
        late = f", {age_ms(f.pose_late)} of it by its time stamp: {ANEW}" if f.pose_late > 0.02 else ""
        yield f"pose stale: pose {age_ms(f.pose_age)}{late}"
    if f.integrity_errors >= li.integrity_errors:
        yield f"integrity: {f.integrity_errors} errors within 1 s, last: {f.integrity}"
    if f.kit_faults:
        yield f"kit fault: the kit reports {', '.join(f.kit_faults)}"
    if f.timeout:
        yield "kit timeout: the kit's command watchdog ran out"
    if not f.quality >= li.quality:
        yield f"pose quality: quality {f.quality:g} < {li.quality:g}"
    if not abs(f.v - f.v_kit) <= li.v_mismatch:
        yield f"speed mismatch: pose {f.v:.2f} m/s, kit {f.v_kit:.2f} m/s"
    if not max(abs(f.v), abs(f.v_kit)) <= li.v_max:
        yield f"too fast: {f.v:.2f} m/s"
    if not abs(f.e) <= li.e_max:
        yield f"off the path: e = {f.e:.2f} m, limit {li.e_max:g} m"
    if math.isfinite(f.request_age) and not abs(f.request) <= li.delta_sw_max * (1.0 + 1e-9):
        yield f"request invalid: the controller asks for {degrees_of(f.request):.1f} deg"
    if f.misses >= li.misses:
        yield f"missed deadlines: {f.misses} missed deadlines of the controller within 1 s"
    if not f.lateness < li.lateness:
        yield f"server late: own delay {age_ms(f.lateness)}"
    if not f.heartbeat_age < li.heartbeat:
        who = f"the panel that engaged ({f.holder}) has not" if f.holder else "no panel has"
        yield f"operator silent: {who} read its keys since {age_ms(f.heartbeat_age)}; open one on a terminal"
    if not (f.v >= -li.v_reverse and f.v_kit >= -li.v_reverse):
        yield f"reversing: {min(f.v, f.v_kit):.2f} m/s"
    if f.foreign:
        yield f"foreign sender: {f.foreign}"
    if f.recording:
        yield f"recording: {f.recording}"


def driving(li: StateLimits, f: Facts) -> Iterator[str]:
    """What must hold while engaged."""
    if not f.request_age < li.request_lost:
        yield f"controller silent: last request {age_ms(f.request_age)} ago"
    if not f.enabled and f.engaged_for >= li.enable_time:
        yield "kit not enabled: the kit does not report that it is enabled"
    if not f.echo_age < li.echo_age:
        yield f"command echo: that of {age_ms(f.echo_age)} ago"
    if not f.follow_age < li.follow_time:
        off = f"off by more than {degrees_of(li.follow_angle):.0f} deg for {age_ms(f.follow_age)}"
        yield f"wheel does not follow: {off}"
    if not abs(f.psi_e) <= li.psi_e_max:
        yield f"across the path: psi_e = {degrees_of(f.psi_e):.0f} deg, limit {degrees_of(li.psi_e_max):.0f} deg"
    if not f.e_growth <= li.e_growth:
        yield f"leaving the path: |e| grew by {f.e_growth:.2f} m within 1 s, limit {li.e_growth:g} m"


def ending(li: StateLimits, f: Facts) -> Iterator[str]:
    """What ends driving although nothing is wrong."""
    if not f.remaining > li.end_margin:
        yield f"end of the course: {f.remaining:.1f} m before its end"
    if not f.still_for < li.still_time:
        yield f"standstill: below {li.v_still:g} m/s for {f.still_for:.1f} s"


def foreign_enable(li: StateLimits, f: Facts) -> Iterator[str]:
    """Neither the human nor this server steers: a fault when armed, told in every state but ENGAGED."""
    if not f.foreign_enable < li.foreign_enable:
        why = "another program steers, or the kit does not let go: switch it off"
        yield f"foreign enable: the kit has been enabled for {age_ms(f.foreign_enable)}, and not by us; {why}"


def latched(li: StateLimits, f: Facts) -> Iterator[str]:
    """What else is wrong, told in every state in which nothing drives or may."""
    yield from steering_reversed(f)
    yield from foreign_enable(li, f)


def engaging(li: StateLimits, f: Facts) -> Iterator[str]:
    """What must hold to engage, only."""
    if f.listen_only:
        yield "listen only: the car server was started to listen only"
    if not f.request_age < li.request_age:
        yield f"request stale: last request {age_ms(f.request_age)} ago"
    if not abs(f.request - f.delta_sw) <= li.delta_engage:
        yield f"command differs: asks for {degrees_of(f.request):.0f} deg at {degrees_of(f.delta_sw):.0f} deg"
    if not abs(f.e) <= li.e_engage:
        yield f"e: e = {f.e:.2f} m, limit {li.e_engage:g} m"
    if not abs(f.psi_e) <= li.psi_e_engage:
        yield f"psi_e: psi_e = {degrees_of(f.psi_e):.0f} deg, limit {degrees_of(li.psi_e_engage):.0f} deg"
    if not abs(f.a_y) <= li.a_y_engage:
        slow = f"limit {li.a_y_engage:.2f} m/s^2: its steering rises too slowly to take over in this bend"
        yield f"a_y: a_y = {f.a_y:.2f} m/s^2, {slow}"
    if not li.v_engage_min <= f.v <= li.v_engage_max:
        yield f"speed: v = {f.v:.2f} m/s, expected {li.v_engage_min:g} to {li.v_engage_max:g}"
    if not f.remaining > li.end_margin + li.end_warning * max(f.v, 0.0):
        yield f"end of the course: {f.remaining:.1f} m before its end"
    if not f.foreign_enable <= 0.0:
        yield "kit enabled: the kit has yet to say that it has let go"
    if not f.astray >= li.astray_min:
        off = f"a pose that lies could lead 0.5 m off in {f.astray:.1f} s"
        yield f"witness: {off}, expected {li.astray_min:g} s; steer by hand for longer, or calibrate"


def readying(li: StateLimits, f: Facts) -> Iterator[str]:
    """What stands against engaging."""
    yield from human(li, f)
    yield from always(li, f)
    yield from engaging(li, f)


def warnings(li: StateLimits, f: Facts) -> Iterator[str]:
    """What the operator should know while engaged, before it ends driving."""
    if f.remaining - li.end_margin < li.end_warning * max(f.v, 0.0):
        yield f"the course ends in {f.remaining - li.end_margin:.0f} m"


def step(limits: StateLimits, state: Machine, facts: Facts, t: float, order: Order | None = None) -> Machine:
    """The state after looking at `facts` at time t [s], with at most one order of the operator::

        OFF      -ARM->          STANDBY
        STANDBY  -all is well->  READY;  READY -anything is not-> STANDBY
        both     -foreign enable-> FAULT
        READY    -ENGAGE->       ENGAGED, in no other way
        ENGAGED  -human->        OVERRIDE;  -any fault-> FAULT;  -DISENGAGE, end of the course, standstill-> STANDBY
        OVERRIDE, FAULT -ACKNOWLEDGE-> STANDBY, in no other way
        any      -OFF->          OFF

    Pure: equal arguments give equal results. Raises nothing.
    """

    if order is Order.OFF:
        return state if state.mode is Mode.OFF else Machine(Mode.OFF, "operator: off", t)
    match state.mode:
        case Mode.OFF:
            return Machine(Mode.STANDBY, "operator: arm", t) if order is Order.ARM else state
        case Mode.STANDBY | Mode.READY as mode:
            if foreign := next(foreign_enable(limits, facts), ""):
                return Machine(Mode.FAULT, foreign, t)
            against = next(readying(limits, facts), "")
            if mode is Mode.STANDBY:
                return state if against else Machine(Mode.READY, "all checks hold", t)
            if against:
                return Machine(Mode.STANDBY, against, t)
            return Machine(Mode.ENGAGED, "operator: engage", t) if order is Order.ENGAGE else state
        case Mode.ENGAGED:
            if order is Order.DISENGAGE:
                return Machine(Mode.STANDBY, "operator: disengage", t)
            if not facts.enabled:  # only then it matters for how long
                facts = facts._replace(engaged_for=t - state.since)
            ends = ((Mode.OVERRIDE, human), (Mode.FAULT, always), (Mode.FAULT, driving), (Mode.STANDBY, ending))
            found = (Machine(mode, cause, t) for mode, check in ends for cause in check(limits, facts))
            return next(found, state)
        case _:
            return Machine(Mode.STANDBY, "operator: acknowledge", t) if order is Order.ACKNOWLEDGE else state
