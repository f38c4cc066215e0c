"""Nothing is wrong, and nothing may be taken for wrong: `python -m tests.attack.calm [--minutes 60] [--jobs 2]`.

Drives under hard sensors, on a computer that is held up again and again, and the two recorded laps of a real car,
played back with noise. Prints how each of them ended.
"""

from __future__ import annotations

import argparse
import gzip
import math
import random
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import cache
from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from steerkit.car.config import CarConfig, load
from steerkit.car.core import Core, Event, Frame, Output, Send, Tick
from steerkit.paths.courses import course
from steerkit.vehicles import VW_PASSAT, vehicle_text
from tests.attack import wire
from tests.attack.bench import Attack, Bench, Drive

LAPS = {"genesis": 1.1, "genesis-rfs": 2.4}
"""Drives of a person in a Hyundai Genesis, 361 and 67 s, shipped with the product; and how far the centre of gravity is
ahead of the point that their positions are of [m]: so says the direction of travel against the heading in bends. The
guide asks for the centre of gravity."""
ASKEW = 0.011
"""Their heading's zero lies so far to the left of the car's [rad], nearly as much as the product bears."""
PAUSE, HELD = 0.5, 0.04
"""A busy computer holds the car server up every so often, on average, and for so long at most [s]."""


class Busy(Drive):
    """A drive whose car server is held up now and then: what comes meanwhile is looked at late, all at once."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.stalls = random.Random(self.seed + 1000)
        self.next_stall, self.back = 1.0, -math.inf
        self.late: list[Event] = []

    def handle(self, event: Event) -> None:
        if self.t >= self.next_stall:
            self.back = self.t + self.stalls.uniform(0.0, HELD)
            self.next_stall = self.back + 0.05 + self.stalls.expovariate(1.0 / PAUSE)
        if self.t < self.back:
            if not isinstance(event, Tick):
                self.late.append(event)
            return
        waiting, self.late = self.late, []
        for each in [*waiting, event]:
            super().handle(each._replace(t=self.t))


def busy_drive(speed: float, seed: int, seconds: float) -> Drive:
    return Busy(Attack("none", seconds=seconds), speed=speed, seed=seed).settle().run()


# ---- recorded laps --------------------------------------------------------------------------------------------------


@cache
def lap(name: str) -> dict[str, np.ndarray]:
    """A recorded lap: t [s], x, y [m], psi [rad], v [m/s], r [rad/s], delta_sw [rad].

    The recorded speed and the shipped course tell where the car was when; heading, wheel and yaw rate are as recorded,
    where there was none (`genesis-rfs`) the heading's slope.
    """
    file = files("steerkit.logs") / "drives" / f"{name.replace('-', '_')}.csv.gz"
    lines = [line for line in gzip.decompress(file.read_bytes()).decode().splitlines() if not line.startswith("#")]
    table = np.array([[float(number) for number in line.split(",")] for line in lines[1:]])
    known = dict(zip(lines[0].split(","), table.T))
    t, v, psi = known["t"], known["v"], np.unwrap(known["psi"])
    way = np.concatenate([[0.0], np.cumsum(0.5 * np.diff(t) * (v[1:] + v[:-1]))])
    path = course(name)
    points = path.point(way * path.length / way[-1] + LAPS[name])
    r = known.get("wz", np.gradient(psi, t))
    wheel = np.radians(known["delta_sw_deg"])
    return {"t": t, "x": points[:, 0], "y": points[:, 1], "psi": psi, "v": v, "r": r, "delta_sw": wheel}


@cache
def configured(name: str) -> CarConfig:
    """The shipped configuration for that car and course, with its limits; it was driven up to 13 m/s."""
    shipped = load("dbw-kit.toml").texts["config.toml"]
    text = shipped.replace('name = "paper"', f'name = "{name}"', 1).replace('"vw-passat"', '"genesis.toml"')
    text = text.replace("v_engage_max = 9.0\nv_max = 10.0", "v_engage_max = 12.9\nv_max = 13.0")
    text = text.replace('signal = "PSI" }', f'signal = "PSI", offset = {-ASKEW} }}')
    text = "\n".join(line for line in text.splitlines() if not line.startswith("beta ="))  # not recorded
    car = replace(
        VW_PASSAT, name="genesis", m=2196.0, l_f=1.204, l_r=1.806, i_z=4667.0, c_f=288619.0, c_r=304166.0,
        steer_ratio=15.87,
    )  # fmt: skip
    with TemporaryDirectory() as folder:
        Path(folder, "genesis.toml").write_text(vehicle_text(car))
        Path(folder, "car.toml").write_text(text)
        return load(Path(folder, "car.toml"))


class Playback(Bench):
    """A recorded lap as the car server would have seen it, with a controller that asks for what the person steered."""

    def __init__(self, name: str, seed: int, noise: float = 1.0):
        self.core = Core(configured(name))
        self.rows, self.noise, self.dice = lap(name), noise, random.Random(seed)
        self.t, self.mode, self.command = 0.0, "OFF", math.nan
        self.modes: list[tuple[float, str, str]] = []
        self.drift = [0.0, 0.0, 0.0]
        self.engaged = 0.0
        """For how long it was [s]."""

    def said(self, out: Output) -> None:
        super().said(out)
        if isinstance(out, Send):
            angle, enable, _ = wire.command(out.data)
            self.command = angle if enable else math.nan

    def frames(self, now: dict[str, float], count: int) -> None:
        """Pose at 100 Hz, report at 50 Hz, with the noise of hard sensors."""
        x, y, psi, v, r = self.noisy(now["x"], now["y"], now["psi"], now["v"], now["r"])
        frames = [
            (wire.POSITION, wire.position(x, y, quality=4, count=count)),
            (wire.MOTION, wire.motion(psi, v, r, count=count)),
            (wire.DYNAMICS, wire.dynamics(0.0, now["v"] * now["r"], self.t, count=count)),
        ]
        if count % 2 == 0:
            driving = math.isfinite(self.command)
            flags = {"ENABLED"} if driving else set()
            wheel = math.degrees(now["delta_sw"])
            echo = math.degrees(self.command) if driving else wheel
            frames.append((wire.REPORT, wire.report(wheel, echo, now["v"], 0.2, flags)))
        for frame_id, data in frames:
            self.handle(Frame(self.t, self.t, frame_id, data))

    def run(self, until: float = math.inf) -> Playback:
        """The lap from its beginning; engaged whenever that is possible."""
        self.arm()
        end = min(until, float(self.rows["t"][-1]))
        count = range(1, round(end / 0.01))
        times = 0.01 * np.array(count)
        seen = [np.interp(times, self.rows["t"], column).tolist() for column in self.rows.values()]
        for k, *numbers in zip(count, *seen):
            self.t, now = 0.01 * k, dict(zip(self.rows, numbers))
            self.frames(now, k)
            if k % 5 == 1:
                request: Any = now["delta_sw"]
                self.packet(1, wire.asked(self.t, request, 0))
            if k % 10 == 3:
                self.packet(2, wire.BEAT)
            if self.mode == "READY":
                self.order("ENGAGE")
            if self.mode == "FAULT":
                self.order("ACKNOWLEDGE")
            if self.core.wake <= self.t:
                self.handle(Tick(self.t))
            self.engaged += 0.01 * (self.mode == "ENGAGED")
        return self

    @property
    def alarms(self) -> list[tuple[float, str]]:
        """When it let go without a reason, and what it said."""
        return [(t, cause) for t, mode, cause in self.modes if mode in ("FAULT", "OVERRIDE")]


# ---- all of it ------------------------------------------------------------------------------------------------------


def _driven(job: tuple[float, int, float]) -> str:
    speed, seed, seconds = job
    drive = busy_drive(*job)
    end = f"let go after {drive.ended() - drive.onset:.1f} s: {drive.cause()}" if math.isfinite(drive.ended()) else ""
    return f"| {speed:g} m/s, seed {seed}, busy computer | {seconds:g} s | {end or 'no alarm'} |"


def _played(job: tuple[str, int]) -> str:
    name, seed = job
    played = Playback(name, seed).run()
    said = "; ".join(f"{t:.1f} s: {cause}" for t, cause in played.alarms) or "no alarm"
    return f"| the lap {name}, seed {seed} | {played.engaged:.0f} s | {said} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--jobs", type=int, default=2, help="processes at once")
    parser.add_argument("--minutes", type=float, default=60.0, help="of simulated driving, nine drives in all")
    parser.add_argument("--seeds", type=int, default=5, help="how often each lap is played back")
    options = parser.parse_args()
    seconds = 60.0 * options.minutes / 9.0
    drives = [(speed, seed, seconds) for seed in range(3) for speed in (2.0, 5.0, 7.0)]
    laps = [(name, seed) for name in LAPS for seed in range(options.seeds)]
    print("| drive | engaged | ended |\n|---|---|---|")
    with ProcessPoolExecutor(options.jobs) as pool:
        for text in [*pool.map(_driven, drives), *pool.map(_played, laps)]:
            print(text, flush=True)


if __name__ == "__main__":
    main()
