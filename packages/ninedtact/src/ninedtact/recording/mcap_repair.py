"""Repairs a truncated recording in place: writes the summary that its writer could not write. Edits labelled spans the same way.

This package reads a truncated recording without repair; other programs (`ros2 bag`, rosbags) may refuse it or read it slowly.
"""

import json
import shutil
import struct
import time
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from io import BytesIO, FileIO
from pathlib import Path
from threading import Lock
from typing import BinaryIO

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    ChunkIndex,
    DataEnd,
    Footer,
    McapRecord,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Statistics,
)
from mcap.writer import MCAP0_MAGIC

from ninedtact.atomic_write import open_atomic_file
from ninedtact.recording.mcap_index_recovery import (
    RECORD_PREFIX_BYTES,
    McapIndex,
    McapRecordSpan,
    open_record_content,
    read_attachment,
)
from ninedtact.recording.metadata import REPAIR_RECORD
from ninedtact.recording.missing_end import require_ended_recording
from ninedtact.recording.reader import SPANS_ATTACHMENT, Recording, recorded_sensor_addresses
from ninedtact.recording.topics_and_messages import LabelledSpan, Topic

_FOOTER_BYTES = 20
_CHUNK_HEADER_BYTES = 64
"""An upper limit of the length of the fields before the data of a chunk."""
_EDIT_LOCKS: dict[Path, Lock] = {}
"""One for each recording whose spans were edited, held from the reading of its spans to their writing."""


def repair_recording(path: Path) -> bool:
    """Complete a truncated recording in place, with a note of it (`Recording.is_repaired`), and return whether it was truncated.

    A recording that is still being written would lose what follows: `require_ended_recording` first. Raises what `Recording`
    raises, and `OSError` on a full disk.
    """
    note = _to_bytes([Metadata(REPAIR_RECORD, {"wall_ns": str(time.time_ns())})])
    is_truncated = _append_to_unfinished(path, lambda found, file: _missing_chunk_index(found) + note)
    _append_to_unfinished(path, _file_ending)
    return is_truncated


def _append_to_unfinished(path: Path, content: Callable[[McapIndex, BinaryIO], bytes]) -> bool:
    """Write content after the last whole record of a recording without an end; return whether it has none."""
    with Recording(recorded_sensor_addresses(path)[0]) as recording:
        found = recording.index
    if found.finished:
        return False
    with path.open("r+b", buffering=0) as file:
        try:
            records = content(found, file)
            file.truncate(found.end)
            file.seek(found.end)
            _write_all(file, records)
        except BaseException:
            file.truncate(found.end)
            raise
    return True


def edit_labelled_spans(
    path: Path, change: Callable[[list[LabelledSpan]], Iterable[LabelledSpan]]
) -> list[LabelledSpan]:
    """Change the labelled spans that a recording has now, whoever wrote them, and return the new ones in their order.

    Edits of one recording within this program follow each other, so that none is lost. Raises what `save_labelled_spans` raises.
    """
    with _EDIT_LOCKS.setdefault(path.resolve(), Lock()):
        with Recording(recorded_sensor_addresses(path)[0]) as recording:
            before = recording.spans()
        spans = sorted(change(before), key=lambda span: (span.begin_ns, span.end_ns))
        if spans != before:
            save_labelled_spans(path, spans)
    return spans


def save_labelled_spans(path: Path, spans: Sequence[LabelledSpan]) -> None:
    """Replace the labelled spans of a recording; the file is replaced as a whole by a copy, or stays as it was.

    Raises what `Recording` raises, `RecordingRefused` for a file that is still being written, and `FileNotWritten`.
    """
    with Recording(recorded_sensor_addresses(path)[0]) as recording:
        require_ended_recording(recording, "label it")
        now_ns = int(max(recording.stamps_ns(Topic.IMAGES), default=0))
    content = json.dumps([vars(span) for span in spans], ensure_ascii=False).encode()
    record = _to_bytes([Attachment(now_ns, now_ns, SPANS_ATTACHMENT, "application/json", content)])
    with path.open("rb") as original, open_atomic_file(path) as file:
        shutil.copyfileobj(original, file)
        file.flush()
        copy = Path(file.name)
        shutil.copymode(path, copy)
        repair_recording(copy)  # the index of its last chunk must stand before the new record
        with Recording(recorded_sensor_addresses(copy)[0]) as recording:
            end = _end_before_spans(recording)
        with copy.open("r+b", buffering=0) as raw:
            raw.truncate(end)
            raw.seek(end)
            _write_all(raw, record)
        _append_to_unfinished(copy, _file_ending)


