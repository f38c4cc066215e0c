"""A real car, or a simulated one on a bus, put together: its course, its loop, its processes, its drive."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path as FilePath
from typing import Any, TextIO

from steerkit import realtime
from steerkit.assembly import steering_loop
from steerkit.block import Block
from steerkit.clock import Clock
from steerkit.controllers.delay import delayed_stanley
from steerkit.controllers.foresight import Foresight
from steerkit.controllers.lqr import Lqr
from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.controllers.pure_pursuit import PurePursuit
from steerkit.controllers.recovery import Guarded
from steerkit.controllers.stanley import Stanley
from steerkit.courses import course
from steerkit.doe import Corrected, Dynamic, Integrator
from steerkit.learning import on_car, rundir
from steerkit.learning.follow import Follow, Steers
from steerkit.learning.settings import ELEMENTS
from steerkit.loop import Loop
from steerkit.path import Path
from steerkit.plants.human_driver import ConstantSpeed
from steerkit.plants.linear_single_track import LinearSingleTrack
from steerkit.plants.nonlinear_single_track import NonlinearSingleTrack
from steerkit.plants.real_car.bus import Port
from steerkit.plants.real_car.client import CarLink, CarLost, DriverLink, RealCar
from steerkit.plants.real_car.config import CarConfig
from steerkit.plants.real_car.simulated import Fault, SimulatedCar
from steerkit.plants.real_car.states import Mode, Order

MPC_BUDGET = 0.03
"""A solution that took longer is not used [s]: the plan before is followed, then the fallback law."""
CONTROLLERS: dict[str, Callable[[CarConfig], Block]] = {
    "stanley": lambda config: Stanley.of(config.vehicle),
    "stanley-textbook": lambda config: Stanley.textbook(config.vehicle),
    "stanley-delay": lambda config: delayed_stanley(config.vehicle, delay=config.delay, lag=config.lag),
    "lqr": lambda config: Lqr.of(
        config.vehicle, LinearSingleTrack(vehicle=config.vehicle).matrices, delay=config.delay, lag=config.lag
    ),
    "pure-pursuit": lambda config: PurePursuit.of(config.vehicle, course_of(config), delay=config.delay),
    "mpc": lambda config: _predictive(config),
    "nonlinear-mpc": lambda config: _predictive(config, nonlinear=True),
}
"""Controllers that steer by themselves, made for a car: its vehicle, its course, the lag and delay of its kit."""
RECOVERIES = {name: CONTROLLERS[name] for name in ("stanley", "stanley-delay")}
"""Controllers that catch a learned one."""
LEARNED = FilePath("runs/car")
"""Where `steerkit learn --car` keeps its run unless told otherwise, and where `nfq` is looked for."""
VALID = f"{', '.join(CONTROLLERS)}, nfq (the newest net in {LEARNED}), a learning run's directory, a policy's .npz file"


def course_of(config: CarConfig) -> Path:
    """The path that a configuration names."""
    if "name" in config.course:
        return course(config.course["name"])
    return config.course["path"]


def _predictive(config: CarConfig, *, nonlinear: bool = False) -> Block:
    from steerkit.controllers.mpc import MPC  # here, as it loads CasADi
    from steerkit.controllers.nonlinear_mpc import NonlinearMPC

    kind, plant = NonlinearMPC if nonlinear else MPC, NonlinearSingleTrack(vehicle=config.vehicle)
    return kind.of(plant, lag=config.lag, delay=config.delay, budget=MPC_BUDGET)


def default_socket() -> str:
    """Where clients look for the driver process unless told otherwise."""
    folder = os.environ.get("XDG_RUNTIME_DIR") or tempfile.gettempdir()
    return str(FilePath(folder) / f"steerkit-car-{os.getuid()}")


# ---- loops ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False, kw_only=True)
class Controller:
    """A controller for a car."""

    block: Block
    """It steers by itself, or picks the actions of `element`."""
    steers: Steers
    """What to tell the recording."""
    element: Dynamic | None = None
    """A learned policy's dynamic output element."""


def controller_named(name: str, config: CarConfig) -> Controller:
    """A controller by name, or a learned policy by its place; raises ValueError with the valid ones."""
    if name in CONTROLLERS:
        return Controller(block=CONTROLLERS[name](config), steers=Steers(name=name))
    place = LEARNED if name == "nfq" else FilePath(name)
    if place.is_dir():
        nets = [f for f in sorted(place.glob("nets/net-*.npz")) if f.stem != "net-0000"]
        if nets:
            return policy_in(nets[-1], element_of(place))
    elif place.is_file():
        return policy_in(place, element_of(place.parent.parent))
    if name == "nfq":
        raise ValueError(f"controller 'nfq': no net in {place}; learn one first: steerkit learn --car FILE")
    raise ValueError(f"controller {name!r} is not known, nor a place with a trained policy; valid: {VALID}")


