"""The car server without its wires: events in, frames and answers out; equal events give equal frames, bit for bit."""

import math
from collections import deque
from typing import Any, NamedTuple

from steerkit.car import protocol
from steerkit.car import state_machine as states
from steerkit.car.config import CarConfig
from steerkit.car.gate import gate
from steerkit.car.senses import EPS, Senses
from steerkit.car.state_machine import Facts, Machine, Mode, Order
from steerkit.estimators.steering_sign import CLEAR, DOUBTED

RESEND = 0.02
"""Period at which the last request is gated and sent again [s]."""
NEUTRAL_FRAMES = 5
"""Frames with enable = 0 that follow the last one with enable = 1."""
FOREIGN = 1.0
"""How long a foreign sender is remembered [s]."""
LOOK = 0.01
"""Longest time between two looks at the checks [s]."""


class Frame(NamedTuple):
    """A CAN frame came in; `arrived` [s] is when, t [s] when it is looked at."""

    t: float
    arrived: float
    frame_id: int
    data: bytes
    kind: str = ""
    """"" for an id of 11 bits, "x" for 29, "fd" for CAN FD, "bad" for what the adapter could not read."""


class Packet(NamedTuple):
    """A client's packet came in."""

    t: float
    link: int
    data: bytes


class Link(NamedTuple):
    """A client came or went."""

    t: float
    link: int
    up: bool


class Tick(NamedTuple):
    """Time has passed."""

    t: float


class RecordingFault(NamedTuple):
    """The recording has stopped, or goes on again."""

    t: float
    wrong: str
    """Why it stopped; "" when it goes on."""


class End(NamedTuple):
    """The process ends; the kit gets neutral frames first."""

    t: float
    cause: str


Event = Frame | Packet | Link | Tick | RecordingFault | End


class Send(NamedTuple):
    """A frame for the bus."""

    frame_id: int
    data: bytes


class Reply(NamedTuple):
    """A packet for a client."""

    link: int
    data: bytes


class Note(NamedTuple):
    """Something to record: a transition, a command, a snapshot."""

    topic: str
    values: dict[str, Any]


Output = Send | Reply | Note

_NOTED = {protocol.Estimates: "estimates", protocol.Adapted: "adapted", protocol.Filtered: "safety"}
"""What a controller says for the recording only, and its topic."""


