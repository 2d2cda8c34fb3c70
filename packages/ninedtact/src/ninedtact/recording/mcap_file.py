"""An MCAP file that is read by the positions of its messages, also where it has no end.

After eight magic bytes, an MCAP file (https://mcap.dev/spec) consists of records, each an opcode, a length and its content.
Messages are stored in chunks; each chunk is followed by records with the time of each message. Those are read here, up to the first
record that is not whole; the content of records is decoded by the library `mcap`.
"""

import struct
import time
import zlib
from collections import defaultdict
from collections.abc import Iterator
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Attachment, Channel, Chunk, McapRecord, Message, Metadata
from mcap.stream_reader import breakup_chunk
from mcap.writer import MCAP0_MAGIC
from numpy import ndarray as Array

from ninedtact.errors import CameraError
from ninedtact.recording.errors import RecordingUnreadable

WRITTEN_WITHIN_S = 5.0
"""Age below which a file without an end may be being written: its writer adds to it every half second."""
_PREFIX = struct.Struct("<BQ")
"""Opcode and length before the content of a record."""
_DATA_RECORDS = (Opcode.HEADER, Opcode.METADATA, Opcode.ATTACHMENT, Opcode.CHUNK, Opcode.MESSAGE_INDEX)
"""Opcodes of the records that the writer of this package puts before the end of the data."""
MESSAGE_POSITION = np.dtype([("stamp_ns", "i8"), ("chunk", "i4"), ("number", "i4"), ("channel", "i4")])
"""Position of a message: its chunk, and its number among the messages of its channel there; with the stamp that it must have."""


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
        self._chunks: list[tuple[int, int]] = []
        self._positions: dict[int, list[Array]] = defaultdict(list)
        self._last_read: tuple[int, dict[int, list[Message]]] = (-1, {})
        try:
            self.is_finished = self._read_magic()
            self._read_records()
            if not self.is_finished:
                self._drop_damaged_end()
            first = next(self.chunks(), [])  # `writer` puts all channels there
            self._channels = {one.topic: one.id for one in first if isinstance(one, Channel)}
            if self.is_finished:
                self._require_counted_records()
        except (McapError, ValueError, IndexError, MemoryError, struct.error) as error:
            self.close()
            raise RecordingUnreadable(
                expected=f"a recording in {path}", got=f"a damaged file ({error})", remedy="restore it from a copy"
            ) from error
        except BaseException:
            self.close()
            raise

    def positions(self, topic: str) -> Array:
        """Return `MESSAGE_POSITION` of the messages of a topic, in the order of writing."""
        parts = self._positions.get(self._channels.get(topic, -1), [])
        if len(parts) > 1:
            parts[:] = [np.concatenate(parts)]
        return parts[0] if parts else np.empty(0, MESSAGE_POSITION)

    def message(self, position: np.void) -> Message:
        """Return the message at one `MESSAGE_POSITION`; raises `RecordingUnreadable` where the file is damaged."""
        number = int(position["chunk"])
        if self._last_read[0] != number:
            self._last_read = number, _messages_by_channel(self._read_chunk(number))
        messages = self._last_read[1].get(int(position["channel"]), [])
        if position["number"] >= len(messages) or messages[position["number"]].log_time != position["stamp_ns"]:
            raise self.damage_error(position)
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
            yield Attachment.read(ReadDataStream(BytesIO(content)))

    def damage_error(self, position: np.void) -> RecordingUnreadable:
        """Return the error for a message that differs from what was written."""
        return self._damage_error(self._chunks[position["chunk"]][0])

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
        size = self._file.seek(0, 2)
        while self.end + _PREFIX.size <= size:
            self._file.seek(self.end)
            opcode, length = _PREFIX.unpack(self._file.read(_PREFIX.size))
            start, end = self.end, self.end + _PREFIX.size + length
            if opcode not in _DATA_RECORDS or end > size:
                break
            if opcode == Opcode.CHUNK:
                self._chunks.append((start, end))
            elif opcode == Opcode.ATTACHMENT:
                self._attachments.append((start, end))
            elif opcode == Opcode.METADATA:
                self.metadata.append(Metadata.read(ReadDataStream(BytesIO(self._content(start, end)))))
            elif opcode == Opcode.MESSAGE_INDEX and self._chunks:
                content = self._content(start, end)  # channel, length, and time and offset of each message
                stamps_ns = np.frombuffer(content, "<u8", offset=6)[::2]
                self._add_positions(int.from_bytes(content[:2], "little"), stamps_ns.astype(np.int64))
            self.end = end

    def _read_chunk(self, number: int) -> list[McapRecord]:
        """Return the records of a chunk, decompressed and checked; raises `RecordingUnreadable`."""
        try:
            chunk = Chunk.read(ReadDataStream(BytesIO(self._content(*self._chunks[number]))))
            return breakup_chunk(chunk, validate_crc=True)
        except Exception as trouble:  # every decompressor has errors of its own
            raise self._damage_error(self._chunks[number][0]) from trouble

    def _drop_damaged_end(self) -> None:
        """Leave out the damaged chunks at the end; the messages of the last whole one are counted, whose index may be missing."""
        while self._chunks:
            last = len(self._chunks) - 1
            self._positions = defaultdict(
                list, {of: [one for one in parts if one["chunk"][0] < last] for of, parts in self._positions.items()}
            )
            with suppress(RecordingUnreadable):
                for channel, messages in _messages_by_channel(self._read_chunk(last)).items():
                    self._add_positions(channel, np.array([message.log_time for message in messages]))
                return
            self._chunks.pop()

    def _add_positions(self, channel: int, stamps_ns: Array) -> None:
        found = np.empty(len(stamps_ns), MESSAGE_POSITION)
        found["stamp_ns"], found["number"] = stamps_ns, np.arange(len(stamps_ns))
        found["channel"], found["chunk"] = channel, len(self._chunks) - 1
        if len(found):
            self._positions[channel].append(found)

    def _require_counted_records(self) -> None:
        """Compare a finished file with the counts of its own summary; raises `RecordingUnreadable` where something is missing."""
        self._file.seek(0)
        summary = SeekingReader(self._file).get_summary()
        stated = None if summary is None else summary.statistics
        messages = {channel: sum(map(len, parts)) for channel, parts in self._positions.items()}
        counts = len(self._chunks), len(self._attachments), len(self.metadata), messages
        if stated is not None and counts != (
            stated.chunk_count,
            stated.attachment_count,
            stated.metadata_count,
            {channel: count for channel, count in stated.channel_message_counts.items() if count},
        ):
            raise self._damage_error(self.end)

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
        raise CameraError(expected=f"a recording at {path}", got=kind, remedy=remedy)
    try:
        return path.open("rb")
    except OSError as error:
        raise RecordingUnreadable(
            expected=f"to read {path}", got=str(error.strerror), remedy="check its permissions"
        ) from error


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
