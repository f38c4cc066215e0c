"""The TOML file of a car: what is shipped is right, and every mistake is named with what would be valid."""

import math
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import pytest

from steerkit.car.config import bus_of, check_pace, load, shipped
from steerkit.car.ports import open_bus
from steerkit.car.senses import Senses

KIT = "dbw-kit.toml"
FILES = {name: shipped(name).read_text(encoding="cp1252") for name in (KIT, "dbw_steering.dbc", "pose.dbc")}
TEXT = FILES[KIT]


def changed(folder: Path, *changes: str) -> Path:
    """The shipped files with changes such as `old -> new`, each in the first of them that holds `old`."""
    texts = dict(FILES)
    for change in changes:
        old, new = change.split(" -> ")
        home = next(name for name in texts if old in texts[name])
        texts[home] = texts[home].replace(old, new, 1)
    texts["car.toml"] = texts.pop(KIT)
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="cp1252")
    return folder / "car.toml"


def test_the_summary_tells_all_that_is_read_and_written_and_every_limit() -> None:
    text = "\n".join(load("dbw-kit.toml").summary())
    words = ["STEERING_REPORT (0x65)", "STEERING_CMD (0x64)", "steps of 0.1 deg", "protection: period 0.02 s"]
    words += ["protection: counter COUNT, CRC-8 0x2F CRC, period 0.01 s", "delta_sw_max_deg = 520", "pose_age = 0.15"]
    assert [word for word in words if word not in text] == []


