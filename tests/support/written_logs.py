"""One drive in every format that `read_drive` knows, each written by the format's own library."""

import gzip
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.io import savemat

from steerkit.diagram.simulation import Log
from steerkit.diagram.units import degrees_of, radians_of

DBC = """\
VERSION ""
NS_ :
BS_:
BU_: CAR
BO_ 37 WHEEL: 8 CAR
 SG_ STEERING_WHEEL_ANGLE : 7|16@0- (0.1,0) [-3276|3276] "deg" CAR
 SG_ CHECKSUM : 63|8@0+ (1,0) [0|255] "" CAR
BO_ 38 MOTION: 8 CAR
 SG_ VEHICLE_SPEED : 7|16@0+ (0.01,0) [0|655] "km/h" CAR
 SG_ YAW_RATE : 23|16@0- (0.005,0) [-163|163] "deg/s" CAR
 SG_ CHECKSUM : 63|8@0+ (1,0) [0|255] "" CAR
"""
"""Two messages, the last byte of each the sum of its identifier, length and other bytes."""

Columns = dict[str, Any]


def driven(seconds: float = 25.0, rate: float = 20.0) -> Columns:
    """A drive of a car whose steering ratio times wheelbase is 43 m, through bends at 6 to 10 m/s; in SI."""
    t = np.arange(round(seconds * rate)) / rate
    delta_sw = 0.9 * np.sin(0.5 * t) + 0.4 * np.sin(1.7 * t + 1.0)
    v = 8.0 - 2.0 * np.cos(0.3 * t)
    return {"t": t, "delta_sw": delta_sw, "v": v, "r": v * delta_sw / 43.0}


@dataclass(frozen=True, kw_only=True)
class Format:
    """How a format is written, and what it keeps."""

    suffix: str
    write: Callable[[Path, Columns], None]
    exact: bool
    """To the last bit? Else to half a step: of CAN's signals, or of float32."""
    sums: bool
    """Is every number under a check sum?"""
    dbc: bool = False
    clock: float = 0.0
    """Step of its times [s]."""


STEPS = {"delta_sw": radians_of(0.1), "v": 0.01 / 3.6, "r": radians_of(0.005)}
"""Resolution of the CAN signals, in SI."""


def _saved(file: Path, columns: Columns) -> None:
    _log(columns).save(file)


def _csv_gz(file: Path, columns: Columns) -> None:
    plain = file.with_name("plain.csv")
    _saved(plain, columns)
    file.write_bytes(gzip.compress(plain.read_bytes(), mtime=0))
    plain.unlink()


def _log(columns: Columns) -> Log:
    units = {"delta_sw": "rad", "v": "m/s", "r": "rad/s"}
    return Log(columns["t"], {name: columns[name] for name in units}, units)


def _parquet(file: Path, columns: Columns) -> None:
    import pyarrow as pa
    import pyarrow.parquet as parquet

    parquet.write_table(pa.table(columns), file, write_page_checksum=True)


def _mf4(compression: Literal[0, 2]) -> Callable[[Path, Columns], None]:
    def write(file: Path, columns: Columns) -> None:
        from asammdf import MDF, Signal

        units = {"delta_sw": "rad", "v": "m/s", "r": "rad/s"}
        with MDF(version="4.10") as mdf:
            mdf.append([Signal(columns[n], columns["t"], name=n, unit=unit) for n, unit in units.items()])
            saved = mdf.save(file.with_name("out.mf4"), overwrite=True, compression=compression)
        shutil.move(saved, file)

    return write


def _can_messages(columns: Columns) -> Iterator[Any]:
    import can
    import cantools

    db: Any = cantools.database.load_string(DBC, "dbc")
    for t, delta_sw, v, r in zip(*(columns[name].tolist() for name in ("t", "delta_sw", "v", "r"))):
        wheel = {"STEERING_WHEEL_ANGLE": degrees_of(delta_sw)}
        motion = {"VEHICLE_SPEED": 3.6 * v, "YAW_RATE": degrees_of(r)}
        for name, values in (("WHEEL", wheel), ("MOTION", motion)):
            message = db.get_message_by_name(name)
            data = message.encode({**values, "CHECKSUM": 0})
            data = data[:-1] + bytes([(message.frame_id + len(data) + sum(data[:-1])) % 256])
            yield can.Message(timestamp=1.7e9 + t, arbitration_id=message.frame_id, data=data, is_extended_id=False)


def _can(file: Path, columns: Columns) -> None:
    import can

    with can.Logger(str(file)) as writer:
        for message in _can_messages(columns):
            writer.on_message_received(message)


def _bag(plugin: str, *, frames: bool = False) -> Callable[[Path, Columns], None]:
    def write(file: Path, columns: Columns) -> None:
        from rosbags.rosbag2 import StoragePlugin, Writer

        folder = file.with_name("bag")
        with Writer(folder, version=9, storage_plugin=StoragePlugin[plugin]) as bag:
            (_frames if frames else _autoware)(bag, columns)
        (stored,) = (one for one in folder.iterdir() if one.suffix != ".yaml")
        shutil.move(stored, file)
        shutil.rmtree(folder)

    return write


