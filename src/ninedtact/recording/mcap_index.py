"""What an MCAP file of ours holds, by its records alone, so that a file that was cut short is read like a whole one.

https://mcap.dev/spec: after eight magic bytes come records, each an opcode, a length and its content. Messages stand in chunks;
each chunk is followed by records that say when and where in it each message is. Only those are read here; what is half
written at the end is left alone. All schemas and channels stand in the first chunk: our writer puts them there.
"""

import struct
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from typing import BinaryIO, NamedTuple

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Schema
from mcap.stream_reader import breakup_chunk, get_chunk_data_stream
from mcap.writer import MCAP0_MAGIC
from numpy import ndarray as Array

from ninedtact.recording.errors import RecordingUnreadable

PREFIX_BYTES = 9
"""Opcode and length."""
OURS = (Opcode.HEADER, Opcode.METADATA, Opcode.ATTACHMENT, Opcode.CHUNK, Opcode.MESSAGE_INDEX)
"""Records before the end of data in files of ours."""
INDEX_ENTRY = np.dtype([("wall_ns", "<u8"), ("offset", "<u8")])
MESSAGE_BEGINNING = struct.Struct("<HIQQ")
"""Channel, sequence number, log time and publish time."""
PLACE = np.dtype([("wall_ns", "i8"), ("chunk", "i4"), ("channel", "i4"), ("offset", "i8")])
"""Where a message is: number of its chunk, and where in it when decompressed; with what it must turn out to be."""


class Span(NamedTuple):
    """One record in the file."""

    opcode: int
    start: int
    end: int


@dataclass
class McapIndex:
    """All records of a file but the summary."""

    finished: bool = False
    """Whether it was closed in order."""
    end: int = len(MCAP0_MAGIC)
    """Of the last whole record before the summary."""
    chunks: list[Span] = field(default_factory=list)
    attachments: list[Span] = field(default_factory=list)
    metadata: list[Span] = field(default_factory=list)
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    places: dict[int, list[Array]] = field(default_factory=lambda: defaultdict(list))
    """`PLACE` of each channel's messages in the order of writing, chunk by chunk."""
    indexes: dict[int, dict[int, int]] = field(default_factory=lambda: defaultdict(dict))
    """Where the index of each chunk and channel starts."""
    index_bytes: dict[int, int] = field(default_factory=lambda: defaultdict(int))
    """Length of all index records of each chunk."""


def index_mcap_records(file: BinaryIO, name: str) -> McapIndex:
    """The records of a file; raises `RecordingUnreadable`."""
    start = file.read(len(MCAP0_MAGIC))
    if start != MCAP0_MAGIC:
        what = "something else" if start else "an empty file"
        raise RecordingUnreadable(f"expected a recording (.mcap) in {name}, got {what}; check the path")
    found, is_over = McapIndex(finished=ends_in_order(file)), False
    for span in spans(file):
        is_over = span.opcode == Opcode.DATA_END
        if is_over or span.opcode not in OURS:
            break
        note(found, span, file)
        found.end = span.end
    if found.finished and not is_over:
        raise damaged(name, found.end)
    return found


def ends_in_order(file: BinaryIO) -> bool:
    """Whether the last bytes are those of a file that was closed in order."""
    file.seek(max(file.seek(0, 2) - len(MCAP0_MAGIC), 0))
    return file.read() == MCAP0_MAGIC


def spans(file: BinaryIO) -> Iterator[Span]:
    """The whole records after the magic bytes."""
    size, start = file.seek(0, 2), len(MCAP0_MAGIC)
    while start + PREFIX_BYTES <= size:
        file.seek(start)
        prefix = file.read(PREFIX_BYTES)
        end = start + PREFIX_BYTES + int.from_bytes(prefix[1:], "little")
        if end > size:
            return
        yield Span(prefix[0], start, end)
        start = end


