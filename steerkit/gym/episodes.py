"""N cars of a task in compiled C, episode after episode: one call a step, arrays in place, no Python a car."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from steerkit._support import native
from steerkit._support.errors import require
from steerkit.gym.episode_code import Fleet, episode_code
from steerkit.gym.starts import Draw
from steerkit.gym.task import Array, Task

_HOW = {AutoresetMode.NEXT_STEP: 0, AutoresetMode.SAME_STEP: 1, AutoresetMode.DISABLED: 2}
_A_THREAD = 256  # cars for which a second thread is worth its start
_THREADS = 64  # as many as the C has room for


class Episodes:
    """N cars of a task in C: each step drives, judges and observes all of them, and begins ended episodes anew.

    Where `Drives` leaves the judging and the starts to Python, here both are traced and compiled with the loop, and the
    starts are drawn from the cars' own NumPy generators: the same numbers, to rounding, as those of single
    environments. All arrays are written in place: what is to be kept has to be copied.

    threads: by default one for 256 cars, up to the number of cores. observation: where to write what the agents see, a
    C-contiguous float32 array (N, columns); by default its own. Raises TraceError for a loop, cost or start that
    cannot be run on symbols, ValueError for sample times that do not fit, NoCompilerError without a C compiler.
    """

    observation: NDArray[np.float32]
    """What the agents see, (N, columns)."""
    reward: Array
    """(N,); so are the others."""
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]
    over: NDArray[np.bool_]
    """Whose episode is over and has not begun anew."""

    def __init__(
        self,
        task: Task,
        cars: int,
        mode: AutoresetMode,
        threads: int | None = None,
        observation: NDArray[np.float32] | None = None,
    ):
        task.require_period()
        self.task, self.n, self._how = task, cars, ctypes.c_int(_HOW[mode])
        self._names = [name.split(".")[1] for name in task.info]
        self._signals = [*task.columns, *task.info]
        code = episode_code(task, self._signals, "path.s")
        self._library = native.load(code.source, vector_maths=True)
        lanes = self._library.lanes()
        groups = -(-cars // lanes)
        padded = groups * lanes
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        chosen = min(cores, cars // _A_THREAD) if threads is None else threads
        self._threads = ctypes.c_int(min(max(1, chosen), groups, _THREADS))
        columns, info = len(task.columns), len(task.info)
        self._arrays: dict[str, NDArray[Any]] = {
            "mid": np.array(task.description.mid, dtype=float),
            "half": np.array(task.description.half, dtype=float),
            "action": np.zeros(padded),
            "state": np.zeros((groups, code.carried, lanes)),
            "signals": np.zeros((groups, len(self._signals), lanes)),
            "observation": np.zeros((cars, columns), np.float32) if observation is None else observation,
            "last_observation": np.zeros((cars, columns), np.float32),
            "info": np.zeros((info, padded)),
            "last_info": np.zeros((info + 2, padded)),
            **{name: np.zeros(padded) for name in ("reward", "cost")},
            "steps": np.zeros(padded, np.int64),
            **{name: np.zeros(padded, np.bool_) for name in ("terminated", "truncated")},
            "over": np.ones(padded, np.bool_),
            "seed": np.zeros(padded, np.uint64),
            "start": np.zeros((padded, 3)),
            "generator": np.zeros(cars, np.uint64),
        }
        self._fleet = Fleet(
            failure=task.failure,
            longest=task.longest,
            end=task.end,
            far=task.starts.last,
            start_e=task.start_e,
            start_psi_e=task.start_psi_e,
            cars=cars,
            padded=padded,
            groups=groups,
            **{name: array.ctypes.data for name, array in self._arrays.items()},
        )
        seen = self._arrays["observation"]
        fits = seen.shape == (cars, columns) and seen.dtype == np.float32 and seen.flags.c_contiguous
        require(
            fits, "Episodes", f"observation {seen.dtype} {seen.shape}, expected float32 {(cars, columns)}, contiguous"
        )
        self._generators: list[np.random.Generator] = []
        for name in ("observation", "reward", "terminated", "truncated", "over"):
            setattr(self, name, self._arrays[name][:cars])

    def draw_from(self, generators: Sequence[np.random.Generator]) -> None:
        """Draw the starts of car i from generator i, which goes on as if Python had drawn them."""
        self._generators = list(generators)  # kept, as C is given their addresses
        faces = [generator.bit_generator.ctypes for generator in generators]
        self._arrays["generator"][:] = [face.state_address for face in faces]
        self._fleet.next_uint32 = ctypes.cast(faces[0].next_uint32, ctypes.c_void_p)
        self._fleet.next_double = ctypes.cast(faces[0].next_double, ctypes.c_void_p)

    def start(self, cars: NDArray[np.intp], draws: Sequence[Draw]) -> None:
        """Put the cars of these numbers where they were drawn."""
        self._arrays["seed"][cars] = [draw.seed for draw in draws]
        self._arrays["start"][cars] = [draw[1:] for draw in draws]
        which = np.zeros(len(self._arrays["over"]), np.bool_)
        which[cars] = True
        self._library.place(ctypes.byref(self._fleet), ctypes.c_void_p(which.ctypes.data))

    def step(self, actions: Array) -> None:
        """Drive all cars one sample with these actions [rad], and go on with the next episode where one has ended.

        Raises FloatingPointError when a signal is no finite number any more, ResetNeeded before the first start.
        """
        if not self._generators:  # C would draw from nothing
            raise gymnasium.error.ResetNeeded("step: no episode has begun; call reset()")
        self._arrays["action"][: self.n] = actions
        self._library.step(ctypes.byref(self._fleet), self._how, self._threads)
        if not np.isfinite(self._arrays["cost"][: self.n]).all() or not np.isfinite(self._arrays["info"]).all():
            self._explain()

    def infos(self) -> dict[str, Array]:
        """What an agent need not know but people want to, (N,) each: SI; copies."""
        return self._told(self._arrays["info"].copy(), self._arrays["steps"], self._arrays["cost"])

    def last(self) -> tuple[NDArray[np.float32], dict[str, Array]]:
        """Observations and infos at the end of the episodes that ended in the last step; of other cars, older ones."""
        rows = self._arrays["last_info"].copy()
        return self._arrays["last_observation"].copy(), self._told(rows[:-2], rows[-2], rows[-1])

    def _told(self, rows: Array, steps: NDArray[Any], cost: Array) -> dict[str, Array]:
        told = {name: row[: self.n] for name, row in zip(self._names, rows)}
        return told | {"t": steps[: self.n] * self.task.dt, "cost": cost[: self.n].copy()}

    def _explain(self) -> None:
        signals = self._arrays["signals"].transpose(1, 0, 2).reshape(len(self._signals), -1)[:, : self.n]
        wrong = np.argwhere(~np.isfinite(signals))
        if len(wrong):
            row, car = wrong[0]
            raise FloatingPointError(
                f"TrackSteering: {self._signals[row]} of car {car} is {signals[row, car]} after "
                f"{self._arrays['steps'][car]} steps; a block of the scenario, or an action, is out of its range"
            )
