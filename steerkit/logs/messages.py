"""What Foxglove and PlotJuggler see of a drive, in a file or live: names, topics, messages in JSON, and the scene."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

_STATES = ("v", "r", "beta", "psi", "a_y")
_LOOP = ("e", "e_dot", "psi_e", "kappa", "s")
POSE, DRIVEN = "/scene/pose", "/scene/driven"
"""Topics of Foxglove's 3D panel: where the car is, and the way that it came."""
MOST = 2000
"""Points of the way driven, at most."""


def shown_as(names: Iterable[str]) -> dict[str, str]:
    """What the layouts call each of the signals of a loop or of a drive: name there to name here.

    `/car/x`, `/wheel/delta_sw`, `/path/e`, ...: the first signal that tells it; all stand under `/signals/` too.
    """
    known = list(names)
    shown: dict[str, str] = {}

    def first(name: str, *sources: str) -> None:
        shown.update([(name, source) for source in sources if source in known][:1])

    for name in ("x", "y", *_STATES):
        first(f"/car/{name}", f"car.{name}", name)
    for name in _LOOP:
        first(f"/path/{name}", f"path.{name}")
    first("/wheel/delta_sw", "car.delta_sw", "actuator.delta_sw", "delta_sw")
    first("/wheel/delta_sw_cmd", "supervisor.delta_sw", "doe.delta_sw", "controller.delta_sw", "gate.delta_sw")
    return shown | {f"/signals/{name.replace('.', '/')}": name for name in known}


def by_topic(shown: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """What belongs to the names `/topic/field`, by topic and field."""
    topics: dict[str, dict[str, Any]] = {}
    for name, what in shown.items():
        topic, _, field = name.rpartition("/")
        topics.setdefault(topic, {})[field] = what
    return topics


def number(value: Any) -> float | None:
    """As JSON has it: null for what is none."""
    value = float(value)
    return value if math.isfinite(value) else None


def packed(values: Mapping[str, Any]) -> bytes:
    """A message."""
    return json.dumps(values, allow_nan=False, separators=(",", ":")).encode()


def schema(topic: str, fields: Iterable[str]) -> tuple[str, dict[str, Any]]:
    """Name and JSON schema of a topic's messages."""
    if topic == POSE:
        return "foxglove.PoseInFrame", _POSE
    if topic == DRIVEN:
        return "foxglove.PosesInFrame", _POSES
    properties = {name: {"type": "number"} for name in sorted(fields)}
    return topic.strip("/").replace("/", "."), {"type": "object", "properties": properties}


_XYZ = {"type": "object", "properties": {axis: {"type": "number"} for axis in "xyz"}}
_XYZW = {"type": "object", "properties": {axis: {"type": "number"} for axis in "xyzw"}}
_PLACED = {"type": "object", "properties": {"position": _XYZ, "orientation": _XYZW}}
_WHEN = {"type": "object", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}}
_POSE = {"type": "object", "properties": {"timestamp": _WHEN, "frame_id": {"type": "string"}, "pose": _PLACED}}
_POSES = {
    "type": "object",
    "properties": {"timestamp": _WHEN, "frame_id": {"type": "string"}, "poses": {"type": "array", "items": _PLACED}},
}


def pose(x: Any, y: Any, psi: Any, when: int) -> dict[str, Any]:
    """Where the car is: x, y [m], psi [rad] (None: not known), at `when` since 1970 [ns]."""
    return {**_stamped(when), "pose": _placed(number(x), number(y), None if psi is None else number(psi))}


def way(points: Sequence[Sequence[float]], when: int) -> dict[str, Any]:
    """The way driven, (n, 2) [m], no more than MOST of its points or so."""
    return {**_stamped(when), "poses": [_placed(x, y, None) for x, y in points[:: max(1, len(points) // MOST)]]}


def _stamped(when: int) -> dict[str, Any]:
    return {"timestamp": {"sec": when // 10**9, "nsec": when % 10**9}, "frame_id": "map"}


def _placed(x: float | None, y: float | None, psi: float | None) -> dict[str, Any]:
    turn = psi or 0.0
    return {
        "position": {"x": x or 0.0, "y": y or 0.0, "z": 0.0},
        "orientation": {"x": 0.0, "y": 0.0, "z": math.sin(turn / 2.0), "w": math.cos(turn / 2.0)},
    }
