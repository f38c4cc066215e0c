"""A learned policy in compiled loops, to the last bit as it is interpreted, and open to every net of its kind."""

from __future__ import annotations

import ctypes
import functools
import platform
from dataclasses import dataclass
from typing import Any

import numpy as np

from steerkit._support import native
from steerkit._support.errors import require
from steerkit.controllers.delay_compensator import DelayCompensator
from steerkit.controllers.nfq_policy import NfqPolicy, without_preview
from steerkit.controllers.policy import COLUMNS, Policy
from steerkit.diagram import maths as m
from steerkit.diagram.block import In, State

_SIZE = ctypes.c_ssize_t  # NumPy's npy_intp
_AT = ctypes.c_void_p
_COMBINE = {"mean": 0, "max": 1, "disagreement": 2}
_TRIES = 8
"""States on which every new net is asked both ways."""

_SOURCE = """\
#include <fenv.h>
#include <math.h>
#include <stddef.h>
#include <string.h>
typedef void (*inner)(char **, const ptrdiff_t *, const ptrdiff_t *, void *);
typedef struct {
  inner matmul, tanh_of;
  void *matmul_data, *tanh_data;
  const double *of_state, *of_action;  /* [hidden][states], [hidden][actions] */
  const double *const *w, *const *d;   /* of each layer: [rows][columns], [rows] */
  const ptrdiff_t *rows, *columns;
  double *h, *z;                       /* [largest][actions] */
  ptrdiff_t states, hidden, actions, layers, nets, combine;
} ensemble;
/* c = a b, as numpy.matmul finds it */
static void product(const ensemble *e, const double *a, const double *b, double *c, ptrdiff_t n, ptrdiff_t k,
                    ptrdiff_t m)
{
  char *args[] = { (char *)a, (char *)b, (char *)c };
  const ptrdiff_t d = sizeof(double), sizes[] = { 1, n, k, m }, steps[] = { 0, 0, 0, k * d, d, m * d, d, m * d, d };
  e->matmul(args, sizes, steps, e->matmul_data);
}
static void squashed(const ensemble *e, double *from, double *to, ptrdiff_t n)
{
  char *args[] = { (char *)from, (char *)to };
  const ptrdiff_t steps[] = { sizeof(double), sizeof(double) };
  e->tanh_of(args, &n, steps, e->tanh_data);
}
/* q of every action for one state, step by step as NfqPolicy._values, by NumPy's own loops */
void values(void *self, const double *in, double *q)
{
  const ensemble *e = self;
  const int raised = fetestexcept(FE_ALL_EXCEPT);
  const ptrdiff_t A = e->actions;
  double *h = e->h, *z = e->z;
  product(e, e->of_state, in, h, e->hidden, e->states, 1);
  for (ptrdiff_t i = 0; i < e->hidden; i++)
    for (ptrdiff_t a = 0; a < A; a++) z[i * A + a] = h[i] + e->of_action[i * A + a];
  squashed(e, z, h, e->hidden * A);
  for (ptrdiff_t l = 0; l < e->layers; l++) {
    const ptrdiff_t rows = e->rows[l];
    product(e, e->w[l], h, z, rows, e->columns[l], A);
    for (ptrdiff_t i = 0; i < rows; i++)
      for (ptrdiff_t a = 0; a < A; a++) z[i * A + a] += e->d[l][i];
    squashed(e, z, h, rows * A);
  }
  for (ptrdiff_t a = 0; a < A; a++) {
    double total = h[a];
    for (ptrdiff_t n = 1; n < e->nets; n++) {
      const double value = h[n * A + a];
      if (e->combine != 1) total += value;
      else if (!(total >= value) && total == total) total = value;
    }
    if (e->combine != 1) total /= (double)e->nets;
    if (e->combine == 2) {
      double spread = 0.0;
      for (ptrdiff_t n = 0; n < e->nets; n++) {
        const double gap = h[n * A + a] - total;
        spread = n ? spread + gap * gap : gap * gap;
      }
      total += sqrt(spread / (double)e->nets);
    }
    q[a] = 0.5 + 0.5 * total;
  }
  feclearexcept(FE_ALL_EXCEPT & ~raised);  /* what rounding or a vector's idle lanes raised is nobody's fault */
}
"""


