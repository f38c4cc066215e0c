"""Drawn drives and what the estimators make of them: open loop, judged by the truth of the simulation."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steerkit.compiled import Backend, compile
from steerkit.diagram.block import Block
from steerkit.diagram.units import radians_of
from steerkit.estimators.single_track_filter import SingleTrackFilter
from steerkit.estimators.steering_delay import WheelDelay, YawDelay
from steerkit.estimators.steering_wear import SteeringFriction, SteeringPlay
from steerkit.scenario import Scenario, fleet_scenario
from steerkit.scenario.drive import assembled, controller
from steerkit.task import DT
from steerkit.vehicles import Vehicle

Array = NDArray[np.float64]

HELD = 0.0075
"""Actuator and car of 10 ms hold their inputs: what follows is that much later than their parameters say [s]."""
_SHOWN = radians_of(3.0)
_AGE, _AGE_DEVIATION = 0.05, 0.01
"""What is told of how old v and r are, and how sure that is [s]."""
_SIGNALS = {
    "delta_sw_cmd": "controller.delta_sw",
    "delta_sw_meas": "column.delta_sw_meas",
    "v": "sensors.v",
    "r": "sensors.r",
    "psi": "sensors.psi",
}


@dataclass(frozen=True, kw_only=True)
class Drive:
    """A drive by somebody who was told all, of a car of whose data sheet little is true."""

    scenario: Scenario
    signals: dict[str, Array]
    """What is measured, 20 samples a second; active is 0 in 40 % of the time."""
    truth: dict[str, float]
    """Of every quantity that an estimator has."""


def drawn(number: int, seconds: float, backend: Backend = "auto") -> Drive:
    """A production car on a course of its own at 5 to 9 m/s, under `hard` sensors.

    Beside what `fleet_scenario` draws (delay, lag, offset within 3 degrees, play up to 2): ratio and tyres 20 % less to
    25 % more than the data sheet has, friction of 0.3 to 1 degree, a gyro whose zero is off by up to 0.005 rad/s, and a
    measured wheel that shows up to 3 degrees too little or too much.
    """
    rng = np.random.default_rng(number)
    ratio, tyres, friction, zero = rng.uniform([0.8, 0.8, 0.3, -0.005], [1.25, 1.25, 1.0, 0.005])
    shown = float(np.random.default_rng((number, 1)).uniform(-_SHOWN, _SHOWN))
    scenario = fleet_scenario(number, v_min=5.0, v_max=9.0, ratio=ratio, tyres=tyres, friction_deg=friction)
    loop = assembled(scenario, controller("stanley-delay", scenario), seed=number)
    log = compile(loop, backend=backend, record=list(_SIGNALS.values()), every=round(DT / loop.dt)).run(seconds)
    signals = {name: np.array(log[signal]) for name, signal in _SIGNALS.items()}
    signals["r"] = signals["r"] + zero
    signals["delta_sw_meas"] = radians_of(0.1) * np.round((signals["delta_sw_meas"] + shown) / radians_of(0.1))
    signals["active"] = active(len(log.t), rng)
    sum_of_both, car = scenario.delay + scenario.lag, scenario.true_vehicle
    truth = {
        "wheel.delay_lag": sum_of_both,
        "wheel.delay": scenario.delay,
        "wheel.lag": scenario.lag,
        "yaw.delay_lag": sum_of_both + scenario.latency + HELD,
        "yaw.delay": scenario.delay + scenario.latency + HELD,
        "yaw.lag": scenario.lag,
        "filter.ratio": ratio,
        "filter.offset": radians_of(scenario.offset_deg),
        "filter.rate_zero": zero,
        "filter.understeer": car.understeer_gradient,
        "measured.ratio": ratio,
        "measured.offset": -shown,
        "measured.rate_zero": zero,
        "friction.friction": radians_of(friction),
        "play.play": radians_of(scenario.play_deg),
    }
    return Drive(scenario=scenario, signals=signals, truth={name: float(value) for name, value in truth.items()})


def active(n: int, rng: np.random.Generator, share: float = 0.6, stretch: float = 6.0) -> Array:
    """1 in that share of n samples, in stretches of some seconds, else 0: a driver who overrides now and then."""
    flags = np.zeros(n)
    k, on = 0, bool(rng.random() < share)
    while k < n:
        length = 1 + int(rng.exponential(stretch if on else stretch * (1.0 - share) / share) / DT)
        flags[k : k + length] = on
        k, on = k + length, not on
    return flags


def all_cars(vehicles: list[Vehicle]) -> Vehicle:
    """The cars as one, each number an array, for a batch."""
    names = [field.name for field in fields(Vehicle) if field.name not in ("name", "delta_sw_max")]
    numbers: dict[str, Any] = {name: np.array([getattr(v, name) for v in vehicles]) for name in names}
    return replace(vehicles[0], name="all", **numbers)


def estimators(vehicle: Vehicle) -> dict[str, Block]:
    """All estimators, by the names that results have them under."""
    return {
        "wheel": WheelDelay(),
        "yaw": YawDelay(vehicle=vehicle),
        "filter": SingleTrackFilter(vehicle=vehicle),
        "measured": SingleTrackFilter(vehicle=vehicle, held=False),
        "friction": SteeringFriction(),
        "play": SteeringPlay(vehicle=vehicle),
    }


def fed(name: str, u: Mapping[str, Any], y: Mapping[str, Any]) -> dict[str, Any]:
    """The inputs of one estimator: from what is measured (u), and from the outputs of those before it (y).

    Offsets and wear are looked for at all times; only who looks for the delay has to look away when overridden. By the
    measured wheel "measured" finds its offset and the ratio, and "play" the play; both are told the age of v and r.
    """
    if name in ("wheel", "yaw"):
        return dict(u)
    always = {**u, "active": 1.0 + 0.0 * u["v"]}
    if name in ("play", "measured"):  # behind a measured wheel there is the age of what is seen, and no lag
        none = 0.0 * u["v"]
        way = {"delay": _AGE + none, "lag": none, "lag_deviation": none, "delay_deviation": _AGE_DEVIATION + none}
        return always | {"angle": u["delta_sw_meas"], "delta_sw": u["delta_sw_meas"]} | way
    source = y["wheel"] if name == "friction" else y["yaw"]
    way = {"delay": source.delay, "lag": source.lag, "lag_deviation": source.lag_deviation}
    command = {"angle": u["delta_sw_cmd"], "delta_sw": u["delta_sw_cmd"]}
    return always | command | way | {"delay_deviation": source.delay_lag_deviation}


def estimated(drives: list[Drive], at: list[float], say: Callable[[str], None]) -> dict[float, dict[str, Any]]:
    """The outputs of all estimators at these times [s], each an array over the drives; all drives run as one batch."""
    blocks = estimators(all_cars([drive.scenario.nominal for drive in drives]))
    signals = {name: np.array([drive.signals[name] for drive in drives]).T.copy() for name in drives[0].signals}
    batch = (len(drives),)
    x: dict[str, Any] = {name: block.init(batch) for name, block in blocks.items()}
    found: dict[float, dict[str, Any]] = {}
    ticks = {round(t / DT): t for t in at}
    for k in range(max(ticks) + 1):
        y = {name: block.output(k * DT, x[name], ()) for name, block in blocks.items()}
        if k in ticks:
            found[ticks[k]] = y
            say(f"{ticks[k]:g} s")
        if k == max(ticks):
            return found
        u = {name: values[k] for name, values in signals.items()}
        for name, block in blocks.items():
            given = fed(name, u, y)
            x[name] = block.update(k * DT, x[name], block.U(*[given[p.name] for p in block.inputs]), y[name])
    return found
