"""Finishes a file that was cut short, in place: the summary that its writer did not live to write.

Without it our own reader does well, other programs may refuse (`ros2 bag`, rosbags) or read it slowly.
"""

import struct
import zlib
from collections.abc import Iterable, Iterator
from io import BytesIO, FileIO
from pathlib import Path
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

from ninedtact.recording.mcap_index import PREFIX_BYTES, McapIndex, Span, stream_of
from ninedtact.recording.reader import Recording

FOOTER_BYTES = 20
CHUNK_BEGINNING_BYTES = 64
"""More than precedes its data."""


def repair_recording(path: Path) -> bool:
    """Finish the file if it was cut short; whether it was. Raises what `Recording` raises, and `OSError` on a full disk."""
    with Recording(path) as episode:
        found = episode.scan
    if found.finished:
        return False
    with path.open("r+b", buffering=0) as file:
        try:
            content = ending(found, file)
            file.truncate(found.end)
            file.seek(found.end)
            write_all(file, content)
        except BaseException:
            file.truncate(found.end)
            raise
    return True


def write_all(file: FileIO, content: bytes) -> None:
    """Write to the last byte."""
    left = memoryview(content)
    while left:
        left = left[file.write(left) :]


def ending(found: McapIndex, file: BinaryIO) -> bytes:
    """All that comes after the last whole record."""
    data_end = last_index(found) + records([DataEnd(0)])
    start = found.end + len(data_end)
    summary = records(summary_of(found, file))
    # The check sum covers the footer too, but for the check sum itself.
    prefix = struct.pack("<BQQQ", Opcode.FOOTER, FOOTER_BYTES, start, 0)
    footer = records([Footer(start, 0, zlib.crc32(prefix, zlib.crc32(summary)))])
    return data_end + summary + footer + MCAP0_MAGIC


def last_index(found: McapIndex) -> bytes:
    """What is missing of the last chunk's index; the scan is told where it will stand."""
    builder, last = RecordBuilder(), len(found.chunks) - 1
    for channel, parts in found.places.items():
        here = parts[-1]
        if here["chunk"][0] == last and channel not in found.indexes[last]:
            found.indexes[last][channel] = found.end + builder.count
            entries = zip(here["wall_ns"].tolist(), here["offset"].tolist(), strict=True)
            MessageIndex(channel, list(entries)).write(builder)
    found.index_bytes[last] += builder.count
    return builder.end()


def summary_of(found: McapIndex, file: BinaryIO) -> Iterator[McapRecord]:
    """Schemas, channels, figures and indexes."""
    yield from found.schemas.values()
    yield from found.channels.values()
    yield statistics(found)
    for number in range(len(found.chunks)):
        yield chunk_index(found, number, file)
    for span in found.attachments:
        yield attachment_index(span, Attachment.read(stream_of(file, span)))
    for span in found.metadata:
        yield MetadataIndex(span.start, span.end - span.start, Metadata.read(stream_of(file, span)).name)


def statistics(found: McapIndex) -> Statistics:
    """How many of everything, and from when to when."""
    counts = {channel: sum(map(len, parts)) for channel, parts in found.places.items()}
    stamps = [part["wall_ns"] for parts in found.places.values() for part in parts]
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


def chunk_index(found: McapIndex, number: int, file: BinaryIO) -> ChunkIndex:
    """Where a chunk is; only its beginning is read."""
    span = found.chunks[number]
    file.seek(span.start + PREFIX_BYTES)
    beginning = ReadDataStream(BytesIO(file.read(CHUNK_BEGINNING_BYTES)))
    first_ns, last_ns, size = (beginning.read8() for _ in range(3))
    beginning.read4()  # the check sum
    compression, compressed_size = beginning.read_prefixed_string(), beginning.read8()
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


def attachment_index(span: Span, attachment: Attachment) -> AttachmentIndex:
    """Where an attachment is."""
    return AttachmentIndex(
        offset=span.start,
        length=span.end - span.start,
        log_time=attachment.log_time,
        create_time=attachment.create_time,
        data_size=len(attachment.data),
        name=attachment.name,
        media_type=attachment.media_type,
    )


def records(of: Iterable[McapRecord]) -> bytes:
    """Records as bytes."""
    builder = RecordBuilder()
    for record in of:
        record.write(builder)
    return builder.end()
