"""An index of an MCAP file built from its records alone, so that a truncated file is read like a complete one.

After eight magic bytes, an MCAP file (https://mcap.dev/spec) consists of records, each an opcode, a length and its content.
Messages are stored in chunks; each chunk is followed by records with the time and position of each message. Only those are read
here; an incomplete record at the end is ignored. All schemas and channels are in the first chunk, where `writer` puts them.
"""

import struct
import zlib
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from typing import BinaryIO, NamedTuple

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Schema, Statistics
from mcap.stream_reader import breakup_chunk, get_chunk_data_stream
from mcap.writer import MCAP0_MAGIC
from numpy import ndarray as Array

from ninedtact.recording.errors import RecordingUnreadable

RECORD_PREFIX_BYTES = 9
"""Length of opcode and length field before the content of a record."""
_KNOWN_RECORDS = (Opcode.HEADER, Opcode.METADATA, Opcode.ATTACHMENT, Opcode.CHUNK, Opcode.MESSAGE_INDEX)
"""Opcodes of the records that the writer of this package puts before the end of the data."""
_INDEX_ENTRY = np.dtype([("stamp_ns", "<u8"), ("offset", "<u8")])
_CHECKSUM_BYTES = 4
_MESSAGE_HEADER = struct.Struct("<HIQQ")
"""Channel, sequence number, log time and publish time."""
MESSAGE_POSITION = np.dtype([("stamp_ns", "i8"), ("chunk", "i4"), ("channel", "i4"), ("offset", "i8")])
"""Position of a message: number of its chunk and offset in it when decompressed, with the stamp and channel it must have."""


class McapRecordSpan(NamedTuple):
    """Opcode, start and end of one record in the file."""

    opcode: int
    start: int
    end: int


@dataclass
class McapIndex:
    """All records of a file except the summary."""

    finished: bool = False
    """Whether the file was closed properly."""
    end: int = len(MCAP0_MAGIC)
    """End of the last whole record before the summary."""
    chunks: list[McapRecordSpan] = field(default_factory=list)
    attachments: list[McapRecordSpan] = field(default_factory=list)
    metadata: list[McapRecordSpan] = field(default_factory=list)
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    positions: dict[int, list[Array]] = field(default_factory=lambda: defaultdict(list))
    """`MESSAGE_POSITION` of the messages of each channel in the order of writing, chunk by chunk."""
    indexes: dict[int, dict[int, int]] = field(default_factory=lambda: defaultdict(dict))
    """Start of the index record of each chunk and channel."""
    index_bytes: dict[int, int] = field(default_factory=lambda: defaultdict(int))
    """Total length of the index records of each chunk."""


def index_mcap_records(file: BinaryIO, name: str) -> McapIndex:
    """Return the index of a file; raises `RecordingUnreadable`."""
    start = file.read(len(MCAP0_MAGIC))
    if start != MCAP0_MAGIC:
        what = "something else" if start else "an empty file"
        raise RecordingUnreadable(f"expected a recording (.mcap) in {name}, got {what}; check the path")
    found, is_over = McapIndex(finished=_is_finished(file)), False
    for span in _iterate_records(file):
        is_over = span.opcode == Opcode.DATA_END
        if is_over or span.opcode not in _KNOWN_RECORDS:
            break
        _add_record(found, span, file)
        found.end = span.end
    if found.finished and not is_over:
        raise damage_error(name, found.end)
    if found.finished:
        _require_counted_messages(found, file, name)
    return found


def _require_counted_messages(found: McapIndex, file: BinaryIO, name: str) -> None:
    """Compare a finished file with the counts of its own summary; raises `RecordingUnreadable` where something is missing."""
    spans = _iterate_records(file, found.end)
    stated = next(
        (Statistics.read(open_record_content(file, one)) for one in spans if one.opcode == Opcode.STATISTICS), None
    )
    messages = {channel: sum(map(len, parts)) for channel, parts in found.positions.items()}
    counts = len(found.chunks), len(found.attachments), len(found.metadata), messages
    if stated is not None and counts != (
        stated.chunk_count,
        stated.attachment_count,
        stated.metadata_count,
        {channel: count for channel, count in stated.channel_message_counts.items() if count},
    ):
        raise damage_error(name, found.end)


def _is_finished(file: BinaryIO) -> bool:
    """Return whether the last bytes are those of a file that was closed properly."""
    file.seek(max(file.seek(0, 2) - len(MCAP0_MAGIC), 0))
    return file.read() == MCAP0_MAGIC


def _iterate_records(file: BinaryIO, start: int = len(MCAP0_MAGIC)) -> Iterator[McapRecordSpan]:
    """Yield the whole records from a position on, by default after the magic bytes."""
    size = file.seek(0, 2)
    while start + RECORD_PREFIX_BYTES <= size:
        file.seek(start)
        prefix = file.read(RECORD_PREFIX_BYTES)
        end = start + RECORD_PREFIX_BYTES + int.from_bytes(prefix[1:], "little")
        if end > size:
            return
        yield McapRecordSpan(prefix[0], start, end)
        start = end


def _add_record(found: McapIndex, span: McapRecordSpan, file: BinaryIO) -> None:
    """Add a record of the file to the index."""
    if span.opcode == Opcode.CHUNK:
        found.chunks.append(span)
    elif span.opcode == Opcode.ATTACHMENT:
        found.attachments.append(span)
    elif span.opcode == Opcode.METADATA:
        found.metadata.append(span)
    elif span.opcode == Opcode.MESSAGE_INDEX and found.chunks:
        chunk, content = len(found.chunks) - 1, _read_content(file, span)
        channel = int.from_bytes(content[:2], "little")
        entries = np.frombuffer(content[6:], _INDEX_ENTRY)
        found.indexes[chunk][channel] = span.start
        found.index_bytes[chunk] += span.end - span.start
        found.positions[channel].append(_positions(channel, chunk, entries["stamp_ns"], entries["offset"]))


