"""A drive as wires and sensors tell it, by the names of ports: what golden numbers of blocks are taken over."""

import numpy as np

from steerkit.diagram.block import Block
from tests.support.steered_car import PASSAT, Signals, steered

OTHERS = {"m": 0.9, "rad": 0.4, "m/s": 0.7, "rad/s": 0.1, "1/m": 0.03, "1": 1.0}
"""Amplitudes of what ports of other names hear."""


def road(broken: bool) -> Signals:
    """75 s, 20 samples a second, of equations of their own: to and fro, ever faster, a stop, and on.

    The car answers 0.1 s late, with a lag of 0.15 s, and with another ratio, understeer gradient and offset than its
    data sheet's; the gyro's zero is off. broken: with gaps, nonsense and jumps, too.
    """
    rng, t = np.random.default_rng(0), 0.05 * np.arange(1500)
    ones, v = np.ones(len(t)), np.interp(t, (0, 30, 40, 43, 47, 55, 75), (4.0, 22.0, 14.0, 0.0, 0.0, 8.3, 12.0))
    command, wheel = 2.0 * steered(75.0) / np.sqrt(1.0 + (v / 8.0) ** 2), np.zeros(len(t))
    for k in range(3, len(t)):
        wheel[k] = wheel[k - 1] + (1.0 - np.exp(-1.0 / 3.0)) * (command[k - 3] - wheel[k - 1])
    length = PASSAT.wheelbase + (PASSAT.understeer_gradient - 0.001) * v**2
    r = v * (wheel + 0.04) / (1.15 * PASSAT.steer_ratio * length)
    psi, beta = np.cumsum(0.05 * r), (1.2 - 0.004 * v**2) * r / np.maximum(v, 1.0)
    told = {"x": np.cumsum(0.05 * v * np.cos(psi + beta)), "y": np.cumsum(0.05 * v * np.sin(psi + beta))}
    told |= {"psi": psi, "v": v, "r": r + 0.004, "delta_sw_meas": wheel + 0.003 * np.sign(np.gradient(wheel))}
    told = {name: values + 0.003 * rng.standard_normal(len(t)) for name, values in told.items()}
    told |= {"beta": beta, "v_cmd": v, "s": np.cumsum(0.05 * v), "active": ones}
    told |= {"age": 0.07 + 0.03 * np.sin(t), "motion_age": 0.02 + 0.02 * np.sin(1.7 * t)}
    told |= {"delta_sw_cmd": command, "delta_sw": command, "angle": command}
    told |= {"delay": 0.11 * ones, "lag": 0.155 * ones, "delay_deviation": 0.02 * ones, "lag_deviation": 0.03 * ones}
    if broken:
        told["x"][600:605] += 0.7
        told["y"][1150:] += 0.4
        told["active"][700:760] = 0.0
        for i, name in enumerate(
            ("x", "psi", "v", "r", "delta_sw_meas", "delta_sw_cmd", "delta_sw", "angle", "delay", "lag")
        ):
            told[name][200 + 60 * i :: 450] = 3.3
            told[name][230 + 60 * i : 240 + 70 * i] = np.nan
    return told


def heard(block: Block, broken: bool) -> list[dict[str, float | tuple[float, ...]]]:
    """Inputs of a block, sample by sample, over that drive; other ports than the drive's hear waves."""
    told, rows = road(broken), dict[str, list[float | tuple[float, ...]]]()
    for i, port in enumerate(block.inputs):
        waves = OTHERS.get(port.unit, 0.0) * np.sin((0.17 + 0.07 * i) * 0.05 * np.arange(1500) + i)
        values = told.get(port.name.removesuffix("_in"), waves).tolist()
        size = getattr(block, port.name).size
        rows[port.name] = values if size is None else [(value,) * size for value in values]
    return [dict(zip(rows, row)) for row in zip(*rows.values())] or [{}] * 1500
