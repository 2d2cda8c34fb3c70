"""What is written is read again, by us and by others, whole or cut short, and whatever stops the writing."""

import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from episodes import BEGAN_NS, BOTH, FRAME_NS, SHAPE, frame, noise, sample, write_episode, write_messages
from mcap.reader import make_reader
from mcap.writer import Writer
from mcap_ros2.decoder import DecoderFactory
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from ninedtact.capture.frame_source import CameraNotFound
from ninedtact.cli import main
from ninedtact.quantities import EstimateWarning, Frame, HeightMap, HeightSource, Wrench, WrenchEstimate
from ninedtact.recording.errors import ExportTargetTaken, RecordingUnreadable, ReferenceMomentRefused
from ninedtact.recording.export import export_recording
from ninedtact.recording.mcap_repair import repair_recording
from ninedtact.recording.metadata import (
    HEIGHT_STEP_16_BIT_MM,
    METADATA_RECORD,
    RECORDING_FORMAT,
    RecordingMetadata,
    parse_recording_metadata,
)
from ninedtact.recording.reader import Recording
from ninedtact.recording.recorded_source import _first_image_at
from ninedtact.recording.summary import median_rate_hz
from ninedtact.recording.topics_and_messages import PairLabel, RecordingEvent, RecordingEventKind, Topic
from ninedtact.recording.writer import RecordingRefused, RecordingStopped, RecordingWriter

TYPES = get_typestore(Stores.ROS2_JAZZY)
SIX = np.array([1.0, -2.0, -7.5, 0.01, -0.02, 0.003])


def test_everything_comes_back_as_it_was(tmp_path: Path) -> None:
    session = RecordingMetadata("a sensor", settings='{"é": 1}', mm_per_px=0.05)
    pressed = np.linspace(-1, 0.2, 12, dtype=np.float32).reshape(3, 4)
    source = np.full((3, 4), HeightSource.MEASURED.value, np.uint8)
    source[0, 0] = HeightSource.OUT_OF_VIEW
    mark = PairLabel(BEGAN_NS, 7, 2, "ball:4", "s-00001", "rule", Wrench(SIX[:3], SIX[3:], stamp_ns=BEGAN_NS))
    event = RecordingEvent(BEGAN_NS + 1, RecordingEventKind.REMARK, "Größe", "3 N·m")
    with RecordingWriter(tmp_path / "all.mcap", session, attachments={"sensor/images/ball.png": b"\0\1"}) as episode:
        for number in (0, 1, 5):
            episode.write_image(frame(number))
        episode.write_image(Frame(noise(9)[::-1, ::2], BEGAN_NS + 9 * FRAME_NS, 6))
        episode.write_measured(Wrench(SIX[:3], SIX[3:], np.array([0.0, 0.0, -35.0]), BEGAN_NS))
        episode.write_estimated(
            WrenchEstimate(
                Wrench(-SIX[:3], SIX[3:], stamp_ns=BEGAN_NS),
                np.diag(np.arange(6.0) ** 2),
                True,
                (EstimateWarning.PART_UNSEEN,),
            ),
            5,
        )
        episode.write_height(HeightMap(pressed, source, 0.05, stamp_ns=BEGAN_NS), 5)
        episode.write_reference(frame(3), tare=2)
        episode.write_label(mark)
        episode.write_event(event)
    with Recording(tmp_path / "all.mcap") as read:
        assert read.is_finished and read.metadata == session
        frames = list(read.frames())
        assert [one.index for one in frames] == [0, 1, 5, 6]
        assert [one.stamp_ns for one in frames] == [BEGAN_NS + number * FRAME_NS for number in (0, 1, 5, 9)]
        for got, sent in zip(frames, [noise(0), noise(1), noise(5), noise(9)[::-1, ::2]], strict=True):
            assert np.array_equal(got.image, sent) and got.image.flags.writeable
        (measured,), (estimated,) = read.wrenches(), read.wrenches(Topic.ESTIMATED)
        about_centre = np.cross([0, 0, -0.035], SIX[:3]) + SIX[3:]
        assert measured.six == pytest.approx([*SIX[:3], *about_centre]) and not measured.about_mm.any()
        assert np.array_equal(estimated.six, [*-SIX[:3], *SIX[3:]]) and measured.stamp_ns == BEGAN_NS
        ((index, z_mm),) = read.heights()
        assert index == 5 and np.isnan(z_mm[0, 0])
        # Metres on disk: the round trip is exact to the last bit of a 32-bit number.
        np.testing.assert_allclose(z_mm.ravel()[1:], pressed.ravel()[1:], rtol=2e-7)
        (covariance,) = read.covariances()
        assert np.array_equal(covariance, np.diag(np.arange(6.0) ** 2))
        assert list(read.warnings()) == [(5, [EstimateWarning.PART_UNSEEN.value])]
        (untouched,) = read.frames(Topic.REFERENCE)
        assert untouched.index == 2 and np.array_equal(untouched.image, noise(3))
        (pair,) = read.labels()
        assert np.array_equal(pair.wrench.six, SIX) and vars(pair) | {"wrench": 0} == vars(mark) | {"wrench": 0}
        assert read.events() == [RecordingEvent(BEGAN_NS + 5 * FRAME_NS, RecordingEventKind.DROPPED, "3"), event]
        (attachment,) = read.attachments()
        assert (attachment.name, attachment.data) == ("sensor/images/ball.png", b"\0\1")


