"""Controllers written for comma's controls challenge: any file with its class `Controller` drives here, as a block."""

from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np

from steerkit._support.errors import in_one_line, number, require
from steerkit._support.plugins import imported
from steerkit.controllers.lateral import DT, PREVIEW
from steerkit.diagram.block import Block, In, Out, State

_AHEAD = ("lataccel", "roll_lataccel", "v_ego", "a_ego")


class BaseController:
    """What a file's `from . import BaseController` gives."""


@dataclass(frozen=True, eq=False, kw_only=True)
class ChallengeController(Block):
    """Drives with an object of the challenge: `update(target_lataccel, current_lataccel, state, future_plan)`.

    Its answer is a_y_cmd [m/s^2]. The object remembers by itself, so the block is not pure: it is made anew where a
    drive begins, is asked once a sample, and can be simulated step by step only. Inputs: a_y_target, a_y, a_roll
    [m/s^2], v [m/s], a_x [m/s^2]; preview, preview_roll [m/s^2], preview_v [m/s], preview_a_x [m/s^2]. State: the
    sample's number. Raises ValueError where the object fails or answers no finite number; TypeError for a batch.
    """

    a_y_target = In("m/s^2")
    a_y = In("m/s^2")
    a_roll = In("m/s^2")
    v = In("m/s")
    a_x = In("m/s^2")
    preview = In("m/s^2", size=PREVIEW)
    preview_roll = In("m/s^2", size=PREVIEW)
    preview_v = In("m/s", size=PREVIEW)
    preview_a_x = In("m/s^2", size=PREVIEW)
    a_y_cmd = Out("m/s^2")

    pure = False
    make: Callable[[], Any]
    """Makes the object."""
    name: str = "controller"
    """What it is called in errors."""
    dt: float = number(DT, "s", above=0.0, high=1.0)
    live: dict[str, Any] = field(default_factory=dict, init=False, repr=False)
    """The object of this drive."""

    @classmethod
    def load(cls, name: str) -> "ChallengeController":
        """The class that `my_file.py:Controller` names; raises ValueError, in one line, where there is none."""
        kind, where = imported(name, "controller", parent=__name__), f"controller '{name}'"
        fits = isinstance(kind, type) and callable(getattr(kind, "update", None))
        expected = "a class with update(self, target_lataccel, current_lataccel, state, future_plan)"
        require(fits, where, f"is {kind!r:.60}, expected {expected}")
        return cls(make=kind, name=where)

    def init(self, batch: tuple[int, ...] = ()) -> State:
        if batch:
            raise TypeError(f"{self.name}: it remembers one drive, and cannot be batched")
        return (0.0,)

    def output(self, t: Any, x: State, u: Any) -> Any:
        try:
            if x[0] == 0.0:  # asked more than once, as the loop settles
                self.live["object"] = self.make()
            now = SimpleNamespace(roll_lataccel=u.a_roll, v_ego=u.v, a_ego=u.a_x)
            ahead = SimpleNamespace(**dict(zip(_AHEAD, map(list, u[5:]))))
            given = self.live["object"].update(u.a_y_target, u.a_y, now, ahead)
            answer = np.asarray(given, dtype=float)
        except (Exception, SystemExit) as error:
            raise ValueError(f"{self.name} failed at {t:.1f} s: {in_one_line(error, foreign=True)}") from error
        said = f"answered {given!r:.60} at {t:.1f} s, expected one finite number, the steer"
        require(answer.size == 1 and np.isfinite(answer).all(), self.name, said)
        return self.Y(float(answer.reshape(-1)[0]))

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        return (x[0] + 1.0,)
