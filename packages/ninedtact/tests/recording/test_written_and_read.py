"""What is written is read again, by this package and by others."""

import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from episodes import BEGAN_NS, FRAME_NS, SHAPE, count_as_others_do, frame, noise, sample, write_episode
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from ninedtact.errors import OutputError
from ninedtact.quantities import EstimateWarning, Frame, HeightMap, HeightSource, Wrench, WrenchEstimate
from ninedtact.recording.export import export_recording
from ninedtact.recording.metadata import HEIGHT_STEP_16_BIT_MM, RecordingMetadata
from ninedtact.recording.reader import Recording
from ninedtact.recording.summary import usual_rate_hz
from ninedtact.recording.topics_and_messages import LabelledSpan, PairLabel, RecordingEvent, RecordingEventKind, Topic
from ninedtact.recording.writer import RecordingWriter

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
        episode.write_image(Frame(noise(9)[::-1, ::-1], BEGAN_NS + 9 * FRAME_NS, 6))
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
        for got, sent in zip(frames, [noise(0), noise(1), noise(5), noise(9)[::-1, ::-1]], strict=True):
            assert np.array_equal(got.image, sent) and got.image.flags.writeable
        (measured,), (estimated,) = read.wrenches(), read.wrenches(Topic.ESTIMATED)
        about_centre = np.cross([0, 0, -0.035], SIX[:3]) + SIX[3:]
        assert measured.six == pytest.approx([*SIX[:3], *about_centre]) and not measured.about_mm.any()
        assert np.array_equal(estimated.six, [*-SIX[:3], *SIX[3:]]) and measured.stamp_ns == BEGAN_NS
        ((index, z_mm),) = read.heights()
        assert index == 5 and np.isnan(z_mm[0, 0])
        # Metres on disk: the round trip is exact to the last bit of a 32-bit number.
        np.testing.assert_allclose(z_mm.ravel()[1:], pressed.ravel()[1:], rtol=2e-7)
        (estimate,) = read.estimates()
        assert np.array_equal(estimate.covariance, np.diag(np.arange(6.0) ** 2))
        assert list(read.warnings()) == [(5, [EstimateWarning.PART_UNSEEN.value])]
        (untouched,) = read.frames(Topic.REFERENCE)
        assert untouched.index == 2 and np.array_equal(untouched.image, noise(3))
        (pair,) = read.labels()
        assert np.array_equal(pair.wrench.six, SIX) and vars(pair) | {"wrench": 0} == vars(mark) | {"wrench": 0}
        assert read.events() == [RecordingEvent(BEGAN_NS + 5 * FRAME_NS, RecordingEventKind.DROPPED, "3"), event]
        (attachment,) = read.file.attachments()
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
        episode.write_image(Frame(noise(9)[::-1, ::-1], BEGAN_NS + FRAME_NS, 1))
        episode.write_reference(frame(3), tare=2)
        episode.write_height(HeightMap(pressed, source, 0.05, stamp_ns=BEGAN_NS), 0)
        beyond = np.array([[99.0], [99.0], [-99.0]], np.float32).repeat(4, axis=1)
        episode.write_height(HeightMap(beyond, source, 0.05, stamp_ns=BEGAN_NS), 1)
    with Recording(path) as read:
        assert read.metadata == session
        for got, sent in zip(read.frames(), [noise(0), noise(9)[::-1, ::-1]], strict=True):
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
    assert count_as_others_do(path) == {
        "/small/image_raw/compressed": 2,
        "/small/reference/compressed": 1,
        "/small/height": 2,
    }
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        decoded = {channel.topic: message for _, channel, _, message in reader.iter_decoded_messages()}
        (metadata,) = reader.iter_metadata()
    assert metadata.metadata["height_step_mm"] == "0.001" and metadata.metadata["camera_delay_ms"] == "12.5"
    image, height = decoded["/small/image_raw/compressed"], decoded["/small/height"]
    assert image.format == "bgr8; png compressed bgr8" and bytes(image.data)[1:4] == b"PNG"
    assert np.array_equal(cv2.imdecode(np.frombuffer(image.data, np.uint8), cv2.IMREAD_COLOR), noise(9)[::-1, ::-1])
    assert (height.encoding, height.step) == ("16SC1", 8) and len(height.data) == 24


