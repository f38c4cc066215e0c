"""What is left of an MCAP of ROS 2 that is cut off or spoilt: its intact messages, in the order of the file."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from steerkit._support.files import Bounded


def intact(file: Path, heavy: tuple[str, ...], notes: list[str]) -> Iterator[tuple[str, str, float, Any]]:
    """(topic, kind, when it was received [s], message) up to where the file breaks off; chunks whose check sum is wrong
    are left out. A note says so.

    The index at the file's end is not needed; where it is there, it tells of topics whose description is lost. heavy:
    kinds that are passed over. Needs mcap and rosbags.
    """
    from mcap.records import Channel, Message, Schema
    from rosbags.typesys import Stores, get_typestore

    store, kinds, topics = get_typestore(Stores.EMPTY), dict[int, str](), dict[int, tuple[str, str]]()
    for record in _records(file):
        try:
            if isinstance(record, Schema):
                kinds[record.id] = _learned(store, record)
            elif isinstance(record, Channel) and record.message_encoding == "cdr":
                topics[record.id] = record.topic, kinds[record.schema_id]
        except Exception:  # of rosbags, for a text that describes no message
            continue
    count, trouble = 0, dict[str, int]()
    for record in _records(file):
        if isinstance(record, str):
            trouble[record] = trouble.get(record, 0) + 1
        elif isinstance(record, Message) and record.channel_id in topics:
            topic, name = topics[record.channel_id]
            kind = name.rpartition("/")[2]
            if kind in heavy:
                continue
            try:
                message = store.deserialize_cdr(record.data, name)
            except Exception:  # bytes that are not what their kind says
                trouble["a message that cannot be read"] = trouble.get("a message that cannot be read", 0) + 1
                continue
            count += 1
            yield topic, kind, 1e-9 * record.log_time, message
    told = ", ".join(f"{number} times {what}" if number > 1 else what for what, number in trouble.items())
    notes.append(
        f"cut off or broken ({told or 'no index, or no metadata.yaml'}): what is intact is used, {count} messages"
    )


def _records(file: Path) -> Iterator[Any]:
    """The records of a file, those in chunks too; in words, what is wrong with a chunk, or why there are no more."""
    from mcap.records import Chunk
    from mcap.stream_reader import StreamReader, breakup_chunk

    with Bounded(file) as stream:
        try:
            for record in StreamReader(stream, emit_chunks=True, record_size_limit=file.stat().st_size).records:
                if not isinstance(record, Chunk):
                    yield record
                    continue
                try:
                    inside = breakup_chunk(record, validate_crc=True)
                except Exception:  # its check sum is wrong, or the packers' errors
                    yield "a chunk that is not intact"
                    continue
                yield from inside
        except Exception as error:  # mcap's own, struct's, and whatever text may be
            yield f"{type(error).__name__} {error}".strip()[:80]


def _learned(store: Any, schema: Any) -> str:
    from rosbags.typesys import get_types_from_idl, get_types_from_msg

    text = schema.data.decode()
    types = get_types_from_idl(text) if schema.encoding == "ros2idl" else get_types_from_msg(text, schema.name)
    store.register({name: fields for name, fields in types.items() if name not in store.fielddefs})
    return str(schema.name)
