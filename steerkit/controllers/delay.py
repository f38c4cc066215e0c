"""A Smith predictor for controllers of a steering with dead time and lag, and Stanley with gains for it."""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

from steerkit._support.errors import number, require
from steerkit.controllers.stanley import Stanley
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, In, Out, State, entries_of
from steerkit.diagram.maths import Scalar
from steerkit.task import DT
from steerkit.vehicles import Vehicle
from steerkit.vehicles.rollout import Motion, Rollout

_TRUST = 0.1
"""Share of a sample in how far a slow wheel is taken to be off its model: half a second."""


_SHARE_OF_TORQUE = 0.3
"""Of a car steered by torque (`Stanley.share`): with all of it sensor noise, or a gain 25 % off, makes it swing."""


@dataclass(frozen=True, eq=False, kw_only=True)
class DelayPredictor(Block):
    """Wraps a controller so that it sees e, psi_e, r and the wheel as they will be when its command has arrived.

    A Smith predictor: the state is rolled out under the commands on their way by `model` (see `Rollout`); the last of
    them is held after the delay. What the model has wrong now (ratio, tyres, offset) it is taken to have wrong all the
    way: the yaw rate is the model's and wrong = r - r_m, r_m being what the model makes of the measured wheel.

    To a controller without a model the car then looks as if it had neither delay nor lag, and damping that fought these
    is no longer wanted: see `delayed_stanley`. For a linear law this is what delay states give an LQR.

    Inputs: e [m], psi_e [rad] and preview [1/m] at the model's `reference`; v [m/s]; r [rad/s]; delta_sw_meas [rad].
    Output: delta_sw [rad]. State: that of the wrapped block; r_m (with a slew: of the sample before, then the wheel of
    that sample, the model's own wheel and by how much that is off, averaged over half a second: commands are taken to
    be off by that); then the commands on their way, oldest first; for one that is not finite, which never left, the
    wheel's angle is taken. A negative v counts as 0. NaN in an input that the wrapped block or the prediction needs
    gives NaN out. A command that is replaced on its way to the wheel (by another controller in charge, a limiter) is
    not known here: for `delay` after a hand-over the prediction is wrong by the difference. Raises ValueError for a
    wrapped block with other ports or sample time, and for a preview_points below 1.

    Source: Smith 1957 (predictor).
    """

    e = In("m")
    psi_e = In("rad")
    preview = In("1/m", size="preview_points")
    v = In("m/s")
    r = In("rad/s")
    delta_sw_meas = In("rad")
    delta_sw = Out("rad")

    block: Block
    """The controller: any with inputs among e, psi_e, kappa, v, r, delta_sw_meas and an output delta_sw."""
    model: Rollout = field(default_factory=Rollout)
    """The car and its steering as they are believed: delay, lag, geometry, tyres."""
    preview_points: int = number(1, "1", low=1)
    """Entries of the preview; model.lookahead/dt + 2 or more see the whole way."""

    def __post_init__(self) -> None:
        super().__post_init__()
        where, have = "DelayPredictor", {p.name for p in self.inputs} - {"preview"} | {"kappa"}
        missing = {p.name for p in self.block.inputs} - have
        needs = f"{type(self.block).__name__} needs {', '.join(sorted(missing))}"
        require(not missing, where, f"{needs}; predicted are {', '.join(sorted(have))}")
        gives = [p.name for p in self.block.outputs]
        require(gives == ["delta_sw"], where, f"block with outputs {gives}, expected delta_sw only")
        for of, dt in (
            ("the wrapped block", self.block.dt),
            ("the model", self.model.dt),
            ("its preview", self.model.preview_dt),
        ):
            require(self.dt == dt, where, f"dt = {self.dt} s, but {of} has {dt} s")

    @classmethod
    def around(cls, block: Block, vehicle: Vehicle, *, delay: float, lag: float, **steering: Any) -> "DelayPredictor":
        """`block` with a believed steering delay and lag [s], and with geometry, tyres and ratio of a `Vehicle`.

        steering: rate_limit [rad/s]; slew [m/s^3] and a_y_limit [m/s^2] of a car that is steered by torque, or None.
        """
        steering = {name: value for name, value in steering.items() if value is not None}
        where, dt = getattr(block, "reference", 0.0), block.dt
        model = Rollout.of(vehicle, delay=delay, lag=lag, reference=where, dt=dt, preview_dt=dt, **steering)
        return cls(block=block, model=model, preview_points=int(model.lookahead / dt + 1e-9) + 2, dt=dt)

    @property
    def reference(self) -> Scalar:
        """Where e, psi_e and the preview are measured: metres ahead of the centre of gravity."""
        return self.model.reference

    @property
    def rate_limit(self) -> Scalar:
        """Fastest steering wheel [rad/s]."""
        return self.model.rate_limit

    @property
    def _kept(self) -> int:
        """Numbers of the model in the state: r_m; with a slew the wheel before, its own wheel, how far that is off."""
        return 1 if self.model.slew is None else 4

    @cached_property
    def _inner(self) -> Any:
        return entries_of(self.block)

    def init(self, batch: tuple[int, ...] = ()) -> State:
        return (*self.block.init(batch), *[m.filled(0.0, batch)] * (self._kept + self.model.waiting))

    def settle(self, t: float, x: State, u: Any) -> State:
        make, n = self._inner
        wheel = (u.delta_sw_meas + 0.0,)
        slow = () if self.model.slew is None else (*wheel * 2, 0.0 * u.delta_sw_meas)
        added = (u.r + 0.0, *slow, *wheel * self.model.waiting)
        return (*self.block.settle(t, make(x[:n]), self._ahead(self.block.D, (*x[:n], *added), u)), *added)

    def output(self, t: Any, x: State, u: Any) -> Any:
        make, n = self._inner
        return self.Y(self.block.output(t, make(x[:n]), self._ahead(self.block.D, x, u)).delta_sw)

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        make, n = self._inner
        seen = self._ahead(self.block.U, x, u) if self.block.update_reads_inputs else None
        inner = self.block.update(t, make(x[:n]), seen, self.block.Y(y.delta_sw))
        sent = m.where(m.is_finite(y.delta_sw), y.delta_sw, u.delta_sw_meas)
        commands, v = (*x[n + self._kept :], sent), m.maximum(u.v, 0.0)
        if self.model.slew is None:
            model: State = (self.model.yaw_rate_after(x[n], u.delta_sw_meas, v, self.dt),)
        else:  # how far a slow wheel got within the sample is known at its end
            off = x[n + 3] + _TRUST * (u.delta_sw_meas - x[n + 2] - x[n + 3])
            own = self.model.wheel_after(x[n + 2], commands, v)
            model = (self._yaw_rate_now(x, u), u.delta_sw_meas + 0.0, own, off)
        return (*inner, *[m.where(m.is_finite(value), value, 0.0) for value in model], *commands[1:])

    def _yaw_rate_now(self, x: State, u: Any) -> Scalar:
        """r_m now; with a slew the state has that of the sample before, and the wheel of then."""
        _, n = self._inner
        if self.model.slew is None:
            return x[n]
        return self.model.yaw_rate_after(x[n], 0.5 * (x[n + 1] + u.delta_sw_meas), m.maximum(u.v, 0.0), self.dt)

    def _ahead(self, ports: Any, x: State, u: Any) -> Any:
        """The wrapped block's inputs when the next command has arrived."""
        _, n = self._inner
        commands = x[n + self._kept :]
        if self.model.slew is not None:
            commands = tuple([command + x[n + 3] for command in commands])
        values = self.predict(self._yaw_rate_now(x, u), commands, u)
        return ports(**{name: values[name] for name in ports._fields})

    def predict(self, r_model: Scalar, commands: State, u: Any) -> dict[str, Scalar]:
        """e, psi_e, kappa, v, r, delta_sw_meas when the next command has arrived; `commands` oldest first."""
        now = Motion(u.e, u.psi_e, u.r, u.delta_sw_meas)
        then, kappa = self.model.arrived(now, commands, u.preview, m.maximum(u.v, 0.0), u.r - r_model)
        return dict(e=then.e, psi_e=then.psi_e, kappa=kappa, v=u.v, r=then.r, delta_sw_meas=then.wheel)


def delayed_stanley(
    vehicle: Vehicle, *, delay: float, lag: float, dt: float = DT, **steering: float | None
) -> DelayPredictor:
    """Stanley for a steering delay and lag [s], 0 to 0.3 s and about 0.1 s: predicted, with gains tuned for that.

    The gains are the best of a grid (docs/measured.md, Stanley's gains): with the prediction, damping only costs.
    steering: as of `DelayPredictor.around`.
    """
    share = 1.0 if steering.get("slew") is None else _SHARE_OF_TORQUE
    changes: dict[str, Any] = dict(k=3.0, k_d_yaw=0.0, k_d_steer=0.0, share=share, **steering)
    law = replace(Stanley.of(vehicle, dt=dt), **changes)
    return DelayPredictor.around(law, vehicle, delay=delay, lag=lag, **steering)
