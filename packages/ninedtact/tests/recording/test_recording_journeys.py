"""What a person does: record, look, and write out, at the command line and from a program."""

import csv
import json
import resource
import shutil
import threading
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from episodes import write_estimates
from hand import BEGAN_NS, Camera, record_hand
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from small_press_simulation import small_press_simulation
from twin_folder import twin_folder

import ninedtact
from ninedtact.calibration.sensor_folder import load_sensor
from ninedtact.capture.camera_delay import CameraDelay, write_camera_delay
from ninedtact.capture.frame_source import DEFAULT_CAMERA, CameraLost
from ninedtact.cli import main
from ninedtact.errors import CameraError
from ninedtact.force.estimator_and_scale import ForceEstimator
from ninedtact.quantities import EstimateWarning, Frame, Wrench, WrenchEstimate
from ninedtact.reading import Reading, read_frame
from ninedtact.recording.attached_sensor import read_folder_files
from ninedtact.recording.labels_and_whole_copy import edit_labelled_spans
from ninedtact.recording.metadata import RecordingMetadata
from ninedtact.recording.reader import Recording, RecordingCutShort, recorded_sensor_addresses
from ninedtact.recording.recorded_source import RecordedFrameSource
from ninedtact.recording.recorder import SensorToRecord, record, record_several
from ninedtact.recording.topics_and_messages import LabelledSpan, Topic
from ninedtact.recording.writer import RecordingWriter
from ninedtact.simulation.simulated_sources import SimulatedCamera
from ninedtact.source_addresses import source_in_real_time


