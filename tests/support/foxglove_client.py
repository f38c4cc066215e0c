"""A client of Foxglove's WebSocket that asks for every topic and reads what comes."""

from __future__ import annotations

import json
import struct
from typing import Any

from websockets.sync.client import ClientConnection, connect

PROTOCOL = "foxglove.sdk.v1"


class Client:
    """One that is connected; `with` ends it."""

    def __init__(self, address: str):
        self.socket: ClientConnection = connect(address, subprotocols=[PROTOCOL], legacy=True)  # type: ignore[list-item]
        self.info = self.words()
        self.channels: dict[int, dict[str, Any]] = {}

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *_: object) -> None:
        self.socket.close()

    def words(self) -> dict[str, Any]:
        """The next message in JSON; those with numbers before it are lost."""
        while isinstance(text := self.socket.recv(timeout=20.0), bytes):
            pass
        return dict(json.loads(text))

    def ask(self, words: dict[str, Any] | bytes) -> None:
        """Send words, or a binary message."""
        self.socket.send(words if isinstance(words, bytes) else json.dumps(words))

    def subscribe(self, count: int) -> None:
        """To all topics, once so many are there."""
        while len(self.channels) < count:
            words = self.words()
            assert words["op"] == "advertise", words
            self.channels |= {channel["id"]: channel for channel in words["channels"]}
        self.ask({"op": "subscribe", "subscriptions": [{"id": k, "channelId": k} for k in self.channels]})

    def next(self, within: float = 20.0) -> tuple[str, int, dict[str, Any]] | None:
        """The next message with numbers: topic, time [ns], values; None if there is none within so long [s]."""
        try:
            while not isinstance(data := self.socket.recv(timeout=within), bytes):
                pass
        except TimeoutError:
            return None
        kind, channel, when = struct.unpack_from("<BIQ", data)
        assert kind == 1
        return self.channels[channel]["topic"], when, json.loads(data[13:])