def test_png_images_and_heights_of_16_bits_come_back(tmp_path: Path) -> None:
    """Images bit for bit, heights to half a step of what the metadata state; other programs decode both."""
    path, step_mm = tmp_path / "small.mcap", HEIGHT_STEP_16_BIT_MM
    pressed = np.linspace(-2.5, 0.9, 12, dtype=np.float32).reshape(3, 4)
    source = np.full((3, 4), HeightSource.MEASURED.value, np.uint8)
    source[0, 0] = HeightSource.OUT_OF_VIEW
    session = RecordingMetadata("small", images="png", height_step_mm=step_mm, camera_delay_ms=12.5)
    with RecordingWriter(path, session) as episode:
        episode.write_image(frame(0))
        episode.write_image(Frame(noise(9)[::-1, ::2], BEGAN_NS + FRAME_NS, 1))
        episode.write_reference(frame(3), tare=2)
        episode.write_height(HeightMap(pressed, source, 0.05, stamp_ns=BEGAN_NS), 0)
        beyond = np.array([[99.0], [99.0], [-99.0]], np.float32).repeat(4, axis=1)
        episode.write_height(HeightMap(beyond, source, 0.05, stamp_ns=BEGAN_NS), 1)
    with Recording(path) as read:
        assert read.metadata == session
        for got, sent in zip(read.frames(), [noise(0), noise(9)[::-1, ::2]], strict=True):
            assert np.array_equal(got.image, sent) and got.image.flags.writeable
        (untouched,), ((_, z_mm), (_, beyond_mm)) = read.frames(Topic.REFERENCE), read.heights()
        assert np.array_equal(untouched.image, noise(3))
        assert np.isnan(z_mm[0, 0]) and np.isnan(beyond_mm[0, 0]) and beyond_mm[1, 1] == pytest.approx(32.767)
        assert beyond_mm[2, 1] == pytest.approx(-32.767)
        assert np.abs(z_mm - pressed).ravel()[1:].max() <= 0.5001 * step_mm
        types = {topic.topic: topic.type for topic in read.summary().topics}
    assert (
        types["/small/image_raw/compressed"]
        == types["/small/reference/compressed"]
        == "sensor_msgs/msg/CompressedImage"
    )
    assert others_read(path) == {"/small/image_raw/compressed": 2, "/small/reference/compressed": 1, "/small/height": 2}
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        decoded = {channel.topic: message for _, channel, _, message in reader.iter_decoded_messages()}
        (metadata,) = reader.iter_metadata()
    assert metadata.metadata["height_step_mm"] == "0.001" and metadata.metadata["camera_delay_ms"] == "12.5"
    image, height = decoded["/small/image_raw/compressed"], decoded["/small/height"]
    assert image.format == "bgr8; png compressed bgr8" and bytes(image.data)[1:4] == b"PNG"
    assert np.array_equal(cv2.imdecode(np.frombuffer(image.data, np.uint8), cv2.IMREAD_COLOR), noise(9)[::-1, ::2])
    assert (height.encoding, height.step) == ("16SC1", 8) and len(height.data) == 24