def _summed(file: Path, columns: Columns) -> None:
    """The bag as mcap's own library writes it: chunks under check sums."""
    from mcap.reader import make_reader
    from mcap.writer import Writer

    _bag("MCAP")(file, columns)
    whole = file.with_name("whole.mcap")
    shutil.move(file, whole)
    with whole.open("rb") as source, file.open("wb") as target:
        writer = Writer(target, chunk_size=16_384)
        writer.start(profile="ros2", library="mcap")
        schemas, channels = dict[int, int](), dict[int, int]()
        for schema, channel, message in make_reader(source).iter_messages():
            assert schema is not None
            if channel.id not in channels:
                schemas.setdefault(schema.id, writer.register_schema(schema.name, schema.encoding, schema.data))
                topic, kind = channel.topic, channel.message_encoding
                channels[channel.id] = writer.register_channel(topic, kind, schemas[schema.id], channel.metadata)
            writer.add_message(channels[channel.id], message.log_time, message.data, message.publish_time)
        writer.finish()
    whole.unlink()


def _autoware(bag: Any, columns: Columns) -> None:
    """Reports of Autoware: the road wheels' angle is float32, as all of its numbers are."""
    from steerkit.logs.ros import typestore

    store = typestore()
    time, header = store.types["builtin_interfaces/msg/Time"], store.types["std_msgs/msg/Header"]
    steering = store.types["autoware_vehicle_msgs/msg/SteeringReport"]
    velocity = store.types["autoware_vehicle_msgs/msg/VelocityReport"]
    topics = {
        kind: bag.add_connection(f"/vehicle/status/{name}_status", kind.__msgtype__, typestore=store)
        for kind, name in ((steering, "steering"), (velocity, "velocity"))
    }
    for t, delta_sw, v, r in zip(*(columns[name].tolist() for name in ("t", "delta_sw", "v", "r"))):
        when = 1_700_000_000_000_000_000 + round(t * 1e9)
        stamp = time(sec=when // 10**9, nanosec=when % 10**9)
        reports = (
            steering(stamp=stamp, steering_tire_angle=delta_sw / 15.0),
            velocity(
                header=header(stamp=stamp, frame_id="base_link"),
                longitudinal_velocity=v,
                lateral_velocity=0.0,
                heading_rate=r,
            ),
        )
        for report in reports:
            bag.write(topics[type(report)], when + 1000, store.serialize_cdr(report, report.__msgtype__))


def _frames(bag: Any, columns: Columns) -> None:
    """CAN frames, as a driver of ROS publishes them."""
    from steerkit.logs.ros import typestore

    store = typestore()
    time, header = store.types["builtin_interfaces/msg/Time"], store.types["std_msgs/msg/Header"]
    frame = store.types["can_msgs/msg/Frame"]
    topic = bag.add_connection("/can_rx", frame.__msgtype__, typestore=store)
    for message in _can_messages(columns):
        when = round(message.timestamp * 1e9)
        sent = frame(
            header=header(stamp=time(sec=when // 10**9, nanosec=when % 10**9), frame_id="can0"),
            id=message.arbitration_id,
            is_rtr=False,
            is_extended=False,
            is_error=False,
            dlc=8,
            data=np.frombuffer(bytes(message.data), dtype=np.uint8),
        )
        bag.write(topic, when, store.serialize_cdr(sent, frame.__msgtype__))


FORMATS: dict[str, Format] = {
    "csv": Format(suffix=".csv", write=_saved, exact=True, sums=False),
    "csv.gz": Format(suffix=".csv.gz", write=_csv_gz, exact=True, sums=True),
    "mat": Format(suffix=".mat", write=partial(savemat, do_compression=True), exact=True, sums=True),
    "mat, not compressed": Format(suffix=".mat", write=savemat, exact=True, sums=False),
    "npz": Format(suffix=".npz", write=_saved, exact=True, sums=True),
    "parquet": Format(suffix=".parquet", write=_parquet, exact=True, sums=True),
    "mf4": Format(suffix=".mf4", write=_mf4(2), exact=True, sums=False),
    "mf4, not compressed": Format(suffix=".mf4", write=_mf4(0), exact=True, sums=False),
    "candump": Format(suffix=".log", write=_can, exact=False, sums=False, dbc=True, clock=1e-6),
    "asc": Format(suffix=".asc", write=_can, exact=False, sums=False, dbc=True, clock=1e-6),
    "blf": Format(suffix=".blf", write=_can, exact=False, sums=False, dbc=True, clock=1e-6),
    "trc": Format(suffix=".trc", write=_can, exact=False, sums=False, dbc=True, clock=1e-3),
    "ros2 mcap": Format(suffix=".mcap", write=_bag("MCAP"), exact=False, sums=False, clock=1e-6),
    "ros2 mcap with sums": Format(suffix=".mcap", write=_summed, exact=False, sums=True, clock=1e-6),
    "ros2 sqlite": Format(suffix=".db3", write=_bag("SQLITE3"), exact=False, sums=False, clock=1e-6),
    "ros2 frames": Format(
        suffix=".mcap", write=_bag("MCAP", frames=True), exact=False, sums=False, dbc=True, clock=1e-6
    ),
}
"""By name. rosbags writes MCAP without sums, mcap's own library with them for chunks. Not in it: a car server's
recording, which its own tests break at every byte."""


def written(name: str, folder: Path, columns: Columns) -> tuple[Path, dict[str, Any]]:
    """The file, and what `read_drive` has to be told beside it."""
    kind = FORMATS[name]
    file = folder / f"drive{kind.suffix}"
    kind.write(file, columns)
    if not kind.dbc:
        return file, {}
    (folder / "car.dbc").write_text(DBC, encoding="utf-8")
    return file, {"dbc": folder / "car.dbc"}
