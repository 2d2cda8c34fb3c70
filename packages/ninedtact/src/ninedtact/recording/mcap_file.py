"""An MCAP file that is read by the positions of its messages, also where it has no end.

After eight magic bytes, an MCAP file (https://mcap.dev/spec) consists of records, each an opcode, a length and its content.
Messages are stored in chunks; each chunk is followed by records with the time of each message. Those are read here, up to the first
record that is not whole; the content of records is decoded by the library `mcap`. Other programs may leave out the records of
times, or the chunks; messages are then counted when the file is opened, and stretches of records without chunks are read as chunks.

The file may be a stranger's: what a chunk says of its size and what it unpacks to are both limited, so that a file costs no more
memory and time than its size allows. Everything that cannot be decoded is damage (`RecordingUnreadable`).
"""

import struct
import time
import zlib
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, McapRecord, Message, Metadata, Schema, Statistics
from mcap.writer import MCAP0_MAGIC
from numpy import ndarray as Array

from ninedtact.errors import CameraError
from ninedtact.recording.errors import RecordingUnreadable

WRITTEN_WITHIN_S = 5.0
"""Age below which a file without an end may be being written: its writer adds to it every half second."""
_PREFIX = struct.Struct("<BQ")
"""Opcode and length before the content of a record."""
_LOOSE_RECORDS = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE)
"""Opcodes of the records that chunks hold, or that stand without one."""
_MESSAGE = struct.Struct("<HIQQ")
"""Channel, sequence, time of the log and time of publishing before the content of a message."""
_DATA_RECORDS = (
    Opcode.HEADER,
    Opcode.METADATA,
    Opcode.ATTACHMENT,
    Opcode.CHUNK,
    Opcode.MESSAGE_INDEX,
    *_LOOSE_RECORDS,
)
"""Opcodes of the records before the end of the data."""
_LOOSE_BYTES = 4_000_000
"""Size from which a stretch of records outside of chunks is read as one chunk."""
_MOST_CHUNK_BYTES = 64_000_000
"""Largest unpacked size of a chunk, twenty times an image of 1280 x 800 pixels; `writer` closes one at 0.5 MB."""
_MOST_RECORDS, _MOST_CHANNELS = 200_000, 5_000
"""Most records of a chunk, one of wrenches alone has some 4,000; and most channels and message types among them."""
_MOST_UNPACKED_BYTES, _MOST_UNPACKED_RATIO = 2_000_000_000, 1000
"""All chunks together unpack to no more than this, or than so many times the file; images of a camera compress to a third."""
_MOST_METADATA, _MOST_METADATA_BYTES = 1000, 20_000_000
_MOST_WINDOW_BYTES = 1 << 27
"""Memory that zstd may need beside its output; its own limit."""
_LATEST_NS = 1 << 62
"""Stamps are times of a clock of this century; the sum of two remains within 64 bits."""
MESSAGE_POSITION = np.dtype([("stamp_ns", "i8"), ("chunk", "i4"), ("number", "i4"), ("channel", "i4")])
"""Position of a message: its chunk, and its number among the messages of its channel there; with the stamp that it must have."""


@dataclass(frozen=True)
class _Span:
    """Where a chunk stands in the file."""

    start: int
    end: int
    is_loose: bool = False
    """Whether it is a stretch of records outside of chunks."""


