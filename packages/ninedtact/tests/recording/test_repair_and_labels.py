"""A repaired recording is as complete as one that was closed, and labels replace each other without harm to the rest."""

import os
import time
import zlib
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from episodes import BEGAN_NS, BOTH, frame, write_messages
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Footer
from mcap.writer import MCAP0_MAGIC, Writer

from ninedtact.recording.errors import RecordingRefused, RecordingUnreadable
from ninedtact.recording.export import export_recording
from ninedtact.recording.mcap_repair import edit_labelled_spans, repair_recording
from ninedtact.recording.metadata import METADATA_RECORD, RecordingMetadata
from ninedtact.recording.reader import Recording, recorded_sensor_addresses
from ninedtact.recording.topics_and_messages import LabelledSpan, Topic
from ninedtact.recording.writer import RecordingWriter

ATTACHED = {"sensor/sensor.toml": b"id = 'small'", "sensor/images/ball.png": b"\0\1"}
PUSH, SLIDE = LabelledSpan(BEGAN_NS, BEGAN_NS + 10, "push"), LabelledSpan(BEGAN_NS + 5, BEGAN_NS + 7, "slide")


def write_attached(path: Path) -> Path:
    with RecordingWriter(path, RecordingMetadata("small"), BOTH, ATTACHED) as episode:
        write_messages(episode, 8, 120)
    return path


def summary_of(path: Path) -> dict[str, Any]:
    """What the summary of a file states, as the MCAP library reads it, with no position of a record in the file."""
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None and summary.statistics is not None
    return {
        "statistics": vars(summary.statistics),
        "schemas": {number: schema.name for number, schema in summary.schemas.items()},
        "channels": {number: vars(channel) for number, channel in summary.channels.items()},
        "attachments": [(one.name, one.data_size, one.log_time, one.length) for one in summary.attachment_indexes],
        "metadata": [(one.name, one.length) for one in summary.metadata_indexes],
        "chunks": [
            (
                each.chunk_start_offset,
                each.chunk_length,
                each.compression,
                each.compressed_size,
                each.uncompressed_size,
                each.message_start_time,
                each.message_end_time,
                each.message_index_offsets,
                each.message_index_length,
            )
            for each in summary.chunk_indexes
        ],
    }


def require_valid_summary_checksum(path: Path) -> None:
    """The checksum covers everything from the summary on, the footer without the checksum included (https://mcap.dev/spec)."""
    content, footer_bytes = path.read_bytes(), 9 + 20
    assert content.endswith(MCAP0_MAGIC)
    start = len(content) - len(MCAP0_MAGIC) - footer_bytes
    assert content[start] == Opcode.FOOTER and int.from_bytes(content[start + 1 : start + 9], "little") == 20
    footer = Footer.read(ReadDataStream(BytesIO(content[start + 9 :])))
    assert footer.summary_crc == zlib.crc32(content[footer.summary_start : start + footer_bytes - 4])


def test_a_repaired_recording_has_the_summary_of_one_that_was_closed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ninedtact.recording.writer.CHUNK_BYTES", 6000)
    whole = write_attached(tmp_path / "whole.mcap")
    with Recording(whole) as read:
        end = read.index.end
        last_index = min(read.index.indexes[len(read.index.chunks) - 1].values())
    for cut_at in (end, end + 5, end - 1, last_index):  # the last two lack a part or all of the index of the last chunk
        cut = tmp_path / f"cut_{cut_at}.mcap"
        cut.write_bytes(whole.read_bytes()[:cut_at])
        assert repair_recording(cut)
        with Recording(whole) as closed, Recording(cut) as repaired:
            assert repaired.is_repaired and not closed.is_repaired
        repaired_summary, summary = summary_of(cut), summary_of(whole)
        note = repaired_summary["metadata"].pop()
        assert note[0] == "ninedtact_repair"
        repaired_summary["statistics"]["metadata_count"] -= 1
        assert repaired_summary == summary
        require_valid_summary_checksum(cut)


def test_labels_replace_each_other_and_leave_everything_else_as_it_was(tmp_path: Path) -> None:
    path = write_attached(tmp_path / "labelled.mcap")
    before = path.read_bytes()
    with Recording(path) as recording:
        end, frames = recording.index.end, [one.image for one in recording.frames()]
    assert edit_labelled_spans(path, lambda spans: [SLIDE, *spans, PUSH]) == [PUSH, SLIDE]
    assert path.read_bytes()[:end] == before[:end]
    sizes = {path.stat().st_size}
    for _ in range(3):
        assert edit_labelled_spans(path, lambda spans: [spans[0]]) == [PUSH]
        assert edit_labelled_spans(path, lambda spans: [*spans, SLIDE]) == [PUSH, SLIDE]
        sizes.add(path.stat().st_size)
    assert len(sizes) == 1, "an earlier list of labels was left in the file"
    with Recording(path) as recording:
        assert recording.is_finished and recording.spans() == [PUSH, SLIDE]
        attachments = list(recording.attachments())
        assert [one.name for one in attachments] == [*ATTACHED, "spans.json"]
        assert attachments[-1].log_time == max(recording.stamps_ns(Topic.IMAGES))
        assert recording.sensor_files() == {"sensor.toml": b"id = 'small'", "images/ball.png": b"\0\1"}
        assert all(
            np.array_equal(*both) for both in zip(frames, (one.image for one in recording.frames()), strict=True)
        )
    require_valid_summary_checksum(path)
    written = path.stat()
    assert edit_labelled_spans(path, lambda spans: spans) == [PUSH, SLIDE]
    assert path.stat().st_ino == written.st_ino  # nothing changed, so nothing was written


