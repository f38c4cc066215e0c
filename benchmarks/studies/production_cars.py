"""Production cars through opendbc's ports, every frame judged by opendbc's safety code in C.

* drives: all ports that take an angle or a curvature, and twelve of the most sold cars that take a torque, of nine
  makers; each is driven on `highway` by `lqr`, by `mpc` and by the recovery that `auto` picks, a third of the time
  each, through the car server's core, gate and port. honest_rejected: frames to the car that the safety code
  rejected; drives_held:
  drives in which |e| stayed within 0.5 m and nothing ended them.
* altered: steering frames of such drives, altered so as to break a limit (a jump of at least twice what a frame allows,
  up to the signal's end; a request while the safety code does not allow one), each judged without being sent;
  altered_passed counts those that pass. Then a controller without sense asks the gate for anything, NaN included, while
  the car drives straight on: gate_passed_wrong counts frames that left the port and were rejected.
* learning: from nothing, with the safety filter, behind gate and port. A net is good when it steered for 20 s on end
  within 0.5 m. departures: samples with |e| > 0.5 m while engaged, the first second of each left out. RMS e and wheel
  are of the last minute, MPC's of its own drive as long, so on the same stretch.
* attacked: behind the safety filter a policy waits for 25 s, in which the filter's doubts narrow, and then steers as it
  should not for 15 s: full lock, from side to side, away from the path, by chance, slowly off. The car's steering ratio
  is as believed or 10 % off, as much as the filter doubts; attacked_max_e: largest |e| then.
* faults: what goes wrong in mid-drive; silent_s: until the last frame that asks for steering.

    python -m benchmarks study production_cars [--parts PART ...] [--ports NAME ...] [--minutes M] [--speeds LOW HIGH]
    [--seeds N] [--json]
"""

import argparse
import math
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.judges.opendbc_safety import SafetyJudge
from benchmarks.run import spread
from benchmarks.run.production import PortedCar, ProductionWorld, config_of
from benchmarks.run.production import altered as altered_frame
from benchmarks.tables import show
from steerkit.car import loop as loops
from steerkit.car.core import RESEND
from steerkit.car.gate import gate
from steerkit.car.learner import CarLearner
from steerkit.car.loop import Follow, with_controller
from steerkit.car.production.platforms import platform
from steerkit.car.production.port import STEP, Frame
from steerkit.car.simulated import Fault
from steerkit.car.state_machine import Mode, Order
from steerkit.controllers.nfq_policy import IDOE_ACTIONS
from steerkit.controllers.policy import Policy
from steerkit.diagram import realtime
from steerkit.diagram.units import degrees_of
from steerkit.learning.settings import setting
from steerkit.learning.trainer import SimulatedTrainer
from steerkit.paths.courses import straight
from steerkit.paths.path import Path as Course
from steerkit.scenario.catalogue import AUTO, make_recovery
from steerkit.task import DT, TRIP