class McapFile:
    """An MCAP file, open for reading until it is closed. One thread at a time."""

    def __init__(self, path: Path) -> None:
        """Open the file and find its records; raises `CameraError` where there is no file, and `RecordingUnreadable`.

        The damaged chunks at the end of a file without an end, as a power cut leaves them, are left out.
        """
        self.path, self._file = path, _open_file(path)
        self.end = len(MCAP0_MAGIC)
        """End of the last whole record before the summary."""
        self.metadata: list[Metadata] = []
        self._attachments: list[tuple[int, int]] = []
        self._chunks: list[_Span] = []
        self._channels: dict[int, Channel] = {}
        self._ids_of_topic: dict[str, list[int]] = defaultdict(list)
        self.types_of_topics: dict[str, str] = {}
        """Message types of the topics that have messages, and of those of the first chunk; empty where none is stated."""
        self._positions: dict[int, list[Array]] = defaultdict(list)
        self._unpacked_bytes, self._counted_chunks = 0, set[int]()
        self._last_read: tuple[int, list[McapRecord]] = (-1, [])
        self._last_messages: tuple[int, dict[int, list[Message]]] = (-1, {})
        try:
            with self._damage_errors():
                self.is_finished = self._read_magic()
                self._read_records()
                if not self.is_finished:
                    self._drop_damaged_end()
                self._count_unindexed_messages()
                self._read_channels()
                if self.is_finished:
                    self._require_counted_records()
        except BaseException:
            self.close()
            raise

    @contextmanager
    def _damage_errors(self) -> Iterator[None]:
        """Raise `RecordingUnreadable` for whatever a library raises in the block for data that it cannot read."""
        try:
            yield
        except (RecordingUnreadable, OSError):
            raise
        except Exception as error:  # every decompressor has errors of its own
            reason = str(error) or "it ends too early"
            raise RecordingUnreadable(
                expected=f"a recording in {self.path}",
                got=f"a damaged file ({reason})",
                remedy="restore it from a copy",
            ) from error

    def positions(self, topic: str) -> Array:
        """Return `MESSAGE_POSITION` of the messages of a topic, in the order of writing."""
        ids = self._ids_of_topic.get(topic, [])
        if len(ids) > 1:  # of files that were merged
            parts = [part for each in ids for part in self._positions.pop(each, [])]
            self._positions[ids[0]] = parts and [np.sort(np.concatenate(parts), order="stamp_ns")]
            del ids[1:]
        parts = self._positions.get(ids[0], []) if ids else []
        if len(parts) > 1:
            parts[:] = [np.concatenate(parts)]
        return parts[0] if parts else np.empty(0, MESSAGE_POSITION)

    def message(self, position: np.void) -> Message:
        """Return the message at one `MESSAGE_POSITION`; raises `RecordingUnreadable` where the file is damaged."""
        number = int(position["chunk"])
        if self._last_messages[0] != number:
            self._last_messages = number, _messages_by_channel(self._read_chunk(number))
        messages = self._last_messages[1].get(int(position["channel"]), [])
        if position["number"] >= len(messages) or messages[position["number"]].log_time != position["stamp_ns"]:
            raise self._damage_error(self._chunks[number].start)
        return messages[position["number"]]

    def chunks(self) -> Iterator[list[McapRecord]]:
        """Yield the schemas, channels and messages of every chunk; raises `RecordingUnreadable` for a damaged one."""
        return map(self._read_chunk, range(len(self._chunks)))

    def attachments(self) -> Iterator[Attachment]:
        """Yield the attached files; raises `RecordingUnreadable` where one is damaged."""
        for start, end in self._attachments:
            content = self._content(start, end)
            checksum = int.from_bytes(content[-4:], "little")
            if checksum and zlib.crc32(content[:-4]) != checksum:  # zero stands for no checksum
                raise self._damage_error(start)
            with self._damage_errors():
                attachment = Attachment.read(ReadDataStream(BytesIO(content)))
            yield attachment

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _read_magic(self) -> bool:
        """Return whether the file was closed properly; raises `RecordingUnreadable` where it is no MCAP file."""
        start = self._file.read(len(MCAP0_MAGIC))
        if start != MCAP0_MAGIC:
            what = "something else" if start else "an empty file"
            raise RecordingUnreadable(expected=f"a recording (.mcap) in {self.path}", got=what, remedy="check the path")
        self._file.seek(-len(MCAP0_MAGIC), 2)
        return self._file.tell() > 0 and self._file.read() == MCAP0_MAGIC

    def _read_records(self) -> None:
        """Find all whole records before the summary; those of messages that follow a chunk belong to it."""
        size, metadata_bytes = self._file.seek(0, 2), 0
        while self.end + _PREFIX.size <= size:
            self._file.seek(self.end)
            opcode, length = _PREFIX.unpack(self._file.read(_PREFIX.size))
            start, end = self.end, self.end + _PREFIX.size + length
            if opcode not in _DATA_RECORDS or end > size:
                break
            if opcode == Opcode.CHUNK:
                self._chunks.append(_Span(start, end))
            elif opcode in _LOOSE_RECORDS:
                self._add_loose_record(start, end)
            elif opcode == Opcode.ATTACHMENT:
                self._attachments.append((start, end))
            elif opcode == Opcode.METADATA:
                metadata_bytes += length
                if metadata_bytes > _MOST_METADATA_BYTES or len(self.metadata) == _MOST_METADATA:
                    raise ValueError("metadata without end")
                self.metadata.append(Metadata.read(ReadDataStream(BytesIO(self._content(start, end)))))
            elif opcode == Opcode.MESSAGE_INDEX and self._chunks:
                content = self._content(start, end)  # channel, length, and time and offset of each message
                stamps_ns, offsets = np.frombuffer(content, "<u8", offset=6).reshape(-1, 2).T
                self._add_positions(int.from_bytes(content[:2], "little"), stamps_ns, np.argsort(np.argsort(offsets)))
            self.end = end

    def _read_chunk(self, number: int) -> list[McapRecord]:
        """Return the records of a chunk, decompressed and checked; raises `RecordingUnreadable`. Those of the last one are kept."""
        if self._last_read[0] == number:
            return self._last_read[1]
        try:
            span = self._chunks[number]
            if span.is_loose:
                data = self._content(span.start - _PREFIX.size, span.end)
            else:
                chunk = Chunk.read(ReadDataStream(BytesIO(self._content(span.start, span.end))))
                self._count_unpacked(number, chunk.uncompressed_size)
                data = _unpack(chunk)
            self._last_read = number, _parse_records(data)
            return self._last_read[1]
        except Exception as trouble:  # every decompressor has errors of its own
            raise self._damage_error(self._chunks[number].start) from trouble

    def _count_unpacked(self, number: int, size: int) -> None:
        """Raise `ValueError` where a chunk, or all chunks that were read, unpack to more than a recording does."""
        if number not in self._counted_chunks:
            self._counted_chunks.add(number)
            self._unpacked_bytes += size
        most = max(_MOST_UNPACKED_BYTES, _MOST_UNPACKED_RATIO * self.end)
        if size > _MOST_CHUNK_BYTES or self._unpacked_bytes > most:
            raise ValueError(f"{size} bytes in a chunk")

    def _drop_damaged_end(self) -> None:
        """Leave out the damaged chunks at the end; the messages of the last whole one are counted, whose index may be missing."""
        whole: list[McapRecord] = []
        while self._chunks:
            with suppress(RecordingUnreadable):
                whole = self._read_chunk(len(self._chunks) - 1)
                break
            self._chunks.pop()
        last = len(self._chunks) - 1
        self._positions = defaultdict(
            list, {of: [one for one in parts if one["chunk"][0] < last] for of, parts in self._positions.items()}
        )
        self._count_messages(whole, last)

    def _count_unindexed_messages(self) -> None:
        """Count the messages of all chunks without records of their times, which our own files have behind each."""
        indexed = {int(part["chunk"][0]) for parts in self._positions.values() for part in parts}
        for number in range(len(self._chunks)):
            if number not in indexed:
                self._count_messages(self._read_chunk(number), number)
        for parts in self._positions.values():
            parts.sort(key=lambda part: int(part["chunk"][0]))

    def _count_messages(self, records: list[McapRecord], chunk: int) -> None:
        for channel, messages in _messages_by_channel(records).items():
            stamps_ns = np.array([message.log_time for message in messages], np.uint64)
            self._add_positions(channel, stamps_ns, np.arange(len(stamps_ns)), chunk)

    def _add_positions(self, channel: int, stamps_ns: Array, numbers: Array, chunk: int | None = None) -> None:
        """Add the messages of a channel in a chunk, by default the last one; numbers: places in it, in the order of writing."""
        if len(stamps_ns) and stamps_ns.max() > _LATEST_NS:
            raise ValueError("a stamp of no time")
        found = np.empty(len(stamps_ns), MESSAGE_POSITION)
        found["stamp_ns"], found["number"] = stamps_ns, numbers
        found["channel"], found["chunk"] = channel, len(self._chunks) - 1 if chunk is None else chunk
        if len(found):
            self._positions[channel].append(found)

    def _add_loose_record(self, start: int, end: int) -> None:
        """Add a record outside of chunks to the stretch of them that it follows."""
        last = self._chunks[-1] if self._chunks else None
        if last is not None and last.is_loose and last.end == start and last.end - last.start < _LOOSE_BYTES:
            self._chunks[-1] = _Span(last.start, end, is_loose=True)
        else:
            self._chunks.append(_Span(start, end, is_loose=True))

    def _read_channels(self) -> None:
        """Read the channels of the first chunk, where `writer` puts all, and of those that hold the first messages of others."""
        begins = defaultdict[int, set[int]](set)
        for channel, parts in self._positions.items():
            if parts:
                begins[int(parts[0]["chunk"][0])].add(channel)
        schemas: dict[int, str] = {}
        for number in sorted({0, *begins}) if self._chunks else ():
            if number and begins[number] <= self._channels.keys():
                continue
            for record in self._read_chunk(number):
                if isinstance(record, Schema):
                    schemas[record.id] = record.name
                elif isinstance(record, Channel) and record.id not in self._channels:
                    self._channels[record.id] = record
                    self._ids_of_topic[record.topic].append(record.id)
                    self.types_of_topics.setdefault(record.topic, schemas.get(record.schema_id, ""))

    def _require_counted_records(self) -> None:
        """Compare a finished file with the counts of its own summary; raises `RecordingUnreadable` where something is missing."""
        messages = {channel: sum(map(len, parts)) for channel, parts in self._positions.items()}
        counts = sum(not span.is_loose for span in self._chunks), len(self._attachments), len(self.metadata), messages
        stated = self._read_statistics()
        if stated is not None and counts != (
            stated.chunk_count,
            stated.attachment_count,
            stated.metadata_count,
            {channel: count for channel, count in stated.channel_message_counts.items() if count},
        ):
            raise self._damage_error(self.end)

    def _read_statistics(self) -> Statistics | None:
        """Return the counts in the summary, which follows the data; None where the file has none."""
        at, size = self.end, self._file.seek(0, 2)
        while at + _PREFIX.size <= size:
            self._file.seek(at)
            opcode, length = _PREFIX.unpack(self._file.read(_PREFIX.size))
            start, at = at, at + _PREFIX.size + length
            if opcode == Opcode.STATISTICS and at <= size:
                return Statistics.read(ReadDataStream(BytesIO(self._content(start, at))))
        return None

    def _content(self, start: int, end: int) -> bytes:
        self._file.seek(start + _PREFIX.size)
        return self._file.read(end - start - _PREFIX.size)

    def _damage_error(self, at: int) -> RecordingUnreadable:
        return RecordingUnreadable(
            expected=f"{self.path} as it was recorded",
            got=f"damaged data at byte {at}",
            remedy="restore the file from a copy",
        )


