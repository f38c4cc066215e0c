"""Recorded transitions (s, a, s_next): all that the learner ever sees of a car, and who steered."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from steerkit._support.errors import optional, require
from steerkit._support.files import read_arrays, write_arrays
from steerkit.controllers.state_description import StateDescription

if TYPE_CHECKING:
    import pandas as pd


class Transitions:
    """A growing record of transitions in contiguous arrays.

    s, s_next: (n, columns) float64, SI; a: (n,) float64 [rad]; episode: (n,) int64; own: (n,) bool, False where another
    than the learner steered, such as the recovery controller: that teaches how the car answers, and no Q-function.
    Consecutive rows of one episode are consecutive samples; whoever records starts a new episode number at every break
    in time. Appending costs O(1) on average: the arrays double. The attributes of these names are read-only views of
    what is recorded so far; a view taken earlier stays valid and does not grow. Non-finite rows are refused with
    ValueError. rows: what is recorded at first, as for `extend`.
    """

    def __init__(self, names: Sequence[str] = StateDescription().names, *rows: ArrayLike):
        require(len(names) > 0, "Transitions", "names is empty, expected the state's columns")
        self.names = tuple(names)
        self._n = 0
        self._s, self._s_next = np.empty((256, len(self.names))), np.empty((256, len(self.names)))
        self._a, self._episode, self._own = np.empty(256), np.empty(256, dtype=np.int64), np.empty(256, dtype=bool)
        if rows:
            self.extend(*rows)

    def __len__(self) -> int:
        return self._n

    def __repr__(self) -> str:
        return f"Transitions({self._n} rows, {len(np.unique(self.episode))} episodes of {', '.join(self.names)})"

    @property
    def s(self) -> NDArray[np.float64]:
        """States (n, columns)."""
        return self._view(self._s)

    @property
    def a(self) -> NDArray[np.float64]:
        """Actions (n,) [rad]."""
        return self._view(self._a)

    @property
    def s_next(self) -> NDArray[np.float64]:
        """States one sample later (n, columns)."""
        return self._view(self._s_next)

    @property
    def episode(self) -> NDArray[np.int64]:
        """Episode numbers (n,)."""
        return self._view(self._episode)

    @property
    def own(self) -> NDArray[np.bool_]:
        """Did the learner steer (n,)?"""
        return self._view(self._own)

    def append(self, s: ArrayLike, a: float, s_next: ArrayLike, episode: int, own: bool = True) -> None:
        """Record one transition; raises ValueError for a wrong length or a non-finite number."""
        self.extend(np.atleast_2d(s), [a], np.atleast_2d(s_next), [episode], own)

    def extend(self, s: ArrayLike, a: ArrayLike, s_next: ArrayLike, episode: ArrayLike, own: ArrayLike = True) -> None:
        """Record n transitions: s, s_next (n, columns), a (n,), episode, own (n,) or one each; all or none of them."""
        s, a, s_next = np.asarray(s, dtype=float), np.asarray(a, dtype=float), np.asarray(s_next, dtype=float)
        n, columns = a.size, len(self.names)
        for name, rows in (("s", s), ("s_next", s_next)):
            fault = f"{name} of shape {rows.shape}, expected ({n}, {columns}): {', '.join(self.names)}"
            require(rows.shape == (n, columns) and a.shape == (n,), "Transitions", fault)
            if not np.isfinite(rows).all():
                row, column = np.argwhere(~np.isfinite(rows))[0]
                fault = f"{name}.{self.names[column]} = {rows[row, column]} in row {row}, expected a finite number"
                raise ValueError(f"Transitions: {fault}; end the episode before the faulty sample")
        require(bool(np.isfinite(a).all()), "Transitions", f"a = {a[~np.isfinite(a)][:1]} [rad], expected finite")
        end = self._n + n
        if end > len(self._a):
            for name in ("_s", "_a", "_s_next", "_episode", "_own"):
                old = getattr(self, name)
                new = np.empty((max(end, 2 * len(old)), *old.shape[1:]), dtype=old.dtype)
                new[: self._n] = old[: self._n]
                setattr(self, name, new)
        rows_now = slice(self._n, end)
        self._s[rows_now], self._a[rows_now], self._s_next[rows_now] = s, a, s_next
        self._episode[rows_now], self._own[rows_now] = episode, own
        self._n = end

    def frozen(self) -> Transitions:
        """The rows of this moment, without a copy: recorded rows never change."""
        same = Transitions(self.names)
        same._n, same._s, same._a, same._s_next = self._n, self.s, self.a, self.s_next
        same._episode, same._own = self.episode, self.own
        return same

    def part(self, rows: slice | NDArray[Any]) -> Transitions:
        """Those rows alone, copied."""
        kept = (self.s, self.a, self.s_next, self.episode, self.own)
        return Transitions(self.names, *(values[rows] for values in kept))

    def to_pandas(self) -> pd.DataFrame:
        """A row a transition, in SI: s by its columns' names, a, s_next with `next_` before them, episode, own.

        Needs pandas (extra `bench`).
        """
        pandas = optional("pandas", "Transitions.to_pandas", "bench")
        columns = [*self.names, "a", *(f"next_{name}" for name in self.names)]
        frame: pd.DataFrame = pandas.DataFrame(np.column_stack([self.s, self.a, self.s_next]), columns=columns)
        return frame.assign(episode=self.episode, own=self.own)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write everything to one .npz file (no pickle)."""
        kept = {name: getattr(self, name) for name in ("names", "s", "a", "s_next", "episode", "own")}
        write_arrays(path, "transitions", kept)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Transitions:
        """What `save` wrote, bit for bit; raises ValueError for a truncated or foreign file."""
        f = read_arrays(path, "transitions")
        try:
            return cls(f["names"].tolist(), f["s"], f["a"], f["s_next"], f["episode"], f["own"])
        except (ValueError, TypeError, KeyError) as why:
            raise ValueError(f"{path}: the transitions in it do not hold together: {why}") from why

    def _view(self, array: NDArray[Any]) -> NDArray[Any]:
        view = array[: self._n]
        view.flags.writeable = False
        return view
