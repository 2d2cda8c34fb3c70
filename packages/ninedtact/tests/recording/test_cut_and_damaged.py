"""Recordings whose end is missing, whose content is damaged, and those that are no recordings; and labels, which rewrite a file."""

import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from episodes import BEGAN_NS, BOTH, count_as_others_do, noise, read_beginning, write_episode, write_messages
from mcap.reader import make_reader
from mcap.records import Message
from mcap.summary import Summary
from mcap.writer import Writer

from ninedtact.cli import main
from ninedtact.errors import CameraError, OutputError
from ninedtact.recording.errors import RecordingStopped, RecordingUnreadable
from ninedtact.recording.labels_and_whole_copy import edit_labelled_spans, write_whole_copy
from ninedtact.recording.metadata import METADATA_RECORD, RECORDING_FORMAT, RecordingMetadata
from ninedtact.recording.reader import Recording, recorded_sensor_addresses
from ninedtact.recording.topics_and_messages import LabelledSpan, Topic
from ninedtact.recording.writer import RecordingWriter

PUSH, SLIDE = LabelledSpan(BEGAN_NS, BEGAN_NS + 10, "push"), LabelledSpan(BEGAN_NS + 5, BEGAN_NS + 7, "slide")
ALL = (12, 200)
"""Images and samples of `write_episode`."""


def summary_of(path: Path) -> Summary:
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None and summary.statistics is not None
    return summary


def make_old(path: Path) -> None:
    os.utime(path, (time.time() - 3600,) * 2)


def test_a_file_cut_anywhere_is_read_to_its_last_whole_chunk_and_copied_whole(tmp_path: Path) -> None:
    whole = write_episode(tmp_path / "whole.mcap")
    content, ends = (
        whole.read_bytes(),
        [one.chunk_start_offset + one.chunk_length for one in summary_of(whole).chunk_indexes],
    )
    cut_file, before = tmp_path / "cut.mcap", (0, 0)
    for cut in sorted([*range(9, len(content) - 1, 1497), *ends, *(end + 20 for end in ends), len(content) - 3]):
        cut_file.write_bytes(content[:cut])
        try:
            found = read_beginning(cut_file)
        except RecordingUnreadable as refusal:
            assert "cut short before it began" in str(refusal) and before == (0, 0)
            continue
        assert found >= before
        before = found
        if cut in ends:
            copy = tmp_path / f"copy_{cut}.mcap"
            write_whole_copy(cut_file, copy)
            assert cut_file.read_bytes() == content[:cut]
            with Recording(copy) as copied, Recording(whole) as original:
                assert copied.is_finished and copied.is_repaired and not original.is_repaired
                assert copied.sensor_files() == original.sensor_files() and copied.metadata == original.metadata
            assert (
                read_beginning(copy) == found == tuple(count_as_others_do(copy)[topic.path("small")] for topic in BOTH)
            )
    assert before == ALL and len(ends) > 10


def test_a_file_whose_end_a_power_cut_left_as_zeros_is_read_to_its_last_undamaged_chunk(tmp_path: Path) -> None:
    path = write_episode(tmp_path / "zeros.mcap")
    content, chunks, before = path.read_bytes(), summary_of(path).chunk_indexes, (0, 0)
    for chunk in chunks[1:]:
        zeroed = chunk.chunk_start_offset + chunk.chunk_length // 2
        path.write_bytes(content[:zeroed] + bytes(len(content) - zeroed))
        assert before < (before := read_beginning(path))
    path.write_bytes(content[: chunks[-1].chunk_start_offset + chunks[-1].chunk_length + 4] + bytes(5000))
    assert read_beginning(path) == ALL
    path.write_bytes(content[: chunks[0].chunk_start_offset + 100] + bytes(5000))
    assert read_beginning(path) == (0, 0)


def test_a_changed_description_a_changed_attachment_and_a_missing_message_are_refused(tmp_path: Path) -> None:
    content = write_episode(tmp_path / "whole.mcap", frames=3, samples=20).read_bytes()
    chunk = summary_of(tmp_path / "whole.mcap").chunk_indexes[0]
    first_index = min(chunk.message_index_offsets.values())
    other_channel = bytes([content[first_index + 9] + 9])  # of the messages that this record of the index counts
    changes = {
        "checksum": content.replace(b"wall_minus_monotonic_ns\x13\0\0\x001", b"wall_minus_monotonic_ns\x13\0\0\x002"),
        "damaged data at byte ": content.replace(b"id = 'small'", b"id = 'sma11'"),
        "damaged data": content[: first_index + 9] + other_channel + content[first_index + 10 :],
    }
    for sentence, changed in changes.items():
        assert changed != content and len(changed) == len(content)
        (tmp_path / "changed.mcap").write_bytes(changed)
        with pytest.raises(RecordingUnreadable, match=sentence), Recording(tmp_path / "changed.mcap") as recording:
            recording.save_sensor_folder(tmp_path / "sensor")


