"""The wire formats, written down a second time from the DBC files and docs/real-car.md: bits, bytes, check sums."""

import json
import math
import struct

COMMAND, REPORT, POSITION, MOTION, DYNAMICS = 0x64, 0x65, 0x120, 0x121, 0x122
"""Ids of the frames."""


def _divided(byte: int) -> int:
    """What is left of a byte, bit by bit."""
    for _ in range(8):
        byte = (byte << 1 ^ 0x2F) & 0xFF if byte & 0x80 else byte << 1
    return byte


_LEFT = [_divided(byte) for byte in range(256)]


def crc8(data: bytes) -> int:
    """AUTOSAR's CRC-8 of polynomial 0x2F."""
    crc = 0xFF
    for byte in data:
        crc = _LEFT[crc ^ byte]
    return crc ^ 0xFF


def _guarded(body: bytes, frame_id: int) -> bytes:
    return body + bytes([crc8(body + bytes([frame_id & 0xFF, frame_id >> 8]))])


def _code(value: float, step: float, bits: int) -> int:
    """A signed code; NaN is the code of `not available`."""
    if not math.isfinite(value):
        return 1 << (bits - 1)
    most = (1 << (bits - 1)) - 1
    return max(-most, min(most, round(value / step))) & ((1 << bits) - 1)


def position(x: float, y: float, *, quality: int, count: int) -> bytes:
    """POSE_POSITION: x, y [m] in millimetres, quality, counter, CRC."""
    body = _code(x, 0.001, 24) | _code(y, 0.001, 24) << 24 | (quality & 15) << 48 | (count & 15) << 52
    return _guarded(body.to_bytes(7, "little"), POSITION)


def motion(psi: float, v: float, r: float, *, count: int) -> bytes:
    """POSE_MOTION: psi [rad], v [m/s], r [rad/s], counter, CRC."""
    angle = math.remainder(psi, 2.0 * math.pi)
    body = _code(angle, 1e-4, 16) | _code(v, 1e-3, 16) << 16 | _code(r, 1e-4, 16) << 32 | (count & 15) << 52
    return _guarded(body.to_bytes(7, "little"), MOTION)


def dynamics(beta: float, a_y: float, stamp: float, *, count: int) -> bytes:
    """POSE_DYNAMICS: beta [rad], a_y [m/s^2], time of measurement [s] in wrapping milliseconds, counter, CRC."""
    body = _code(beta, 1e-4, 16) | _code(a_y, 1e-3, 16) << 16 | (round(stamp * 1e3) & 0xFFFF) << 32
    return _guarded((body | (count & 15) << 52).to_bytes(7, "little"), DYNAMICS)


FLAGS = ("ENABLED", "OVERRIDE", "FLTPWR", "FLTWDC", "FLTBUS1", "FLTBUS2", "FLTCAL", "TMOUT")


def report(angle_deg: float, echo_deg: float, v: float, torque: float, flags: set[str]) -> bytes:
    """STEERING_REPORT: wheel and echoed command [deg], v [m/s] in km/h, torque [N m], flags; no counter, no CRC."""
    raised = sum(1 << i for i, name in enumerate(FLAGS) if name in flags)
    body = _code(angle_deg, 0.1, 16) | _code(echo_deg, 0.1, 15) << 16 | _code(3.6 * v, 0.01, 16) << 32
    return (body | _code(torque, 0.0625, 8) << 48 | raised << 56).to_bytes(8, "little")


def command(data: bytes) -> tuple[float, bool, bool]:
    """STEERING_CMD: wheel [rad], enable, clear."""
    (tenths,) = struct.unpack_from("<h", data)
    return math.radians(tenths / 10.0), bool(data[2] & 1), bool(data[2] & 2)


HELLO = {True: b'["Hello", true, 7, "", "own client"]', False: b'["Hello", false, 7, "", "own panel"]'}
"""By whether it is the controller's."""
ORDERS = {name: f'["Command", "{name}"]'.encode() for name in ("ARM", "ENGAGE", "DISENGAGE", "ACKNOWLEDGE", "OFF")}
QUERY, BEAT = b'["Query"]', b'["Beat"]'
_KNOWN = "t x y psi v beta r a_y delta_sw v_kit torque e psi_e command report_age pose_age request_age errors"


def asked(basis: float, angle: float, misses: int) -> bytes:
    """A client's request: the time of the snapshot behind it [s], an angle [rad], missed deadlines."""
    return json.dumps(["Request", basis, angle, misses]).encode()


def snapshot(data: bytes) -> dict[str, float]:
    """What the car server says that it knows; nothing, if it says something else."""
    kind, *values = json.loads(data)
    return dict(zip(_KNOWN.split(), values)) if kind == "Snapshot" else {}