class _UFunc(ctypes.Structure):
    """The head of NumPy's public C structure PyUFuncObject, as in numpy/ufuncobject.h since NumPy 1.7."""

    _fields_ = [
        ("head", ctypes.c_char * object.__basicsize__),
        ("nin", ctypes.c_int),
        ("nout", ctypes.c_int),
        ("nargs", ctypes.c_int),
        ("identity", ctypes.c_int),
        ("functions", ctypes.POINTER(_AT)),
        ("data", ctypes.POINTER(_AT)),
        ("ntypes", ctypes.c_int),
        ("reserved", ctypes.c_int),
        ("name", ctypes.c_char_p),
    ]


class _Ensemble(ctypes.Structure):
    """The struct `ensemble` of the C above."""

    _fields_ = [
        *((name, _AT) for name in ("matmul", "tanh_of", "matmul_data", "tanh_data", "of_state", "of_action", "w", "d")),
        *((name, _AT) for name in ("rows", "columns", "h", "z")),
        *((name, _SIZE) for name in ("states", "hidden", "actions", "layers", "nets", "combine")),
    ]


class NotTheSameError(RuntimeError):
    """On this machine a net in C would not give, bit for bit, what it gives interpreted; the message says why."""


def _loop_of(function: np.ufunc) -> tuple[int, int]:
    """The addresses of NumPy's own loop over doubles, and of its data."""
    if platform.python_implementation() != "CPython":
        raise NotTheSameError(f"NumPy's loops are found in CPython only, this is {platform.python_implementation()}")
    kinds = "d" * function.nin + "->" + "d" * function.nout
    inside = _UFunc.from_address(id(function))
    known = (inside.nin, inside.nout, inside.ntypes) == (function.nin, function.nout, function.ntypes)
    if not known or inside.name != function.__name__.encode() or kinds not in function.types:
        raise NotTheSameError(f"NumPy {np.__version__} keeps the loops of {function.__name__} elsewhere")
    place = function.types.index(kinds)
    return inside.functions[place] or 0, (inside.data[place] or 0) if inside.data else 0


@functools.cache
def _library() -> ctypes.CDLL:
    return native.load(_SOURCE)


class NativeNets:
    """The nets of a policy for C: the address of a function, and of what it is to be called with.

    The function takes the six inputs that the nets see and gives the value of each action, in the order of the
    policy's search; it calls NumPy's own loops for products and tanh, in the order in which `NfqPolicy` does, hence
    the same bits. That is tried on some states when it is made. Raises NotTheSameError where it fails, and
    NoCompilerError without a C compiler.
    """

    def __init__(self, policy: NfqPolicy):
        of_state, of_action, layers = policy._folded
        self.actions = of_action.shape[1]
        kept = [np.ascontiguousarray(of_state), np.ascontiguousarray(of_action)]
        ws, ds = ([np.ascontiguousarray(layer[i]) for layer in layers] for i in (0, 1))
        largest = max(map(len, (of_state, *ws))) * self.actions
        sizes = [np.array([w.shape[i] for w in ws], dtype=np.intp) for i in (0, 1)]
        places = [np.array([a.ctypes.data for a in arrays], dtype=np.uintp) for arrays in (ws, ds)]
        room = [np.zeros(largest), np.zeros(largest)]
        self._arrays = [*kept, *ws, *ds, *sizes, *places, *room]  # kept, as C is given their addresses
        matmul, tanh = _loop_of(np.matmul), _loop_of(np.tanh)
        self._self = _Ensemble(
            *(matmul[0], tanh[0], matmul[1], tanh[1]),
            *[a.ctypes.data for a in (*kept, *places, *sizes, *room)],
            *(of_state.shape[1], len(of_state), self.actions, len(layers), len(policy.nets or ())),
            _COMBINE[policy.combine],
        )
        self.addresses = ctypes.cast(_library().values, _AT).value or 0, ctypes.addressof(self._self)
        if not self._agrees(policy):
            raise NotTheSameError("NumPy's products or tanh differ from those of its own loops called alone")

    def __call__(self, *state: float) -> tuple[float, ...]:
        """The value of each action for one state."""
        given, told = np.array(state), np.empty(self.actions)
        _library().values(_AT(self.addresses[1]), _AT(given.ctypes.data), _AT(told.ctypes.data))
        return tuple(told.tolist())

    def _agrees(self, policy: NfqPolicy) -> bool:
        about = policy.description
        states = about.mid + about.half * np.random.default_rng(1).uniform(-1.5, 1.5, (_TRIES, len(COLUMNS)))
        interpreted = [policy._values(np.array(state)[:, None]).tobytes() for state in states.tolist()]
        return interpreted == [np.array(self(*state)).tobytes() for state in states.tolist()]