@pytest.mark.parametrize("field", ["images", "height_step_mm", "camera_delay_ms"])
def test_metadata_that_cannot_be_are_refused(field: str) -> None:
    values = {**RecordingMetadata("x").to_mcap_metadata(), field: "nan"}
    values.pop("checksum")
    with pytest.raises(RecordingUnreadable, match="expected it to state what was recorded, got"):
        parse_recording_metadata(values, "it")


def others_read(path: Path) -> dict[str, int]:
    """Messages by topic, as the libraries of MCAP and of ROS bags count them; they must agree."""
    counts: dict[str, int] = {}
    with path.open("rb") as file:
        for _, channel, _, _ in make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages():
            counts[channel.topic] = counts.get(channel.topic, 0) + 1
    with Reader(path) as bag:
        known = [connection for connection in bag.connections if not connection.msgtype.startswith("ninedtact")]
        for connection, _, raw in bag.messages(known):
            TYPES.deserialize_cdr(raw, connection.msgtype)
        assert {
            connection.topic: connection.msgcount for connection in bag.connections if connection.msgcount
        } == counts
    return counts


def test_other_programs_read_it(tmp_path: Path) -> None:
    session = RecordingMetadata("small")
    path = write_episode(tmp_path / "other.mcap", session=session)
    assert others_read(path) == {"/small/image_raw": 12, "/small/wrench_measured": 200}
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        images = [message for *_, message in reader.iter_decoded_messages(topics=["/small/image_raw"])]
        wrenches = [message for *_, message in reader.iter_decoded_messages(topics=["/small/wrench_measured"])]
        (attachment,), (metadata,) = reader.iter_attachments(), reader.iter_metadata()
    assert attachment.name == "sensor/sensor.toml" and metadata.metadata["sensor"] == "small"
    image, wall_ns = images[3], session.wall_ns(BEGAN_NS + 3 * FRAME_NS)
    assert (image.encoding, image.height, image.width, image.step) == ("bgr8", *SHAPE[:2], 3 * SHAPE[1])
    assert bytes(image.data) == noise(3).tobytes()
    assert (image.header.stamp.sec, image.header.stamp.nanosec) == divmod(wall_ns, 1_000_000_000)
    assert abs(wall_ns - time.time_ns()) < 400 * 86400e9
    assert wrenches[5].wrench.torque.z == sample(5).torque_nm[2] and wrenches[5].header.frame_id == "skin"


def prefix_of_the_whole(path: Path) -> tuple[int, int]:
    """That all that an episode holds is the beginning of `write_episode`; how many images and samples."""
    with Recording(path) as read:
        frames, wrenches = list(read.frames()), list(read.wrenches())
    assert [one.index for one in frames] == list(range(len(frames)))
    assert all(np.array_equal(one.image, noise(one.index)) for one in frames)
    assert all(np.array_equal(one.six, sample(number).six) for number, one in enumerate(wrenches))
    return len(frames), len(wrenches)


def test_a_file_cut_anywhere_is_read_to_its_last_whole_chunk_and_can_be_mended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ninedtact.recording.writer.CHUNK_BYTES", 6000)
    whole = write_episode(tmp_path / "whole.mcap").read_bytes()
    cut_file, before = tmp_path / "cut.mcap", (0, 0)
    for number, cut in enumerate([*range(9, len(whole) - 1, 1497), *range(len(whole) - 60, len(whole), 3)]):
        cut_file.write_bytes(whole[:cut])
        try:
            found = prefix_of_the_whole(cut_file)
        except RecordingUnreadable as refusal:
            assert "cut short before it began" in str(refusal) and before == (0, 0)
            continue
        assert found >= before
        before = found
        assert repair_recording(cut_file) and not repair_recording(cut_file)
        assert prefix_of_the_whole(cut_file) == found
        if number % 8 == 0:
            assert tuple(others_read(cut_file).get(topic.path("small"), 0) for topic in BOTH) == found
    assert before == (12, 200)


