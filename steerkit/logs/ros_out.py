"""Writer of a ROS 2 bag (MCAP): steering and velocity as Autoware reports them, and odometry."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from steerkit.logs.channels import Array
from steerkit.logs.ros import typestore


def write_bag(file: Path, t: Array, signals: dict[str, Array], begin: int) -> dict[str, int]:
    """Write `/vehicle/status/steering_status`, `/vehicle/status/velocity_status` and, with x and y, `/odom`.

    signals: delta (road wheels) [rad], v [m/s], r [rad/s], and x, y [m], psi [rad] if they are known, all (n,) over
    t [s]. begin: when t = 0 is, since 1970 [ns]. Returns messages by topic. Needs rosbags (extra `logs`).
    """
    from rosbags.rosbag2 import StoragePlugin, Writer

    store = typestore()
    counts: dict[str, int] = {}
    with tempfile.TemporaryDirectory(dir=file.parent) as folder:
        place = Path(folder) / "bag"
        with Writer(place, version=9, storage_plugin=StoragePlugin.MCAP) as bag:
            topics: dict[str, Any] = {}
            for k, seconds in enumerate(t.tolist()):
                when = begin + round(seconds * 1e9)
                for topic, message in _messages(store, {n: float(s[k]) for n, s in signals.items()}, when):
                    if topic not in topics:
                        topics[topic] = bag.add_connection(topic, message.__msgtype__, typestore=store)
                    bag.write(topics[topic], when, store.serialize_cdr(message, message.__msgtype__))
                    counts[topic] = counts.get(topic, 0) + 1
        (stored,) = place.glob("*.mcap")
        shutil.move(stored, file)
    return counts


def _messages(store: Any, now: dict[str, float], when: int) -> list[tuple[str, Any]]:
    def of(name: str, **values: Any) -> Any:
        return store.types[name](**values)

    stamp = of("builtin_interfaces/msg/Time", sec=when // 10**9, nanosec=when % 10**9)
    steering = of("autoware_vehicle_msgs/msg/SteeringReport", stamp=stamp, steering_tire_angle=now["delta"])
    velocity = of(
        "autoware_vehicle_msgs/msg/VelocityReport",
        header=of("std_msgs/msg/Header", stamp=stamp, frame_id="base_link"),
        longitudinal_velocity=now["v"],
        lateral_velocity=0.0,
        heading_rate=now["r"],
    )
    messages = [("/vehicle/status/steering_status", steering), ("/vehicle/status/velocity_status", velocity)]
    if not np.isfinite([now.get("x", np.nan), now.get("y", np.nan)]).all():
        return messages
    psi = now.get("psi", 0.0)
    turned = of("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=float(np.sin(psi / 2)), w=float(np.cos(psi / 2)))
    pose = of(
        "geometry_msgs/msg/Pose",
        position=of("geometry_msgs/msg/Point", x=now["x"], y=now["y"], z=0.0),
        orientation=turned,
    )
    twist = of(
        "geometry_msgs/msg/Twist",
        linear=of("geometry_msgs/msg/Vector3", x=now["v"], y=0.0, z=0.0),
        angular=of("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=now["r"]),
    )
    odometry = of(
        "nav_msgs/msg/Odometry",
        header=of("std_msgs/msg/Header", stamp=stamp, frame_id="map"),
        child_frame_id="base_link",
        pose=of("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=np.zeros(36)),
        twist=of("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36)),
    )
    return [*messages, ("/odom", odometry)]