def _end_before_spans(recording: Recording) -> int:
    """Return the end of the last record before the summary, without an earlier list of spans that stands there."""
    spans, end = recording.index.attachments, recording.index.end
    names = [attachment.name for attachment in recording.attachments()]
    if spans and spans[-1].end == end and names[-1] == SPANS_ATTACHMENT:
        return spans[-1].start
    return end


def _write_all(file: FileIO, content: bytes) -> None:
    """Write all bytes, even if single writes take only some of them."""
    left = memoryview(content)
    while left:
        left = left[file.write(left) :]


def _file_ending(found: McapIndex, file: BinaryIO) -> bytes:
    """Return everything that follows the last whole record."""
    data_end = _missing_chunk_index(found) + _to_bytes([DataEnd(0)])
    start = found.end + len(data_end)
    summary = _to_bytes(_summary_records(found, file))
    # The checksum covers the footer too, except for the checksum itself.
    prefix = struct.pack("<BQQQ", Opcode.FOOTER, _FOOTER_BYTES, start, 0)
    footer = _to_bytes([Footer(start, 0, zlib.crc32(prefix, zlib.crc32(summary)))])
    return data_end + summary + footer + MCAP0_MAGIC


def _missing_chunk_index(found: McapIndex) -> bytes:
    """Return the index records that the last chunk lacks, and add their positions to the index."""
    builder, last = RecordBuilder(), len(found.chunks) - 1
    for channel, parts in found.positions.items():
        here = parts[-1]
        if here["chunk"][0] == last and channel not in found.indexes[last]:
            found.indexes[last][channel] = found.end + builder.count
            entries = zip(here["stamp_ns"].tolist(), here["offset"].tolist(), strict=True)
            MessageIndex(channel, list(entries)).write(builder)
    found.index_bytes[last] += builder.count
    return builder.end()


def _summary_records(found: McapIndex, file: BinaryIO) -> Iterator[McapRecord]:
    """Yield schemas, channels, statistics and indexes."""
    yield from found.schemas.values()
    yield from found.channels.values()
    yield _statistics(found)
    for number in range(len(found.chunks)):
        yield _chunk_index(found, number, file)
    for span in found.attachments:
        yield _attachment_index(span, read_attachment(file, span, str(file.name)))
    for span in found.metadata:
        yield MetadataIndex(span.start, span.end - span.start, Metadata.read(open_record_content(file, span)).name)


def _statistics(found: McapIndex) -> Statistics:
    """Return the number of records of each kind, and the first and last time."""
    counts = {channel: sum(map(len, parts)) for channel, parts in found.positions.items()}
    stamps = [part["stamp_ns"] for parts in found.positions.values() for part in parts]
    return Statistics(
        attachment_count=len(found.attachments),
        channel_count=len(found.channels),
        channel_message_counts=counts,
        chunk_count=len(found.chunks),
        message_count=sum(counts.values()),
        message_start_time=min((int(part.min()) for part in stamps), default=0),
        message_end_time=max((int(part.max()) for part in stamps), default=0),
        metadata_count=len(found.metadata),
        schema_count=len(found.schemas),
    )


def _chunk_index(found: McapIndex, number: int, file: BinaryIO) -> ChunkIndex:
    """Return the index record of a chunk, of which only the header is read."""
    span = found.chunks[number]
    file.seek(span.start + RECORD_PREFIX_BYTES)
    header = ReadDataStream(BytesIO(file.read(_CHUNK_HEADER_BYTES)))
    first_ns, last_ns, size = (header.read8() for _ in range(3))
    header.read4()  # the checksum
    compression, compressed_size = header.read_prefixed_string(), header.read8()
    return ChunkIndex(
        chunk_start_offset=span.start,
        chunk_length=span.end - span.start,
        compression=compression,
        compressed_size=compressed_size,
        message_start_time=first_ns,
        message_end_time=last_ns,
        message_index_offsets=found.indexes[number],
        message_index_length=found.index_bytes[number],
        uncompressed_size=size,
    )


def _attachment_index(span: McapRecordSpan, attachment: Attachment) -> AttachmentIndex:
    """Return the index record of an attachment."""
    return AttachmentIndex(
        offset=span.start,
        length=span.end - span.start,
        log_time=attachment.log_time,
        create_time=attachment.create_time,
        data_size=len(attachment.data),
        name=attachment.name,
        media_type=attachment.media_type,
    )


def _to_bytes(of: Iterable[McapRecord]) -> bytes:
    """Return the bytes of some records."""
    builder = RecordBuilder()
    for record in of:
        record.write(builder)
    return builder.end()