ANGLE = (
    *("FORD_BRONCO_SPORT_MK1", "FORD_ESCAPE_MK4", "FORD_ESCAPE_MK4_5", "FORD_EXPEDITION_MK4", "FORD_EXPLORER_MK6"),
    *("FORD_FOCUS_MK4", "FORD_F_150_LIGHTNING_MK1", "FORD_F_150_MK14", "FORD_MAVERICK_MK1", "FORD_MUSTANG_MACH_E_MK1"),
    *("FORD_RANGER_MK2", "NISSAN_ALTIMA", "NISSAN_LEAF", "NISSAN_LEAF_IC", "NISSAN_ROGUE", "NISSAN_XTRAIL"),
    *("TESLA_MODEL_3", "TESLA_MODEL_Y", "TOYOTA_RAV4_TSS2_2023"),
)
"""All that take an angle or a curvature and can be steered."""
TORQUE = (
    *("TOYOTA_COROLLA_TSS2", "TOYOTA_CAMRY_TSS2", "HONDA_CIVIC_BOSCH", "HONDA_CRV_5G", "HYUNDAI_ELANTRA_2021"),
    *("HYUNDAI_IONIQ_5", "VOLKSWAGEN_GOLF_MK7", "SUBARU_OUTBACK", "MAZDA_CX5_2022", "CHRYSLER_PACIFICA_2020"),
    *("CHEVROLET_BOLT_EUV", "RIVIAN_R1"),
)
"""Of those that take a torque, some of the most sold, of nine makers."""
QUICK = ("TESLA_MODEL_3", "FORD_MUSTANG_MACH_E_MK1", "TOYOTA_COROLLA_TSS2")
LEARNS = ("TESLA_MODEL_3", "NISSAN_LEAF", "FORD_MUSTANG_MACH_E_MK1", "TOYOTA_COROLLA_TSS2", "HYUNDAI_ELANTRA_2021")
CONTROLLERS = ("lqr", "mpc", AUTO)
PARTS = ("drives", "altered", "learning", "attacked", "faults")
GOOD = 20.0
"""A net that steers for so long on end is good [s]."""
JUDGED = 60.0
"""Time at the end over which learners and MPC are compared, on the same stretch [s]."""
ATTACKS = ("lock", "side to side", "away", "chance", "slowly")
RATIOS = (0.9, 1.0, 1.1)
"""Of the attacked car's steering ratio, over that of its file."""
WAITS_FOR_STRAIGHT = 120.0
"""For how long a drive may wait for a piece of the course on which its steering can take over [s]."""
WAITS, STEERS = 25.0, 15.0
"""For how long its policy waits, and steers [s]."""
PAUSES = 3.0
"""Between a fault and its end [s]."""
FAULTS = {
    "driver's torque": Fault(kind="override", target="report", start=0.0),
    "brake": Fault(kind="brake", target="report", start=0.0),
    "door": Fault(kind="door", target="report", start=0.0),
    "cruise control off": Fault(kind="disabled", target="report", start=0.0),
    "steering fault": Fault(kind="kit_fault", target="report", start=0.0),
    "ignition off, bus lost": Fault(kind="drop", target="report", start=0.0),
    "frames frozen": Fault(kind="freeze", target="report", start=0.0),
    "frames 0.3 s late": Fault(kind="delay", target="report", start=0.0, amount=0.3),
    "wrong check sums": Fault(kind="corrupt", target="report", start=0.0),
    "pose lost": Fault(kind="drop", target="pose", start=0.0),
}
KILLED = ("controller killed", "car server killed")


class Drive:
    """A loop in a world: ARM and ENGAGE as soon as it may, `step` by `step`."""

    def __init__(self, world: ProductionWorld, first: Any, each: Callable[[realtime.Run], Any]):
        self.world, self.each = world, each
        self.run = realtime.Run(first, first.init(), realtime.Timing(period=DT))
        self.e: list[float] = []
        self.wheel: list[float] = []
        self.engaged_at = math.nan

    def step(self) -> None:
        """One sample."""
        run, world = self.run, self.world
        run.loop.advance(run.k, run.x, run.y)
        run.k += 1
        self.each(run)
        order = {Mode.OFF: Order.ARM, Mode.READY: Order.ENGAGE}.get(world.mode)
        if order is not None:
            world.order(order)
        if world.mode is Mode.ENGAGED:
            self.engaged_at = world.t if math.isnan(self.engaged_at) else self.engaged_at
            self.e.append(float(world.car.on_path.e))
            self.wheel.append(float(world.car.car.turned))

    @property
    def ended(self) -> str:
        """Why it no longer drives, or ""."""
        machine = self.world.core.machine
        return machine.cause if machine.mode in (Mode.FAULT, Mode.OVERRIDE) else ""

    def rms_e(self, last: float) -> float:
        """RMS e over the last seconds [m]."""
        return float(np.sqrt(np.mean(np.square(self.e[-round(last / DT) :] or [math.nan]))))

    def wheel_rate_deg(self, last: float = math.inf) -> float:
        """RMS rate of the steering wheel over the last seconds [deg/s]."""
        wheel = self.wheel if last == math.inf else self.wheel[-round(last / DT) :]
        return float(degrees_of(np.sqrt(np.mean((np.diff(wheel) / DT) ** 2)))) if len(wheel) > 2 else math.nan


