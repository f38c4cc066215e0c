"""Logs out: a drive, a simulated run or a car's recording as MCAP that Foxglove, PlotJuggler and ROS 2 open."""

from __future__ import annotations

import json
import math
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from steerkit.errors import require
from steerkit.files import whole, write_text
from steerkit.logs.drive import Drive
from steerkit.simulation import Log

LAYOUTS = {"foxglove": "foxglove.json", "plotjuggler": "plotjuggler.xml"}
"""The layouts that ship: where the car is, e, the wheel, the states."""
KINDS = (".mcap", ".csv", ".npz", ".parquet")
BEGIN = 1_700_000_000_000_000_000
"""When a log without a date begins, since 1970 [ns]."""
_STATES = ("v", "r", "beta", "psi", "a_y")
_LOOP = ("e", "e_dot", "psi_e", "kappa", "s")


def layout(program: str, file: str | Path) -> Path:
    """Write the layout for a program, `foxglove` or `plotjuggler`, to a file; returns it."""
    from steerkit.errors import known

    text = (files(__package__) / "layouts" / LAYOUTS[known(program, LAYOUTS, "layout")]).read_text(encoding="utf-8")
    write_text(file, text)
    return Path(file)


def signals_of(log: Log) -> dict[str, np.ndarray]:
    """What a layout shows, by its name there: `/car/x`, `/wheel/delta_sw`, `/path/e`, ... from the signals of a loop or
    of a drive, the first that is there; the rest under their own names."""
    columns = {name: values for name, values in log.columns().items() if name != "t"}
    require(not any("[" in name and name.startswith("car.") for name in columns), "export", "a batch of cars; save one")
    shown: dict[str, np.ndarray] = {}
    for name in ("x", "y", *_STATES):
        _first(shown, f"/car/{name}", columns, (f"car.{name}", name))
    for name in _LOOP:
        _first(shown, f"/path/{name}", columns, (f"path.{name}",))
    _first(shown, "/wheel/delta_sw", columns, ("car.delta_sw", "actuator.delta_sw", "delta_sw"))
    _first(shown, "/wheel/delta_sw_cmd", columns, ("supervisor.delta_sw", "doe.delta_sw", "controller.delta_sw"))
    return shown | {f"/signals/{name.replace('.', '/')}": values for name, values in columns.items()}


def _first(shown: dict[str, np.ndarray], name: str, columns: dict[str, np.ndarray], sources: tuple[str, ...]) -> None:
    source = next((one for one in sources if one in columns), None)
    if source is not None:
        shown[name] = columns[source]


def to_mcap(log: Log | Drive, file: str | Path) -> dict[str, int]:
    """Write a log as MCAP with a topic a group (`/car`, `/path`, `/wheel`, `/signals/...`) in JSON, and `/scene/pose`,
    `/scene/driven` for Foxglove's 3D panel; returns messages by topic.

    Numbers come back bit for bit; one that is none is null. Raises ValueError for a batch of cars.
    """
    from mcap.writer import Writer

    record = log.to_log() if isinstance(log, Drive) else log
    shown = signals_of(record)
    topics: dict[str, dict[str, np.ndarray]] = {}
    for name, values in shown.items():
        topic, _, field = name.rpartition("/")
        topics.setdefault(topic, {})[field] = values
    with whole(file) as draft, draft.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="", library="exported by steerkit-control")
        channels = {topic: _channel(writer, topic, _schema(sorted(fields))) for topic, fields in topics.items()}
        scene = {"x", "y"} <= topics.get("/car", {}).keys()
        pose = _channel(writer, "/scene/pose", "foxglove.PoseInFrame", _POSE) if scene else 0
        for k, t in enumerate(record.t.tolist()):
            when = BEGIN + round(t * 1e9)
            for topic, fields in topics.items():
                _add(writer, channels[topic], when, {name: _number(values[k]) for name, values in fields.items()})
            if scene:
                _add(writer, pose, when, _pose(topics["/car"], k, when))
        if scene:
            driven = _channel(writer, "/scene/driven", "foxglove.PosesInFrame", _POSES)
            _add(writer, driven, BEGIN, _driven(topics["/car"]))
        writer.finish()
    return dict.fromkeys(topics, len(record.t)) | ({"/scene/pose": len(record.t)} if scene else {})