RECORDING = """
import sys, time
import numpy as np
from pathlib import Path
from episodes import noise
from ninedtact.quantities import Frame, Wrench
from ninedtact.recording.writer import RecordingWriter
from ninedtact.recording.metadata import RecordingMetadata
with RecordingWriter(Path(sys.argv[1]), RecordingMetadata("killed")) as episode:
    for number in range(100_000):
        episode.write_measured(Wrench(np.ones(3), np.ones(3), stamp_ns=time.monotonic_ns()))
        if number % 20 == 0:
            episode.write_image(Frame(noise(number), time.monotonic_ns(), number // 20))
        time.sleep(0.002)
"""


def test_a_killed_program_loses_at_most_the_last_second(tmp_path: Path) -> None:
    path = tmp_path / "killed.mcap"
    here = {**os.environ, "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *filter(None, sys.path)])}
    running = subprocess.Popen([sys.executable, "-c", RECORDING, str(path)], env=here)
    while not path.exists() or path.stat().st_size < 50_000:
        assert running.poll() is None
        time.sleep(0.02)
    time.sleep(1.0)
    running.send_signal(signal.SIGKILL)
    killed_ns = time.monotonic_ns()
    running.wait()
    with Recording(path) as read:
        assert not read.is_finished and not read.is_being_written
        frames = list(read.frames())
        assert [one.index for one in frames] == list(range(len(frames))) and len(frames) > 5
        assert all(np.array_equal(one.image, noise(20 * one.index)) for one in frames)
        assert killed_ns - read.stamps_ns(Topic.MEASURED)[-1] < 1e9 and killed_ns - frames[-1].stamp_ns < 1e9


def test_a_recording_that_is_being_written_is_read_and_is_not_said_to_be_cut(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path, cut, copy = tmp_path / "running.mcap", tmp_path / "cut.mcap", tmp_path / "whole.mcap"
    with RecordingWriter(path, RecordingMetadata("small"), BOTH) as episode:
        write_messages(episode, 6, 40)
        episode.flush()
        assert main(["info", str(path)]) == 0
        said = capsys.readouterr().out
        assert "is still being written" in said and "cut short" not in said and "--whole-copy" not in said
        assert main(["export", str(path), "--out", str(tmp_path / "out")]) == 1
        said = capsys.readouterr().err
        assert "of a recording that is still being written; use what was read" in said and "cut short" not in said
        make_old(path)
        with pytest.raises(OutputError, match=r"which is still being written.*; wait, and label it then"):
            edit_labelled_spans(path, lambda _: [PUSH])
        cut.write_bytes(path.read_bytes())  # a copy, which nobody writes
    assert read_beginning(path) == (6, 40)
    assert main(["info", str(cut)]) == 0 and "The file was cut short: it ends" in capsys.readouterr().out
    with monkeypatch.context() as without_locks:
        without_locks.setitem(sys.modules, "fcntl", None)
        assert main(["info", str(cut)]) == 0 and "The file is still being written" in capsys.readouterr().out
    assert main(["info", str(cut), "--whole-copy", str(copy)]) == 0 and str(copy) in capsys.readouterr().out
    assert main(["info", str(copy)]) == 0
    assert "This is the whole copy of a file that was cut short. The rest is missing." in capsys.readouterr().out
    assert main(["export", str(copy), "--out", str(tmp_path / "completed")]) == 0
    assert "whole copy of a file that was cut short" in capsys.readouterr().err
    assert read_beginning(copy) == (6, 40)
    assert main(["info", str(cut), "--whole-copy", str(copy)]) == 1
    assert "expected --whole-copy to be a new file" in capsys.readouterr().err


@contextmanager
def disk_of(size: int) -> Iterator[None]:
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_full_disk_is_told_and_what_was_written_stays(tmp_path: Path) -> None:
    path = tmp_path / "full.mcap"
    with disk_of(30_000), pytest.raises(RecordingStopped, match=r"expected .* got .*; free the disk"):
        write_episode(path)
    assert path.stat().st_size <= 30_000
    images, samples = read_beginning(path)
    assert images >= 3 and samples >= 50
    write_whole_copy(path, tmp_path / "copy.mcap")
    assert count_as_others_do(tmp_path / "copy.mcap")["/small/image_raw"] == images
    with disk_of(100), pytest.raises(RecordingStopped):
        write_episode(tmp_path / "at_once.mcap")
    assert not (tmp_path / "at_once.mcap").exists()


@pytest.mark.parametrize("at", [5, 7, 8, 9, 14])
def test_an_interruption_at_any_write_leaves_whole_records(
    at: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    writes, written = iter(range(10_000)), os.write

    def interrupted(descriptor: int, content: memoryview) -> int:
        if next(writes) == at:
            written(descriptor, content[: len(content) // 2])
            raise KeyboardInterrupt
        return written(descriptor, content)

    path = tmp_path / "interrupted.mcap"
    monkeypatch.setattr("ninedtact.recording.writer.os.write", interrupted)
    with pytest.raises(KeyboardInterrupt), RecordingWriter(path, RecordingMetadata("small")) as episode:
        for _ in range(5):
            write_messages(episode)
    monkeypatch.undo()
    found = read_beginning(path)
    write_whole_copy(path, tmp_path / "copy.mcap")
    counts = count_as_others_do(tmp_path / "copy.mcap")
    assert (counts["/small/image_raw"], counts["/small/wrench_measured"]) == found > (0, 0)


def write_of_another_program(path: Path) -> None:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        writer.add_message(writer.register_channel("/x", "json", 0), 1, b"{}", 1)
        writer.finish()


def write_metadata(path: Path, *names: str, version: int = RECORDING_FORMAT) -> Path:
    """An MCAP file with the metadata of sensors and nothing else."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        for name in names:
            values = RecordingMetadata("small", name=name).to_mcap_metadata() | {"format": str(version)}
            values.pop("checksum")
            writer.add_metadata(METADATA_RECORD, values)
        writer.finish()
    return path


def write_first_bytes(path: Path) -> None:
    path.write_bytes(write_episode(path.with_name("w.mcap")).read_bytes()[:60])


BAD: dict[str, Callable[[Path], object]] = {
    "an empty file": lambda path: path.write_bytes(b""),
    "something else": lambda path: path.write_bytes(b"not a recording" * 100),
    "of another program": write_of_another_program,
    "from a newer ninedtact": lambda path: write_metadata(path, "", version=RECORDING_FORMAT + 1),
    "from an older ninedtact; record it again": lambda path: write_metadata(path, "", version=RECORDING_FORMAT - 1),
    "cut short before it began": write_first_bytes,
    "no such file": lambda path: None,
}


@pytest.mark.parametrize("said", BAD)
def test_a_bad_recording_is_one_sentence(said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bad, out = tmp_path / "bad.mcap", tmp_path / "out"
    BAD[said](bad)
    for words in (["info", str(bad)], ["export", str(bad), "--out", str(out)], ["live", "--source", str(bad)]):
        assert main(words) == 1
        (sentence,) = capsys.readouterr().err.strip().splitlines()
        assert sentence.startswith("ninedtact: expected") and said in sentence and sentence.count(";") == 1
    assert not out.exists()


def test_a_recording_never_overwrites_and_is_missed_in_words(tmp_path: Path) -> None:
    path = write_episode(tmp_path / "there.mcap", frames=1, samples=1)
    before = path.read_bytes()
    for taken in (path, tmp_path / "no folder" / "x.mcap"):
        with pytest.raises(OutputError, match=r"expected .* got"), RecordingWriter(taken, RecordingMetadata("x")):
            pass
    assert path.read_bytes() == before
    os.mkfifo(tmp_path / "pipe.mcap")
    (empty := tmp_path / "empty").mkdir()
    for path, said in (
        (tmp_path / "pipe.mcap", "a pipe or device; give a file"),
        (empty, "a folder; give a file"),
        (tmp_path, "a folder; give the file in it, .*there.mcap"),
    ):
        with pytest.raises(CameraError, match=f"got {said}"):
            Recording(path)


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


def test_labels_replace_each_other_and_leave_everything_else_as_it_was(tmp_path: Path) -> None:
    path = write_episode(tmp_path / "labelled.mcap")
    before, channels = messages_of(path), summary_of(path).channels
    assert edit_labelled_spans(path, lambda spans: [SLIDE, *spans, PUSH]) == [PUSH, SLIDE]
    assert edit_labelled_spans(path, lambda spans: [spans[0]]) == [PUSH]
    assert edit_labelled_spans(path, lambda spans: [*spans, SLIDE]) == [PUSH, SLIDE]
    with Recording(path) as recording:
        assert recording.is_finished and not recording.is_repaired and recording.spans() == [PUSH, SLIDE]
        attachments = list(recording.file.attachments())
        assert [one.name for one in attachments] == ["sensor/sensor.toml", "spans.json"]
        assert attachments[-1].log_time == max(recording.stamps_ns(Topic.IMAGES))
    assert messages_of(path) == before and summary_of(path).channels == channels
    assert read_beginning(path) == ALL == tuple(count_as_others_do(path)[topic.path("small")] for topic in BOTH)
    written = path.stat()
    assert edit_labelled_spans(path, lambda spans: spans) == [PUSH, SLIDE]
    assert path.stat().st_ino == written.st_ino  # nothing changed, so nothing was written


def messages_of(path: Path) -> list[Message]:
    with path.open("rb") as file:
        return [message for _, _, message in make_reader(file).iter_messages(log_time_order=False)]


def test_labels_of_a_recording_that_was_cut_short_are_written_with_its_whole_copy(tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(write_episode(tmp_path / "whole.mcap").read_bytes()[:-100])
    for age_s in (4.0, -4.0):  # another computer may be writing it, whose clock may be ahead
        os.utime(cut, (time.time() - age_s,) * 2)
        with pytest.raises(OutputError, match=r"or was until 5 s ago; wait, and label it then"):
            edit_labelled_spans(cut, lambda _: [PUSH])
    os.utime(cut, (time.time() - 5.5,) * 2)
    assert edit_labelled_spans(cut, lambda _: [PUSH]) == [PUSH]
    with Recording(cut) as recording:
        assert recording.is_finished and recording.is_repaired and recording.spans() == [PUSH]
    assert read_beginning(cut) == ALL