def drive_of(world: ProductionWorld, controller: str) -> Drive:
    """The drive of a controller by its name, or of the recovery that `auto` picks."""
    if controller == AUTO:
        block = make_recovery(AUTO, loops.design_model_of(world.config), alone=True)
    else:
        block = loops.controller_named(controller, world.config, in_time=True).block
    follow = Follow.of(loops.car_loop(world.config, world, block), world)

    def each(run: realtime.Run) -> None:
        follow.begin(run)
        follow.choose(run)

    return Drive(world, follow.resting, each)


Speeds = dict[str, Any]
"""v_min and v_max [m/s] of a drive; empty: those of the car's file."""


def driven(piece: tuple[str, str, float, int, Speeds]) -> dict[str, Any]:
    """One drive: port, controller, seconds, seed, speeds."""
    name, controller, seconds, seed, speeds = piece
    world = ProductionWorld(config_of(name), seed=seed, **speeds)
    drive = drive_of(world, controller)
    while len(drive.e) < round(seconds / DT) and not drive.ended and world.t < seconds + WAITS_FOR_STRAIGHT:
        drive.step()
    e, port, counts = np.array(drive.e or [math.nan]), world.car, world.car.car.counts
    held = bool(np.nanmax(np.abs(e)) < TRIP) and len(e) >= round(seconds / DT) and not drive.ended
    return {
        "port": name,
        "controller": controller,
        "held": held,
        "max_e": float(np.abs(e).max()),
        "rms_e": float(np.sqrt(np.mean(e**2))),
        "wheel": drive.wheel_rate_deg(),
        "last_rms_e": drive.rms_e(JUDGED),
        "last_wheel": drive.wheel_rate_deg(JUDGED),
        "v": float(port.now.v),
        "frames": counts.received + counts.sent,
        "sent": counts.sent,
        "rejected": counts.rejected,
        "not_in_order": counts.not_in_order,
        "ended": drive.ended,
        "update_ms": 1e3 * port.library.update_s / port.steps,
        "apply_ms": 1e3 * port.library.apply_s / port.steps,
    }


def _allowed(name: str, v: float) -> float:
    """The most that the safety code lets a command change in a frame at v [m/s], in the units of a `Command`."""
    found = platform(name)
    controls, slow = found.controls, max(v - 2.0, 1.0)
    if found.steered_by == "torque":
        return float(max(controls.STEER_DELTA_UP, controls.STEER_DELTA_DOWN)) / found.full
    angles: Any = controls.ANGLE_LIMITS
    if getattr(angles, "MAX_LATERAL_JERK", 0.0):
        return float(np.degrees(angles.MAX_LATERAL_JERK / slow**2 * 12.0 * 2.89 * (1.0 + 6e-4 * slow**2)) * 0.02)
    return float(np.interp(slow, *angles.ANGLE_RATE_LIMIT_DOWN))


