"""ROS bags without ROS: what is read, and what is intact of a damaged one."""

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.rosbag2 import StoragePlugin, Writer

from steerkit.logs import Drive, read_drive, read_log
from steerkit.logs.ros import typestore
from tests.support.written_logs import driven, written

pytest.importorskip("rosbags")
BEGIN = 1_700_000_000_000_000_000


class Bag:
    """A bag that is being written, with the types of ROS and ours."""

    def __init__(self, writer: Any):
        self.writer, self.store = writer, typestore()
        self.topics: dict[str, Any] = {}

    def of(self, name: str, **values: Any) -> Any:
        return self.store.types[name](**values)

    def stamp(self, t: float, offset: float = 0.0) -> Any:
        when = BEGIN + round((t + offset) * 1e9)
        time = self.of("builtin_interfaces/msg/Time", sec=when // 10**9, nanosec=when % 10**9)
        return self.of("std_msgs/msg/Header", stamp=time, frame_id="map")

    def put(self, topic: str, t: float, message: Any) -> None:
        if topic not in self.topics:
            self.topics[topic] = self.writer.add_connection(topic, message.__msgtype__, typestore=self.store)
        data = self.store.serialize_cdr(message, message.__msgtype__)
        self.writer.write(self.topics[topic], BEGIN + round(t * 1e9), data)

    def odometry(self, t: float, psi: float, v: float, r: float, *, off: float = 0.0) -> Any:
        point = self.of("geometry_msgs/msg/Point", x=5.0 * t, y=-t, z=0.0)
        # heading psi, then rolled by 0.2 rad about the car's own axis: the heading stays psi
        (s, c), (a, b) = (np.sin(psi / 2), np.cos(psi / 2)), (np.sin(0.1), np.cos(0.1))
        turned = self.of("geometry_msgs/msg/Quaternion", x=c * a, y=s * a, z=s * b, w=c * b)
        pose = self.of("geometry_msgs/msg/Pose", position=point, orientation=turned)
        linear = self.of("geometry_msgs/msg/Vector3", x=v, y=0.0, z=0.0)
        angular = self.of("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=r)
        twist = self.of("geometry_msgs/msg/Twist", linear=linear, angular=angular)
        return self.of(
            "nav_msgs/msg/Odometry",
            header=self.stamp(t, off),
            child_frame_id="base_link",
            pose=self.of("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=np.zeros(36)),
            twist=self.of("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36)),
        )


@pytest.fixture
def bag(tmp_path: Path) -> Bag:
    writer = Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP)
    writer.open()
    return Bag(writer)


def closed(bag: Bag) -> Path:
    bag.writer.close()
    return Path(bag.writer.path)


def test_odometry_and_a_steering_command_of_ackermann_make_a_drive(bag: Bag) -> None:
    """Angle and speed at 20 Hz, pose and twist at 50 Hz; a picture and a command are not taken for a measurement."""
    for k in range(25 * 50):
        t = k / 50.0
        delta, v = 0.06 * np.sin(0.6 * t), 6.0 + np.sin(0.2 * t)
        bag.put("/localization/kinematic_state", t, bag.odometry(t, 0.3 * np.sin(0.3 * t), v, v * delta / 2.9))
        if k % 5 == 0:
            for topic, angle in (("/ackermann", delta), ("/control/command/ackermann", -9.0)):
                zero = dict.fromkeys(("steering_angle_velocity", "acceleration", "jerk"), 0.0)
                drive = bag.of("ackermann_msgs/msg/AckermannDrive", steering_angle=angle, speed=v, **zero)
                stamped = bag.of("ackermann_msgs/msg/AckermannDriveStamped", header=bag.stamp(t), drive=drive)
                bag.put(topic, t + 0.003, stamped)
    file = closed(bag)
    drive = read_drive(file, {"psi": "/localization/kinematic_state.pose.pose.orientation.yaw"}, trusted=True)
    assert "delta = /ackermann.drive.steering_angle [rad]" in drive.notes[0]
    assert "r = /localization/kinematic_state.twist.twist.angular.z [rad/s]" in drive.notes[0]
    assert drive.x is not None
    assert drive.psi is not None
    np.testing.assert_allclose(drive.x - drive.x[0], 5.0 * drive.t, atol=1e-4)
    np.testing.assert_allclose(drive.psi, 0.3 * np.sin(0.3 * drive.t), atol=1e-3)
    np.testing.assert_allclose(drive.delta_sw, 15.0 * 0.06 * np.sin(0.6 * drive.t), atol=2e-3)


def test_stamps_of_another_clock_are_not_taken(bag: Bag) -> None:
    for k in range(100):
        bag.put("/odom", 0.02 * k, bag.odometry(0.02 * k, 0.0, 5.0, 0.0, off=-1.0e8))
    log = read_log(closed(bag))
    assert log.notes == ("/odom: its stamps are of another clock: taken as they were received",)
    t = log.channels["/odom.pose.pose.position.x"].t
    np.testing.assert_allclose(t, 1e-9 * BEGIN + 0.02 * np.arange(100), atol=1e-6)


def test_a_folder_without_its_description_and_what_is_no_bag_teach(bag: Bag, tmp_path: Path) -> None:
    bag.put("/odom", 0.0, bag.odometry(0.0, 0.0, 5.0, 0.0))
    folder = closed(bag)
    (folder / "metadata.yaml").unlink()  # as after a recorder that was killed
    log = read_log(folder)
    assert log.notes == ("cut off or broken (no index, or no metadata.yaml): what comes before is used, 1 messages",)
    assert log.channels["/odom.twist.twist.linear.x"].values.tolist() == [5.0]
    (folder / "bag.mcap").write_bytes(b"\x89MCAP0\r\n" + bytes(99))
    with pytest.raises(ValueError, match="no ROS bag"):
        read_log(folder)
    with pytest.raises(ValueError, match=r"no ROS bag, or a broken one"):
        read(b"\x89MCAP0\r\n" + bytes(500), tmp_path)
    (tmp_path / "a.db3").write_bytes(b"SQLite format 3\0 and nothing more")
    with pytest.raises(ValueError, match=r"a\.db3: no ROS bag, or a broken one"):
        read_log(tmp_path / "a.db3")


def test_a_database_that_is_cut_off_is_refused(tmp_path: Path) -> None:
    """SQLite itself would read on, and give numbers that nobody wrote."""
    file, _ = written("ros2 sqlite", tmp_path, driven())
    whole = file.read_bytes()
    for size in (len(whole) - 1, len(whole) - 4096, len(whole) // 2):
        file.write_bytes(whole[:size])
        with pytest.raises(ValueError, match="cut off, or not closed"):
            read_log(file)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[bytes, Drive]:
    file, _ = written("ros2 mcap with sums", tmp_path_factory.mktemp("bag"), driven(60.0))
    return file.read_bytes(), read_drive(file)


def read(data: bytes, folder: Path) -> Any:
    file = folder / "drive.mcap"
    file.write_bytes(data)
    return read_drive(file)


def notes_of(drive: Drive) -> list[str]:
    return [note for note in drive.notes if note.startswith("cut off or broken")]


def test_of_a_file_that_is_cut_off_what_comes_before_is_used(whole: tuple[bytes, Drive], tmp_path: Path) -> None:
    data, right = whole
    assert not notes_of(right)
    for share in (0.6, 0.9):
        drive = read(data[: int(share * len(data))], tmp_path)
        (note,) = notes_of(drive)
        assert "what comes before is used" in note
        n = len(drive.v)
        assert 0.4 * len(right.v) < n < len(right.v)
        np.testing.assert_array_equal(drive.v[: n - 1], right.v[: n - 1])


def test_from_a_chunk_on_that_does_not_hold_its_sum_nothing_is_used(whole: tuple[bytes, Drive], tmp_path: Path) -> None:
    data, right = whole
    summary = make_reader(io.BytesIO(data)).get_summary()
    assert summary is not None
    chunk = summary.chunk_indexes[2 * len(summary.chunk_indexes) // 3]
    spoilt = bytearray(data)
    spoilt[chunk.chunk_start_offset + chunk.chunk_length // 2] ^= 16
    drive = read(bytes(spoilt), tmp_path)
    (note,) = notes_of(drive)
    assert "CRC" in note
    n = len(drive.v)
    assert 0.4 * len(right.v) < n < 0.8 * len(right.v)
    np.testing.assert_array_equal(drive.v[: n - 1], right.v[: n - 1])
