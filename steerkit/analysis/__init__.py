"""Linear analysis of loops with python-control: linearise, break open, margins; and systems to and from it::

    L = break_at(loop, "controller.delta_sw")       # a control.StateSpace; closed loop = control.feedback(L)
    print(margins(L), L.poles());  control.bode_plot(L)

A loop with several sample times is taken over its whole period, after which all blocks sample together again: one step
of the result is one period. That is exact and no approximation by the slowest block (lifting: Meyer, Burrus 1975).
"""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import control
import numpy as np

from steerkit._support.errors import require
from steerkit.analysis.systems import FromControl as FromControl
from steerkit.analysis.systems import Period, port_names, signal_name
from steerkit.analysis.systems import to_control as to_control
from steerkit.diagram.maths import Array

if TYPE_CHECKING:
    from steerkit.diagram.loop import Loop, LoopState
    from steerkit.diagram.simulation import Signal


_TINY = 1e-8  # an entry smaller than this joins nothing
_SAME = 1e-5  # largest change of the model from one period to the next that still is time-invariant


class NotTimeInvariantError(ValueError):
    """The loop's linearisation changes from one period to the next: there are no poles and margins to speak of."""


def linearise(
    loop: "Loop",
    at: "LoopState | None" = None,
    *,
    inputs: "Sequence[Signal] | None" = None,
    outputs: "Sequence[Signal] | None" = None,
    cut: "Sequence[Signal]" = (),
    invariant: bool = True,
) -> Any:
    """The loop about a run as a discrete `control.StateSpace`, one step a period of the loop.

        x(K+1) = A x(K) + B u(K),  y(K) = C x(K) + D u(K)

    in deviations from the run from `at` on (default: `loop.init()`).

    inputs: signals that u is added to, behind their block and before all their users, held over a period.
    outputs: signals, as they are at the period's start. Both default to all scalar signals. cut: those inputs at which
    the loop is opened: u takes the signal's place, with one entry for each of the block's samples in a period, as y
    has for such a signal. States that no input reaches or no output shows (the driver model's noise) are left out.

    Slopes are central differences of the loop's own step, good to about 1e-9 where it is smooth; at a limiter's kink
    they are the mean of both sides. Raises NotTimeInvariantError when the next period has other matrices (drive
    straight, at a constant speed: in a bend the pose turns with the car); `invariant=False` gives the first period's.
    ValueError for a state within a period, a vector signal, or a cut that is no input; KeyError for an unknown signal.
    """
    scalars = [name for name in loop.units if getattr(loop.blocks[name.split(".")[0]], name.split(".")[1]).size is None]
    added = scalars if inputs is None else [signal_name(loop, s) for s in inputs]
    shown = scalars if outputs is None else [signal_name(loop, s) for s in outputs]
    opened = [signal_name(loop, s) for s in cut]
    stray = [name for name in opened if name not in added]
    require(not stray, "linearise", f"cut at {', '.join(stray)}, which is not among the inputs")
    state = loop.init() if at is None else at
    period = Period(loop, {name: name in opened for name in added}, shown, state)
    closed = Period(loop, {}, opened, state)
    x, k, matrices = closed.x0, state.k, []
    for _ in range(2 if invariant else 1):
        next_x, cut_values = closed.run(x.tolist(), [], k)
        now = dict(zip(opened, cut_values))
        taps = [now.get(name, [0.0]) for name in added]
        matrices.append(period.matrices(x, taps, k))
        x, k = np.array(next_x), k + loop.period
    a, b, c, d = matrices[0]
    rows, row_names = _named(shown, period.samples, opened)
    _, column_names = _named(added, [len(values) for values in taps], opened)
    keep = _joined(a, b, c[rows])
    parts = (a[np.ix_(keep, keep)], b[keep], c[np.ix_(rows, keep)], d[rows])
    if invariant:
        a, b, c, d = matrices[1]
        then = (a[np.ix_(keep, keep)], b[keep], c[np.ix_(rows, keep)], d[rows])
        change = max((float(np.abs(p - q).max()) for p, q in zip(parts, then) if p.size), default=0.0)
        if not change <= _SAME * (1.0 + max(float(np.abs(p).max()) for p in parts if p.size)):
            raise NotTimeInvariantError(
                f"linearise: {loop!r} changes by {change:.2g} from one period to the next at tick {state.k}; start on "
                "a straight path at a constant speed and in steady motion, or take this one period with invariant=False"
            )
    labels = [period.labels[i] for i in keep]
    return control.ss(*parts, loop.dt * loop.period, inputs=column_names, outputs=row_names, states=labels)


