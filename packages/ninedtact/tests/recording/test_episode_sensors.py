"""Recordings of several sensors as one data set: name, calibration and reference image of each are kept."""

import json
from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest
from twin_folder import twin_folder

from ninedtact.calibration.save import to_sensor_toml
from ninedtact.calibration.sensor_folder import load_sensor
from ninedtact.cli import main
from ninedtact.quantities import Frame, Rectified
from ninedtact.recording.attached_sensor import sensor_folder_attachments
from ninedtact.recording.episode_sensors import write_episode_sensors
from ninedtact.recording.metadata import RecordingMetadata
from ninedtact.recording.reader import Recording
from ninedtact.recording.topics_and_messages import Topic
from ninedtact.recording.writer import RecordingWriter

GREY = Rectified(np.linspace(90.3, 140.7, 30 * 44, dtype=np.float32).reshape(30, 44), 0.05)


def write_episode(path: Path, sensor: Path | None, name: str, reference: Topic | None) -> Path:
    """Write twelve images of one brightness each, and the reference image in one of the ways that recordings have."""
    attachments = {} if sensor is None else sensor_folder_attachments(sensor)
    with RecordingWriter(path, RecordingMetadata(name), tuple(Topic), attachments) as writer:
        for number in range(2 if reference is Topic.REFERENCE else 0):
            writer.write_reference(Frame(np.full((30, 44, 3), 200 + 2 * number, np.uint8), 10**9), 0)
        if reference is Topic.REFERENCE_GREY:
            writer.write_reference_grey(GREY, 10**9)
        for number in range(12):
            writer.write_image(Frame(np.full((30, 44, 3), 100 + number, np.uint8), 10**9 + number * 10**7, number))
    return path


def test_each_episode_keeps_its_sensor_and_its_reference_image(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    left, right = twin_folder(tmp_path / "left"), twin_folder(tmp_path / "right")
    record = load_sensor(right).record
    depth = msgspec.structs.replace(record.depth, noise_mm=0.02)
    (right / "sensor.toml").write_bytes(to_sensor_toml(msgspec.structs.replace(record, depth=depth)))
    kinds = [
        (left, "left", None),
        (right, "right", Topic.REFERENCE),
        (left, "left", Topic.REFERENCE_GREY),
        (None, "unknown", None),
    ]
    paths = [write_episode(tmp_path / f"{number}.mcap", *kind) for number, kind in enumerate(kinds)]
    write_episode_sensors([Recording(path) for path in paths], tmp_path / "set")
    episodes = json.loads((tmp_path / "set/episodes.json").read_text())
    assert [one["sensor"] for one in episodes] == ["left", "right", "left", "unknown"]
    checksums = [load_sensor(left).calibration_checksum, load_sensor(right).calibration_checksum]
    assert [one["calibration_checksum"] for one in episodes] == [*checksums, checksums[0], ""]
    assert len(list((tmp_path / "set/sensors").iterdir())) == 2
    for one in episodes[:3]:
        assert load_sensor(tmp_path / "set" / one["sensor_folder"]).calibration_checksum == one["calibration_checksum"]
    references = [tmp_path / "set" / one["reference"] for one in episodes]
    greys = [cv2.imread(str(references[number]))[0, 0, 0] for number in (0, 1, 3)]  # type: ignore[index]
    assert greys[1] == 201 and {greys[0], greys[2]} <= {104, 105}
    np.testing.assert_array_equal(np.load(references[2]), GREY.grey)
    assert main(["info", str(paths[0])]) == 0 and checksums[0][:8] in capsys.readouterr().out
    assert main(["export", str(paths[2]), "--out", str(tmp_path / "out")]) == 0
    np.testing.assert_array_equal(np.load(tmp_path / f"out/references/rectified_{10**9}.npy"), GREY.grey)
    assert json.loads((tmp_path / "out/recording.json").read_text())["calibration_checksum"] == checksums[0]