def policy_in(file: FilePath, doe: str) -> Controller:
    """The learned policy in `file`, with the output element of that name."""
    return Controller(block=NfqPolicy.load(file), steers=Steers.by_policy(file, doe), element=ELEMENTS[doe]())


def element_of(place: FilePath) -> str:
    """The name of the output element that a run's policies were trained with; raises ValueError when nothing tells."""
    if (place / "car.json").is_file():
        return on_car.setting_of(place).doe
    if (place / "run.json").is_file():
        return rundir.experiment_of(place).setting.doe
    raise ValueError(f"{place} is no run directory (neither car.json nor run.json), so nothing tells the output "
                     "element of its policies")  # fmt: skip


def recovery_named(name: str, config: CarConfig) -> Block:
    """The controller that catches a learned one; raises ValueError with the valid names."""
    if name not in RECOVERIES:
        raise ValueError(f"recovery {name!r} is not known; valid: {', '.join(RECOVERIES)}")
    return RECOVERIES[name](config)


def car_loop(
    config: CarConfig, path: Path, link: CarLink, controller: Block, *, doe: Dynamic | None = None,
    recovery: str = "stanley",
) -> Loop:  # fmt: skip
    """The loop of the simulated runs with a `RealCar` in the plant's place: 20 Hz, e at the front axle.

    controller: a block that steers, or a policy, which gets `doe` (default: an Integrator), corrected by what the gate
    let through, and the recovery controller of that name, called in time for the gate to let it turn the wheel.
    """
    learned = any(port.name == "action" for port in controller.outputs)
    return steering_loop(
        car=RealCar(link=link),
        path=path,
        driver=ConstantSpeed(speed=0.0),  # the human in the car keeps the speed; nobody reads this
        controller=Guarded(block=controller) if learned else controller,
        doe=Corrected(element=doe or Integrator()) if learned else None,
        recovery=recovery_named(recovery, config) if learned else None,
        foresight=foresight(config) if learned else None,
        reference=config.vehicle.l_f,
    )


def foresight(config: CarConfig) -> Foresight:
    """How far the car will get behind the gate of `config`."""
    limits = config.gate
    same = ("a_y_max", "jerk_max", "rate_max", "delta_sw_max", "v_floor", "steer_ratio", "wheelbase")
    return Foresight(**{name: getattr(limits, name) for name in same})


def drive(
    config: CarConfig, path: Path, link: DriverLink, controller: Controller, *, recovery: str = "stanley",
    duration: float = float("inf"), clock: Clock | None = None,
    watch: Callable[[realtime.Run], bool | None] | None = None,
) -> realtime.Run:  # fmt: skip
    """Run a controller at 20 Hz on the car behind `link`, engaged or not, for `duration` [s].

    Missed deadlines go to the driver process with the next request; it disengages when they repeat. Raises CarLost
    when the driver process ends.
    """
    link.wait(timeout=10.0)
    follow = Follow.of(car_loop(config, path, link, controller.block, doe=controller.element, recovery=recovery), link)

    def step(run: realtime.Run) -> bool:
        follow.begin(run)
        follow.choose(run)
        return bool(watch and watch(run))

    link.remark(replace(controller.steers, recovery=recovery).text())
    return realtime.run(
        follow.resting, duration, timer=clock or Clock(), watch=step, on_miss=lambda run: count_misses(run, link)
    )


def count_misses(run: realtime.Run, link: DriverLink) -> None:
    """Tell the driver process about missed deadlines, with the next request."""
    link.misses = run.timing.misses


# ---- processes --------------------------------------------------------------------------------------------------


def start(*words: str, **popen: Any) -> subprocess.Popen[str]:
    """Start `steerkit car WORDS` as a process of its own, out of the terminal's reach (Ctrl-C is not for it)."""
    command = [sys.executable, "-m", "steerkit.car_cli", *words]
    return subprocess.Popen(command, text=True, start_new_session=True, **popen)


def start_driver(
    config: str, socket_path: str, *, recording: str = "", channel: str = "", time_scale: float = 1.0,
    realtime: bool = False, log: TextIO | None = None, wait: float = 15.0,
) -> subprocess.Popen[str]:  # fmt: skip
    """Start the process that owns the bus, and wait until it answers; raises CarLost when it does not."""
    options = ["--config", config, "--socket", socket_path, "--time-scale", str(time_scale)]
    options += ["--recording", recording] if recording else []
    options += ["--channel", channel] if channel else []
    options += ["--realtime"] if realtime else []
    process = start("driver", *options, stdout=log, stderr=log)
    end = time.monotonic() + wait
    while time.monotonic() < end and process.poll() is None:
        try:
            DriverLink(socket_path, controller=False).close()
            return process
        except CarLost:
            time.sleep(0.05)
    process.terminate()
    raise CarLost(f"the driver process did not come up: {_last_line(log) or f'no answer within {wait:g} s'}")