def _open_file(path: Path) -> BinaryIO:
    if not path.exists():
        raise CameraError(expected=f"a recording at {path}", got="no such file", remedy="check the path")
    if not path.is_file():
        kind = "a folder" if path.is_dir() else "a pipe or device"
        remedy = "give a file, because it is read more than once"
        if path.is_dir() and (inside := sorted(filter(Path.is_file, path.glob("*.mcap")))):
            remedy = f"give the file in it, {inside[0]}"
        raise CameraError(expected=f"a recording at {path}", got=kind, remedy=remedy)
    try:
        return path.open("rb")
    except OSError as error:
        raise RecordingUnreadable(
            expected=f"to read {path}", got=str(error.strerror), remedy="check its permissions"
        ) from error


def _unpack(chunk: Chunk) -> bytes:
    """Return the data of a chunk, of the size that it states; raises `ValueError` and what a decompressor raises."""
    size = chunk.uncompressed_size
    if chunk.compression == "zstd":
        import zstandard

        reader = zstandard.ZstdDecompressor(max_window_size=_MOST_WINDOW_BYTES).stream_reader(chunk.data)
        data = bytes(reader.read(size + 1))  # whatever the frame itself states
    elif chunk.compression == "lz4":
        import lz4.frame  # type: ignore[import-untyped]

        data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
    elif chunk.compression == "":
        data = chunk.data
    else:
        raise ValueError(f"compression by {chunk.compression[:20]!r}")
    if len(data) != size:
        raise ValueError(f"a chunk of another size than the {size} bytes that it states")
    if chunk.uncompressed_crc not in (0, zlib.crc32(data)):  # zero stands for no checksum
        raise ValueError("a chunk of another checksum")
    return data