def note(found: McapIndex, span: Span, file: BinaryIO) -> None:
    """Remember a record."""
    if span.opcode == Opcode.CHUNK:
        found.chunks.append(span)
    elif span.opcode == Opcode.ATTACHMENT:
        found.attachments.append(span)
    elif span.opcode == Opcode.METADATA:
        found.metadata.append(span)
    elif span.opcode == Opcode.MESSAGE_INDEX and found.chunks:
        chunk, content = len(found.chunks) - 1, content_of(file, span)
        channel = int.from_bytes(content[:2], "little")
        entries = np.frombuffer(content[6:], INDEX_ENTRY)
        found.indexes[chunk][channel] = span.start
        found.index_bytes[chunk] += span.end - span.start
        found.places[channel].append(places(channel, chunk, entries["wall_ns"], entries["offset"]))


def read_outer_chunks(found: McapIndex, file: BinaryIO, name: str) -> None:
    """Schemas and channels from the first chunk; from a last one whose index was cut off, where its messages are."""
    if not found.chunks:
        return
    for record in breakup_chunk(chunk_at(file, found.chunks[0], name)):
        if isinstance(record, Schema):
            found.schemas[record.id] = record
        elif isinstance(record, Channel):
            found.channels[record.id] = record
    last = len(found.chunks) - 1
    if not found.finished:
        for channel, entries in index_of(chunk_at(file, found.chunks[last], name)).items():
            if channel not in found.indexes[last]:
                wall_ns, offset = np.array(entries).T
                found.places[channel].append(places(channel, last, wall_ns, offset))


def index_of(chunk: Chunk) -> dict[int, list[tuple[int, int]]]:
    """Stamp and offset of each message by channel, as an index has them."""
    entries: dict[int, list[tuple[int, int]]] = defaultdict(list)
    at = 0
    while at < len(chunk.data):
        length = int.from_bytes(chunk.data[at + 1 : at + PREFIX_BYTES], "little")
        if chunk.data[at] == Opcode.MESSAGE:
            message = message_at(chunk.data, at)
            entries[message.channel].append((message.wall_ns, at))
        at += PREFIX_BYTES + length
    return entries


class StoredMessage(NamedTuple):
    """One message as it stands in a chunk."""

    channel: int
    sequence: int
    wall_ns: int
    data: bytes


def message_at(chunk: bytes, at: int) -> StoredMessage:
    """The message at this offset of a decompressed chunk."""
    if chunk[at] != Opcode.MESSAGE:
        raise ValueError(f"expected a message, got opcode {chunk[at]}")
    end = at + PREFIX_BYTES + int.from_bytes(chunk[at + 1 : at + PREFIX_BYTES], "little")
    channel, sequence, wall_ns, _ = MESSAGE_BEGINNING.unpack_from(chunk, at + PREFIX_BYTES)
    return StoredMessage(channel, sequence, wall_ns, chunk[at + PREFIX_BYTES + MESSAGE_BEGINNING.size : end])


def places(channel: int, chunk: int, wall_ns: Array, offset: Array) -> Array:
    """`PLACE` of some messages of one channel and chunk."""
    found = np.empty(len(wall_ns), PLACE)
    found["channel"], found["chunk"], found["wall_ns"], found["offset"] = channel, chunk, wall_ns, offset
    return found


def chunk_at(file: BinaryIO, span: Span, name: str) -> Chunk:
    """A chunk, decompressed and checked; raises `RecordingUnreadable`."""
    try:
        chunk = Chunk.read(stream_of(file, span))
        stream, size = get_chunk_data_stream(chunk, validate_crc=True)
        chunk.data, chunk.compression = stream.read(size), ""
    except Exception as trouble:  # whatever the decompressor calls it
        raise damaged(name, span.start) from trouble
    return chunk


def damaged(name: str, at: int) -> RecordingUnreadable:
    """What is said of content that is not what was written."""
    return RecordingUnreadable(
        f"expected {name} as it was recorded, got damaged data at byte {at}; restore the file from a copy"
    )


def content_of(file: BinaryIO, span: Span) -> bytes:
    """A record without its prefix."""
    file.seek(span.start + PREFIX_BYTES)
    return file.read(span.end - span.start - PREFIX_BYTES)


def stream_of(file: BinaryIO, span: Span) -> ReadDataStream:
    """A record without its prefix, for the library's readers."""
    return ReadDataStream(BytesIO(content_of(file, span)))