def _last_line(log: TextIO | None) -> str:
    """What a process said last in its log, and where that is."""
    if log is None or not os.path.isfile(log.name):
        return ""
    lines = FilePath(log.name).read_text(errors="replace").split("\n")
    return f"{next((line for line in reversed(lines) if line), 'it said nothing')} (log: {log.name})"


def start_simulated(
    config: str, *, time_scale: float = 1.0, log: str = "", listen: str = "", options: Sequence[str] = (),
    wait: float = 15.0,
) -> tuple[subprocess.Popen[str], str]:  # fmt: skip
    """Start a simulated car; returns its process, which takes faults on its standard input, and its channel."""
    words = ["simulate", "--config", config, "--time-scale", str(time_scale), *options]
    words += ["--log", log] if log else []
    words += ["--listen", listen] if listen else []
    process = start(*words, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert process.stdout is not None
    line = process.stdout.readline()
    if not line.startswith("channel "):
        process.terminate()
        raise CarLost(f"the simulated car did not come up: {line!r}")
    return process, line.split()[1]


def simulated_car(config: CarConfig, path: Path, **options: Any) -> SimulatedCar:
    """The simulated car of a configuration, with Stanley as the human at its wheel."""
    return SimulatedCar(config, path, Stanley.of(config.vehicle), **options)


def serve_simulated(
    car: SimulatedCar, port: Port, clock: Clock, *, log: TextIO | None = None, faults: TextIO | None = None,
    duration: float = float("inf"),
) -> None:  # fmt: skip
    """Run a simulated car in real time on a port; it writes every command it hears to `log`, as JSON lines.

    faults: lines such as `drop pose 0.5` (kind, target, length [s], amount), each acting from when it is read.
    """
    if faults:
        os.set_blocking(faults.fileno(), False)
    end = clock.now() + duration
    reported = 0.0
    while clock.now() < end:
        for frame_id, data in port.wait(clock.wall(car.next - clock.now())):
            t = clock.now()
            car.receive(t, frame_id, data)
            if log and frame_id == car.config.writer.frame_id:
                angle, enable, _ = car.config.writer.read(data)
                log.write(f'{{"t": {t!r}, "data": "{data.hex()}", "enable": {int(enable)}, "angle": {angle!r}}}\n')
        now = clock.now()
        if now - car.t > 1.0:  # the machine stood still; so did the car
            car.t = now - 0.01
        for _, frame_id, data in car.advance(now):
            port.send(frame_id, data)
        if now - reported > 0.25:
            reported = now
            for line in faults.readlines() if faults else ():
                try:
                    car.faults.append(fault_of(line, now))
                except ValueError as error:
                    print(error, flush=True)
            if log:
                state = {"t": now, "s": car.on_path.s, "progress": car.on_path.progress, "e": car.on_path.e,
                         "v": car.now.v, "enabled": car.enabled, "timeout": car.timeout}  # fmt: skip
                log.write(json.dumps(state) + "\n")
                log.flush()


def fault_of(line: str, start: float) -> Fault:
    """The fault in a line such as `drop pose 0.5` or `delay pose 2 0.2`: kind, target, length [s], amount."""
    kind, target, *numbers = line.split()
    length, amount = (*map(float, numbers), *(float("inf"), 0.0)[len(numbers) :])
    return Fault(kind=kind, target=target, start=start, length=length, amount=amount)


def engage(socket_path: str, *, timeout: float = 20.0) -> None:
    """Arm, acknowledge and engage as an operator would, waiting for READY; for tests and simulated cars."""
    with DriverLink(socket_path, controller=False) as operator:
        end = time.monotonic() + timeout
        while True:
            snapshot = operator.query()
            match snapshot.mode:
                case Mode.ENGAGED:
                    return
                case Mode.OFF:
                    operator.order(Order.ARM)
                case Mode.FAULT | Mode.OVERRIDE:
                    operator.order(Order.ACKNOWLEDGE)
                case Mode.READY:
                    operator.order(Order.ENGAGE)
                case Mode.STANDBY if "kit " in snapshot.text:  # it has a fault latched
                    operator.order(Order.ACKNOWLEDGE)
            if time.monotonic() > end:
                raise CarLost(f"not engaged within {timeout:g} s: {snapshot.mode}: {snapshot.text}")
            time.sleep(0.05)