def test_an_attachment_of_another_kind_at_the_end_of_the_file_is_not_taken_for_labels(tmp_path: Path) -> None:
    path = tmp_path / "empty.mcap"
    with RecordingWriter(path, RecordingMetadata("small"), BOTH, ATTACHED):
        pass  # no messages: the attachments are the last records
    assert edit_labelled_spans(path, lambda _: [PUSH]) == [PUSH]
    with Recording(path) as recording:
        attachments = list(recording.attachments())
        assert [one.name for one in attachments] == [*ATTACHED, "spans.json"] and attachments[-1].log_time == 0


def test_labels_of_a_truncated_recording_complete_it_and_one_being_written_is_refused(tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(write_attached(tmp_path / "whole.mcap").read_bytes()[:-100])
    for age_s in (4.0, -4.0):  # the clock may have been set back
        os.utime(cut, (time.time() - age_s,) * 2)
        with pytest.raises(
            RecordingRefused, match=r"may be writing: it changed [34]\.\d s ago; wait, and label it then"
        ):
            edit_labelled_spans(cut, lambda _: [PUSH])
    os.utime(cut, (time.time() - 5.5,) * 2)
    assert edit_labelled_spans(cut, lambda _: [PUSH]) == [PUSH]
    with Recording(cut) as recording:
        assert recording.is_finished and recording.spans() == [PUSH] and len(recording.positions(Topic.IMAGES)) == 8
    require_valid_summary_checksum(cut)


def test_labels_that_two_threads_add_are_all_kept(tmp_path: Path) -> None:
    path = write_attached(tmp_path / "shared.mcap")

    def add(number: int) -> None:
        span = LabelledSpan(BEGAN_NS + number, BEGAN_NS + number + 1, f"span {number}")

        def change(spans: list[LabelledSpan]) -> Iterable[LabelledSpan]:
            return [*spans, span]

        edit_labelled_spans(path, change)

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(add, range(12)))
    with Recording(path) as recording:
        assert [one.label for one in recording.spans()] == [f"span {number}" for number in range(12)]


def write_metadata(path: Path, *names: str) -> Path:
    """An MCAP file with the metadata of sensors and nothing else."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        for name in names:
            writer.add_metadata(METADATA_RECORD, RecordingMetadata("small", name=name).to_mcap_metadata())
        writer.finish()
    return path


def test_sensors_of_a_recording_are_named_and_no_two_alike(tmp_path: Path) -> None:
    path = write_metadata(tmp_path / "two.mcap", "left", "right")
    assert recorded_sensor_addresses(path) == [f"{path}#left", f"{path}#right"]
    assert recorded_sensor_addresses(f"{path}#left") == [f"{path}#left"]
    with Recording(f"{path}#right") as recording:
        assert recording.metadata.name == "right" and recording.duration_s == recording.began_ns == 0
    for address, got in ((path, "got none; name it as .*#left"), (f"{path}#middle", "got 'middle'")):
        with pytest.raises(RecordingUnreadable, match=f"expected one of the sensors left, right of .* {got}"):
            Recording(address)
    with pytest.raises(RecordingUnreadable, match="two sensors of the same name"):
        Recording(f"{write_metadata(tmp_path / 'alike.mcap', 'left', 'left')}#left")
    alone = write_metadata(tmp_path / "alone.mcap", "")
    with pytest.raises(RecordingUnreadable, match=r"expected no name of a sensor .* got 'left'; drop it"):
        Recording(f"{alone}#left")


def test_an_exported_recording_counts_and_numbers_what_it_holds(tmp_path: Path) -> None:
    path = tmp_path / "tared.mcap"
    with RecordingWriter(path, RecordingMetadata("small")) as episode:
        for tare, number in ((0, 0), (0, 1), (2, 5)):
            episode.write_reference(frame(number), tare)
        episode.write_image(frame(7))
        episode.write_span(SLIDE)
        episode.write_span(PUSH)
    with Recording(path) as recording:
        counts = export_recording(recording, tmp_path / "out")
    assert {name: count for name, count in counts.items() if count} == {"images": 1, "references": 3, "spans": 2}
    assert sorted(each.name for each in (tmp_path / "out" / "references").iterdir()) == [
        "reference_000_00001.png",
        "reference_000_00002.png",
        "reference_002_00003.png",
    ]
    spans = (tmp_path / "out" / "spans.csv").read_text().splitlines()
    assert [line.split(",")[0] for line in spans] == ["label", "push", "slide"]