def _channel(writer: Any, topic: str, name_or_schema: Any, schema: dict[str, Any] | None = None) -> int:
    name, text = (name_or_schema, schema) if schema else (topic.strip("/").replace("/", "."), name_or_schema)
    number = writer.register_schema(name=name, encoding="jsonschema", data=json.dumps(text).encode())
    return int(writer.register_channel(topic=topic, message_encoding="json", schema_id=number))


def _add(writer: Any, channel: int, when: int, values: dict[str, Any]) -> None:
    data = json.dumps(values, allow_nan=False, separators=(",", ":")).encode()
    writer.add_message(channel_id=channel, log_time=when, publish_time=when, data=data)


def _schema(names: list[str]) -> dict[str, Any]:
    return {"type": "object", "properties": {name: {"type": "number"} for name in names}}


_XYZ = {"type": "object", "properties": {axis: {"type": "number"} for axis in "xyz"}}
_XYZW = {"type": "object", "properties": {axis: {"type": "number"} for axis in "xyzw"}}
_PLACED = {"type": "object", "properties": {"position": _XYZ, "orientation": _XYZW}}
_WHEN = {"type": "object", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}}
_POSE = {"type": "object", "properties": {"timestamp": _WHEN, "frame_id": {"type": "string"}, "pose": _PLACED}}
_POSES = {
    "type": "object",
    "properties": {"timestamp": _WHEN, "frame_id": {"type": "string"}, "poses": {"type": "array", "items": _PLACED}},
}


def _pose(car: dict[str, np.ndarray], k: int, when: int) -> dict[str, Any]:
    psi = _number(car["psi"][k]) if "psi" in car else None
    return {
        "timestamp": {"sec": when // 10**9, "nsec": when % 10**9},
        "frame_id": "map",
        "pose": _placed(_number(car["x"][k]), _number(car["y"][k]), psi),
    }


def _driven(car: dict[str, np.ndarray]) -> dict[str, Any]:
    points = np.column_stack((car["x"], car["y"]))
    points = points[np.isfinite(points).all(axis=1)]
    points = points[:: max(1, len(points) // 2000)]
    return {
        "timestamp": {"sec": BEGIN // 10**9, "nsec": 0},
        "frame_id": "map",
        "poses": [_placed(x, y, None) for x, y in points.tolist()],
    }


def _placed(x: float | None, y: float | None, psi: float | None) -> dict[str, Any]:
    turn = psi or 0.0
    return {
        "position": {"x": x or 0.0, "y": y or 0.0, "z": 0.0},
        "orientation": {"x": 0.0, "y": 0.0, "z": math.sin(turn / 2.0), "w": math.cos(turn / 2.0)},
    }


def _number(value: Any) -> float | None:
    number = float(value)
    return number if math.isfinite(number) else None


def to_ros2(drive: Log | Drive, file: str | Path, *, steer_ratio: float) -> dict[str, int]:
    """Write a log as the MCAP of a ROS 2 bag: Autoware's SteeringReport and VelocityReport, and nav_msgs/Odometry where
    it knows its place; returns messages by topic.

    steer_ratio: of the car: the report's angle is the road wheels'. Numbers of the reports are float32, as Autoware has
    them. Raises ValueError for a log without steering, speed and yaw rate.
    """
    from steerkit.logs.ros_out import write_bag

    record = drive.to_log() if isinstance(drive, Drive) else drive
    shown = signals_of(record)
    needed = ("/wheel/delta_sw", "/car/v", "/car/r")
    missing = [name for name in needed if name not in shown]
    require(not missing, "export to ROS 2", f"the log has no {', '.join(missing)}; it has {', '.join(record)}")
    named = {
        name.rpartition("/")[2]: shown[name] for name in (*needed, "/car/x", "/car/y", "/car/psi") if name in shown
    }
    named["delta"] = named.pop("delta_sw") / steer_ratio
    with whole(file) as draft:
        return write_bag(draft, record.t, named, BEGIN)
