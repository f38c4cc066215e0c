"""The frames of a simulated production car: what its buses say, and what its steering makes of a command's frames.

Source of names and codes: commaai/opendbc 0.3.1 (MIT), `car/MAKER/carstate.py` and `safety/modes/MAKER.h`.
"""

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from steerkit._support.files import read_toml
from steerkit.car.production.platforms import Platform

_KNOWN = {"__builtins__": {}, "abs": abs, "round": round}
SLOW = 10
"""What stands still is sent in every tenth step only."""


@dataclass(frozen=True, kw_only=True)
class Said:
    """What a production car says of itself; angles and rates + to the left, as everywhere."""

    angle_deg: float = 0.0
    """Of the steering wheel."""
    rate_deg: float = 0.0
    """Its rate, a second."""
    v: float = 0.0
    r: float = 0.0
    hand: bool = False
    """Is the human's hand at the wheel, strong enough to override?"""
    brake: bool = False
    gas: bool = False
    cruise: bool = True
    """Is its cruise control engaged? Steering is allowed only then."""
    door: bool = False
    belt: bool = True
    drive: bool = True
    """Is the lever at D?"""
    fault: bool = False
    """Has its steering a fault?"""
    motor: float = 0.0
    """The share of its largest torque that its motor gives."""


class Command(NamedTuple):
    """What a frame asks of the steering."""

    value: float
    """Steering-wheel angle [deg], curvature [1/m], or the share of the largest torque; + to the left."""
    active: bool


@cache
def _table() -> dict[str, Any]:
    return read_toml(Path(__file__).with_name("frames.toml"), "frames")


@cache
def _says(maker: str) -> dict[str, dict[str, Any]]:
    """What a maker's cars say: message, signal, and the compiled arithmetic of its value; see `frames.toml`."""
    return {
        name: {signal: compile(str(value), f"frames.toml {name}", "eval") for signal, value in signals.items()}
        for name, signals in _table()[maker].items()
    }


def steering_messages(platform: Platform, interface: Any) -> dict[int, tuple[Any, str, str, float]]:
    """The messages that steer a car, by their ids: message, signal of the value, of the request or "", sign."""
    dbc = next(iter(interface.can_parsers.values())).dbc
    other = "STEERING_LKA" if platform.steered_by == "angle" else "STEERING_LTA"
    return {
        dbc.name_to_msg[name].address: (dbc.name_to_msg[name], value, active, float(sign))
        for name, value, active, sign in _table()["steers"][platform.maker]
        if name != other and name in dbc.name_to_msg
    }


class CarFrames:
    """The frames that a production car sends, step by step, and what its steering reads of those sent to it.

    platform: which. It counts its frames, so that counters go on; what a car says otherwise is in `Said`.
    """

    def __init__(self, platform: Platform):
        from opendbc.can import CANPacker

        self.platform = platform
        interface, says = platform.interface(), _says("hyundai_can_fd" if platform.can_fd else platform.maker)
        self._messages: list[tuple[Any, Any, int, dict[str, Any]]] = []
        for parser in interface.can_parsers.values():
            if parser is None or parser.bus >= 128:
                continue  # what the computer itself sent
            packer = CANPacker(parser.dbc_name)
            names = [state.name for state in parser.message_states.values() if not state.ignore_alive]
            first = parser.bus == min(p.bus for p in interface.can_parsers.values() if p and p.message_states)
            more = _table()["checked"].get(platform.maker, ())
            names += [name for name in more if first and name not in names]
            for name in names:
                if message := parser.dbc.name_to_msg.get(name):
                    known = {signal: code for signal, code in says.get(name, {}).items() if signal in message.sigs}
                    self._messages.append((packer, message, parser.bus, known))
        self._step = 0
        self.asks = steering_messages(platform, interface)

    def send(self, said: Said) -> list[tuple[int, bytes, int]]:
        """The frames (id, data, bus) of one step of 10 ms."""
        car, frames, slow = self.platform, list[tuple[int, bytes, int]](), self._step % SLOW == 0
        factor = car.params.wheelSpeedFactor if car.maker == "toyota" else 1.0
        names = vars(said) | {"kph": 3.6 * said.v / factor, "full": car.full, "scale": car.motor_scale}
        names["code"] = car.code_of
        for packer, message, bus, codes in self._messages:
            if codes or slow:
                known = {signal: float(eval(code, _KNOWN, names)) for signal, code in codes.items()}
                data = bytes(packer.pack(message.address, known))[: _table()["shorter"].get(message.name)]
                if protect := PROTECTS.get(car.maker):  # by what the library's packer does not know
                    data = bytes(protect(message.name, bytearray(data), self._step))
                frames.append((message.address, data, bus))
        self._step += 1
        return frames

    def command(self, frame_id: int, data: bytes, v: float) -> Command | None:
        """What a frame from the computer asks of the steering at v [m/s]; None for one that does not steer."""
        from opendbc.can.parser import get_raw_value

        if frame_id not in self.asks:
            return None
        message, value, active, sign = self.asks[frame_id]

        def read(name: str) -> float:
            signal = message.sigs[name]
            raw = get_raw_value(data, signal)
            raw -= (1 << signal.size) if signal.is_signed and raw >> (signal.size - 1) else 0
            return float(raw * signal.factor + signal.offset)

        asked = sign * read(value)
        if self.platform.maker == "volkswagen":
            asked *= -1.0 if read("HCA_01_LM_OffSign" if "HCA_01_LM_OffSign" in message.sigs else "LM_OffSign") else 1.0
        on = read(active) != 0.0 if active else asked != 0.0
        return Command(asked / self.platform.full_at(v), on)