def test_a_file_whose_end_a_power_cut_left_as_zeros_is_read_to_its_last_undamaged_chunk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ninedtact.recording.writer.CHUNK_BYTES", 6000)
    path = write_episode(tmp_path / "zeros.mcap")
    with Recording(path) as read:
        chunks, written = read.index.chunks, path.read_bytes()[: read.index.end]
    middles = [(chunk.start + chunk.end) // 2 for chunk in chunks[1:]]
    before = (0, 0)
    for number, zeroed in enumerate([*middles, chunks[-1].end + 4]):
        path.write_bytes(written[:zeroed] + bytes(len(written) - zeroed))
        found = prefix_of_the_whole(path)
        assert found > before
        before = found
        assert repair_recording(path) and prefix_of_the_whole(path) == found
        if number % 8 == 0:
            assert tuple(others_read(path).get(topic.path("small"), 0) for topic in BOTH) == found
    assert before == (12, 200)


def test_a_changed_description_a_changed_attachment_and_a_missing_message_are_refused(tmp_path: Path) -> None:
    content = write_episode(tmp_path / "whole.mcap", frames=3, samples=20).read_bytes()
    with Recording(tmp_path / "whole.mcap") as whole:
        first_index = min(start for starts in whole.index.indexes.values() for start in starts.values())
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


def test_damage_is_told_and_never_passes_for_a_image(tmp_path: Path) -> None:
    whole = bytearray(write_episode(tmp_path / "whole.mcap", frames=3, samples=20).read_bytes())
    told = 0
    for at in range(len(whole) // 5, len(whole), 211):
        damaged = whole.copy()
        damaged[at] ^= 0x55
        (tmp_path / "damaged.mcap").write_bytes(damaged)
        try:
            prefix_of_the_whole(tmp_path / "damaged.mcap")
        except RecordingUnreadable as refusal:
            told += 1
            assert "expected" in str(refusal) and "got" in str(refusal)
    assert told > 10


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"images": "jpg"}, "images stored as 'jpg'"),
        ({"height_step_mm": -1.0}, "steps of -1 mm"),
        ({"name": "a/b"}, "a/b"),
    ],
)
def test_what_could_not_be_read_again_is_not_recorded(tmp_path: Path, changed: dict[str, Any], told: str) -> None:
    path, metadata = tmp_path / "never.mcap", RecordingMetadata("small")
    for field, value in changed.items():
        object.__setattr__(metadata, field, value)  # as a program without a type checker would give it
    with pytest.raises(RecordingRefused, match=told), RecordingWriter(path, metadata):
        pass
    assert not path.exists()


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
        assert not read.is_finished
        frames = list(read.frames())
        assert [one.index for one in frames] == list(range(len(frames))) and len(frames) > 5
        assert all(np.array_equal(one.image, noise(20 * one.index)) for one in frames)
        assert killed_ns - read.stamps_ns(Topic.MEASURED)[-1] < 1e9 and killed_ns - frames[-1].stamp_ns < 1e9