NO_CRC = 'MOTION = { counter = "COUNT", crc = "CRC", period = 0.01 -> MOTION = { counter = "COUNT", period = '
"""And another period."""
MISTAKES = [
    ("expected 'steerkit car 1'", 'format = "steerkit car 1" -> format = "2"'),
    ("did you mean 'slcan'", 'interface = "slcan" -> interface = "slcam"'),
    ("[bus] channel = True", 'channel = "/dev/ttyACM0" -> channel = true'),
    ("[bus] bitrate = 'fast', expected a whole number", 'bitrate = 500000 -> bitrate = "fast"'),
    ("did you mean 'course'", "[course] -> [curse]"),
    ("table 'driver' is not known (did you mean 'server'?)", "[server] -> [driver]"),
    ("poes.dbc: no such file", '"pose.dbc"] -> "poes.dbc"]'),
    ("did you mean 'vw-passat'", 'name = "vw-passat" -> name = "vw-pasat"'),
    ("signal of STEERING_REPORT 'ANGEL' is not known (did you mean 'ANGLE'?)", 'signal = "ANGLE" -> signal = "ANGEL"'),
    ("[read.psi] frame 'POSE' is not known", 'frame = "POSE_MOTION", signal = "PSI" -> frame = "POSE", signal = "PSI"'),
    ("'deg' for v_kit, expected one of 'm/s'", 'signal = "VEH_VEL" } -> signal = "VEH_VEL", unit = "deg" }'),
    ("sign = 2, expected 1 or -1", 'signal = "ANGLE" } -> signal = "ANGLE", sign = 2 }'),
    ("expected scale > 0", 'signal = "ANGLE" } -> signal = "ANGLE", scale = -1 }'),
    ("did you mean 'scale'", 'signal = "ANGLE" } -> signal = "ANGLE", skale = 2 }'),
    ("did you mean 'v_kit'", "v_kit = -> v_kid ="),
    ("[read] torque: missing", 'torque = { frame = "STEERING_REPORT", signal = "TORQUE" } -> '),
    ("[read] echo: missing", "echo = { -> # echo = {"),
    ("or, for a frame that has neither, { period = ... }", "STEERING_REPORT = { period = 0.02 } -> "),
    ("counts to less than 6, too few", "SG_ COUNT : 52|4@1+ -> SG_ COUNT : 52|2@1+"),
    ("[protect] STEERING_REPORT = None", "STEERING_REPORT = { period = 0.02 } -> "),
    ("did you mean 'COUNT'", 'POSE_MOTION = { counter = "COUNT" -> POSE_MOTION = { counter = "COUNTER"'),
    ("does not fill one byte", 'crc = "CRC", period -> crc = "COUNT", period'),
    ("did you mean 'COUNT'", 'counter = "COUNT", crc -> counter = "COUN", crc'),
    ("[write] enable: missing", 'enable = "EN" -> '),
    ("did you mean 'CLEAR'", 'clear = "CLEAR" -> clear = "CLAER"'),
    ("[write.fixed] SVEL = 300", "fixed = { SVEL = 0 } -> fixed = { SVEL = 300 }"),
    ("expected true or false", 'listen_only = false -> listen_only = "no"'),
    ("[kit] lag = 1.01 s, expected 0 to 1 s", "lag = 0.1 -> lag = 1.01"),
    ("[limits] e_max = nan", "e_max = 2.0 -> e_max = nan"),
    ("[limits] e_max = 1000", f"e_max = 2.0 -> e_max = {10**400}"),
    ("[limits] delta_sw_max_deg = 5200, expected ", "delta_sw_max_deg = 520 -> delta_sw_max_deg = 5200"),
    ("[limits] misses = 1000", f"e_max = 2.0 -> misses = {10**400}"),
    ("cannot be read as TOML", f"e_max = 2.0 -> e_max = {5000 * '['}"),
    ("did you mean 'delta_sw_max_deg'", "delta_sw_max_deg = 520 -> delta_sw_max = 9"),
    ("v_engage_min < v_engage_max <= v_max", "v_engage_max = 9.0 -> v_engage_max = 11.0"),
    ("TOML", 'signal = "CMD" } -> signal = "CMD" }\nx = { frame = "STEERING_REPORT", signal = "RES" }'),
    ("[course] file = 'nowhere.csv': ", 'name = "paper" -> file = "nowhere.csv"\nclosed = true'),
    ("give either name, such as 'paper', or file", 'name = "paper" -> '),
    ("did you mean 'faults'", "[read.faults] -> [read.fault]"),
    ("delta_sw_max_deg = 520 is more than SCMD", "(0.1,0) [-3276.7|3276.7] -> (0.1,0) [-400|400]"),
    ("steps of 5 deg", "SG_ SCMD : 0|16@1- (0.1,0) -> SG_ SCMD : 0|16@1- (5,0)"),
    ("CMD_TYPE = 1, expected 0, or a value that the DBC", "fixed = { SVEL = 0 } -> fixed = { CMD_TYPE = 1 }"),
    ("scales from 1e-12 to 1e+09, offsets up to 1e+09", 'signal = "QUALITY" } -> signal = "QUALITY", scale = 1e308 }'),
    ("offsets up to 1e+09", 'signal = "QUALITY" } -> signal = "QUALITY", offset = -1e308 }'),
    (", offset 0 in the DBC, expected scales from", "SG_ QUALITY : 48|4@1+ (1,0) -> SG_ QUALITY : 48|4@1+ (1E308,0)"),
    ("[read.v] V: steps of 1 [SI], expected at most 0.5", 'signal = "V" } -> signal = "V", scale = 1000 }'),
    ("[read.x] X: steps of 2 [SI], expected at most 1", "SG_ X : 0|24@1- (0.001,0) -> SG_ X : 0|24@1- (2,0)"),
    ("[files] dbc: pose.dbc: ", 'BU_: INS PC -> {"no": "DBC"} BO_'),
    ("[files] dbc: /dev/zero: /dev/zero: is a device or a pipe", '"pose.dbc"] -> "/dev/zero"]'),
    ("/dev/zero: is a device or a pipe", 'name = "paper" -> file = "/dev/zero"\nclosed = true'),
    ("[bus] channel 'spy://x/ttyACM0': expected a serial device", 'channel = "/dev -> channel = "spy://x'),
    ("options: channel = 'spy://x', expected", 'options = {} -> options = { channel = "spy://x" }'),
    ("options: can_filters = [], expected", "options = {} -> options = { can_filters = [] }"),
    ("IGNORE = 1, expected 0", "fixed = { SVEL = 0 } -> fixed = { SVEL = 0, IGNORE = 1 }"),
    ("EN is written by [write] already", "fixed = { SVEL = 0 } -> fixed = { EN = 1 }"),
    ("more than one bit", 'enable = "EN" -> enable = "SVEL"'),
    ("EN has 2 roles", 'clear = "CLEAR" -> clear = "EN"'),
    ("expected at least one flag", 'signals = ["FLTPWR", "FLTWDC", "FLTBUS1", "FLTBUS2", "FLTCAL"] -> signals = []'),
    ("ANGLE is read as 2 quantities", 'signal = "CMD" } -> signal = "ANGLE"}'),
    ("are the two swapped?", 'signal = "ANGLE" } -> signal = "CMD"}', 'signal = "CMD" } -> signal = "ANGLE"}'),
    ("are the two swapped?", '"ENABLED" } -> "OVERRIDE"}', '"OVERRIDE" } -> "ENABLED"}'),
    ("are the two swapped?", 'signal = "X" } -> signal = "Y"}', 'signal = "Y" } -> signal = "X"}'),
    ("expected one frame", '"POSE_POSITION", signal = "Y" } -> "POSE_DYNAMICS", signal = "A_Y", unit = "m" }'),
    ("[read.timeout] signal = 'VEH_VEL' has 16 bits", 'signal = "TMOUT" } -> signal = "VEH_VEL", unit = "1" }'),
    ("is multiplexed", "SG_ X : 0|24@1- -> SG_ X m0 : 0|24@1-", "SG_ QUALITY : 48 -> SG_ QUALITY M : 48"),
    ("scale 0", "SG_ R : 32|16@1- (0.0001,0) -> SG_ R : 32|16@1- (0,0)"),
    ("[read.torque] TORQUE reaches from", "e_max = 2.0 -> torque_max = 7.5"),
    ("[read.v] V reaches from", '[-32.767|32.767] "m/s" -> [-5|5] "m/s"'),
    ("only their number tells a second sender", "STEERING_REPORT = { period = 0.02 } -> STEERING_REPORT = { }"),
    ("expected 0.002 to 0.1 s", "STEERING_REPORT = { period = 0.02 } -> STEERING_REPORT = { period = 60.0 }"),
    ("[write] enable = 'CLEAR' is named like clear", '= "EN" -> = "CLEAR"', 'clear = "CLEAR"  -> clear = "EN" '),
    ("[write] alert = 'EN' is named like enable", '= "EN" -> = "ALERT"', 'alert = "ALERT"  -> alert = "EN" '),
    ("[write] enable = 'IGNORE' switches a protection of the kit off", 'enable = "EN" -> enable = "IGNORE"'),
    ("[write] clear = 'IGNORE' switches a protection of the kit off", 'clear = "CLEAR" -> clear = "IGNORE"'),
    ("[write] alert = 'CAL' switches a protection of the kit off", 'alert = "ALERT" -> alert = "CAL"'),
    ("counter = 'SVEL' counts in steps of 4 from 0", 'counter = "COUNT"\nfixed = { SVEL = 0 } -> counter = "SVEL"'),
    ("[protect.POSE_POSITION] counter = 'COUNT'", "SG_ COUNT : 52|4@1+ (1,0) -> SG_ COUNT : 52|4@1+ (1,3)"),
    ("[protect] POSE_MOTION: CRC has two parts", 'MOTION = { counter = "COUNT" -> MOTION = { counter = "CRC"'),
    ("[protect] POSE_DYNAMICS: COUNT has two parts", 'signal = "STAMP" } -> signal = "COUNT", unit = "ms" }'),
    ("[protect] POSE_MOTION: period = 60 s, expected 0.002 to 0.1 s, or none", f"{NO_CRC}60"),
    ("[protect] POSE_MOTION: period = nan s", f"{NO_CRC}nan"),
    ("[read.psi] reaches from -1.571 to 1.571 rad", '[-3.2767|3.2767] "rad" -> [-1.5708|1.5708] "rad"'),
    ("must come from different frames", '"POSE_MOTION", signal = "V" } -> "STEERING_REPORT", signal = "VEH_VEL" }'),
    ("my-car.toml cannot be read", 'name = "vw-passat" -> name = "my-car.toml"'),
]


