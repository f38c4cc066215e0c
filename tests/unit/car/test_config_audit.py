"""`check` as an auditor: files whose parts are each valid, and which are no car all the same."""

from __future__ import annotations

from pathlib import Path

import pytest

from steerkit.car.config import ConfigError, load, shipped

TEXT = shipped("dbw-kit.toml").read_text(encoding="utf-8")
DBC = {name: shipped(name).read_text(encoding="cp1252") for name in ("dbw_steering.dbc", "pose.dbc")}
FILE, KIT, POSE = "car.toml", "dbw_steering.dbc", "pose.dbc"


def said(folder: Path, *changes: tuple[str, str, str]) -> str:
    """What is said of the shipped configuration with some texts exchanged: (file, old, new)."""
    texts = {FILE: TEXT, **DBC}
    for name, old, new in changes:
        assert old in texts[name], old
        texts[name] = texts[name].replace(old, new, 1)
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="cp1252")
    try:
        load(folder / FILE)
    except ConfigError as error:
        return str(error)
    return ""


def test_the_shipped_one_passes_beside_its_own_copies(tmp_path: Path) -> None:
    assert said(tmp_path) == ""


CASES = {
    "command range smaller than the allowed angle": (
        [(KIT, "SG_ SCMD : 0|16@1- (0.1,0) [-3276.7|3276.7]", "SG_ SCMD : 0|16@1- (0.1,0) [-400|400]")],
        "delta_sw_max_deg = 520 is more than SCMD",
    ),
    "command in steps of 5 degrees": (
        [(KIT, "SG_ SCMD : 0|16@1- (0.1,0)", "SG_ SCMD : 0|16@1- (5,0)")],
        "steps of 5 deg",
    ),
    "a flag that switches protection off": (
        [(FILE, "fixed = { SVEL = 0 }", "fixed = { SVEL = 0, IGNORE = 1 }")],
        "IGNORE = 1, expected 0",
    ),
    "a fixed signal that is written anyway": (
        [(FILE, "fixed = { SVEL = 0 }", "fixed = { EN = 1 }")],
        "EN is written by [write] already",
    ),
    "enable with more than one bit": ([(FILE, 'enable = "EN"', 'enable = "SVEL"')], "more than one bit"),
    "one signal, two roles": ([(FILE, 'clear = "CLEAR"', 'clear = "EN"')], "EN has 2 roles"),
    "an empty fault list": (
        [(FILE, 'signals = ["FLTPWR", "FLTWDC", "FLTBUS1", "FLTBUS2", "FLTCAL"]', "signals = []")],
        "expected at least one flag",
    ),
    "one signal read twice": (
        [
            (
                FILE,
                'echo = { frame = "STEERING_REPORT", signal = "CMD" }',
                'echo = { frame = "STEERING_REPORT", signal = "ANGLE" }',
            )
        ],
        "ANGLE is read as 2 quantities",
    ),
    "angle and echo swapped": (
        [
            (
                FILE,
                'delta_sw = { frame = "STEERING_REPORT", signal = "ANGLE" }',
                'delta_sw = { frame = "STEERING_REPORT", signal = "CMD" }',
            ),
            (
                FILE,
                'echo = { frame = "STEERING_REPORT", signal = "CMD" }',
                'echo = { frame = "STEERING_REPORT", signal = "ANGLE" }',
            ),
        ],
        "are the two swapped?",
    ),
    "enabled and override swapped": (
        [
            (FILE, 'signal = "ENABLED" }', 'signal = "OVERRIDE"}'),
            (FILE, 'signal = "OVERRIDE" }', 'signal = "ENABLED"}'),
        ],
        "are the two swapped?",
    ),
    "x and y swapped": (
        [(FILE, 'signal = "X" }', 'signal = "Y"}'), (FILE, 'signal = "Y" }', 'signal = "X"}')],
        "are the two swapped?",
    ),
    "x and y in different frames": (
        [
            (
                FILE,
                'y = { frame = "POSE_POSITION", signal = "Y" }',
                'y = { frame = "POSE_DYNAMICS", signal = "A_Y", unit = "m" }',
            )
        ],
        "expected one frame",
    ),
    "a flag that is a number": (
        [
            (
                FILE,
                'timeout = { frame = "STEERING_REPORT", signal = "TMOUT" }',
                'timeout = { frame = "STEERING_REPORT", signal = "VEH_VEL", unit = "1" }',
            )
        ],
        "",
    ),
    "a multiplexed frame": (
        [(POSE, "SG_ X : 0|24@1-", "SG_ X m0 : 0|24@1-"), (POSE, "SG_ QUALITY : 48", "SG_ QUALITY M : 48")],
        "is multiplexed",
    ),
    "a signal of scale zero": ([(POSE, "SG_ R : 32|16@1- (0.0001,0)", "SG_ R : 32|16@1- (0,0)")], "scale 0"),
    "a torque that cannot reach its limit": (
        [(FILE, "e_max = 2.0", "torque_max = 7.5")],
        "[read.torque] TORQUE reaches from",
    ),
    "a speed that cannot reach its limit": (
        [(POSE, '[-32.767|32.767] "m/s"', '[-5|5] "m/s"')],
        "[read.v] V reaches from",
    ),
    "no period for a frame without protection": (
        [(FILE, "STEERING_REPORT = { period = 0.02 }", "STEERING_REPORT = { }")],
        "only their number tells a second sender",
    ),
    "a period of a minute": (
        [(FILE, "STEERING_REPORT = { period = 0.02 }", "STEERING_REPORT = { period = 60.0 }")],
        "expected 0.002 to 0.1 s",
    ),
    "the message rate of the gate": (
        [(FILE, "e_max = 2.0", "dt_min = 1e-5")],
        "dt_min = 1e-05, expected 0.004 to 0.02",
    ),
    "a jump as long as the course": ([(FILE, "e_max = 2.0", "pose_jump = 100.0")], "pose_jump = 100, expected 0.05 to"),
    "enable and clear swapped": (
        [(FILE, 'enable = "EN"', 'enable = "CLEAR"'), (FILE, 'clear = "CLEAR" ', 'clear = "EN" ')],
        "[write] enable = 'CLEAR' is named like clear; are the two swapped?",
    ),
    "alert and enable swapped": (
        [(FILE, 'enable = "EN"', 'enable = "ALERT"'), (FILE, 'alert = "ALERT" ', 'alert = "EN" ')],
        "[write] alert = 'EN' is named like enable",
    ),
    "a flag that switches protection off while steering": (
        [(FILE, 'enable = "EN"', 'enable = "IGNORE"')],
        "[write] enable = 'IGNORE' switches a protection of the kit off",
    ),
    "a flag that switches protection off when faults are cleared": (
        [(FILE, 'clear = "CLEAR"', 'clear = "IGNORE"')],
        "[write] clear = 'IGNORE' switches a protection of the kit off",
    ),
    "a flag that calibrates the kit at every takeover": (
        [(FILE, 'alert = "ALERT"', 'alert = "CAL"')],
        "[write] alert = 'CAL' switches a protection of the kit off; expected the signal for alert",
    ),
    "a speed that counts": (
        [(FILE, 'counter = "COUNT"\nfixed = { SVEL = 0 }', 'counter = "SVEL"')],
        "counter = 'SVEL' counts in steps of 4 from 0, expected 1 from 0",
    ),
    "a read counter with steps": (
        [(POSE, "SG_ COUNT : 52|4@1+ (1,0)", "SG_ COUNT : 52|4@1+ (1,3)")],
        "[protect.POSE_POSITION] counter = 'COUNT' counts in steps of 1 from 3",
    ),
    "a counter that is the CRC": (
        [(FILE, 'POSE_MOTION = { counter = "COUNT"', 'POSE_MOTION = { counter = "CRC"')],
        "[protect] POSE_MOTION: CRC has two parts",
    ),
    "a counter for a time stamp": (
        [(FILE, 'signal = "STAMP" }', 'signal = "COUNT", unit = "ms" }')],
        "[protect] POSE_DYNAMICS: COUNT has two parts",
    ),
    "a pose every minute": (
        [
            (
                FILE,
                'POSE_MOTION = { counter = "COUNT", crc = "CRC", period = 0.01',
                'POSE_MOTION = { counter = "COUNT", period = 60',
            )
        ],
        "[protect] POSE_MOTION: period = 60 s, expected 0.002 to 0.1 s, or none",
    ),
    "a pose at no time": (
        [
            (
                FILE,
                'POSE_MOTION = { counter = "COUNT", crc = "CRC", period = 0.01',
                'POSE_MOTION = { counter = "COUNT", period = nan',
            )
        ],
        "[protect] POSE_MOTION: period = nan s",
    ),
    "a heading that reaches half around": (
        [(POSE, '[-3.2767|3.2767] "rad"', '[-1.5708|1.5708] "rad"')],
        "[read.psi] reaches from -1.571 to 1.571 rad, expected a whole circle",
    ),
    "a vehicle file that is not there": (
        [(FILE, 'name = "vw-passat"', 'name = "my-car.toml"')],
        "my-car.toml cannot be read",
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_a_car_that_is_none_is_refused_with_what_would_be_valid(name: str, tmp_path: Path) -> None:
    changes, words = CASES[name]
    text = said(tmp_path, *changes)
    assert text
    assert words in text


def test_a_vehicle_file_beside_the_configuration_is_read_and_recorded(tmp_path: Path) -> None:
    from steerkit.vehicles import VW_PASSAT
    from steerkit.vehicles.file import vehicle_text

    (tmp_path / "my-car.toml").write_text(vehicle_text(VW_PASSAT))
    assert said(tmp_path, (FILE, 'name = "vw-passat"', 'name = "my-car.toml"')) == ""
    config = load(tmp_path / FILE)
    assert config.vehicle == VW_PASSAT
    assert "my-car.toml" in config.texts