def _parse_records(data: bytes) -> list[McapRecord]:
    """Return the schemas, channels and messages of a chunk; raises `ValueError` and what `mcap` raises."""
    records: list[McapRecord] = []
    at = count = channels = 0
    while at < len(data):
        opcode, length = _PREFIX.unpack_from(data, at)
        start, at, count = at + _PREFIX.size, at + _PREFIX.size + length, count + 1
        channels += opcode in (Opcode.CHANNEL, Opcode.SCHEMA)
        if at > len(data) or count > _MOST_RECORDS or channels > _MOST_CHANNELS:
            raise ValueError("a chunk of more records than it holds")
        if opcode == Opcode.MESSAGE and length >= _MESSAGE.size:
            channel, sequence, log_time, publish_time = _MESSAGE.unpack_from(data, start)
            records.append(Message(channel, log_time, data[start + _MESSAGE.size : at], publish_time, sequence))
        elif opcode == Opcode.CHANNEL:
            records.append(Channel.read(ReadDataStream(BytesIO(data[start:at]))))
        elif opcode == Opcode.SCHEMA:
            records.append(Schema.read(ReadDataStream(BytesIO(data[start:at]))))
        elif opcode == Opcode.MESSAGE:
            raise ValueError("a message without a beginning")
    return records


def _messages_by_channel(records: list[McapRecord]) -> dict[int, list[Message]]:
    messages = defaultdict(list)
    for record in records:
        if isinstance(record, Message):
            messages[record.channel_id].append(record)
    return messages


def lock_while_writing(descriptor: int) -> None:
    """Mark an open file as being written, until its descriptor is closed; does nothing where files cannot be locked."""
    with suppress(OSError, ImportError):
        import fcntl  # not on Windows

        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)


def is_being_written(path: Path) -> bool:
    """Return whether a program of this computer still writes a file without an end.

    The lock of its writer ends with the program, whatever ends it. Where files cannot be locked, one that has just changed counts.
    """
    try:
        import fcntl

        with path.open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except (ImportError, OSError):
        return seconds_since_change(path) < WRITTEN_WITHIN_S
    return False


def seconds_since_change(path: Path) -> float:
    """Return the age of a file; it counts both ways, because the clock may have been set back."""
    return abs(time.time() - path.stat().st_mtime)
