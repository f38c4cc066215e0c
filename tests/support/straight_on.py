"""A car driven with the wheel held."""

from steerkit.diagram.block import Block


def straight_on(car: Block, seconds: float, delta_sw: float = 0.0, v: float = 7.0) -> tuple[list, list]:
    x, outputs = car.init(), []
    for k in range(round(seconds / car.dt)):
        outputs.append(car.output(k * car.dt, x, ()))
        x = car.update(k * car.dt, x, car.U(delta_sw, v), outputs[-1])
    return list(x), outputs
