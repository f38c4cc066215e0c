"""The TOML file: what is shipped is right, and every mistake is named with what would be valid."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from steerkit.car.config import ConfigError, load, shipped
from steerkit.diagram.units import radians_of

TEXT = shipped("dbw-kit.toml").read_text()


def changed(tmp_path: Path, old: str, new: str, text: str = TEXT) -> Path:
    assert old in text
    file = tmp_path / "car.toml"
    file.write_text(text.replace(old, new, 1))
    return file


def test_the_shipped_one_is_right() -> None:
    config = load("dbw-kit.toml")
    assert config.writer.frame_id == 0x64
    assert {r.frame_id for r in config.readers} == {0x65, 0x120, 0x121, 0x122}
    assert config.report_frames == {0x65}
    assert config.pose_frames == {0x120, 0x121, 0x122}
    assert config.gate.quantum == pytest.approx(radians_of(0.1))
    assert config.gate.delta_sw_max == pytest.approx(radians_of(520.0))
    assert config.states.report_age == 0.1
    assert config.states.pose_age == 0.15
    assert config.bus == {"interface": "slcan", "channel": "/dev/ttyACM0", "bitrate": 500000}
    assert config.quantities["v_kit"].gain == pytest.approx(1 / 3.6)
    assert len(config.fault_flags) == 5


def test_the_summary_tells_all_that_is_read_and_written_and_every_limit() -> None:
    text = "\n".join(load("dbw-kit.toml").summary())
    for word in (
        "STEERING_REPORT (0x65)",
        "STEERING_CMD (0x64)",
        "protection: counter COUNT, CRC-8 0x2F CRC, period 0.01 s",
        "protection: period 0.02 s",
        "delta_sw_max_deg = 520",
        "e_max = 2",
        "pose_age = 0.15",
        "steps of 0.1 deg",
    ):
        assert word in text


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('format = "steerkit car 1"', 'format = "2"', "expected 'steerkit car 1'"),
        ('interface = "slcan"', 'interface = "slcam"', "did you mean 'slcan'"),
        ('channel = "/dev/ttyACM0"', "channel = true", "[bus] channel = True"),
        ("bitrate = 500000", 'bitrate = "fast"', "[bus] bitrate = 'fast', expected a whole number"),
        ("[course]", "[curse]", "did you mean 'course'"),
        ("[server]", "[driver]", "driver: not known; did you mean 'server'"),
        ('"pose.dbc"]', '"poes.dbc"]', "poes.dbc: no such file"),
        ('name = "vw-passat"', 'name = "vw-pasat"', "did you mean 'vw-passat'"),
        ('signal = "ANGLE"', 'signal = "ANGEL"', "STEERING_REPORT has no signal 'ANGEL'; did you mean 'ANGLE'"),
        ('frame = "POSE_MOTION", signal = "PSI"', 'frame = "POSE", signal = "PSI"', "[read.psi] frame = 'POSE'"),
        ('signal = "VEH_VEL" }', 'signal = "VEH_VEL", unit = "deg" }', "'deg' for v_kit, expected one of 'm/s'"),
        ('signal = "ANGLE" }', 'signal = "ANGLE", sign = 2 }', "sign = 2, expected 1 or -1"),
        ('signal = "ANGLE" }', 'signal = "ANGLE", scale = -1 }', "expected scale > 0"),
        ('signal = "ANGLE" }', 'signal = "ANGLE", skale = 2 }', "did you mean 'scale'"),
        ("v_kit =", "v_kid =", "did you mean 'v_kit'"),
        ('torque = { frame = "STEERING_REPORT", signal = "TORQUE" }', "", "[read] torque: missing"),
        ("echo = {", "# echo = {", "[read] echo: missing"),
        ("STEERING_REPORT = { period = 0.02 }", "", "[protect] STEERING_REPORT = None"),
        ('POSE_MOTION = { counter = "COUNT"', 'POSE_MOTION = { counter = "COUNTER"', "did you mean 'COUNT'"),
        ('crc = "CRC", period', 'crc = "COUNT", period', "does not fill one byte"),
        ('counter = "COUNT", crc', 'counter = "COUN", crc', "did you mean 'COUNT'"),
        ('enable = "EN"', "", "[write] enable: missing"),
        ('clear = "CLEAR"', 'clear = "CLAER"', "did you mean 'CLEAR'"),
        ("fixed = { SVEL = 0 }", "fixed = { SVEL = 300 }", "[write.fixed] SVEL = 300"),
        ("listen_only = false", 'listen_only = "no"', "expected true or false"),
        ("e_max = 2.0", "e_max = 20.0", "[limits] e_max = 20, expected 0.1 to 5"),
        ("e_max = 2.0", "e_max = -1", "[limits] e_max = -1"),
        ("e_max = 2.0", "e_max = nan", "[limits] e_max = nan"),
        ("delta_sw_max_deg = 520", "delta_sw_max_deg = 521", "expected 5 to 520"),
        ("delta_sw_max_deg = 520", "delta_sw_max = 9", "did you mean 'delta_sw_max_deg'"),
        ("e_max = 2.0", "report_age = 0.5", "expected 0.02 to 0.15"),
        ("e_max = 2.0", "request_age = 0.2", "expected 0.052 to 0.09"),
        ("v_engage_max = 9.0", "v_engage_max = 11.0", "v_engage_min < v_engage_max <= v_max"),
        ('signal = "CMD" }', 'signal = "CMD" }\nx = { frame = "STEERING_REPORT", signal = "RES" }', "TOML"),
        ('name = "paper"', 'file = "nowhere.csv"\nclosed = true', "there is no"),
        ('name = "paper"', "", "give either name, such as 'paper', or file"),
        ("[read.faults]", "[read.fault]", "did you mean 'faults'"),
    ],
)
def test_mistakes_are_named(tmp_path: Path, old: str, new: str, says: str) -> None:
    with pytest.raises(ConfigError) as caught:
        load(changed(tmp_path, old, new))
    assert says in str(caught.value)
    assert "car.toml" in str(caught.value)


def test_what_the_file_says_arrives_in_its_place(tmp_path: Path) -> None:
    text = TEXT.replace("lag = 0.1 ", "lag = 0.23 ").replace("delay = 0.0 ", "delay = 0.04 ")
    text = text.replace("e_max = 2.0", "e_max = 1.5\nfollow_angle_deg = 45\nmisses = 5")
    new = 'signal = "ANGLE", sign = -1, scale = 2, offset = 0.25, unit = "rad" }'
    config = load(changed(tmp_path, 'signal = "ANGLE" }', new, text))
    assert (config.lag, config.delay) == (0.23, 0.04)
    assert (config.states.e_max, config.states.misses) == (1.5, 5)
    assert config.states.follow_angle == pytest.approx(math.pi / 4.0)
    mapping = config.quantities["delta_sw"]
    assert (mapping.sign, mapping.scale, mapping.offset, mapping.gain) == (-1.0, 2.0, 0.25, -2.0)
    facts = config.facts()["read"]["delta_sw"]
    assert (facts["gain"], facts["offset"]) == (-2.0, 0.25)
    assert config.gate.wheelbase == config.vehicle.wheelbase == config.vehicle.l_f + config.vehicle.l_r
    assert config.gate.steer_ratio == config.vehicle.steer_ratio


def test_all_mistakes_come_at_once(tmp_path: Path) -> None:
    text = TEXT.replace("e_max = 2.0", "e_max = 20.0").replace('signal = "ANGLE"', 'signal = "ANGEL"')
    with pytest.raises(ConfigError) as caught:
        load(changed(tmp_path, '"vw-passat"', '"vw"', text))
    assert len(str(caught.value).splitlines()) >= 3


def test_kit_and_pose_must_not_share_a_frame(tmp_path: Path) -> None:
    old = 'v = { frame = "POSE_MOTION", signal = "V" }'
    with pytest.raises(ConfigError, match="must come from different frames"):
        load(changed(tmp_path, old, 'v = { frame = "STEERING_REPORT", signal = "VEH_VEL" }'))


def test_no_such_file_names_the_shipped_ones() -> None:
    with pytest.raises(ConfigError, match=r"shipped: dbw-kit\.toml, dbw_steering\.dbc, pose\.dbc"):
        load("mine.toml")


def test_own_dbc_and_own_course_beside_the_file(tmp_path: Path) -> None:
    (tmp_path / "pose.dbc").write_text(shipped("pose.dbc").read_text().replace("0.001,0) [-8388", "0.01,0) [-8388"))
    points = [(50 * math.cos(a / 10), 50 * math.sin(a / 10)) for a in range(63)]
    (tmp_path / "ring.csv").write_text("x,y\n" + "\n".join(f"{x},{y}" for x, y in points))
    config = load(changed(tmp_path, 'name = "paper"', 'file = "ring.csv"\nclosed = true'))
    assert config.quantities["x"].gain == 1.0
    assert next(r for r in config.readers if r.name == "POSE_POSITION").message.get_signal_by_name("X").scale == 0.01
    assert config.course["path"].length == pytest.approx(2 * math.pi * 50, rel=0.01)
    assert {"config.toml", "pose.dbc", "ring.csv"} <= config.texts.keys()


def test_degrees_of_a_receiver_become_metres(tmp_path: Path) -> None:
    from steerkit.car.core import Core, Frame
    from steerkit.paths.courses import course

    text = TEXT.replace("\nx = {", "\n# x = {").replace("\ny = {", "\n# y = {")
    text = text.replace(
        "[protect]",
        """[read.gnss]
lat = { frame = "GNSS_POSITION", signal = "LAT" }
lon = { frame = "GNSS_POSITION", signal = "LON" }
origin_deg = [52.0, 10.0]

[protect]
GNSS_POSITION = { period = 0.01 }
""",
    )
    file = tmp_path / "car.toml"
    file.write_text(text)
    config = load(file)
    core = Core(config, course("paper"))
    message = next(r.message for r in config.readers if r.name == "GNSS_POSITION")
    core.handle(Frame(0.0, 0.0, 0x130, message.encode({"LAT": 52.001, "LON": 10.001})))
    snapshot = core.snapshot(0.0)
    assert snapshot.y == pytest.approx(111.27, abs=0.05)  # a minute of latitude there is 1854.6 m
    assert snapshot.x == pytest.approx(68.68, abs=0.05)
