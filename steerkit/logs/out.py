"""Logs out: a drive, a simulated run or a car's recording as MCAP that Foxglove, PlotJuggler and ROS 2 open."""

from __future__ import annotations

import json
from collections.abc import Iterable
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from steerkit._support.errors import require
from steerkit._support.files import atomic_write, write_text
from steerkit.diagram.simulation import Log
from steerkit.logs import messages
from steerkit.logs.drive import Drive

LAYOUTS = {"foxglove": "foxglove.json", "plotjuggler": "plotjuggler.xml"}
"""The layouts that ship: where the car is, e, the wheel, the states."""
KINDS = (".mcap", ".csv", ".npz", ".parquet")
BEGIN = 1_700_000_000_000_000_000
"""When a log without a date begins, since 1970 [ns]."""


def layout(program: str, file: str | Path) -> Path:
    """Write the layout for a program, `foxglove` or `plotjuggler`, to a file; returns it."""
    from steerkit._support.errors import known

    text = (files(__package__) / "layouts" / LAYOUTS[known(program, LAYOUTS, "layout")]).read_text(encoding="utf-8")
    write_text(file, text)
    return Path(file)


def signals_of(log: Log) -> dict[str, np.ndarray]:
    """What a layout shows, by its name there: `/car/x`, `/wheel/delta_sw`, `/path/e`, ... from the signals of a loop or
    of a drive, the first that is there; the rest under their own names."""
    columns = {name: values for name, values in log.columns().items() if name != "t"}
    require(not any("[" in name and name.startswith("car.") for name in columns), "export", "a batch of cars; save one")
    return {name: columns[source] for name, source in messages.shown_as(columns).items()}


def to_mcap(log: Log | Drive, file: str | Path) -> dict[str, int]:
    """Write a log as MCAP with a topic a group (`/car`, `/path`, `/wheel`, `/signals/...`) in JSON, and `/scene/pose`,
    `/scene/driven` for Foxglove's 3D panel; returns messages by topic.

    Numbers come back bit for bit; one that is none is null. Raises ValueError for a batch of cars.
    """
    from mcap.writer import Writer

    record = log.to_log() if isinstance(log, Drive) else log
    topics = messages.by_topic(signals_of(record))
    car = topics.get("/car", {})
    scene = [messages.POSE, messages.DRIVEN] if {"x", "y"} <= car.keys() else []
    with atomic_write(file) as draft, draft.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="", library="exported by steerkit-control")
        channels = {topic: _channel(writer, topic) for topic in scene}
        channels |= {topic: _channel(writer, topic, fields) for topic, fields in topics.items()}
        for k, t in enumerate(record.t.tolist()):
            when = BEGIN + round(t * 1e9)
            for topic, fields in topics.items():
                _add(writer, channels[topic], when, {name: messages.number(all_[k]) for name, all_ in fields.items()})
            if scene:
                psi = car["psi"][k] if "psi" in car else None
                _add(writer, channels[messages.POSE], when, messages.pose(car["x"][k], car["y"][k], psi, when))
        if scene:
            points = np.column_stack((car["x"], car["y"]))
            points = points[np.isfinite(points).all(axis=1)]
            _add(writer, channels[messages.DRIVEN], BEGIN, messages.way(points.tolist(), BEGIN))
        writer.finish()
    return dict.fromkeys([*topics, *scene[:1]], len(record.t))


def _channel(writer: Any, topic: str, fields: Iterable[str] = ()) -> int:
    name, schema = messages.schema(topic, fields)
    known = writer.register_schema(name=name, encoding="jsonschema", data=json.dumps(schema).encode())
    return int(writer.register_channel(topic=topic, message_encoding="json", schema_id=known))


def _add(writer: Any, channel: int, when: int, values: dict[str, Any]) -> None:
    writer.add_message(channel_id=channel, log_time=when, publish_time=when, data=messages.packed(values))


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
    with atomic_write(file) as draft:
        return write_bag(draft, record.t, named, BEGIN)