def test_a_recording_that_is_being_written_is_not_repaired(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "running.mcap"
    with RecordingWriter(path, RecordingMetadata("small"), BOTH) as episode:
        write_messages(episode, 6, 40)
        episode.flush()
        assert main(["info", str(path)]) == 0
        said = capsys.readouterr().out
        assert "is still being written" in said and "cut short" not in said and "--repair" not in said
        assert main(["export", str(path), "--out", str(tmp_path / "out")]) == 1
        said = capsys.readouterr().err
        assert "of a recording that is still being written; use what was read" in said and "cut short" not in said
        size = path.stat().st_size
        assert main(["info", str(path), "--repair"]) == 1 and path.stat().st_size == size
        assert "which is still being written; wait, and repair it then" in capsys.readouterr().err
        content = path.read_bytes()
    assert prefix_of_the_whole(path) == (6, 40)
    cut = tmp_path / "cut.mcap"  # a copy, which nobody writes
    cut.write_bytes(content)
    assert main(["info", str(cut)]) == 0 and "The file was cut short: it ends" in capsys.readouterr().out
    monkeypatch.setattr("ninedtact.recording.missing_end._is_locked", lambda recording: None)
    assert main(["info", str(cut)]) == 0 and "The file is still being written" in capsys.readouterr().out
    monkeypatch.undo()
    os.utime(cut, (time.time() - 3600,) * 2)
    for options in (["--repair"], []):
        assert main(["info", str(cut), *options]) == 0
        assert "The file was cut short and completed later. The rest is missing." in capsys.readouterr().out
    assert main(["export", str(cut), "--out", str(tmp_path / "completed")]) == 0
    assert "was cut short and completed later" in capsys.readouterr().err
    assert prefix_of_the_whole(cut) == (6, 40)
    with Recording(cut) as read:
        assert read.is_finished


@contextmanager
def disk_of(size: int) -> Iterator[None]:
    """While the block runs, no file may grow beyond this."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_full_disk_is_told_and_what_was_written_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ninedtact.recording.writer.CHUNK_BYTES", 3000)
    path = tmp_path / "full.mcap"
    with disk_of(30_000), pytest.raises(RecordingStopped, match=r"expected .* got: .*; free the disk"):
        write_episode(path)
    assert path.stat().st_size <= 30_000
    images, samples = prefix_of_the_whole(path)
    assert images >= 4 and samples >= 50
    repair_recording(path)  # there was no room for the summary: now there is
    assert others_read(path)["/small/image_raw"] == images
    with disk_of(100), pytest.raises(RecordingStopped):
        write_episode(tmp_path / "at_once.mcap")
    assert not (tmp_path / "at_once.mcap").exists()


@pytest.mark.parametrize("at", [5, 7, 8, 9, 14])
def test_an_interruption_at_any_write_leaves_a_finished_file(
    at: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ninedtact.recording.writer.CHUNK_BYTES", 3000)
    writes, written = iter(range(10_000)), os.write

    def interrupted(descriptor: int, content: memoryview) -> int:
        if next(writes) == at:
            written(descriptor, content[: len(content) // 2])
            raise KeyboardInterrupt
        return written(descriptor, content)

    path = tmp_path / "interrupted.mcap"
    monkeypatch.setattr("ninedtact.recording.writer.os.write", interrupted)
    with pytest.raises(KeyboardInterrupt), RecordingWriter(path, RecordingMetadata("small")) as episode:
        write_messages(episode, 12, 200)
    prefix_of_the_whole(path)
    with Recording(path) as read:
        assert read.is_finished
    others_read(path)


def foreign(path: Path) -> None:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        writer.add_message(writer.register_channel("/x", "json", 0), 1, b"{}", 1)
        writer.finish()


def of_format(version: int, path: Path) -> None:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        writer.add_metadata(METADATA_RECORD, RecordingMetadata("x").to_mcap_metadata() | {"format": str(version)})
        writer.finish()


BAD = {
    "an empty file": lambda path: path.write_bytes(b""),
    "something else": lambda path: path.write_bytes(b"not a recording" * 100),
    "of another program": foreign,
    "from a newer ninedtact": lambda path: of_format(RECORDING_FORMAT + 1, path),
    "from an older ninedtact; record it again": lambda path: of_format(RECORDING_FORMAT - 1, path),
    "cut short before it began": lambda path: path.write_bytes(
        write_episode(path.with_name("w.mcap")).read_bytes()[:60]
    ),
    "no such file": lambda path: None,
}


@pytest.mark.parametrize("said", BAD)
@pytest.mark.parametrize("command", ["info", "export", "live"])
def test_a_bad_recording_is_one_sentence(
    command: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bad = tmp_path / "bad.mcap"
    BAD[said](bad)
    options = {
        "info": [str(bad)],
        "export": [str(bad), "--out", str(tmp_path / "out")],
        "live": ["--source", str(bad)],
    }
    assert main([command, *options[command]]) == 1
    (sentence,) = capsys.readouterr().err.strip().splitlines()
    assert sentence.startswith("ninedtact: expected") and said in sentence and sentence.count(";") == 1
    assert not (tmp_path / "out").exists()


def test_a_recording_never_overwrites_and_is_missed_in_words(tmp_path: Path) -> None:
    path = write_episode(tmp_path / "there.mcap", frames=1, samples=1)
    before = path.read_bytes()
    for taken in (path, tmp_path / "no folder" / "x.mcap"):
        with pytest.raises(RecordingRefused, match=r"expected .* got"), RecordingWriter(taken, RecordingMetadata("x")):
            pass
    assert path.read_bytes() == before
    os.mkfifo(tmp_path / "pipe.mcap")
    for path, kind in ((tmp_path / "pipe.mcap", "a pipe or device"), (tmp_path, "a folder")):
        with pytest.raises(CameraNotFound, match=f"got {kind}; give a file"):
            Recording(path)
    with pytest.raises(CameraNotFound, match="no such file"):
        Recording(tmp_path / "none.mcap")


@pytest.mark.parametrize("purpose", ["record", "collect"])
def test_rate_and_gaps_are_those_of_the_stamps(purpose: str, tmp_path: Path) -> None:
    path = tmp_path / "gaps.mcap"
    with RecordingWriter(path, RecordingMetadata("gaps", purpose=purpose)) as episode:
        for number in (0, 1, 2, 4, 5, 8, 9, 10, 11, 15):
            episode.write_image(Frame(noise(0), BEGAN_NS + number * 20_000_000, number))
            if number in (0, 4):
                episode.write_measured(Wrench(SIX[:3], SIX[3:], stamp_ns=BEGAN_NS + number * 20_000_000))
    with Recording(path) as read:
        topics = {topic.topic.rpartition("/")[2]: topic for topic in read.summary().topics}
        assert read.began_ns == BEGAN_NS and read.duration_s == read.summary().seconds == pytest.approx(0.3)
    images, measured = topics["image_raw"], topics["wrench_measured"]
    assert (images.messages, measured.messages, measured.rate_hz) == (10, 2, None)
    if purpose == "record":  # steps of three and four are gaps, one of two is not
        assert (images.rate_hz, images.longest_gap_ms, images.gaps) == (pytest.approx(50), pytest.approx(80), 2)
    else:  # images that were selected have no rate
        assert images.rate_hz is images.gaps is None
    assert median_rate_hz(np.array([0, 20_000_000])) == pytest.approx(50)
    assert median_rate_hz(np.array([5])) == median_rate_hz(np.array([5, 5, 5])) == 30


def test_a_folder_that_holds_something_is_not_exported_into(tmp_path: Path) -> None:
    path, out = tmp_path / "one.mcap", tmp_path / "out"
    with RecordingWriter(path, RecordingMetadata("one")) as episode:
        episode.write_image(frame(0))
    with Recording(path) as read:
        out.mkdir()
        (out / "mine.txt").write_text("mine")
        for taken in (out, out / "mine.txt"):
            with pytest.raises(ExportTargetTaken, match="new or empty folder"):
                export_recording(read, taken)
        assert [each.name for each in out.iterdir()] == ["mine.txt"]
        (out / "mine.txt").unlink()
        assert {name: count for name, count in export_recording(read, out).items() if count} == {"images": 1}
        assert export_recording(read, tmp_path / "new")["images"] == 1


def test_a_reference_begins_at_its_moment_and_has_ten_images() -> None:
    """Images every tenth of a second."""
    recording = object.__new__(Recording)
    recording.path = Path("press.mcap")

    def first(images: int, at_s: float) -> int:
        stamps_ns = [(BEGAN_NS + number * 100_000_000,) for number in range(images)]
        return _first_image_at(recording, np.array(stamps_ns, [("stamp_ns", "i8")]), at_s)

    assert [first(25, at_s) for at_s in (0.0, 0.05, 0.1, 1.5)] == [0, 1, 1, 15] and first(10, 0.0) == 0
    for images, at_s, room in (
        (25, 1.51, "between 0 and 1.50 s"),
        (25, -0.1, "between 0 and 1.50 s"),
        (10, 0.1, "between 0 and 0.00 s"),
        (9, 0.0, "in a recording of 10 images"),
        (25, float("nan"), "between 0 and 1.50 s"),
    ):
        with pytest.raises(ReferenceMomentRefused, match=f"expected a moment {room} for a reference of 10 images"):
            first(images, at_s)


def test_wrench_and_errors_of_an_estimate_are_recorded_about_the_skin_centre(tmp_path: Path) -> None:
    errors = np.diag([0.1, 0.2, 0.3, 1e-3, 2e-3, 3e-3])
    centred = WrenchEstimate(Wrench(np.array([0.1, 0.2, -2.0]), np.array([1e-3, 1e-3, 0]), stamp_ns=7), errors, True)
    path = tmp_path / "one.mcap"
    with RecordingWriter(path, RecordingMetadata("small"), {Topic.ESTIMATED, Topic.COVARIANCE}) as episode:
        episode.write_estimated(centred.about(np.array([2.0, 3.0, -5.0])))
    with Recording(path) as recording:
        [found] = recording.estimates()
    np.testing.assert_allclose(found.wrench.six, centred.wrench.six, atol=1e-12)
    np.testing.assert_allclose(found.covariance, errors, atol=1e-12)
    assert found.touching