@pytest.mark.parametrize(("says", "changes"), [(says, changes) for says, *changes in MISTAKES])
def test_mistakes_are_named(tmp_path: Path, says: str, changes: list[str]) -> None:
    with pytest.raises(ValueError, match=r"car\.toml") as caught:
        load(changed(tmp_path, *changes))
    assert says in str(caught.value)


def test_what_the_file_says_arrives_in_its_place(tmp_path: Path) -> None:
    limits = "e_max = 2.0 -> e_max = 1.5\nfollow_angle_deg = 45\nmisses = 1"
    angle = 'signal = "ANGLE" } -> signal = "ANGLE", sign = -1, scale = 2, offset = 0.25, unit = "rad" }'
    report = "STEERING_REPORT = { period = 0.02 } -> STEERING_REPORT = { period = 0.002 }"
    count, kit = "SG_ COUNT : 52|4@1+ -> SG_ COUNT : 52|3@1+", ("lag = 0.1 -> lag = 1.0", "delay = 0.0 -> delay = 0.04")
    config = load(changed(tmp_path, *kit, limits, angle, report, f"{NO_CRC}0.1", count))
    assert (config.lag, config.delay) == (1.0, 0.04)
    assert (config.states.e_max, config.states.misses) == (1.5, 1)
    assert [r.period for r in config.readers if r.name in ("STEERING_REPORT", "POSE_MOTION")] == [0.002, 0.1]
    assert config.states.follow_angle == pytest.approx(math.pi / 4.0)
    mapping = config.quantities["delta_sw"]
    assert (mapping.sign, mapping.scale, mapping.offset, mapping.gain) == (-1.0, 2.0, 0.25, -2.0)


