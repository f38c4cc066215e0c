"""A client of Foxglove's WebSocket that asks for every topic and reads what comes."""

from __future__ import annotations

import json
import struct
from base64 import b64decode
from types import SimpleNamespace
from typing import Any

from websockets.sync.client import ClientConnection, connect


def message_of(schema: Any, data: bytes) -> dict[str, Any]:
    """A message by its schema (name, encoding, data): in JSON, or of Foxglove's own kinds."""
    if schema.encoding == "jsonschema":
        return dict(json.loads(data))
    from google.protobuf import descriptor_pb2, json_format, message_factory

    kinds = message_factory.GetMessages(descriptor_pb2.FileDescriptorSet.FromString(schema.data).file)
    shown = json_format.MessageToDict(kinds[schema.name].FromString(data), always_print_fields_with_no_presence=True)
    return dict(shown)


PROTOCOL = "foxglove.sdk.v1"


class Client:
    """One that is connected; `with` ends it."""

    def __init__(self, address: str):
        self.socket: ClientConnection = connect(address, subprotocols=[PROTOCOL], legacy=True, close_timeout=0.5)  # type: ignore[list-item]
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
        operation, channel, when = struct.unpack_from("<BIQ", data)
        assert operation == 1
        kind = self.channels[channel]
        schema = SimpleNamespace(name=kind["schemaName"], encoding=kind["schemaEncoding"], data=kind["schema"])
        if schema.encoding == "protobuf":
            schema.data = b64decode(schema.data)
        return kind["topic"], when, message_of(schema, data[13:])