@dataclass(frozen=True, eq=False, kw_only=True)
class OpenPolicy(Policy):
    """Stands for an `NfqPolicy` in a loop that is traced: its nets are a `Routine`, all its other numbers are open.

    So one compiled program serves every net of the same actions, description and reading, whatever its layout and
    dead time. Equations, ports and state are those of `NfqPolicy`. Source: see there.
    """

    preview = In("1/m", size="preview_points")

    policy: NfqPolicy
    """Of which kind."""
    routine: m.Routine
    """Six inputs to the values of the actions, in the order of the policy's search."""
    numbers: tuple[Any, ...] = ()
    """See `numbers_of`."""

    def __post_init__(self) -> None:
        same = self.policy.dt == self.dt
        require(same, "OpenPolicy", f"dt = {self.dt} s, the policy's is {self.policy.dt} s, expected the same")
        if not self.preview_points:
            without_preview(self)

    @property
    def preview_points(self) -> int:
        """As the policy's."""
        return self.policy.preview_points

    @property
    def preview_dt(self) -> float:
        """As the policy's [s]."""
        return self.policy.preview_dt

    @classmethod
    def of(cls, policy: NfqPolicy) -> OpenPolicy:
        """For policies like this one; its nets are to be handed to whoever runs the program."""
        routine = m.Routine(name="nets", size=len(policy.actions), call=_refused, native=_refused)
        return cls(policy=policy, routine=routine, numbers=numbers_of(policy), dt=policy.dt)

    def init(self, batch: tuple[int, ...] = ()) -> State:
        return self.policy.init(batch)

    def settle(self, t: float, x: State, u: Any) -> State:
        return self.policy.settle(t, x, u)

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        return self._forecast.remember(x, u) if self.preview_points else ()

    def output(self, t: Any, x: State, u: Any) -> Any:
        """As that of `NfqPolicy`, on symbols."""
        if not m.is_symbol(t):  # a loop asks for its outputs once before it is traced
            return self.policy.output(t, x, u)
        ready_from, foresees, *_ = self.numbers
        s: tuple[Any, ...] = tuple(u[: len(COLUMNS)])
        if self.preview_points:
            s = m.chosen(foresees > 0.5, self._forecast.ahead(x, u), s)
        nan, share, about = float("nan"), 1.0, self.policy.description
        if about.scaled_from < np.inf:
            excess, s = about.excess(u.v), about.scaled(s)
            share = 1.0 / (excess * excess)
        sound = m.is_finite(s[0] + s[1] + s[2] + s[3] + s[4] + s[5])
        column = self.routine(*[m.where(sound, value, nan) for value in s])
        action, q = self.policy.least(column)
        return self.Y(m.where(sound, share * action, nan), q, m.where(t >= ready_from, 1.0, 0.0))

    @functools.cached_property
    def _forecast(self) -> DelayCompensator:
        _, _, samples, *numbers = self.numbers
        return DelayCompensator(samples=samples).with_numbers(numbers)


def numbers_of(policy: NfqPolicy) -> tuple[float, ...]:
    """What differs between policies of a kind, besides their nets: `ready_from`, and all of the forecast.

    Without a forecast its numbers are those of the car that stands, by which `NfqPolicy` remembers until it has one.
    """
    about = policy.forecast or DelayCompensator()
    return (policy.ready_from, float(policy.forecast is not None), float(about.samples), *map(float, about.numbers))


class Kind:
    """What a program for an `OpenPolicy` depends on, as the key of a cache: equal for policies that one serves."""

    def __init__(self, policy: NfqPolicy):
        self.policy = policy
        """One of them."""
        reading = policy.preview_points, policy.preview_dt, policy.dt
        self._key = policy.actions, repr(policy.description), policy.continuous, *reading

    def __hash__(self) -> int:
        return hash(self._key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Kind) and self._key == other._key


def _refused(*_: Any) -> Any:
    raise TypeError("the nets of an OpenPolicy are handed to its program; they are in no loop")