def _protect_ford(name: str, data: bytearray, count: int) -> bytearray:
    """Source: opendbc `safety/modes/ford.h`, ford_compute_checksum: 0xFF less the sum of what it protects."""
    if name == "BrakeSysFeatures":
        data[2] = data[2] & 0xC3 | (count & 0xF) << 2
        data[3] = 0xFF - (data[0] + data[1] + (data[2] >> 6) + (data[2] >> 2 & 0xF)) & 0xFF
    elif name == "Yaw_Data_FD1":
        data[5] = count & 0xFF
        data[4] = 0xFF - (sum(data[:4]) + data[5] + (data[6] >> 6) + (data[6] >> 4 & 3)) & 0xFF
    return data


def _protect_hyundai(name: str, data: bytearray, count: int) -> bytearray:
    """Source: opendbc `safety/modes/hyundai.h`, hyundai_get_counter, hyundai_compute_checksum."""
    if name == "WHL_SPD11":
        for byte, code in ((1, count), (3, count >> 2), (5, 0), (7, 0)):
            data[byte] = data[byte] & 0x3F | (code & 3) << 6
        bits = sum(byte.bit_count() for byte in data)
        bits -= sum((data[byte] >> 6).bit_count() for byte in (1, 3))
        code = (bits ^ 9) & 15
        data[5], data[7] = data[5] | (code & 3) << 6, data[7] | (code >> 2) << 6
    elif name == "TCS13":
        data[1], data[6] = data[1] & 0x1F | (count & 7) << 5, data[6] & 0xF0
        data[6] |= -_nibbles(data[:7]) & 15
    elif name == "EMS16":
        data[7] = data[7] & 0xC0 | (count & 3) << 4
        data[7] |= -_nibbles(data) & 15
    elif name == "SCC12":
        data[7] = count & 15
        data[7] |= (-_nibbles(data) & 15) << 4
    elif name == "CLU11":
        data[3] = data[3] & 0x0F | (count & 15) << 4
    return data


def _protect_rivian(name: str, data: bytearray, count: int) -> bytearray:
    """Source: opendbc `safety/modes/rivian.h`: counters from 0 to 14, CRC-8 with polynomial 0x1D."""
    from opendbc.car.rivian.riviancan import checksum

    ends = {"ESP_Status": 0xB1, "VDM_PropStatus": 0x9A}
    if name in ends:
        data[1] = data[1] & 0xF0 | count % 15
        data[0] = checksum(data[1:], 0x1D, ends[name])
    return data


PROTECTS = {"ford": _protect_ford, "hyundai": _protect_hyundai, "rivian": _protect_rivian}


def _nibbles(data: bytearray) -> int:
    return sum((byte & 15) + (byte >> 4) for byte in data)
