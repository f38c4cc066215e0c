"""Dynamic output elements (DOE), which turn a few coarse actions into smooth steering (Riedmiller et al. 2007).

A DOE has a state, and that state has to be an input of the policy, or the process is not Markov:
every DOE shows it as `state`. At a hand-over it must continue from the angle really steered, its input
`applied`; then the first step after any hand-over is one DOE step and no jump.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

from steerkit._support.errors import number
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, In, Out, State, Wrapper, set_ports
from steerkit.task import STOP


class HeldAngle(NamedTuple):
    """State of a DOE: the steering-wheel angle of the sample before [rad]."""

    delta_sw: Any


@dataclass(frozen=True, eq=False, kw_only=True)
class OutputElement(Block):
    """Ports and state that all dynamic output elements share; abstract.

    Inputs: action [rad]; applied [rad], the angle commanded in the end (after supervisor and limits).
    Outputs: delta_sw [rad]; state [rad], the angle of the sample before, which an `action` cannot yet change.
    """

    action = In("rad")
    applied = In("rad", direct=False)
    delta_sw = Out("rad")
    state = Out("rad", direct=())

    limit: m.Scalar = number(STOP, "rad", above=0.0, high=20.0)
    """Largest |delta_sw| [rad]; like `tau`, one number or an `(N,)` array for a batch."""

    def init(self, batch: tuple[int, ...] = ()) -> HeldAngle:
        return HeldAngle(m.filled(0.0, batch))

    def update(self, t: Any, x: HeldAngle, u: Any, y: Any) -> HeldAngle:
        return HeldAngle(m.clip(u.applied, -self.limit, self.limit))

    def action_for(self, delta_sw: m.Scalar, state: m.Scalar) -> m.Scalar:
        """The action [rad] that would have made this angle [rad] of that state: what was done where another changed it.

        Raises NotImplementedError for an element of your own that does not say.
        """
        raise NotImplementedError(f"{type(self).__name__}.action_for is not defined: which action makes an angle?")


@dataclass(frozen=True, eq=False, kw_only=True)
class Integrator(OutputElement):
    """The integrating DOE: each action is a step of the steering wheel.

    delta_sw(t) = sat(applied(t - dt) + action(t)),  sat to +-limit.

    Inputs, outputs, state: see `OutputElement`. A NaN action gives a NaN angle (never a silent zero). Raises ValueError
    for dt or limit out of range. Source: Riedmiller, Montemerlo, Dahlkamp 2007, section on the dynamic output
    element (there: delta(t) = delta(t-1) + action).
    """

    def output(self, t: Any, x: HeldAngle, u: Any) -> Any:
        return self.Y(m.clip(x.delta_sw + u.action, -self.limit, self.limit), x.delta_sw)

    def action_for(self, delta_sw: m.Scalar, state: m.Scalar) -> m.Scalar:
        return delta_sw - state


@dataclass(frozen=True, eq=False, kw_only=True)
class LowPass(OutputElement):
    """The low-pass DOE: each action is an angle that the steering wheel approaches exponentially.

    delta_sw(t) = sat(applied(t - dt) + (1 - exp(-dt/tau)) * (action(t) - applied(t - dt))),  tau > 0 [s].

    The exact discretisation of tau*delta' = action - delta under an action held for dt. Inputs, outputs, state: see
    `OutputElement`. Raises ValueError for dt, limit or tau out of range. Source: Riedmiller et al. 2007 (low-pass DOE).
    """

    tau: m.Scalar = number(0.3, "s", above=0.0)
    """Time constant [s]."""

    def output(self, t: Any, x: HeldAngle, u: Any) -> Any:
        angle = x.delta_sw + self._gain * (u.action - x.delta_sw)
        return self.Y(m.clip(angle, -self.limit, self.limit), x.delta_sw)

    @property
    def _gain(self) -> m.Scalar:
        return 1.0 - m.exp(-self.dt / self.tau)

    def action_for(self, delta_sw: m.Scalar, state: m.Scalar) -> m.Scalar:
        return state + (delta_sw - state) / self._gain


@dataclass(frozen=True, eq=False, kw_only=True)
class PlainAngle(OutputElement):
    """No dynamics: the action is the angle, delta_sw(t) = sat(action(t)); the paper's bang-bang controller.

    Inputs, outputs, state: see `OutputElement`; the state still says which angle was steered last.
    """

    def output(self, t: Any, x: HeldAngle, u: Any) -> Any:
        return self.Y(m.clip(u.action, -self.limit, self.limit), x.delta_sw)

    def action_for(self, delta_sw: m.Scalar, state: m.Scalar) -> m.Scalar:
        return delta_sw


@dataclass(frozen=True, eq=False, kw_only=True)
class Corrected(Block):
    """A DOE on a car that reports the applied command: it continues from that angle, not from its own request.

    Behind a gate a DOE that remembers its own request winds up, and its `state` is no longer the car's. `element`'s
    equation holds, with applied(t - dt) as reported at t.

    Inputs: action [rad]; applied [rad], direct: the angle commanded last, as the car reports it at this sample.
    Outputs: delta_sw [rad]; state [rad], the reported angle within `element.limit`. No state.
    A NaN passes through. Sample time: that of `element`.
    """

    action = In("rad")
    applied = In("rad")
    delta_sw = Out("rad")
    state = Out("rad", direct=(applied,))

    element: OutputElement = Integrator()

    def __post_init__(self) -> None:
        object.__setattr__(self, "dt", self.element.dt)

    def output(self, t: Any, x: Any, u: Any) -> Any:
        held = HeldAngle(m.clip(u.applied, -self.element.limit, self.element.limit))
        return self.Y(*self.element.output(t, held, self.element.D(u.action)))


@dataclass(frozen=True, eq=False, kw_only=True)
class WithElement(Wrapper):
    """A policy and its dynamic output element as one controller that steers by itself.

        action = policy(inputs, doe = delta_sw(t - dt)),   delta_sw(t) = element(action, delta_sw(t - dt))

    Inputs: those of the policy but `doe`; delta_sw_meas [rad], the measured angle, from which it sets out. Output:
    delta_sw [rad]. State: the policy's and the angle of the sample before. Nobody else may steer in between: a loop
    with a recovery controller wants policy and element apart (`steering_loop`). A NaN passes through.
    Raises ValueError for a policy without the output action.
    """

    changes = ("action",)
    delta_sw_meas = In("rad")
    delta_sw = Out("rad")

    element: OutputElement = Integrator()
    """What turns its actions into an angle; `block` is the policy."""

    def __post_init__(self) -> None:
        super().__post_init__()
        own = type(self)
        inputs = [port for port in self.block.inputs if port.name not in ("doe", "delta_sw_meas")]
        set_ports(self, (*inputs, *own.inputs), own.outputs)

    def init(self, batch: tuple[int, ...] = ()) -> State:
        return (*self.block.init(batch), *self.element.init(batch))

    def settle(self, t: float, x: State, u: Any) -> State:
        begin = self.element.init()._replace(delta_sw=m.clip(u.delta_sw_meas, -self.element.limit, self.element.limit))
        return (*self.block.settle(t, self.inner(x), self._shown(self.block.D, u, begin)), *begin)

    def _shown(self, kind: Any, u: Any, held: HeldAngle) -> Any:
        """What the policy sees of the inputs."""
        return kind(**{name: held.delta_sw if name == "doe" else getattr(u, name) for name in kind._fields})

    def _answer(self, t: Any, x: State, u: Any) -> Any:
        return self.block.output(t, self.inner(x), self._shown(self.block.D, u, HeldAngle(*self.own(x))))

    def output(self, t: Any, x: State, u: Any) -> Any:
        made = self.element.output(t, HeldAngle(*self.own(x)), self.element.D(self._answer(t, x, u).action))
        return self.Y(made.delta_sw)

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        held, answer = HeldAngle(*self.own(x)), self._answer(t, x, u)
        inner = self.block.update(t, self.inner(x), self._shown(self.block.U, u, held), answer)
        applied = self.element.U(action=answer.action, applied=y.delta_sw)
        return (*inner, *self.element.update(t, held, applied, y))