@pytest.fixture(scope="module")
def sensor(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sensor like the default twin that knows its twin, made without calibrating."""
    return twin_folder(tmp_path_factory.mktemp("recording") / "sensor")


def untouched_images(folder: Path, sensor: Path, images: int) -> Path:
    folder.mkdir()
    untouched, rng = cv2.imread(str(sensor / "untouched.png")), np.random.default_rng(0)
    for number in range(images):
        noisy = untouched + rng.normal(0, 2, untouched.shape)
        cv2.imwrite(str(folder / f"{number}.png"), noisy.clip(0, 255).astype(np.uint8))
    return folder


def told(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> dict:
    assert main([*map(str, arguments), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_a_twin_is_recorded_shown_again_and_written_out(
    sensor: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, out = tmp_path / "twin.mcap", tmp_path / "out"
    options = ["--source", "sim", "--force-torque", "sim", "--sensor", sensor, "--seconds", "3", "--heights"]
    written = told(capsys, "record", *options, "--out", path)["written"]
    assert written["/twin/image_raw"] == written["/twin/height"] > 3 and written["/twin/wrench_measured"] > 10
    found = told(capsys, "info", path)
    assert (
        found["finished"] and found["sensor"] == "twin" and 0.1 < found["seconds"] < 20
    )  # a busy computer begins late
    topics = {topic["topic"]: topic for topic in found["topics"]}
    assert {name: topic["messages"] for name, topic in topics.items() if name in written} == written
    assert told(capsys, "doctor", "--source", path)["cameras"][0]["size_px"] == [640, 480]
    assert topics["/twin/image_raw"]["rate_hz"] > 1 and topics["/twin/wrench_measured"]["gaps"] is not None
    exported = told(capsys, "export", path, "--out", out)["written"]
    assert exported["images"] == exported["heights"] == written["/twin/image_raw"] and exported["pairs"] == 0
    load_sensor(out / "sensor")
    rows = list(csv.DictReader((out / "wrench_measured.csv").open()))
    assert len(rows) == written["/twin/wrench_measured"] and min(float(row["force_z_n"]) for row in rows) < -0.5
    with Recording(path) as episode:
        for frame, row in zip(episode.frames(), csv.DictReader((out / "images.csv").open()), strict=True):
            assert np.array_equal(cv2.imread(str(out / "images" / row["image"])), frame.image)
            assert int(row["monotonic_ns"]) == frame.stamp_ns
            assert float(row["time_s"]) == (frame.stamp_ns - episode.began_ns) / 1e9
    assert len(list((out / "heights").glob("*.npy"))) == exported["heights"]
    assert main(["export", str(path), "--out", str(out)]) == 1 and "new or empty" in capsys.readouterr().err


def test_exported_estimates_have_their_errors_and_warnings(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    estimates, out = write_estimates(tmp_path / "estimates.mcap"), tmp_path / "out"
    assert told(capsys, "export", tmp_path / "estimates.mcap", "--out", out)["written"]["estimated"] == len(estimates)
    for row, estimate in zip(csv.DictReader((out / "wrench_estimated.csv").open()), estimates, strict=True):
        columns = [name for name in row if name.endswith(("_n", "_nm"))]
        assert [float(row[name]) for name in columns] == estimate.wrench.six.tolist()
        assert [float(row[f"{name}_std"]) for name in columns] == pytest.approx(estimate.std.tolist())
        assert row["warnings"] == "; ".join(estimate.warnings) and int(row["monotonic_ns"]) == estimate.wrench.stamp_ns


def test_a_small_recording_is_played_back_and_exported_like_a_large_one(
    sensor: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The small one is made from the large one as its source, with the delay of the camera taken off its stamps."""
    large, small, copy = tmp_path / "large.mcap", tmp_path / "small.mcap", tmp_path / "sensor"
    shutil.copytree(sensor, copy)
    write_camera_delay(copy, CameraDelay(delay_ms=20.0, error_ms=0.5))
    told(
        capsys,
        "record",
        "--source",
        untouched_images(tmp_path / "images", sensor, 12),
        "--sensor",
        sensor,
        "--heights",
        "--out",
        large,
    )
    options = ["--images", "png", "--height-bits", "16", "--heights", "--camera-delay-ms", "saved", "--out", small]
    before_ns = time.monotonic_ns()
    told(capsys, "record", "--source", large, "--sensor", copy, *options)
    assert small.stat().st_size < 0.9 * large.stat().st_size
    found = told(capsys, "info", small)
    assert (found["height_step_mm"], found["camera_delay_ms"]) == (0.001, 20.0)
    assert main(["info", str(small)]) == 0
    said = capsys.readouterr().out
    assert "not checked for damage here" in said
    assert "heights in steps of 0.001 mm" in said and "less the camera's delay of 20 ms" in said
    told(capsys, "export", small, "--out", tmp_path / "out")
    with Recording(large) as one, Recording(small) as other, RecordedFrameSource(small) as played:
        heights = dict(one.heights())
        assert other.stamps_ns(Topic.IMAGES)[0] > before_ns
        for frame, same, again in zip(one.frames(), other.frames(), played, strict=True):
            assert np.array_equal(frame.image, same.image) and np.array_equal(frame.image, again.image)
            exported = cv2.imread(str(tmp_path / "out" / "images" / f"image_{same.index:08d}.png"))
            assert np.array_equal(exported, frame.image)
            z_mm = np.load(tmp_path / "out" / "heights" / f"height_{same.index:08d}.npy")
            np.testing.assert_allclose(z_mm, heights[frame.index], rtol=0, atol=0.0006)


def test_warnings_of_heights_are_recorded_exported_and_said(
    sensor: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    images, path, out = untouched_images(tmp_path / "images", sensor, 11), tmp_path / "dark.mcap", tmp_path / "out"
    for number in (11, 12):
        cv2.imwrite(str(images / f"{number}.png"), np.zeros((480, 640, 3), np.uint8))
    assert main(["record", "--source", str(images), "--sensor", str(sensor), "--heights", "--out", str(path)]) == 0
    assert "2 images have the warning 'image dark'\n" in capsys.readouterr().out
    with Recording(path) as recording:
        assert list(recording.warnings()) == [(11, ["image dark"]), (12, ["image dark"])]
    exported = told(capsys, "export", path, "--out", out)["written"]
    assert (exported["heights"], exported["warned"]) == (13, 2)
    rows = {row["height"]: row["warnings"] for row in csv.DictReader((out / "heights.csv").open())}
    assert list(rows) == sorted(file.name for file in (out / "heights").iterdir())
    assert list(rows.values()) == [""] * 11 + ["image dark"] * 2


def test_several_sensors_are_recorded_into_one_file_on_one_clock(
    sensor: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, hands = tmp_path / "two.mcap", {"left": 90, "right": 120}
    for hand, grey in hands.items():
        (tmp_path / hand).mkdir()
        for number in range(14):
            cv2.imwrite(str(tmp_path / hand / f"{number:02d}.png"), np.full((480, 640, 3), grey + number, np.uint8))
    sources = ["--source", *(f"{hand}={tmp_path / hand}" for hand in hands)]
    sensors = ["--sensor", *(f"{hand}={sensor}" for hand in hands)]
    found = told(capsys, "record", *sources, *sensors, "--images", "png", "--heights", "--out", path)
    assert found["written"]["/left/image_raw/compressed"] == found["written"]["/right/height"] == 14
    assert found["dropped"] == {"left": 0, "right": 0} and found["lost"] == {}
    began_ns = []
    for hand, grey in hands.items():
        with Recording(f"{path}#{hand}") as recording:
            assert [frame.image[0, 0, 0] for frame in recording.frames()] == list(range(grey, grey + 14))
            assert recording.sensor == "twin" and recording.sensor_files() == read_folder_files(sensor)
            assert len(list(recording.heights())) == recording.summary().topics[0].messages == 14
            began_ns.append(recording.stamps_ns(Topic.IMAGES)[0])
        with ninedtact.open(source=f"{path}#{hand}", force="none") as opened:
            assert opened.read().image[0, 0, 0] == grey + 10  # after ten reference images
    assert abs(began_ns[0] - began_ns[1]) < 2e9
    with path.open("rb") as file:  # any other program reads it, and knows which frame is whose
        read = list(make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages())
    frames = {channel.topic: message.header.frame_id for _, channel, _, message in read if channel.topic[-3:] != "nts"}
    assert frames["/left/image_raw/compressed"] == "left_camera" and frames["/right/height"] == "right_skin"
    assert [one["name"] for one in told(capsys, "info", path)["sensors"]] == ["left", "right"]
    told(capsys, "export", path, "--out", tmp_path / "both")
    assert all(len(list((tmp_path / "both" / hand / "images").iterdir())) == 14 for hand in hands)
    span = LabelledSpan(int(began_ns[0]), int(began_ns[0]) + 10**6, "grasp")
    edit_labelled_spans(path, lambda _: [span])
    for address in recorded_sensor_addresses(path):  # labels are those of all sensors
        with Recording(address) as recording:
            assert recording.is_finished and recording.spans() == [span]


class LostCamera(Camera):
    """Loses two images after five, and is unplugged after twelve."""

    def read(self) -> Frame:
        frame = super().read()
        if frame.index == 12:
            raise CameraLost("expected an image, got none; plug the camera in")
        return replace(frame, index=frame.index + 2 * (frame.index > 4))


def test_a_sensor_that_is_lost_is_reported_and_the_others_go_on(sensor: Path, tmp_path: Path) -> None:
    folder, said = load_sensor(sensor), list[str]()
    parts = {"left": SensorToRecord(LostCamera(1.0), folder), "right": SensorToRecord(Camera(1.0), folder)}
    writers, errors = record_several(parts, tmp_path / "grasp.mcap", notify=said.append)
    assert list(errors) == ["left"] and said == [f"left: {errors['left']}; the others go on"]
    assert writers["left"].written[Topic.IMAGES] == 12 < writers["right"].written[Topic.IMAGES]
    with Recording(tmp_path / "grasp.mcap#left") as recording:
        dropped, event = recording.events()
        assert dropped.subject == "2" == str(writers["left"].dropped)
        assert [frame.index for frame in recording.frames()] == [0, 1, 2, 3, 4, *range(7, 14)]
        assert event.subject == "lost" and "plug the camera in" in event.text and recording.is_finished


def test_a_full_disk_keeps_what_was_recorded_of_several_sensors(sensor: Path, tmp_path: Path) -> None:
    folder, path, said = load_sensor(sensor), tmp_path / "grasp.mcap", list[str]()
    parts = {name: SensorToRecord(Camera(10.0), folder) for name in ("left", "right")}
    room, limit = 2 * sum(map(len, read_folder_files(sensor).values())) + 600_000, resource.RLIMIT_FSIZE
    before = resource.getrlimit(limit)
    resource.setrlimit(limit, (room, before[1]))
    try:
        writers, errors = record_several(parts, path, notify=said.append)
    finally:
        resource.setrlimit(limit, before)
    assert set(errors) == set(writers)
    for address in recorded_sensor_addresses(path):
        with Recording(address) as recording:
            images = list(recording.frames())
        assert len(images) > 10
        for frame, expected in zip(images, Camera(10.0), strict=False):
            assert np.array_equal(frame.image, expected.image)
    assert any("got an earlier write that failed" in one for one in said)
    assert all("free the disk" in one and "others go on" not in one for one in said)


def test_the_delay_of_another_camera_is_not_subtracted(
    sensor: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copy, video, out = tmp_path / "sensor", untouched_video(tmp_path / "v.avi", sensor, 12), tmp_path / "v.mcap"
    shutil.copytree(sensor, copy)
    assert main(["camera-delay", "--source", "sim", "--sensor", str(copy), "--seconds", "3"]) == 0
    assert f"not kept in {copy}: it is the delay of a simulated camera" in capsys.readouterr().out
    assert not (copy / "camera.toml").exists()
    write_camera_delay(copy, CameraDelay(delay_ms=20.0, error_ms=0.5, camera="camera usb:1-2"))
    options = ["--source", video, "--sensor", copy, "--out", out, "--camera-delay-ms", "saved"]
    (said,) = failure_lines(capsys, "record", *options)
    name = source_in_real_time(str(video), DEFAULT_CAMERA).name
    assert f"expected the delay of '{name}' in {copy / 'camera.toml'}, got that of 'camera usb:1-2'" in said
    assert not out.exists()
    write_camera_delay(copy, CameraDelay(delay_ms=20.0, error_ms=0.5, camera=name))
    told(capsys, "record", *options)
    with Recording(out) as recording:
        assert (recording.metadata.camera_delay_ms, recording.metadata.source) == (20.0, name)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ("--source 0 --out x.mp4", "--out to end in .mcap"),
        ("--source /dev/none --out x.mcap --sensor SENSOR", "/dev/none"),
        ("--source 0 --out x.mcap", "expected --sensor with --source 0"),
        ("--source 0 --out x.mcap --seconds 0", "--seconds above 0 "),
        ("--source 0 --force-torque sim --out x.mcap --sensor SENSOR", "name two that belong together"),
        ("--source sim --out x.mcap --sensor SENSOR --height-bits 16", "--height-bits with --heights"),
        (
            "--source left=0 left=1 --out x.mcap",
            "a name of its own for each of several, such as left=usb:1-2, got left=1",
        ),
        ("--source 0 1 --out x.mcap", "--source with a name of its own for each"),
        ("--source left=0 right=1 --sensor middle=a --out x.mcap", "--sensor for left, right, got one for middle"),
        ("--source 0 --sensor a b --out x.mcap", "expected one --sensor with one --source, got 2"),
        ("--source left=sim right=/dev/video99 --sensor left=SENSOR right=SENSOR --out x.mcap", "/dev/video99"),
        (
            "--source sim --sensor SENSOR --out x.mcap --camera-delay-ms saved",
            "measure it with 'ninedtact camera-delay",
        ),
        (
            "--source sim --sensor SENSOR --out x.mcap --camera-delay-ms nan",
            "--camera-delay-ms to be a number, got nan",
        ),
    ],
)
def test_wrong_use_is_one_sentence_and_leaves_nothing(
    options: str,
    said: str,
    sensor: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["record", *options.replace("SENSOR", str(sensor)).split()]) == 1
    (sentence,) = capsys.readouterr().err.strip().splitlines()
    assert sentence.startswith("ninedtact: expected") and said in sentence
    assert list(tmp_path.iterdir()) == []


class Guessing(ForceEstimator):
    """Tells how dark the image is, as a force."""

    name = "guess"

    def estimate(self, reading: Reading) -> WrenchEstimate:
        force_n = np.array([0.0, 0.0, float((reading.rectified.grey - reading.reference.grey).mean())])
        return WrenchEstimate(
            Wrench(force_n, np.zeros(3), stamp_ns=reading.frame.stamp_ns),
            np.diag([4.0, 1, 1, 1, 1, 1]),
            True,
            (EstimateWarning.OUT_OF_RANGE,),
        )

    def forget(self) -> None: ...


def test_a_program_records_heights_and_estimates_and_reads_them_again(sensor: Path, tmp_path: Path) -> None:
    path, folder, camera = (
        tmp_path / "press.mcap",
        load_sensor(sensor),
        SimulatedCamera(small_press_simulation(rounds=1)),
    )
    writer = record(camera, path, folder, heights=True, estimator=Guessing())
    with Recording(path) as recording:
        assert recording.sensor == folder.id and recording.is_finished and recording.dropped_count == 0
        assert recording.topics[:1] == ["/twin/image_raw"] and recording.duration_s > 0.5
        readings, heights, estimates = (
            list(recording.readings()),
            dict(recording.heights()),
            list(recording.estimates()),
        )
        assert recording.summary().topics[0].messages == len(readings) == writer.written[Topic.IMAGES] >= 15
        assert list(recording.warnings()) == [(index, ["out of range"]) for index in range(len(readings))]
        assert np.array_equal(recording.stamps_ns(Topic.HEIGHTS), [reading.stamp_ns for reading in readings])
    for reading, estimate in zip(readings, estimates, strict=True):
        in_view = reading.height.in_view
        kept, again = heights[reading.frame.index], reading.height.z_mm
        np.testing.assert_allclose(kept[in_view], again[in_view], rtol=1e-6, atol=1e-6)
        assert np.array_equal(estimate.wrench.six, Guessing().estimate(reading).wrench.six)
        assert np.array_equal(estimate.covariance, np.diag([4.0, 1, 1, 1, 1, 1]))
    deepest = [reading.max_indentation_mm for reading in readings]
    assert min(deepest[:3]) < 0.2 and max(deepest) > 0.4


@pytest.mark.parametrize("skipped", [0, 20])
def test_a_recording_of_a_twin_may_begin_at_any_moment_of_a_press(skipped: int, sensor: Path, tmp_path: Path) -> None:
    """A loaded computer misses the first images; heights are those of the same images against the untouched skin."""

    class Late(SimulatedCamera):
        def open(self) -> None:
            super().open()
            for _ in range(skipped):
                self.read()

    path, folder = tmp_path / "press.mcap", load_sensor(sensor)
    camera = Late(small_press_simulation(rounds=2))
    record(camera, path, folder, heights=True)
    truth = folder.shape.depth_reader(*camera.reference_frames)
    with Recording(path) as recording:
        heights, readings = dict(recording.heights()), list(recording.readings())
    for reading in readings:
        wanted = read_frame(reading.frame, folder.shape, truth).height
        for got in (heights[reading.frame.index], reading.height.z_mm):
            np.testing.assert_allclose(got[wanted.in_view], wanted.z_mm[wanted.in_view], atol=1e-5)


def test_the_seconds_of_a_recording_begin_when_its_camera_is_open(sensor: Path, tmp_path: Path) -> None:
    """A loaded computer, or a camera that is tried in two formats, takes longer to open than is recorded."""

    class Slow(Camera):
        def open(self) -> None:
            time.sleep(0.3)
            super().open()

    writer = record(Slow(1.0), tmp_path / "press.mcap", load_sensor(sensor), seconds=0.15)
    assert writer.written[Topic.IMAGES]


def test_a_camera_that_changes_its_size_ends_the_recording(sensor: Path, tmp_path: Path) -> None:
    class Changing(Camera):
        def read(self) -> Frame:
            frame = super().read()
            return frame if frame.index < 5 else replace(frame, image=frame.image[::2])

    path = tmp_path / "press.mcap"
    with pytest.raises(CameraError, match=r"images of 64x48 pixels from the camera of the hand, .*got 64x24"):
        record(Changing(1.0), path, load_sensor(sensor))
    with Recording(path) as recording:
        assert recording.is_finished and len(list(recording.frames())) == 5


def test_what_came_before_a_loss_is_kept(sensor: Path, tmp_path: Path) -> None:
    path, said = tmp_path / "lost.mcap", list[str]()
    with pytest.raises(CameraLost):
        record(LostCamera(10.0), path, load_sensor(sensor), camera_delay_ms=12.5, notify=said.append)
    assert not [thread for thread in threading.enumerate() if "listen" in thread.name]
    assert said == [f"{path} keeps the messages before the failure: 12 of /twin/image_raw, 1 of /twin/events"]
    with Recording(path) as read:
        assert read.is_finished and len(list(read.frames())) == 12 and len(read.events()) == 1
        assert read.metadata.camera_delay_ms == 12.5 and read.began_ns == BEGAN_NS - 12_500_000


@pytest.mark.parametrize("step_s", [3600.0, -3600.0])
def test_a_clock_that_is_set_meanwhile_is_told_and_stamps_continue(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step_s: float
) -> None:
    said: list[str] = []
    path, image, clock = tmp_path / "clock.mcap", np.zeros((4, 4, 3), np.uint8), time.time_ns
    with RecordingWriter(path, RecordingMetadata("clock"), notify=said.append) as writer:
        writer.write_image(Frame(image, time.monotonic_ns(), 0))
        writer.flush()
        assert not said
        monkeypatch.setattr(time, "time_ns", lambda: clock() + int(step_s * 1e9))
        writer.flush()
        writer.write_image(Frame(image, time.monotonic_ns(), 1))
        writer.flush()
    assert len(said) == 1 and f"moved by {step_s:+.1f} s" in said[0]
    with Recording(path) as read:
        assert [(event.subject, event.text) for event in read.events()] == [("clock", said[0])]
    with path.open("rb") as file:
        wall_ns, stamps_ns = np.transpose(
            [(message.publish_time, message.log_time) for *_, message in make_reader(file).iter_messages()]
        )
    assert (np.diff(stamps_ns) > 0).all() and (np.diff(wall_ns) == np.diff(stamps_ns)).all()


def untouched_video(path: Path, sensor: Path, images: int) -> Path:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 30.0, (640, 480))
    for _ in range(images):
        writer.write(cv2.imread(str(sensor / "untouched.png")))
    writer.release()
    return path


def failure_lines(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> list[str]:
    """Return the lines of a command that fails, without those of its progress bar."""
    assert main([*map(str, arguments)]) == 1
    return [line for line in capsys.readouterr().err.splitlines() if line.startswith("ninedtact: ")]


def test_a_recording_that_fails_says_what_it_keeps_only_if_it_is_there(
    sensor: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    video, path = untouched_video(tmp_path / "half.avi", sensor, 24), tmp_path / "half.mcap"
    video.write_bytes(video.read_bytes()[: video.stat().st_size // 2])
    kept, said = failure_lines(capsys, "record", "--source", video, "--sensor", sensor, "--out", path)
    with Recording(path) as recording:
        images = recording.summary().topics[0].messages
        assert images in (11, 12) and recording.is_finished
        assert recording.dropped_count == 24 - images
    assert (
        kept
        == f"ninedtact: {path} keeps the messages before the failure: {images} of /twin/image_raw, 1 of /twin/events"
    )
    assert f"{images} are whole, {24 - images} are missing or damaged" in said
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, before[1]))
    try:
        options = ["--source", "sim", "--sensor", sensor, "--seconds", "1", "--out", tmp_path / "full.mcap"]
        (said,) = failure_lines(capsys, "record", *options)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert "expected to continue writing" in said and not (tmp_path / "full.mcap").exists()


def test_a_damaged_recording_leaves_the_folder_of_its_export_as_it_was(
    sensor: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, out = tmp_path / "hand.mcap", tmp_path / "out"
    record_hand(path, sensor, seconds=2.0)
    content = path.read_bytes()
    out.mkdir()
    for share in (0.2, 0.9):  # in a file of the sensor, and in the images
        at = int(share * len(content))
        path.write_bytes(content[:at] + bytes(40) + content[at + 40 :])
        for folder in (out, tmp_path / "new" / "folder"):
            (said,) = failure_lines(capsys, "export", path, "--out", folder)
            assert "got damaged data at byte" in said
        assert list(out.iterdir()) == [] and not (tmp_path / "new" / "folder").exists()
        assert not list(tmp_path.rglob("*.partial"))


@pytest.mark.parametrize("share", [0.1, 0.5, 0.97])
def test_a_recording_that_was_cut_short_is_exported_with_its_images_or_refused(
    sensor: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], share: float
) -> None:
    path, out = tmp_path / "hand.mcap", tmp_path / "new" / "out"
    record_hand(path, sensor, seconds=2.0)
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    assert main(["info", str(path), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    images = sum(one["messages"] for one in found["topics"] if one["topic"].endswith("image_raw"))
    assert (images > 0) == (share > 0.9)
    if images == 0:
        refusal = "got a file that was cut short before its first image; copy it again whole"
        assert main(["info", str(path)]) == 0
        said = capsys.readouterr().out
        assert refusal in said and "It can be read as it is" not in said
        (said,) = failure_lines(capsys, "info", path, "--whole-copy", tmp_path / "whole.mcap")
        assert said.endswith(refusal) and not (tmp_path / "whole.mcap").exists()
        (said,) = failure_lines(capsys, "export", path, "--out", out)
        assert said.endswith(refusal)
        assert not out.exists() and not list(tmp_path.rglob("*.partial"))
        return
    assert main(["info", str(path)]) == 0
    said = (
        f"The file was cut short: it ends after {found['seconds']:.1f} s. The rest is missing. If the recording program"
    )
    assert said in capsys.readouterr().out
    said = (
        f"expected all of {path}, got {found['seconds']:.1f} s of a recording that was cut short, so that the rest is"
    )
    (exported,) = failure_lines(capsys, "export", path, "--out", out)
    assert exported.startswith(f"ninedtact: {said}")
    copy = tmp_path / "copy.mcap"
    kept, recorded = failure_lines(capsys, "record", "--source", path, "--sensor", sensor, "--out", copy)
    assert f"{images} of /twin/image_raw" in kept and recorded == exported
    with RecordedFrameSource(path) as source:
        with pytest.raises(RecordingCutShort, match="so that the rest is missing; use what was read"):
            list(source)
        assert list(source) == []
    told_once = list[str]()
    with source_in_real_time(str(path), notify=told_once.append) as played:
        assert len(list(played)) == images and len(told_once) == 1 and told_once[0].startswith(said)
    assert len(list((out / "images").iterdir())) == images
    assert {one.name for one in (out / "sensor").iterdir()} == {one.name for one in sensor.iterdir()}
