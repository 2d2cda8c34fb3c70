"""Writes recordings anew from recordings: what is whole of one that was cut short, and one with other labels.

This package reads a recording that was cut short as it is; other programs (`ros2 bag`, rosbags) may refuse it or read it slowly.
"""

import json
import shutil
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from threading import Lock
from typing import BinaryIO

from mcap.records import Attachment, Channel, Message, Schema
from mcap.writer import CompressionType, Writer

from ninedtact._version import __version__
from ninedtact.atomic_write import open_atomic_file
from ninedtact.errors import OutputError
from ninedtact.recording.mcap_file import WRITTEN_WITHIN_S, McapFile, is_being_written, seconds_since_change
from ninedtact.recording.metadata import REPAIR_RECORD
from ninedtact.recording.reader import SPANS_ATTACHMENT, Recording, recorded_sensor_addresses
from ninedtact.recording.topics_and_messages import LabelledSpan, Topic
from ninedtact.recording.writer import CHUNK_BYTES

_EDIT_LOCKS: dict[Path, Lock] = {}
"""One for each recording whose spans were edited, held from the reading of its spans to their writing."""


def write_whole_copy(path: Path, out: Path) -> None:
    """Write what is whole of a recording into a file with an end, which other programs read too.

    The copy of a recording that was cut short has a note of it (`Recording.is_repaired`). Raises what `Recording` raises, and
    `FileNotWritten`.
    """
    with Recording(recorded_sensor_addresses(path)[0]) as recording, open_atomic_file(out) as file:
        _write_whole(recording.file, file)


def edit_labelled_spans(
    path: Path, change: Callable[[list[LabelledSpan]], Iterable[LabelledSpan]]
) -> list[LabelledSpan]:
    """Change the labelled spans that a recording has now, whoever wrote them, and return the new ones in their order.

    Edits of one recording within this program follow each other, so that none is lost. The file is replaced as a whole by a copy,
    or stays as it was. Raises what `Recording` raises,
    `OutputError` for a file that is still being written, and `FileNotWritten`.
    """
    with _EDIT_LOCKS.setdefault(path.resolve(), Lock()), Recording(recorded_sensor_addresses(path)[0]) as recording:
        before = recording.spans()
        spans = sorted(change(before), key=lambda span: (span.begin_ns, span.end_ns))
        if spans == before:
            return spans
        _require_ended(recording)
        newest_ns = int(max(recording.stamps_ns(Topic.IMAGES), default=0))
        content = json.dumps([vars(span) for span in spans], ensure_ascii=False).encode()
        attached = Attachment(newest_ns, newest_ns, SPANS_ATTACHMENT, "application/json", content)
        with open_atomic_file(path) as file:
            shutil.copymode(path, file.name)
            _write_whole(recording.file, file, attached)
    return spans


def _require_ended(recording: Recording) -> None:
    """Raise `OutputError` for a file that may still be being written; the lock of another computer is not seen here."""
    if recording.is_finished:
        return
    if is_being_written(recording.path) or seconds_since_change(recording.path) < WRITTEN_WITHIN_S:
        raise OutputError(
            expected="a recording that has ended",
            got=f"{recording.path}, which is still being written, or was until {WRITTEN_WITHIN_S:g} s ago",
            remedy="wait, and label it then",
        )


def _write_whole(source: McapFile, file: BinaryIO, spans: Attachment | None = None) -> None:
    """Write all whole records of a file, with these spans in place of those attached to it.

    Schemas and channels keep their numbers, because they are registered in the same order.
    """
    writer = Writer(file, CHUNK_BYTES, CompressionType.ZSTD)
    writer.start("ros2", f"ninedtact {__version__}")
    for metadata in source.metadata:
        writer.add_metadata(metadata.name, metadata.metadata)
    if not source.is_finished:
        writer.add_metadata(REPAIR_RECORD, {"wall_ns": str(time.time_ns())})
    attached = [one for one in source.attachments() if spans is None or one.name != spans.name]
    for one in attached if spans is None else [*attached, spans]:
        writer.add_attachment(one.create_time, one.log_time, one.name, one.media_type, one.data)
    for record in (record for chunk in source.chunks() for record in chunk):
        if isinstance(record, Schema):
            writer.register_schema(record.name, record.encoding, record.data)
        elif isinstance(record, Channel):
            writer.register_channel(record.topic, record.message_encoding, record.schema_id, record.metadata)
        elif isinstance(record, Message):
            writer.add_message(record.channel_id, record.log_time, record.data, record.publish_time, record.sequence)
    writer.finish()