def test_all_contradictions_come_at_once(tmp_path: Path) -> None:
    swapped = ('"ENABLED" } -> "OVERRIDE"}', '"OVERRIDE" } -> "ENABLED"}')
    with pytest.raises(ValueError, match="are the two swapped") as caught:
        load(changed(tmp_path, *swapped, "SG_ SCMD : 0|16@1- (0.1,0) -> SG_ SCMD : 0|16@1- (5,0)"))
    assert len(str(caught.value).splitlines()) >= 3


def test_degrees_of_a_receiver_become_metres(tmp_path: Path) -> None:
    gnss = """[protect] -> [read.gnss]
lat = { frame = "GNSS_POSITION", signal = "LAT" }
lon = { frame = "GNSS_POSITION", signal = "LON" }
origin_deg = [52.0, 10.0]

[protect]
GNSS_POSITION = { period = 0.01 }
"""
    config = load(changed(tmp_path, "\nx = { -> \n# x = {", "\ny = { -> \n# y = {", gnss))
    senses = Senses(config)
    message = next(r.message for r in config.readers if r.name == "GNSS_POSITION")
    senses.frame(0.0, 0.0, 0x130, message.encode({"LAT": 52.001, "LON": 10.001}), ())
    assert senses.values["y"] == pytest.approx(111.27, abs=0.05)  # a minute of latitude there is 1854.6 m
    assert senses.values["x"] == pytest.approx(68.68, abs=0.05)


SLCAN = {"interface": "slcan", "bitrate": 500000, "sleep_after_open": 0.0}


@pytest.mark.parametrize(
    ("channel", "bus"),
    [
        ("", None),
        ("socketcan:vcan0", {"interface": "socketcan", "channel": "vcan0"}),
        ("/dev/pts/7", {"channel": "/dev/pts/7", **SLCAN}),
        ("socket://127.0.0.1:5000", {"channel": "socket://127.0.0.1:5000", **SLCAN}),
    ],
)
def test_a_channel_is_a_bus(channel: str, bus: Any) -> None:
    assert bus_of(channel) == bus


@pytest.mark.parametrize(
    "channel",
    [
        *("spy:///dev/ttyS0?file={}", "SPY://loop://?file={}&all", "slcan:spy://loop://?file={}", "alt://{}?class=X"),
        *("socket://127.0.0.1:7?file={}", "cantact:{}", "serial:spy://loop://?file={}", "mcp23:{}"),
    ],
)
def test_a_channel_that_is_no_bus_of_the_guide_is_refused_before_it_is_opened(tmp_path: Path, channel: str) -> None:
    (tmp_path / "mine").write_text("kept")
    channel = channel.format(tmp_path / "mine")
    with pytest.raises(ValueError, match=r"^\[bus\] "):
        bus_of(channel)
    interface, _, place = channel.rpartition(":" if channel.startswith(("slcan:", "serial:")) else "no such")
    with pytest.raises(OSError, match="cannot be opened"):
        open_bus({"interface": interface.split(":")[0] or "slcan", "channel": place})
    assert (tmp_path / "mine").read_text() == "kept"


REAL = ("", "/dev/ttyACM0", "socket://127.0.0.1:5000", "socketcan:can0", "pcan:PCAN_USBBUS1")


@pytest.mark.parametrize("channel", [*REAL, "/dev/pts/7", "socketcan:vcan0", "virtual:x"])
def test_time_runs_as_in_reality_where_a_real_car_may_be(channel: str) -> None:
    bus = bus_of(channel) or load(KIT).bus
    check_pace(1.0, bus)
    refused = pytest.raises(ValueError, match=r"--time-scale 0\.5 on .*: a real car has real time")
    with refused if channel in REAL else nullcontext():
        check_pace(0.5, bus)


def test_the_file_s_bus_is_taken_unless_a_channel_is_given() -> None:
    usual, other = load(KIT), load(KIT, "virtual:x")
    assert usual.bus == load(KIT).bus
    assert other.bus == {"interface": "virtual", "channel": "x"} != usual.bus
