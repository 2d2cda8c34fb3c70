"""What a person does: record, look, write out, collect on a twin and from a recording, at the command line."""

import csv
import io
import json
import math
import os
import pty
import resource
import shutil
import signal
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from episodes import write_estimates
from hand import BEGAN_NS, TOUCH_S, TOUCHES, UNTOUCHED_S, Camera, ForceTorque, at_s, truth
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from small_press_simulation import small_press_simulation
from twin_folder import twin_folder

import ninedtact
from ninedtact.calibration.sensor_folder import SensorFolder, load_sensor
from ninedtact.capture.camera_delay import CameraDelay, write_camera_delay
from ninedtact.capture.force_torque.sample_checks import CheckedWrenchSource, SampleCheckSettings
from ninedtact.capture.frame_pacing import LatestFrameSource
from ninedtact.capture.frame_source import DEFAULT_CAMERA, CameraLost, FrameSource, SourceNotOpen
from ninedtact.capture.wrench_source import WrenchSaturated, WrenchSource
from ninedtact.cli import main
from ninedtact.cli.record import _twin_sources
from ninedtact.cli.result_and_interrupt import stop_on_signal
from ninedtact.cli.ros2_foxglove_and_serve import run_commands_together
from ninedtact.force.estimator_interface import ForceEstimator
from ninedtact.open_sensor import assemble_live_sensor, load_given_or_recorded_sensor, source_in_real_time
from ninedtact.quantities import EstimateWarning, Frame, Wrench, WrenchEstimate
from ninedtact.reading import Reading
from ninedtact.recording.errors import RecordingUnreadable
from ninedtact.recording.mcap_repair import save_labelled_spans
from ninedtact.recording.merge_streams import Arrival, merge_live_streams, merge_recorded_streams
from ninedtact.recording.metadata import RecordingMetadata
from ninedtact.recording.missing_end import RecordingCutShort
from ninedtact.recording.reader import (
    Recording,
    read_folder_files,
    recorded_sensor_addresses,
    sensor_folder_attachments,
)
from ninedtact.recording.recorded_source import RecordedFrameSource
from ninedtact.recording.recorder import EstimateRecorder, Recorder, SensorToRecord, record, record_several
from ninedtact.recording.topics_and_messages import LabelledSpan, Topic
from ninedtact.recording.writer import RecordingWriter
from ninedtact.simulation.simulated_sources import SimulatedCamera
from ninedtact.simulation.twin import default_twin
from ninedtact_train.cli.collect import CollectTerminalDisplay, collect_progress_line, open_key_reader
from ninedtact_train.collecting.collected_pairs import read_recorded_pairs
from ninedtact_train.collecting.collection_sources import (
    build_simulated_collect_setup,
    collection_setup_from_recordings,
)
from ninedtact_train.collecting.collector import COLLECTED_TOPICS, Collector, collect_pairs
from ninedtact_train.collecting.pair_selection import CollectSettings


