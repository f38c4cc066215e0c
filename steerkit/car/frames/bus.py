"""Opening a CAN bus of python-can, and a simulated car's port on one."""

from __future__ import annotations

import contextlib
from typing import Any, Protocol

from steerkit.car.frames.python_can import python_can


def open_bus(arguments: dict[str, Any]) -> Any:
    """`can.Bus` of these arguments; raises OSError, naming them, when it cannot be opened."""
    can = python_can()
    try:
        return can.Bus(**arguments)
    except Exception as error:  # the interfaces' own libraries raise whatever they like, a NameError included
        where = ", ".join(f"{k} = {v!r}" for k, v in arguments.items())
        raise OSError(
            f"bus {where}: cannot be opened ({error}); is the adapter there and free, its interface installed?"
        ) from error


class Port(Protocol):
    """What a simulated car asks of its end of a bus."""

    channel: str

    def wait(self, timeout: float) -> list[tuple[int, bytes]]:
        """The frames (id, data) that came in, after at most `timeout` [s] without any."""
        ...

    def send(self, frame_id: int, data: bytes) -> None:
        """A frame to whoever listens."""
        ...

    def close(self) -> None:
        """Free the port."""
        ...


class BusPort:
    """A simulated car's port on a bus that the computer has already: kernel CAN, UDP multicast, ...

    arguments: of `can.Bus`. channel: what `--channel` of the car server wants. Raises OSError.
    """

    def __init__(self, arguments: dict[str, Any]):
        self._bus = open_bus(arguments)
        self.channel = f"{arguments['interface']}:{arguments['channel']}"

    def wait(self, timeout: float) -> list[tuple[int, bytes]]:
        """The frames (id, data) that came in, after at most `timeout` [s] without any."""
        frames: list[tuple[int, bytes]] = []
        pause = max(0.0, timeout)
        while (message := self._bus.recv(pause)) is not None and len(frames) < 100:
            frames.append((message.arbitration_id, bytes(message.data)))
            pause = 0.0
        return frames

    def send(self, frame_id: int, data: bytes) -> None:
        """A frame to the bus; a full one drops it."""
        can = python_can()
        with contextlib.suppress(can.CanOperationError):
            self._bus.send(can.Message(arbitration_id=frame_id, data=data, is_extended_id=False))

    def close(self) -> None:
        """Free the bus."""
        self._bus.shutdown()