def altered(piece: tuple[str, int, int]) -> dict[str, Any]:
    """Frames of a drive, altered to break a limit, and requests without sense through gate and port."""
    name, wanted, seed = piece
    rng = np.random.default_rng(seed)
    world = ProductionWorld(config_of(name), seed=seed)
    drive = drive_of(world, "lqr")
    judge, found, frames = world.judge, platform(name), world.car.car.frames
    assert judge is not None
    tried = passed = 0
    heard: list[Frame] = []
    world.car.listen = heard.append
    while tried < wanted and not drive.ended:
        heard.clear()
        drive.step()
        v = float(world.car.now.v)
        steering = [frame for frame in heard if frames.command(frame.frame_id, frame.data, v)]
        for frame in steering[-1:]:  # that which the safety code compares with
            command = frames.command(frame.frame_id, frame.data, v)
            if world.mode is not Mode.ENGAGED or command is None or not command.active or command.value == 0.0:
                continue
            for _ in range(40):
                # Honda's safety code bounds neither torque nor its rate: there only a request that may not be is wrong
                jump = rng.random() < 0.7 and found.maker != "honda"
                if jump:
                    least = 2.0 * _allowed(name, v)
                    most = {"torque": 2.0, "curvature": 0.02, "angle": 300.0}[found.steered_by]
                    size = math.exp(rng.uniform(math.log(least), math.log(most)))
                    # a torque may fall to nothing at once
                    side = command.value if found.steered_by == "torque" else rng.uniform(-1.0, 1.0)
                    data = altered_frame(frames, frame.frame_id, frame.data, by=math.copysign(size, side))
                    again = frames.command(frame.frame_id, data, v)
                    if again is None or abs(again.value - command.value) < 0.9 * least:
                        continue  # the signal's end is nearer
                else:
                    data = frame.data
                tried += 1
                passed += judge.would_pass(world.t, frame.frame_id, data, frame.bus, allowed=jump)
    return {"port": name, "altered": tried, "passed": passed, **_hostile(name, wanted // 20, rng)}


@cache
def _endless() -> Course:
    """A straight that nobody drives to its end."""
    return straight(20000.0)


def _hostile(name: str, frames: int, rng: np.random.Generator) -> dict[str, Any]:
    """What leaves the port while the gate is asked for anything, on a straight road."""
    config = replace(config_of(name), course=_endless())
    judge = SafetyJudge(platform(name))
    car = PortedCar(config, judge=judge, s=10.0)
    t, last, wish, due, sent = 0.0, math.nan, 0.0, 1.5, 0
    while sent < frames and t < 600.0:
        t += STEP
        car.advance(t)
        if t >= due:
            due += RESEND
            kind = int(rng.integers(6))
            wish = (
                wish,
                float(rng.uniform(-9.0, 9.0)),
                math.nan,
                math.copysign(9.0, rng.normal()),
                float(rng.normal()) * 0.1,
                math.inf,
            )[kind]
            wheel = float(car.car.turned)
            last = wheel if math.isnan(last) else last
            verdict = gate(config.gate, wish, last, (float(car.now.v),) * 2, RESEND)
            if verdict.send:
                last, sent = verdict.delta_sw, sent + 1
                car.receive(t, config.writer.message.frame_id, config.writer.write(last, enable=True, count=sent))
    return {"hostile": car.car.counts.sent, "hostile_rejected": car.car.counts.rejected}


class Beside(SimulatedTrainer):
    """A trainer without a process that fails or has to be ended; an update takes a second of driving."""

    faults: tuple[str, ...] = ()

    def close(self) -> None:
        """Nothing to end."""


def learned(piece: tuple[str, int, float, Speeds]) -> dict[str, Any]:
    """One learning run: port, seed, seconds, speeds."""
    name, seed, seconds, speeds = piece
    world: Any = ProductionWorld(config_of(name), seed=seed, **speeds)
    how = replace(setting("default"), safe=True)
    given: dict[str, Any] = {"seed": seed, "clock": None, "trainer": Beside()}
    with (
        tempfile.TemporaryDirectory() as folder,
        CarLearner(how, Path(folder) / "run", world.config, world, **given) as learner,
    ):
        learner.remark()
        drive = Drive(world, learner.follow.resting, learner.step)
        good, since, departures, steered = math.nan, math.nan, 0, 0
        while len(drive.e) < round(seconds / DT) and world.t < 2.0 * seconds:
            before = len(drive.e)
            drive.step()
            if len(drive.e) == before:
                since = math.nan
                if drive.ended:
                    world.order(Order.ACKNOWLEDGE)
                continue
            departures += abs(drive.e[-1]) > TRIP and len(drive.e) > 20
            steers = drive.run.sample["supervisor.learning"] > 0.5 and learner.learner_state.counts.updates > 0
            steered += steers
            since = (since if math.isfinite(since) else world.t) if steers and abs(drive.e[-1]) < TRIP else math.nan
            if math.isnan(good) and world.t - since >= GOOD:
                good = since - drive.engaged_at
        figures = learner.figures()
    best = driven((name, "mpc", seconds, seed, speeds))
    rms_e, wheel = drive.rms_e(JUDGED), drive.wheel_rate_deg(JUDGED)
    return {
        "port": name,
        "seed": seed,
        "good_s": good,
        "departures": departures,
        "rejected": world.car.car.counts.rejected,
        "frames": world.car.car.counts.received + world.car.car.counts.sent,
        "updates": figures["updates"],
        "failures": figures["failures"],
        "share": steered / max(1, len(drive.e)),
        "rms_e": rms_e,
        "rms_x_mpc": rms_e / best["last_rms_e"],
        "wheel": wheel,
        "wheel_x_mpc": wheel / best["last_wheel"],
        "ended": [cause for _, mode, cause in world.modes if mode in (Mode.FAULT, Mode.OVERRIDE)],
    }


@dataclass(frozen=True, eq=False, kw_only=True)
class Turncoat(Policy):
    """Steers the car off its path from `begins` on."""

    kind: str = "lock"
    """One of `ATTACKS`."""
    begins: float = math.inf
    """[s]"""

    def output(self, t: Any, x: Any, u: Any) -> Any:
        action = {
            "lock": IDOE_ACTIONS[-1],
            "side to side": math.copysign(IDOE_ACTIONS[-1], int(t / 0.8) % 2 - 0.5),
            "away": math.copysign(IDOE_ACTIONS[-1], u.e),
            "chance": float(np.random.default_rng(int(t / 0.3)).uniform(IDOE_ACTIONS[-2], IDOE_ACTIONS[-1])),
            "slowly": 0.003,
        }[self.kind]
        return self.Y(action, float(t >= self.begins))


def attacked(piece: tuple[str, str, float, Speeds], *, waits: float = WAITS, steers: float = STEERS) -> dict[str, Any]:
    """One attack: port, kind, factor on the steering ratio, speeds."""
    name, kind, ratio, speeds = piece
    config = config_of(name)
    car = replace(config.vehicle, steer_ratio=ratio * config.vehicle.steer_ratio)
    world: Any = ProductionWorld(config, seed=1, vehicle=car, **speeds)
    policy = Turncoat(kind=kind)
    loop = loops.car_loop(config, world, policy, safe=True, clock=None)
    follow = Follow.of(loop, world)

    def each(run: realtime.Run) -> None:
        follow.begin(run)
        if len(drive.e) == round(waits / DT):
            begun = replace(policy, begins=run.k * DT)
            follow.exchange(run, with_controller(loop, begun))
        follow.choose(run)

    drive = Drive(world, follow.resting, each)
    while len(drive.e) < round((waits + steers) / DT) and not drive.ended and world.t < waits + steers + 10.0:
        drive.step()
    e = [abs(value) for value in drive.e[round(waits / DT) :]]  # none: it was not driven until then
    return {"port": name, "attack": kind, "ratio": ratio, "max_e": max(e, default=math.inf), "ended": drive.ended}


def faulty(piece: tuple[str, str, int], *, before: float = 4.0, after: float = PAUSES) -> dict[str, Any]:
    """One fault in mid-drive: port, fault, seed; watched from so long before it until so long after it [s]."""
    name, what, seed = piece
    world = ProductionWorld(config_of(name), seed=seed)
    drive = drive_of(world, "lqr")
    asked = [-math.inf]

    def listen(frame: Frame) -> None:
        command = world.car.car.frames.command(frame.frame_id, frame.data, float(world.car.now.v))
        if command is not None and command.active and command.value != 0.0:
            asked[0] = world.car.due

    world.car.listen = listen
    while len(drive.e) < round(before / DT) and not drive.ended:
        drive.step()
    begun, steered = world.t, asked[0]
    if what in FAULTS:
        world.car.faults.append(replace(FAULTS[what], start=begun))
    for _ in range(round(after / DT)):
        if what == KILLED[1]:
            break  # core and port are one process: nothing is sent any more
        if what == KILLED[0]:
            world.until(world.t + DT)
        else:
            drive.step()
    assert world.judge is not None
    return {
        "port": name,
        "fault": what,
        "drove": begun - steered < 0.2,
        "silent_s": max(0.0, asked[0] - begun),
        "allowed": world.judge.allowed,
        "rejected": world.car.car.counts.rejected,
        "cause": world.core.machine.cause,
        "mode": str(world.mode),
    }


def add_options(parser: argparse.ArgumentParser) -> None:
    """Its own command line options; --quick is three ports for a few seconds."""
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=list(PARTS), help="what to measure (all)")
    parser.add_argument("--ports", nargs="+", default=None, help="by opendbc's names (31; 5 of learning and attacks)")
    parser.add_argument("--minutes", type=float, default=10.0, help="of driving with each port (10)")
    parser.add_argument("--speeds", nargs=2, type=float, default=None, help="lowest and highest of the drives [m/s]")
    parser.add_argument("--frames", type=int, default=100_000, help="to alter (100,000)")
    parser.add_argument("--seeds", type=int, default=3, help="learners of each of five ports (3)")
    parser.add_argument("--learn-minutes", type=float, default=4.0, help="of each learner (4)")
    spread.add_options(parser)


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """All parts, with their tables."""
    quick = options.quick
    ports = options.ports or (QUICK if quick else (*ANGLE, *TORQUE))
    some = options.ports or (QUICK[:1] if quick else LEARNS)
    seconds = 1.1 if quick else 60.0 * options.minutes / len(CONTROLLERS)
    learning = 1.1 if quick else 60.0 * options.learn_minutes
    frames, seeds = (60, 1) if quick else (options.frames // len(ports) + 1, options.seeds)
    speeds = dict(zip(("v_min", "v_max"), options.speeds or ()))
    jobs: dict[str, tuple[Callable[[Any], dict[str, Any]], list[Any]]] = {
        "drives": (driven, [(n, c, seconds, i, speeds) for n in ports for i, c in enumerate(CONTROLLERS)]),
        "altered": (altered, [(name, frames, 1) for name in ports]),
        "learning": (learned, [(name, seed, learning, speeds) for name in some for seed in range(seeds)]),
        "attacked": (attacked, [(n, kind, x, speeds) for n in some for kind in ATTACKS for x in RATIOS]),
        "faults": (faulty, [(name, what, 1) for name in some for what in (*FAULTS, *KILLED)]),
    }
    if quick:
        jobs["drives"] = (driven, jobs["drives"][1][:: len(CONTROLLERS)])
        jobs["altered"] = (altered, jobs["altered"][1][-1:])
        jobs["attacked"] = (partial(attacked, waits=0.6, steers=0.5), jobs["attacked"][1][:1])
        jobs["faults"] = (partial(faulty, before=0.5, after=0.5), jobs["faults"][1][:1])
    rows: dict[str, list[dict[str, Any]]] = {}
    with spread.computing(spread.where(options)) as those:
        for part in options.parts:
            rows[part] = those.in_order(*jobs[part], part)
            show(part, rows[part])
    return _figures(rows) | {"rows": rows}


def _figures(rows: dict[str, list[dict[str, Any]]]) -> dict[str, Any]:
    drives, changed, learners, attacks, faults = (rows.get(part, []) for part in PARTS)
    good = sorted(row["good_s"] if math.isfinite(row["good_s"]) else math.inf for row in learners)
    return {
        "ports": len({row["port"] for row in drives}),
        "frames": sum(row["frames"] for row in drives),
        "honest_rejected": sum(row["rejected"] for row in (*drives, *learners)),
        "not_in_order": sum(row["not_in_order"] for row in drives),
        "altered": sum(row["altered"] for row in changed),
        "altered_passed": sum(row["passed"] for row in changed),
        "gate_asked": sum(row["hostile"] for row in changed),
        "gate_passed_wrong": sum(row["hostile_rejected"] for row in changed),
        "drives": len(drives),
        "drives_held": sum(row["held"] for row in drives),
        "worst_e": max([row["max_e"] for row in drives], default=math.nan),
        "learned": sum(math.isfinite(row["good_s"]) for row in learners),
        "learned_of": len(learners),
        "good_median_s": float(np.median(good)) if good else math.nan,
        "wheel_x_mpc": max([row["wheel_x_mpc"] for row in learners], default=math.nan),
        "departures": sum(row["departures"] for row in learners),
        "attacked_max_e": max([row["max_e"] for row in attacks], default=math.nan),
        "silent_worst_s": max([row["silent_s"] for row in faults], default=math.nan),
        "update_ms": float(np.median([row["update_ms"] for row in drives])) if drives else math.nan,
        "apply_ms": float(np.median([row["apply_ms"] for row in drives])) if drives else math.nan,
    }