def complete_mcap_index(found: McapIndex, file: BinaryIO, name: str) -> None:
    """Complete an index by the schemas and channels of the first chunk, and by the positions of a last chunk without index.

    The last chunks of an unfinished file are left out where they are damaged, as a power cut leaves them: the file ends before.
    """
    if not found.chunks:
        return
    last_chunk = None if found.finished else _drop_damaged_end(found, file, name)
    for record in breakup_chunk(read_mcap_chunk(file, found.chunks[0], name)):
        if isinstance(record, Schema):
            found.schemas[record.id] = record
        elif isinstance(record, Channel):
            found.channels[record.id] = record
    last = len(found.chunks) - 1
    if last_chunk is not None:
        for channel, entries in _message_offsets(last_chunk).items():
            if channel not in found.indexes[last]:
                stamp_ns, offset = np.array(entries).T
                found.positions[channel].append(_positions(channel, last, stamp_ns, offset))


def _drop_damaged_end(found: McapIndex, file: BinaryIO, name: str) -> Chunk:
    """Drop damaged chunks at the end, with all that follows them, and return the last whole one.

    Raises `RecordingUnreadable` where the first chunk is damaged, too.
    """
    while True:
        last, span = len(found.chunks) - 1, found.chunks[-1]
        try:
            return read_mcap_chunk(file, span, name)
        except RecordingUnreadable:
            if last == 0:
                raise
        found.end = span.start
        del found.chunks[last]
        for records in (found.attachments, found.metadata):
            records[:] = [record for record in records if record.end <= found.end]
        for channel in found.indexes.pop(last, {}):
            found.positions[channel].pop()
        found.index_bytes.pop(last, None)


def _message_offsets(chunk: Chunk) -> dict[int, list[tuple[int, int]]]:
    """Return stamp and offset of each message by channel, as an index record has them."""
    entries: dict[int, list[tuple[int, int]]] = defaultdict(list)
    at = 0
    while at < len(chunk.data):
        length = int.from_bytes(chunk.data[at + 1 : at + RECORD_PREFIX_BYTES], "little")
        if chunk.data[at] == Opcode.MESSAGE:
            message = parse_message_record(chunk.data, at)
            entries[message.channel].append((message.stamp_ns, at))
        at += RECORD_PREFIX_BYTES + length
    return entries


class StoredMessage(NamedTuple):
    """One message as it is stored in a chunk."""

    channel: int
    sequence: int
    stamp_ns: int
    data: bytes


def parse_message_record(chunk: bytes, at: int) -> StoredMessage:
    """Return the message at this offset of a decompressed chunk; raises `ValueError` where there is none."""
    if chunk[at] != Opcode.MESSAGE:
        raise ValueError(f"expected a message, got opcode {chunk[at]}")
    end = at + RECORD_PREFIX_BYTES + int.from_bytes(chunk[at + 1 : at + RECORD_PREFIX_BYTES], "little")
    channel, sequence, stamp_ns, _ = _MESSAGE_HEADER.unpack_from(chunk, at + RECORD_PREFIX_BYTES)
    return StoredMessage(channel, sequence, stamp_ns, chunk[at + RECORD_PREFIX_BYTES + _MESSAGE_HEADER.size : end])


def _positions(channel: int, chunk: int, stamp_ns: Array, offset: Array) -> Array:
    """Return `MESSAGE_POSITION` of some messages of one channel and chunk."""
    found = np.empty(len(stamp_ns), MESSAGE_POSITION)
    found["channel"], found["chunk"], found["stamp_ns"], found["offset"] = channel, chunk, stamp_ns, offset
    return found


def read_mcap_chunk(file: BinaryIO, span: McapRecordSpan, name: str) -> Chunk:
    """Return a chunk, decompressed and checked; raises `RecordingUnreadable`."""
    try:
        chunk = Chunk.read(open_record_content(file, span))
        stream, size = get_chunk_data_stream(chunk, validate_crc=True)
        chunk.data, chunk.compression = stream.read(size), ""
    except Exception as trouble:  # every decompressor has errors of its own
        raise damage_error(name, span.start) from trouble
    return chunk


def read_attachment(file: BinaryIO, span: McapRecordSpan, name: str) -> Attachment:
    """Return an attached file, checked; raises `RecordingUnreadable`."""
    content = _read_content(file, span)
    checksum = int.from_bytes(content[-_CHECKSUM_BYTES:], "little")
    if checksum and zlib.crc32(content[:-_CHECKSUM_BYTES]) != checksum:  # zero stands for no checksum
        raise damage_error(name, span.start)
    return Attachment.read(ReadDataStream(BytesIO(content)))


def damage_error(name: str, at: int) -> RecordingUnreadable:
    """Return the error for content that differs from what was written."""
    return RecordingUnreadable(
        f"expected {name} as it was recorded, got damaged data at byte {at}; restore the file from a copy"
    )


def _read_content(file: BinaryIO, span: McapRecordSpan) -> bytes:
    """Return the content of a record."""
    file.seek(span.start + RECORD_PREFIX_BYTES)
    return file.read(span.end - span.start - RECORD_PREFIX_BYTES)


def open_record_content(file: BinaryIO, span: McapRecordSpan) -> ReadDataStream:
    """Return the content of a record as a stream for the readers of the mcap library."""
    return ReadDataStream(BytesIO(_read_content(file, span)))