class Core:
    """All decisions of the car server. `handle` one event after the other; call it with a `Tick` at `wake` [s].

    config: the car and its course; the core tracks e by itself, at the front axle.
    """

    def __init__(self, config: CarConfig):
        self.config = config
        self.machine = Machine()
        self.wake = 0.0
        self.t = -math.inf
        self.senses = Senses(config)
        self._course = protocol.digest(config.course)
        self._late: deque[tuple[float, float]] = deque(maxlen=1000)
        self._links: dict[int, bool | None] = {}  # is it the controller? None: has not said yet
        self._names: dict[int, str] = {}
        self._beats: dict[int, float] = {}  # of operators: when their panel last read its keys
        self._holder = -1  # whose panel engaged
        self._let_go = -math.inf  # when driving last ended
        self._unrecorded = ""
        self.ended = False
        self._request: protocol.Request | None = None
        self._new_request = False
        self._misses: deque[tuple[float, int]] = deque(maxlen=1000)
        self._sent: deque[tuple[float, float]] = deque(maxlen=32)  # while engaged: (t, delta_sw)
        self._last_frame = -math.inf
        self._frames_sent = 0
        self._command = math.nan
        self._neutral = 0
        self._clear = self._urgent = False

    @property
    def _pause(self) -> float:
        """Least time between the last frame and the next neutral one [s]."""
        return self.config.gate.dt_min if self._urgent else RESEND

    @property
    def quiet(self) -> bool:
        """Has all been sent that had to be?"""
        return self._neutral == 0

    def handle(self, event: Event) -> list[Output]:
        """What is to be done about an event. Raises nothing for whatever comes over the bus or the socket."""
        t = event.t if event.t >= self.t else self.t  # time never goes back
        if self.t > -math.inf and t > self.wake + 1e-3:
            self._late.append((t, t - self.wake))
        self.t = t
        out: list[Output] = []
        order = None
        match event:
            case Frame():
                self.senses.frame(t, event.arrived, event.frame_id, event.data, self._sent, event.kind)
            case Packet():
                order = self._packet(t, event, out)
            case Link(up=True):
                self._links[event.link] = None
            case Link(up=False):
                if self._links.pop(event.link, None):
                    self._request = None
            case RecordingFault():
                self._unrecorded = event.wrong
            case End():
                self.ended = True
                self._enter(Machine(Mode.OFF, event.cause, t), out)
        if not self.ended:
            self._decide(t, order, out)
        self._write(t, out)
        self.wake = self._next(t)
        return out

    def _packet(self, t: float, event: Packet, out: list[Output]) -> Order | None:
        message, refused, order = None, "", None
        try:
            message = protocol.decode(event.data)
        except ValueError as error:
            refused = str(error)
        match message:
            case None:
                pass
            case protocol.Hello(version=version) if version != protocol.VERSION:
                both = f"version {protocol.VERSION} of the protocol, not {version}"
                refused = f"the car server speaks {both}: start both from the same installation"
            case protocol.Hello(controller=True) if True in self._links.values():
                refused = "there is a controller already; end it first"
            case protocol.Hello() if message.course not in (protocol.NO_COURSE, self._course):
                refused = "the car server is on another course; start both with the same configuration"
            case protocol.Hello():
                self._links[event.link] = message.controller
                shown = "".join([one for one in message.name if one.isprintable()])[:80]
                self._names[event.link] = shown or f"client {event.link}"
            case _ if self._links.get(event.link) is None and not isinstance(message, protocol.Query):
                refused = "say hello first, with a version that is understood"
            case protocol.Beat() if not self._links[event.link]:
                self._beats[event.link] = t
            case protocol.Query():
                snapshot = self.snapshot(t)
                out.append(Reply(event.link, protocol.encode(snapshot)))
                if self._links.get(event.link):
                    out.append(Note("car", dict(snapshot._asdict(), text="")))
            case protocol.Command():
                order = message.order
                refused = self._against(order)
                if order is Order.ENGAGE and not refused:
                    refused = self._take_hold(t, event.link)
                if refused:
                    out.append(Note("refused", {"t": t, "order": order, "why": refused}))
                    order = None
            case protocol.Request():
                refused = self._take_request(t, event.link, message)
            case protocol.Remark() if self._links.get(event.link):
                out.append(Note("steers", {"t": t, "what": message.text}))
            case protocol.Estimates() | protocol.Adapted() | protocol.Filtered() if self._links.get(event.link):
                values = message.named() if isinstance(message, protocol.Estimates) else message._asdict()
                out.append(Note(_NOTED[type(message)], {"t": t, **values}))
            case _:
                refused = f"{type(message).__name__} is not for the car server"
        if refused:
            out.append(Reply(event.link, protocol.encode(protocol.Refused(refused))))
        return order

    def _take_request(self, t: float, link: int, request: protocol.Request) -> str:
        if not self._links.get(link):
            return "only the controller may ask for an angle"
        if not request.basis <= t + 1e-3:  # a NaN is refused too
            self.senses.error(t, "request from the future")
            return "the request's basis lies in the future"
        before = self._request.misses if self._request else request.misses
        if request.misses > before:
            self._misses.append((t, request.misses - before))
        self._request, self._new_request = request, True
        return ""

    def _against(self, order: Order) -> str:
        mode = self.machine.mode
        if order is Order.ENGAGE and mode is not Mode.READY:
            return f"not engaged from {mode}: {'; '.join(self.obstacles()) or self.machine.cause}"
        if order is Order.ARM and mode is not Mode.OFF:
            return f"armed already: {mode}"
        nothing = order is Order.ACKNOWLEDGE and mode not in (Mode.FAULT, Mode.OVERRIDE, Mode.STANDBY)
        return f"nothing to acknowledge in {mode}" if nothing else ""

    def _take_hold(self, t: float, link: int) -> str:
        """Take note whose heartbeat counts if `link` engages: its own, or that of the only panel; else why not."""
        alive = [one for one, last in self._beats.items() if t - last + EPS < self.config.states.heartbeat]
        if link not in alive and len(alive) != 1:
            panels = "; ".join([self._names[one] for one in alive])
            return f"not engaged: engage at one of the panels that read their keys: {panels}"
        self._holder = link if link in alive else alive[0]
        return ""

    @property
    def _beat(self) -> float:
        """When the panel that engaged last read its keys; while nobody drives, when any did [s]."""
        if self.machine.mode is Mode.ENGAGED:
            return self._beats.get(self._holder, -math.inf)
        return max(self._beats.values(), default=-math.inf)

    def facts(self, t: float) -> Facts:
        """All that is known at time t [s]."""
        v, senses, request, config = self.senses.values, self.senses, self._request, self.config
        of_last_second: tuple[deque[Any], ...] = (senses.errors, self._misses, self._late)
        for queue in of_last_second:
            while queue and queue[0][0] <= t - 1.0:
                queue.popleft()
        known, nan, enabled = v.get, math.nan, v.get("enabled", 0.0) != 0.0
        engaged, since, enabled_since = self.machine.mode is Mode.ENGAGED, self.machine.since, senses.enabled_since
        unasked = 0.0 if enabled_since is None else senses.enabled_at - max(enabled_since, self._let_go) + EPS
        follow_age = t - max(senses.follow_ok, since) + EPS if engaged else 0.0
        less_will_do = bool(senses.errors) or follow_age > 0.5 * config.states.follow_time  # something is wrong anyway
        just_now = t - self._let_go < config.states.foreign_enable  # a kit's reports come later than it acts
        return Facts(
            connected=True in self._links.values(),
            listen_only=config.listen_only,
            report_age=senses.age(t, config.report_frames),
            pose_age=senses.age(t, config.pose_frames) + senses.delay,
            pose_late=senses.delay,
            request_age=t - request.basis + EPS if request else math.inf,
            request=request.delta_sw if request else math.nan,
            delta_sw=known("delta_sw", nan),
            v=known("v", nan),
            v_kit=known("v_kit", nan),
            override=known("override", 0.0) != 0.0,
            enabled=enabled,
            timeout=known("timeout", 0.0) != 0.0,
            brake=known("brake", 0.0) != 0.0,
            accelerator=known("accelerator", 0.0) != 0.0,
            e=senses.e,
            psi_e=senses.psi_e,
            a_y=known("a_y", known("v", nan) * known("r", nan)),
            quality=known("quality", math.inf),
            torque_reports=senses.torque_reports,
            kit_faults=tuple([f.removeprefix("fault:") for f in config.fault_flags if known(f, 0.0) != 0.0]),
            integrity_errors=len(senses.errors),
            integrity=senses.errors[-1][1] if senses.errors else "",
            misses=sum([n for _, n in self._misses]),
            lateness=max([late for _, late in self._late]) if self._late else 0.0,
            echo_age=t - max(senses.echo_ok, since) + EPS if engaged else 0.0,
            follow_age=follow_age,
            wrong_sign=senses.signs.wrong(DOUBTED if less_will_do else CLEAR),
            e_growth=senses.e_growth(since) if engaged else 0.0,
            still_for=t - max(senses.moving, since) if engaged else 0.0,
            remaining=senses.remaining,
            heartbeat_age=t - self._beat + EPS,
            holder=self._names.get(self._holder, "") if engaged else "",
            foreign=senses.foreign[1] if t - senses.foreign[0] < FOREIGN else "",
            foreign_enable=0.0 if engaged else max(EPS if enabled or just_now else 0.0, unasked),
            recording=self._unrecorded if config.keep_recording else "",
            astray=senses.astray(t),
        )

    def obstacles(self) -> list[str]:
        """What stands against engaging now."""
        return [*states.readying(self.config.states, self.facts(self.t))]

    def _decide(self, t: float, order: Order | None, out: list[Output]) -> None:
        before = self.machine
        after = states.step(self.config.states, before, self.facts(t), t, order)
        may_clear = bool(self.config.writer.clear) and not self.config.listen_only
        if order is Order.ACKNOWLEDGE and after.mode is Mode.STANDBY and may_clear:
            self._clear, self._urgent, self._neutral = True, True, max(self._neutral, 1)  # kits latch too
        if order is Order.ACKNOWLEDGE:
            self.senses.signs.forget()  # only engaging can show that the motor's is not right
        if order is Order.ACKNOWLEDGE and (self.senses.ahead or before.mode is Mode.STANDBY):
            self.senses.forget_delay()  # never a delay, or one that its operator was told of
        if after is before:
            return
        self._enter(after, out)
        if after.mode is Mode.ENGAGED:
            self._sent.clear()
            self._command, self._neutral = self.senses.values["delta_sw"], 0
            self.senses.echo_ok = self.senses.follow_ok = t
        if order is Order.ARM:
            self.senses.forget_delay()

    def _enter(self, after: Machine, out: list[Output]) -> None:
        """Another state; the kit is told to let go where that ends driving."""
        before, self.machine = self.machine, after
        out.append(Note("state", {"t": after.since, "from": before.mode, "to": after.mode, "cause": after.cause}))
        if before.mode is Mode.ENGAGED:
            self._neutral, self._urgent, self._let_go = NEUTRAL_FRAMES, True, after.since

    def _write(self, t: float, out: list[Output]) -> None:
        if self.config.listen_only:
            return
        pause = t - self._last_frame + EPS
        if self.machine.mode is Mode.ENGAGED:
            request, dt_min = self._request, self.config.gate.dt_min
            fresh = request is not None and t - request.basis + EPS < self.config.states.request_age
            if request is None or not fresh or pause < (dt_min if self._new_request else RESEND):
                return
            speeds = (self.senses.values["v"], self.senses.values["v_kit"])
            dt = pause if self._sent else dt_min
            verdict = gate(self.config.gate, request.delta_sw, self._command, speeds, dt)
            self._new_request, sent = False, verdict.delta_sw if verdict.send else math.nan
            out.append(Note("command", {"t": t, "request": request.delta_sw, "sent": sent, "why": verdict.why}))
            if verdict.send:
                self._command = sent
                self._sent.append((t, sent))
                self._send(t, out, enable=True)
        elif self._neutral > 0 and pause >= self._pause:
            self._neutral -= 1
            self._send(t, out, enable=False)

    def _send(self, t: float, out: list[Output], *, enable: bool) -> None:
        writer = self.config.writer
        angle = self._command if math.isfinite(self._command) else 0.0
        angle = round(angle / writer.quantum) * writer.quantum
        alert = not enable and not self._clear
        data = writer.write(angle, enable=enable, clear=self._clear, alert=alert, count=self._frames_sent)
        self._clear = self._urgent = False
        self._last_frame = t
        self._frames_sent += 1
        out.append(Send(writer.message.frame_id, data))

    def _next(self, t: float) -> float:
        """When to look again at the latest: at the next frame to send, and when anything grows too old."""
        wake = t + LOOK
        if self.machine.mode is Mode.ENGAGED:
            limits, config = self.config.states, self.config
            pause = config.gate.dt_min if self._new_request else RESEND
            moments = [
                self._last_frame + pause,
                self.senses.oldest(config.report_frames) + limits.report_age,
                self.senses.oldest(config.pose_frames) + limits.pose_age - self.senses.delay,
                self._beat + limits.heartbeat,
            ]
            if self._request:
                moments.append(self._request.basis + limits.request_lost)
            wake = min([wake, *(moment for moment in moments if moment > t)])
        elif self._neutral:
            wake = min(wake, self._last_frame + self._pause)
        return max(wake, t + 1e-4)  # never spin

    def snapshot(self, t: float) -> protocol.Snapshot:
        """What a client may know at time t [s]."""
        v, f = self.senses.values, self.facts(t)
        known = {name: value for name, value in f._asdict().items() if name in protocol.Snapshot._fields}
        known |= {name: v.get(name, math.nan) for name in ("x", "y", "psi", "r", "torque")}
        limits = self.config.states
        checks = {Mode.STANDBY: states.readying, Mode.READY: states.readying, Mode.ENGAGED: states.warnings}
        against = [*checks.get(self.machine.mode, states.latched)(limits, f)]
        if self._unrecorded and not f.recording:  # else it stands among the obstacles already
            against.append(f"not recorded: {self._unrecorded}")
        return protocol.Snapshot(
            t=t,
            **known,
            beta=self.senses.beta,
            command=self._command,
            errors=float(self.senses.error_count),
            frames_sent=float(self._frames_sent),
            places=float(self.senses.places),
            mode=self.machine.mode,
            text="\n".join([self.machine.cause, *against]),
        )
