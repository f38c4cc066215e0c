"""Cars whose signs are not those of ISO 8855, as somebody's own plant may have them."""

from dataclasses import dataclass
from typing import Any

from steerkit.plants.single_track import NonlinearSingleTrack


@dataclass(frozen=True, eq=False, kw_only=True)
class TurnsRight(NonlinearSingleTrack):
    """A positive angle turns it to the right."""

    def update(self, t: Any, x: Any, u: Any, y: Any) -> Any:
        return super().update(t, x, u._replace(delta_sw_cmd=-u.delta_sw_cmd), y)


@dataclass(frozen=True, eq=False, kw_only=True)
class YawsRight(NonlinearSingleTrack):
    """Its yaw rate is positive to the right."""

    def output(self, t: Any, x: Any, u: Any) -> Any:
        y = super().output(t, x, u)
        return y._replace(r=-y.r)