@pytest.fixture(scope="module")
def sensor(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sensor like the default twin that knows its twin, made without calibrating."""
    return twin_folder(tmp_path_factory.mktemp("recording") / "sensor")


def told(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> dict:
    assert main([*map(str, arguments), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_a_twin_is_recorded_shown_again_and_written_out(
    sensor: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, out = tmp_path / "twin.mcap", tmp_path / "out"
    options = ["--source", "sim", "--force-torque", "sim", "--sensor", sensor, "--seconds", "5", "--heights"]
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
    (tmp_path / "images").mkdir()
    for number in range(12):
        cv2.imwrite(str(tmp_path / "images" / f"{number}.png"), default_twin().renderer(None, number))
    told(capsys, "record", "--source", tmp_path / "images", "--sensor", sensor, "--heights", "--out", large)
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
            assert z_mm == pytest.approx(heights[frame.index], abs=0.0006, nan_ok=True)


def test_warnings_of_heights_are_recorded_exported_and_said(
    sensor: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    images, path, out = tmp_path / "images", tmp_path / "dark.mcap", tmp_path / "out"
    images.mkdir()
    for number in range(13):
        lit = default_twin().renderer(None, number) if number < 11 else np.zeros((480, 640, 3), np.uint8)
        cv2.imwrite(str(images / f"{number}.png"), lit)
    assert main(["record", "--source", str(images), "--sensor", str(sensor), "--heights", "--out", str(path)]) == 0
    assert "2 images have the warning 'image dark'\n" in capsys.readouterr().out
    with Recording(path) as recording:
        assert list(recording.warnings()) == [(11, ["image dark"]), (12, ["image dark"])]
    exported = told(capsys, "export", path, "--out", out)["written"]
    assert (exported["heights"], exported["warned"]) == (13, 2)
    rows = {row["height"]: row["warnings"] for row in csv.DictReader((out / "heights.csv").open())}
    assert list(rows) == sorted(file.name for file in (out / "heights").iterdir())
    assert list(rows.values()) == [""] * 11 + ["image dark"] * 2


def test_the_delay_of_the_camera_is_taken_off_every_stamp(sensor: Path, tmp_path: Path) -> None:
    path, folder = tmp_path / "press.mcap", load_sensor(sensor)
    record(Camera(0.2), path, folder, camera_delay_ms=12.5)
    with Recording(path) as recording:
        assert recording.metadata.camera_delay_ms == 12.5
        assert recording.stamps_ns(Topic.IMAGES)[0] == BEGAN_NS - 12_500_000


@pytest.fixture
def two_sensors(sensor: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Path:
    """A recording of two sensors, left and right, from folders of 40 images each."""
    for hand, grey in (("left", 90), ("right", 120)):
        (tmp_path / hand).mkdir()
        for number in range(40):
            cv2.imwrite(str(tmp_path / hand / f"{number:02d}.png"), np.full((480, 640, 3), grey + number, np.uint8))
    sources = ["--source", f"left={tmp_path / 'left'}", f"right={tmp_path / 'right'}"]
    sensors = ["--sensor", f"left={sensor}", f"right={sensor}"]
    found = told(capsys, "record", *sources, *sensors, "--images", "png", "--heights", "--out", tmp_path / "two.mcap")
    assert found["written"]["/left/image_raw/compressed"] == found["written"]["/right/height"] == 40
    assert found["dropped"] == {"left": 0, "right": 0} and found["lost"] == {}
    return tmp_path / "two.mcap"


def test_several_sensors_are_recorded_into_one_file_on_one_clock(
    two_sensors: Path, sensor: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert recorded_sensor_addresses(two_sensors) == [f"{two_sensors}#left", f"{two_sensors}#right"]
    began_ns = []
    for hand, grey in (("left", 90), ("right", 120)):
        with Recording(f"{two_sensors}#{hand}") as recording:
            assert [frame.image[0, 0, 0] for frame in recording.frames()] == list(range(grey, grey + 40))
            assert recording.sensor == "twin" and recording.sensor_files() == read_folder_files(sensor)
            assert len(list(recording.heights())) == recording.summary().topics[0].messages == 40
            began_ns.append(recording.stamps_ns(Topic.IMAGES)[0])
        with ninedtact.open(source=f"{two_sensors}#{hand}", force="none") as opened:
            assert opened.read().image[0, 0, 0] == grey + 10  # after ten reference images
    assert abs(began_ns[0] - began_ns[1]) < 2e9
    with two_sensors.open("rb") as file:  # any other program reads it, and knows which frame is whose
        read = list(make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages())
    frames = {channel.topic: message.header.frame_id for _, channel, _, message in read if channel.topic[-3:] != "nts"}
    assert frames["/left/image_raw/compressed"] == "left_camera" and frames["/right/height"] == "right_skin"
    said = told(capsys, "info", two_sensors)["sensors"]
    assert [one["name"] for one in said] == ["left", "right"]
    told(capsys, "export", two_sensors, "--out", tmp_path / "both")
    assert all(len(list((tmp_path / "both" / hand / "images").iterdir())) == 40 for hand in ("left", "right"))


def test_a_sensor_of_several_must_be_named_and_labels_are_theirs_together(two_sensors: Path) -> None:
    with pytest.raises(
        RecordingUnreadable, match=r"expected one of the sensors left, right of .*, got none; name it as"
    ):
        Recording(two_sensors)
    with pytest.raises(RecordingUnreadable, match=r"got 'middle'; name it as .*#left"):
        Recording(f"{two_sensors}#middle")
    with Recording(f"{two_sensors}#right") as recording:
        span = LabelledSpan(recording.began_ns, recording.began_ns + 10**6, "grasp")
    save_labelled_spans(two_sensors, [span])
    for address in recorded_sensor_addresses(two_sensors):
        with Recording(address) as recording:
            assert recording.is_finished and recording.spans() == [span]


def test_a_sensor_that_is_not_there_keeps_all_from_being_recorded(
    sensor: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sensors = ["--sensor", f"left={sensor}", f"right={sensor}"]
    sources = ["--source", "left=sim", "right=/dev/video99"]
    assert main(["record", *map(str, [*sources, *sensors, "--out", tmp_path / "one.mcap"])]) == 1
    assert "/dev/video99" in capsys.readouterr().err and not (tmp_path / "one.mcap").exists()


class LostCamera(Camera):
    """Delivers twelve images and is then unplugged."""

    def read(self) -> Frame:
        frame = super().read()
        if frame.index == 12:
            raise CameraLost("expected an image, got none; plug the camera in")
        return frame


def test_a_sensor_that_is_lost_is_reported_and_the_others_go_on(sensor: Path, tmp_path: Path) -> None:
    folder, said = load_sensor(sensor), list[str]()
    parts = {"left": SensorToRecord(LostCamera(1.0), folder), "right": SensorToRecord(Camera(1.0), folder)}
    writers, errors = record_several(parts, tmp_path / "grasp.mcap", notify=said.append)
    assert list(errors) == ["left"] and said == [f"left: {errors['left']}; the others go on"]
    assert writers["left"].written[Topic.IMAGES] == 12 < writers["right"].written[Topic.IMAGES]
    with Recording(tmp_path / "grasp.mcap#left") as recording:
        (event,) = recording.events()
        assert event.subject == "lost" and "plug the camera in" in event.text and recording.is_finished


def test_a_full_disk_keeps_what_was_recorded_of_several_sensors(
    sensor: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ninedtact.recording.writer.CHUNK_BYTES", 30_000)
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


@pytest.mark.parametrize(
    ("sources", "sensors", "sentence"),
    [
        (
            ["left=0", "left=1"],
            [],
            "--source with a name of its own for each of several, such as left=usb:1-2, got left=1",
        ),
        (["0", "1"], [], "--source with a name of its own for each"),
        (["left=0", "right=1"], ["middle=a"], "--sensor for left, right, got one for middle"),
        (["0"], ["a", "b"], "expected one --sensor with one --source, got 2"),
    ],
)
def test_several_sensors_need_names(
    sources: list[str], sensors: list[str], sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["--source", *sources, *(["--sensor", *sensors] if sensors else []), "--out", str(tmp_path / "two.mcap")]
    assert main(["record", *options]) == 1 and sentence in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("delay", "sentence"), [("saved", "measure it with 'ninedtact camera-delay"), ("nan", "at most 5000 ms, got nan")]
)
def test_a_delay_that_is_not_known_is_refused(
    delay: str, sentence: str, sensor: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "no.mcap"
    options = ["--source", "sim", "--sensor", str(sensor), "--out", str(out), "--camera-delay-ms", delay]
    assert main(["record", *options]) == 1 and sentence in capsys.readouterr().err and not out.exists()


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
        assert recording.metadata.camera_delay_ms == 20.0
    assert collection_setup_from_recordings(out, out, SampleCheckSettings()).camera_name == name


def test_a_recording_is_shown_live_with_the_sensor_that_it_carries(tmp_path: Path, sensor: Path) -> None:
    path = tmp_path / "hand.mcap"
    recorded_hand(path, sensor, seconds=0.5)
    with (
        load_given_or_recorded_sensor(None, str(path)) as folder,
        LatestFrameSource(source_in_real_time(str(path), DEFAULT_CAMERA)) as source,
    ):
        assert folder.id == "twin" and folder.shape.rectify.raw_shape == (480, 640)
        frame = source.read()
        assert time.monotonic_ns() - frame.stamp_ns < 2e9 and frame.image.shape == (48, 64, 3)
    assert not folder.path.exists()


def recorded_hand(path: Path, sensor: Path, seconds: float, delay_ms: float = 0.0) -> None:
    """Everything that the hand's devices tell."""
    metadata = RecordingMetadata("twin", camera_delay_ms=delay_ms)
    with RecordingWriter(path, metadata, attachments=sensor_folder_attachments(sensor)) as episode:
        for heard in merge_recorded_streams(Camera(seconds), ForceTorque()):
            assert heard is not None
            (episode.write_image if isinstance(heard.item, Frame) else episode.write_measured)(heard.item)


def test_simulated_sensors_side_by_side_have_noise_of_their_own(sensor: Path) -> None:
    folder, names = load_sensor(sensor), ("", "left", "right")
    shown = [assemble_live_sensor(folder, "sim", name=name).simulation for name in names]
    recorded = [_twin_sources(folder, False, name)[0].simulation for name in names]
    for simulations in (shown, recorded):
        alone, left, right = (simulation.twin.renderer(None, 1).astype(int) for simulation in simulations)
        assert (alone == folder.twin().renderer(None, 1)).all()
        assert (
            abs(np.corrcoef((left - right).ravel(), (alone - right).ravel())[0, 1] - 0.5) < 0.02
        )  # as of three samples


def test_pairs_are_collected_from_a_recording_with_its_stamps_and_its_sensor(
    sensor: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source, out = tmp_path / "hand.mcap", tmp_path / "pairs.mcap"
    recorded_hand(source, sensor, UNTOUCHED_S + TOUCHES * TOUCH_S)
    sources = ["--source", source, "--force-torque", source, "--tolerance-ms", "12"]
    found = told(capsys, "collect", *sources, "--out", out, "--objects", "cup", "--seed", "1")
    pairs = list(read_recorded_pairs(out))
    assert found["pairs"] == len(pairs) >= 15 and found["objects"] == {"cup": len(pairs) - 1, "none": 1}
    assert found["refused"] == {} and found["kinds"]["rule"] == len(pairs) - 1 - found["kinds"]["light_touch"]
    assert all(np.abs(pair.wrench.six - truth(at_s(pair.time_ns)))[:3].max() < 0.15 for pair in pairs)
    assert {pair.sensor for pair in pairs} == {"twin"}
    with Recording(source) as one, Recording(out) as other:
        assert one.metadata.wall_minus_monotonic_ns == other.metadata.wall_minus_monotonic_ns
    assert main(["collect", *map(str, sources), "--out", str(out)]) == 1
    assert "expected --out to be a new file" in capsys.readouterr().err


def test_a_delay_that_a_recording_has_subtracted_is_not_subtracted_again(
    sensor: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source, out = tmp_path / "hand.mcap", tmp_path / "pairs.mcap"
    recorded_hand(source, sensor, 0.5, delay_ms=42.0)
    options = ["collect", "--source", source, "--force-torque", source, "--out", out, "--camera-delay-ms"]
    assert main([*map(str, options), "42"]) == 1
    assert f"{source}, whose stamps already have 42 ms subtracted, got 42.0; drop it" in capsys.readouterr().err
    assert main([*map(str, options), "saved"]) == 0
    assert "the saved delay is not subtracted again" in capsys.readouterr().err
    with Recording(out) as recording:
        assert recording.metadata.camera_delay_ms == 42.0
        assert json.loads(recording.metadata.settings)["camera_delay_ms"] == 0.0


def test_pairs_are_collected_on_a_twin_under_a_scripted_hand(
    sensor: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "twin.mcap"
    options = ["--objects", "ball:4", "cylinder:3,11", "--touches", "1", "--pairs", "6", "--seed", "3"]
    sources = ["--source", "sim", "--force-torque", "sim", "--sensor", sensor]
    found = told(capsys, "collect", *sources, "--out", out, *options)
    pairs = list(read_recorded_pairs(out))
    assert found["pairs"] == len(pairs) == 6 and set(found["objects"]) == {"none", "ball:4", "cylinder:3,11"}
    by_rule = np.array([pair.wrench.six for pair in pairs if pair.kind == "rule"])
    assert by_rule[:, 2].max() < -0.25 and by_rule[:, 2].min() < -1
    for pair in pairs:
        change = cv2.blur(pair.image - np.mean(pair.reference.images, axis=0), (15, 15))
        assert (change.min() < -2) == (pair.wrench.force_n[2] < -0.3)
    figures = told(capsys, "info", out)
    assert figures["purpose"] == "collect" and figures["pairs"] == found["kinds"]


def test_a_program_collects_pairs_with_one_call(sensor: Path, tmp_path: Path) -> None:
    folder, out = load_sensor(sensor), tmp_path / "pairs.mcap"
    setup = build_simulated_collect_setup(folder, ["ball:4"], 1, 3, SampleCheckSettings())
    seen: list[int] = []
    collector = collect_pairs(
        setup,
        out,
        folder,
        seed=3,
        should_stop=lambda collector: len(collector.counts.pairs) == 3,
        on_progress=lambda collector: seen.append(len(collector.counts.pairs)),
    )
    assert [pair.object for pair in read_recorded_pairs(out)][-1] == collector.object == "ball:4"
    assert seen[0] == 0 and seen[-1] == len(collector.counts.pairs) == len(list(read_recorded_pairs(out))) == 3
    with Recording(out) as recording:
        assert recording.metadata.purpose == "collect" and recording.sensor == folder.id and recording.is_finished


@pytest.mark.parametrize(
    ("command", "options", "said"),
    [
        ("record", "--source 0 --out x.mp4", "--out to end in .mcap"),
        ("record", "--source /dev/none --out x.mcap --sensor SENSOR", "/dev/none"),
        ("record", "--source 0 --out x.mcap", "expected --sensor with --source 0"),
        ("record", "--source 0 --out x.mcap --seconds 0", "--seconds above zero"),
        ("record", "--source 0 --force-torque sim --out x.mcap --sensor SENSOR", "name two that belong together"),
        ("collect", "--source sim --force-torque netft:1.2.3.4 --out x.mcap --sensor SENSOR", "both sim"),
        ("record", "--source sim --out x.mcap --sensor SENSOR --height-bits 16", "--height-bits with --heights"),
        ("collect", "--source 0 --force-torque gopher:1 --out x.mcap --sensor SENSOR", "got 'gopher:1'"),
        ("collect", "--source no.mcap --force-torque no.mcap --out x.mcap --sensor SENSOR", "no such file"),
        (
            "collect",
            "--source sim --force-torque sim --out x.mcap --sensor SENSOR --min-difference 0",
            "a difference above zero",
        ),
        ("collect", "--source sim --force-torque sim --out x.mcap --sensor SENSOR --objects bal", "got 'bal'"),
        ("collect", "--source sim --force-torque sim --out x.mcap --sensor SENSOR --pairs 0", "--pairs of at least 1"),
        ("collect", "--source sim --force-torque sim --out x.mcap --sensor SENSOR --seed -1", "--seed of zero or more"),
    ],
)
def test_wrong_use_is_one_sentence_and_leaves_nothing(
    command: str,
    options: str,
    said: str,
    sensor: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main([command, *options.replace("SENSOR", str(sensor)).split()]) == 1
    (sentence,) = capsys.readouterr().err.strip().splitlines()
    assert sentence.startswith("ninedtact: expected") and said in sentence
    assert list(tmp_path.iterdir()) == []


def test_a_tare_without_samples_says_so_and_hoards_no_images(tmp_path: Path) -> None:
    with (
        RecordingWriter(tmp_path / "e.mcap", RecordingMetadata("x"), COLLECTED_TOPICS) as episode,
        Camera(2.0) as camera,
    ):
        collector = Collector(episode)
        for frame in camera:
            collector.add(Arrival(frame, frame.stamp_ns))
        assert "no samples from the force/torque sensor yet" in collect_progress_line(collector)
        collector.add(
            Arrival(WrenchSaturated("expected F_z of netft:x within ± 9.8 N, got 11; press less"), frame.stamp_ns)
        )
    assert collect_progress_line(collector).endswith(
        "taring: expected F_z of netft:x within ± 9.8 N, got 11; press less"
    )
    assert collector.tare_in_progress is not None and len(collector.tare_in_progress.frames) == 10


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


def test_heights_and_estimates_are_written_beside_every_image(sensor: Path, tmp_path: Path) -> None:
    camera, shape = SimulatedCamera(small_press_simulation(rounds=1)), load_sensor(sensor).shape
    assert EstimateRecorder(shape).topics == {Topic.HEIGHTS} and EstimateRecorder(shape, heights=False).topics == set()
    with RecordingWriter(tmp_path / "meant.mcap", RecordingMetadata("x")) as episode:
        Recorder(episode, camera, estimates=EstimateRecorder(shape, Guessing())).run(lambda: False)
    with Recording(tmp_path / "meant.mcap") as read:
        heights, estimates = dict(read.heights()), list(read.wrenches(Topic.ESTIMATED))
        covariances, warnings = list(read.covariances()), list(read.warnings())
        stamps_ns = read.stamps_ns(Topic.IMAGES)
        assert len(heights) == len(estimates) == len(covariances) == len(stamps_ns) >= 15
        assert np.array_equal(covariances[0], np.diag([4.0, 1, 1, 1, 1, 1]))
        assert warnings == [(index, ["out of range"]) for index in range(len(stamps_ns))]
        assert np.array_equal(read.stamps_ns(Topic.HEIGHTS), stamps_ns)
    deepest = [float(np.nanmin(z_mm)) for z_mm in heights.values()]
    assert max(deepest[:3]) > -0.2 and min(deepest) < -0.4
    assert abs(np.corrcoef(deepest, [one.force_n[2] for one in estimates])[0, 1]) > 0.9


def test_a_reference_of_another_sensor_is_a_warning_of_every_estimate_and_said_once(
    sensor: Path, tmp_path: Path
) -> None:
    camera, shape = SimulatedCamera(small_press_simulation(rounds=1)), load_sensor(sensor).shape
    said: list[str] = []
    estimates = EstimateRecorder(
        shape, Guessing(), True, lambda frames: ("another sensor's gel: it is not there",), said.append
    )
    with RecordingWriter(tmp_path / "other.mcap", RecordingMetadata("x")) as episode:
        Recorder(episode, camera, estimates=estimates).run(lambda: False)
    assert said == ["the reference image is doubtful; another sensor's gel: it is not there"]
    with Recording(tmp_path / "other.mcap") as read:
        (remark,) = read.events()
        assert (remark.subject, remark.text) == ("reference image", "another sensor's gel: it is not there")
        assert {tuple(texts) for _, texts in read.warnings()} == {
            ("reference unlike the calibrated one", "out of range")
        }


def test_record_prints_what_a_person_must_know_of_every_estimate(
    sensor_a: SensorFolder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "twin.mcap"
    options = ["--source", "sim", "--sensor", sensor_a.path, "--seconds", "5", "--force", "physics", "--out", path]
    assert main(["record", *map(str, options)]) == 0
    said = capsys.readouterr().err
    notices = sensor_a.estimator("physics").notices
    assert notices and all(f"ninedtact: {notice}\n" in said for notice in notices)


def test_a_program_records_and_reads_what_a_command_would(sensor: Path, tmp_path: Path) -> None:
    path, folder = tmp_path / "press.mcap", load_sensor(sensor)
    writer = record(SimulatedCamera(small_press_simulation(rounds=1)), path, folder, heights=True)
    with Recording(path) as recording:
        assert recording.sensor == folder.id and recording.is_finished and recording.dropped_count == 0
        assert recording.topics == ["/twin/image_raw", "/twin/height"] and recording.duration_s > 0.5
        readings, heights = list(recording.readings()), dict(recording.heights())
        assert recording.summary().topics[0].messages == len(readings) == writer.written[Topic.IMAGES]
    for reading in readings:
        in_view = reading.height.in_view
        kept, again = heights[reading.frame.index], reading.height.z_mm
        np.testing.assert_allclose(kept[in_view], again[in_view], rtol=1e-6, atol=1e-6)


class Losing(Camera):
    """A camera that is unplugged, after having lost two images."""

    def read(self) -> Frame:
        frame = super().read()
        if frame.index == 9:
            raise CameraLost("expected an image, got none; plug it in")
        return replace(frame, index=frame.index + 2 * (frame.index > 4))


def test_what_came_before_a_loss_is_kept_and_missing_images_are_counted(tmp_path: Path) -> None:
    path = tmp_path / "lost.mcap"
    with pytest.raises(CameraLost), RecordingWriter(path, RecordingMetadata("lost")) as episode:
        Recorder(episode, Losing(10.0)).run(lambda: False)
    assert episode.dropped == 2 and not [thread for thread in threading.enumerate() if "listen" in thread.name]
    with Recording(path) as read:
        assert read.is_finished and [frame.index for frame in read.frames()] == [0, 1, 2, 3, 4, 7, 8, 9, 10]


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
    """A video of the skin without contact."""
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


def test_heights_that_could_not_be_computed_are_an_error_and_the_images_stay(
    sensor: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    video, path = untouched_video(tmp_path / "short.avi", sensor, 6), tmp_path / "short.mcap"
    options = ["--source", video, "--sensor", sensor, "--out", path, "--heights"]
    kept, said = failure_lines(capsys, "record", *options)
    assert f"{path} keeps" in kept and "6 of /twin/image_raw" in kept
    assert "expected at least 10 images for the reference of heights and forces, got 6" in said


def test_a_damaged_recording_leaves_the_folder_of_its_export_as_it_was(
    sensor: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, out = tmp_path / "hand.mcap", tmp_path / "out"
    recorded_hand(path, sensor, seconds=2.0)
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
    recorded_hand(path, sensor, seconds=2.0)
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    os.utime(path, (time.time() - 3600,) * 2)  # a file that was just changed is not repaired
    assert main(["info", str(path), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    images = sum(one["messages"] for one in found["topics"] if one["topic"].endswith("image_raw"))
    assert (images > 0) == (share > 0.9)
    if images == 0:
        refusal = "got a file that was cut short before its first image; copy it again whole"
        assert main(["info", str(path)]) == 0
        said = capsys.readouterr().out
        assert refusal in said and "It can be read as it is" not in said
        (said,) = failure_lines(capsys, "info", path, "--repair")
        assert said.endswith(refusal) and path.stat().st_size == int(share * len(content))
        for to in ("files", "lerobot"):
            (said,) = failure_lines(capsys, "export", path, "--out", out, "--to", to)
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


class Waiting(Camera):
    """A camera that delivers twenty images at once, and no more."""

    def open(self) -> None:
        super().open()
        self.has_delivered, self.closing = threading.Event(), threading.Event()

    def read(self) -> Frame:
        frame = super().read()
        if frame.index == 20:
            self.has_delivered.set()
            self.closing.wait()
            raise SourceNotOpen(self.name)
        return frame

    def close(self) -> None:
        self.closing.set()


def test_images_that_were_read_before_the_end_are_written(tmp_path: Path) -> None:
    camera = Waiting(10.0)
    with RecordingWriter(tmp_path / "stopped.mcap", RecordingMetadata("stopped")) as episode:
        Recorder(episode, camera).run(lambda: camera.has_delivered.wait(timeout=5))
    assert episode.written[Topic.IMAGES] == 20


class InTime(FrameSource, WrenchSource):
    """One of the hand's devices, at its own pace and stamped when it is read."""

    recorded_hz = None

    def __init__(self, device: Camera | ForceTorque, began_at: float) -> None:
        self.device, self.began_at, self.name = device, began_at, device.name

    def open(self) -> None:
        self.device.open()

    def read(self) -> Frame | Wrench:
        item = self.device.read()
        due_at = self.began_at + at_s(item.stamp_ns)
        time.sleep(max(due_at - time.monotonic(), 0))
        return replace(item, stamp_ns=round(due_at * 1e9))

    def close(self) -> None: ...


def test_devices_are_collected_from_live(tmp_path: Path) -> None:
    began_at = time.monotonic() + 0.2
    settings = CollectSettings(tolerance_ms=100.0)
    camera, force_torque = InTime(Camera(UNTOUCHED_S + TOUCH_S), began_at), InTime(ForceTorque(), began_at)
    with RecordingWriter(tmp_path / "live.mcap", RecordingMetadata("live"), COLLECTED_TOPICS) as episode:
        collector = Collector(episode, settings)
        for heard in merge_live_streams(camera, CheckedWrenchSource(force_torque)):
            if heard is not None:
                collector.add(heard)
        collector.finish()
    pairs = list(read_recorded_pairs(tmp_path / "live.mcap"))
    with Recording(tmp_path / "live.mcap") as read:
        assert len(list(read.wrenches())) > 200
    assert len([pair for pair in pairs if pair.kind == "rule"]) >= 5
    for pair in pairs:
        assert np.abs(pair.wrench.six - truth(pair.time_ns / 1e9 - began_at))[:3].max() < 0.15
    assert not [thread for thread in threading.enumerate() if "listen" in thread.name]


def test_keys_are_read_one_by_one_and_the_terminal_is_as_before(monkeypatch: pytest.MonkeyPatch) -> None:
    ours, theirs = pty.openpty()
    monkeypatch.setattr("sys.stdin", os.fdopen(theirs))
    before = termios.tcgetattr(theirs)
    with open_key_reader() as typed:
        assert typed.read_keys() == ""
        os.write(ours, b"nu")
        time.sleep(0.05)
        assert typed.read_keys() == "nu"
    assert termios.tcgetattr(theirs)[3] == before[3]
    reading, writing = os.pipe()
    monkeypatch.setattr("sys.stdin", os.fdopen(reading))
    os.write(writing, b"q")
    os.close(writing)
    with open_key_reader() as typed:
        assert [typed.read_keys() for _ in range(3)] == ["q", "", ""]


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_the_screen_is_rewritten_in_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = Terminal()
    monkeypatch.setattr("sys.stderr", terminal)
    with RecordingWriter(tmp_path / "e.mcap", RecordingMetadata("x"), COLLECTED_TOPICS) as episode:
        collector, screen = Collector(episode), CollectTerminalDisplay()
        screen.show(collector)
        screen.show(collector)
        screen.show_message("next object: cup")
        screen.show(collector, at_once=True)
    shown = terminal.getvalue()
    assert shown.count("n next object") == 2 and shown.count("\x1b[J") == 1 and "Fz -12.00 ············" in shown
    assert "do not touch the gel" in shown and "missing: Fx" in shown and "next object: cup" in shown


def read_screen(terminal: int) -> str:
    """Return what was written, up to its last line; a terminal may give it in parts."""
    written = b""
    while not written.endswith(b"q end\r\n"):
        written += os.read(terminal, 10_000)
    return written.decode()


def test_the_screen_is_rewritten_in_place_where_its_lines_are_wider_than_the_terminal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    outer, inner = pty.openpty()
    termios.tcsetwinsize(inner, (50, 30))
    with (
        os.fdopen(inner, "w") as terminal,
        RecordingWriter(tmp_path / "e.mcap", RecordingMetadata("x"), COLLECTED_TOPICS) as episode,
    ):
        monkeypatch.setattr("sys.stderr", terminal)
        collector, screen = Collector(episode), CollectTerminalDisplay()
        screen.show(collector)
        first = read_screen(outer)
        screen.show(collector, at_once=True)
        again = read_screen(outer)
    os.close(outer)
    rows = sum(max(math.ceil(len(line) / 30), 1) for line in first.split("\r\n")[:-1])
    assert rows > 15 and again == f"\x1b[{rows}A\x1b[J{first}"


def test_ctrl_c_asks_once_and_insists_twice() -> None:
    with stop_on_signal() as until:
        assert not until.now
        os.kill(os.getpid(), 2)
        assert until.now
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), 2)
            time.sleep(1)
    with stop_on_signal(seconds=0.01) as until:
        time.sleep(0.02)
        assert until.now and until.requested is False


def test_a_closing_terminal_asks_for_the_end_as_often_as_it_likes_unless_it_is_ignored() -> None:
    before = signal.getsignal(signal.SIGHUP)
    try:
        for ignored in (False, True):
            signal.signal(signal.SIGHUP, signal.SIG_IGN if ignored else signal.SIG_DFL)
            with stop_on_signal() as until:
                for _ in range(2):
                    signal.raise_signal(signal.SIGHUP)
                assert until.requested is not ignored
    finally:
        signal.signal(signal.SIGHUP, before)


SLEEPER = "import sys, time; open(sys.argv[1], 'w').close(); time.sleep(600)"
TOGETHER = """
import sys
from ninedtact.cli.ros2_foxglove_and_serve import run_commands_together
from ninedtact.cli.result_and_interrupt import stop_on_signal
with stop_on_signal() as until:
    run_commands_together({path: [sys.executable, "-c", sys.argv[1], path] for path in sys.argv[2:]}, lambda: until.requested)
"""


def running_with(files: list[Path]) -> list[int]:
    """Return the processes that were started with one of these files."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):  # it has ended
            words = (process / "cmdline").read_text(errors="replace").split("\0")
            found += [int(process.name)] if set(words) & {str(file) for file in files} else []
    return found


def wait_for_sleepers(files: list[Path]) -> None:
    give_up_at = time.monotonic() + 60
    while not all(file.exists() for file in files):
        assert time.monotonic() < give_up_at
        time.sleep(0.02)


@pytest.fixture
def sleepers(tmp_path: Path) -> Iterator[list[Path]]:
    """The files that processes create before they sleep; no such process outlives the test."""
    files = [tmp_path / "left", tmp_path / "right"]
    yield files
    for number in running_with(files):
        os.kill(number, signal.SIGKILL)


def heed_hangup() -> None:
    """Undo that what runs under nohup ignores the end of its terminal."""
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


def test_no_process_of_several_runs_on_when_the_terminal_closes(sleepers: list[Path]) -> None:
    command = [sys.executable, "-c", TOGETHER, SLEEPER, *map(str, sleepers)]
    with subprocess.Popen(command, preexec_fn=heed_hangup) as parent:
        wait_for_sleepers(sleepers)
        parent.send_signal(signal.SIGHUP)
        assert parent.wait(60) == 0
    assert running_with(sleepers) == []


@pytest.mark.parametrize("what", ["an error", "a program that is not there"])
def test_no_process_of_several_runs_on_after_an_error(what: str, sleepers: list[Path], tmp_path: Path) -> None:
    commands = {file.name: [sys.executable, "-c", SLEEPER, str(file)] for file in sleepers}

    def raise_error() -> bool:
        wait_for_sleepers(sleepers)
        raise KeyboardInterrupt

    if what == "an error":
        with pytest.raises(KeyboardInterrupt):
            run_commands_together(commands, raise_error)
    else:
        with pytest.raises(FileNotFoundError):
            run_commands_together(commands | {"third": [str(tmp_path / "missing")]}, raise_error)
    assert running_with(sleepers) == []