def test_other_programs_read_it(tmp_path: Path) -> None:
    session = RecordingMetadata("small")
    path = write_episode(tmp_path / "other.mcap", session=session)
    assert count_as_others_do(path) == {"/small/image_raw": 12, "/small/wrench_measured": 200}
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


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"images": "jpg"}, r"'jpg' - at `\$\.images`"),
        ({"height_step_mm": -1.0}, r">= 0\.0 - at `\$\.height_step_mm`"),
        ({"name": "a/b"}, r"at `\$\.name`"),
    ],
)
def test_what_could_not_be_read_again_is_not_recorded(tmp_path: Path, changed: dict[str, Any], told: str) -> None:
    path, metadata = tmp_path / "never.mcap", RecordingMetadata("small")
    for field, value in changed.items():
        object.__setattr__(metadata, field, value)  # as a program without a type checker would give it
    with pytest.raises(OutputError, match=told), RecordingWriter(path, metadata):
        pass
    assert not path.exists()


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
    assert usual_rate_hz(np.array([0, 20_000_000])) == pytest.approx(50)
    assert usual_rate_hz(np.array([0, 20_000_000, 900_000_000])) == pytest.approx(50)
    milliseconds = np.rint(np.arange(40) * 1e3 / 60).astype(np.int64) * 1_000_000
    for times in (milliseconds, np.delete(milliseconds, [7, 8, 20])):
        assert usual_rate_hz(times) == pytest.approx(60, rel=0.005)
    assert usual_rate_hz(np.array([5])) == usual_rate_hz(np.array([5, 5, 5])) == 30


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


def test_estimates_of_images_with_one_stamp_are_those_of_their_image(tmp_path: Path) -> None:
    """As on a computer whose clock has coarse steps."""
    path, image = tmp_path / "alike.mcap", frame(0)
    with RecordingWriter(path, RecordingMetadata("small")) as episode:
        for index, warnings in ((0, ()), (1, (EstimateWarning.PART_UNSEEN,))):
            episode.write_image(Frame(image.image, image.stamp_ns, index))
            wrench = Wrench(np.full(3, 1.0 + index), np.zeros(3), stamp_ns=image.stamp_ns)
            episode.write_estimated(WrenchEstimate(wrench, np.eye(6) * (1 + index), True, warnings), index)
    with Recording(path) as recording:
        first, second = recording.estimates()
    assert (first.wrench.force_n[0], first.covariance[0, 0], first.warnings) == (1.0, 1.0, ())
    assert (second.wrench.force_n[0], second.covariance[0, 0]) == (2.0, 2.0)
    assert second.warnings == (EstimateWarning.PART_UNSEEN,)


def test_an_exported_recording_counts_and_numbers_what_it_holds_and_keeps_what_is_there(tmp_path: Path) -> None:
    path, out = tmp_path / "tared.mcap", tmp_path / "out"
    with RecordingWriter(path, RecordingMetadata("small")) as episode:
        for tare, number in ((0, 0), (0, 1), (2, 5)):
            episode.write_reference(frame(number), tare)
        episode.write_image(frame(7))
        episode.write_span(LabelledSpan(BEGAN_NS + 5, BEGAN_NS + 7, "slide"))
        episode.write_span(LabelledSpan(BEGAN_NS, BEGAN_NS + 10, "push"))
    out.mkdir()
    (out / "mine.txt").write_text("mine")
    with Recording(path) as recording:
        for taken in (out, out / "mine.txt"):
            with pytest.raises(OutputError, match="new or empty folder"):
                export_recording(recording, taken)
        assert [each.name for each in out.iterdir()] == ["mine.txt"]
        (out / "mine.txt").unlink()
        counts = export_recording(recording, out)
    assert {name: count for name, count in counts.items() if count} == {"images": 1, "references": 3, "spans": 2}
    assert sorted(each.name for each in (out / "references").iterdir()) == [
        "reference_000_00001.png",
        "reference_000_00002.png",
        "reference_002_00003.png",
    ]
    spans = (out / "spans.csv").read_text().splitlines()
    assert [line.split(",")[0] for line in spans] == ["label", "push", "slide"]
