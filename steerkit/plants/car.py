"""The ports that every car has, simulated or real."""

from __future__ import annotations

from dataclasses import dataclass

from steerkit.diagram.block import Block, In, Out


@dataclass(frozen=True, eq=False, kw_only=True)
class Car(Block):
    """A car, driven by steering-wheel angle and speed; abstract.

    inputs: delta_sw_cmd [rad], the angle at the steering wheel; v_cmd [m/s], the speed that the human keeps. Both act
    from their sample to the next. outputs, of state only: x, y [m] of the centre of gravity; psi [rad], any turn;
    v [m/s], its speed; beta [rad]; r [rad/s]; a_y [m/s^2]; delta_sw [rad].
    """

    delta_sw_cmd = In("rad", direct=False)
    v_cmd = In("m/s", direct=False)
    x = Out("m", direct=())
    y = Out("m", direct=())
    psi = Out("rad", direct=())
    v = Out("m/s", direct=())
    beta = Out("rad", direct=())
    r = Out("rad/s", direct=())
    a_y = Out("m/s^2", direct=())
    delta_sw = Out("rad", direct=())