def break_at(loop: "Loop", signal: "Signal", *, at: "LoopState | None" = None) -> Any:
    """The open loop L at a signal, as a discrete `control.StateSpace` in the negative-feedback convention.

    The wire is cut behind the signal's block; L = -(what the block gives)/(what its users get), so that the closed
    loop is `control.feedback(L)` and `margins(L)` holds. One input and output for a signal of the loop's slowest
    blocks; a faster one has as many as it has samples in a period, and no margin in the classical sense. Raises
    as `linearise` does, and ValueError when no loop runs through the signal, or a limiter holds it.
    """
    around = linearise(loop, at, inputs=[signal], outputs=[signal], cut=[signal])
    if not around.nstates and not np.any(around.D):
        name = signal_name(loop, signal)
        raise ValueError(
            f"break_at: {name} does not act back on itself here; is a limiter active, or does no one use it?"
        )
    labels = dict(inputs=around.input_labels, outputs=around.output_labels, states=around.state_labels)
    return control.ss(-around, **labels)


class Margins(NamedTuple):
    """How far a loop is from instability; infinite where nothing of that kind makes it unstable."""

    gain: float
    """Factor on the loop gain: the nearest to 1 above it [1]."""
    phase: float
    """Least phase at a gain crossing [rad]."""
    delay: float
    """Least additional delay [s]."""


def margins(system: Any) -> Margins:
    """Gain, phase and delay margins of an open loop L, a single-input, single-output `control` system.

    Over 0 < w < pi/dt (or, continuous, 1e-4 to 1e4 rad/s): phase margin = |pi + arg L| where |L| = 1; delay margin =
    ((pi + arg L) mod 2 pi)/w there; gain margin = 1/|L| > 1 where L is real and negative. Crossings are found on a
    logarithmic grid and refined. Raises ValueError for an unstable closed loop, which has no margins, and for a
    system with several inputs or outputs. Source: Astrom, Murray 2021, section 10.3.
    """
    if system.ninputs != 1 or system.noutputs != 1:
        raise ValueError(
            f"margins: a system with {system.ninputs} inputs and {system.noutputs} outputs, expected 1 and 1; break "
            "the loop at a signal of its slowest blocks"
        )
    discrete = system.isdtime(strict=True)
    closed = control.feedback(system).poles()
    beyond = np.abs(closed) - 1.0 if discrete else np.real(closed)
    if (beyond > 1e-7).any():
        raise ValueError(f"margins: the closed loop is unstable (poles {closed[beyond > 1e-7]}), so it has none")
    top = math.pi / system.dt if discrete else 1e4
    grid = np.geomspace(1e-4 * (top if discrete else 1.0), top * (1.0 - 1e-9), 4000)
    answers = control.frd(system(np.exp(1j * grid * system.dt) if discrete else 1j * grid), grid, smooth=True)
    factors, degrees, _, _, crossings, _ = control.stability_margins(answers, returnall=True)
    if discrete and (last := float(np.real(system(-1.0)))) < 0.0:  # L is real at half the sampling rate
        factors = np.append(factors, -1.0 / last)
    phases = np.radians(degrees)
    each = factors[factors > 1.0], np.abs(phases), phases % (2.0 * math.pi) / crossings
    return Margins(*[float(found.min(initial=math.inf)) for found in each])


def _named(signals: Sequence[str], samples: Sequence[int], opened: Sequence[str]) -> tuple[list[int], list[str]]:
    """Which entries are shown of signals with so many samples each, and their names."""
    numbers, names, start = list[int](), list[str](), 0
    for signal, name, count in zip(signals, port_names(signals), samples):
        shown = count if signal in opened else 1
        numbers += range(start, start + shown)
        names += [name] if shown == 1 else [f"{name}_{i}" for i in range(shown)]
        start += count
    return numbers, names


def _joined(a: Array, b: Array, c: Array) -> list[int]:
    """The states that an input reaches and that an output shows."""
    linked = np.eye(len(a), dtype=bool) | (np.abs(a) > _TINY)
    ways = np.linalg.matrix_power(linked, max(len(a), 1))  # from each state to each, within as many steps as there are
    reached = ways @ (np.abs(b) > _TINY).any(axis=1)
    seen = (np.abs(c) > _TINY).any(axis=0) @ ways
    return [int(i) for i in np.flatnonzero(reached & seen)]
