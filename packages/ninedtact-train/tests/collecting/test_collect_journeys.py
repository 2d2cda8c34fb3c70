"""What a person does with `ninedtact collect`: on a twin, from a recording and live, at the command line and from a program."""

import json
import os
import pty
import termios
import threading
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hand import TOUCH_S, TOUCHES, UNTOUCHED_S, Camera, ForceTorque, at_s, record_hand, truth
from twin_folder import twin_folder

from ninedtact.capture.force_torque.sample_checks import CheckedWrenchSource
from ninedtact.capture.frame_source import FrameSource
from ninedtact.capture.wrench_source import WrenchSource
from ninedtact.cli import main
from ninedtact.quantities import Frame, Wrench
from ninedtact.recording.metadata import RecordingMetadata
from ninedtact.recording.reader import Recording
from ninedtact.recording.writer import RecordingWriter
from ninedtact_train.cli.collect import open_key_reader
from ninedtact_train.collecting.collected_pairs import read_recorded_pairs
from ninedtact_train.collecting.collection_sources import merge_live_streams
from ninedtact_train.collecting.collector import COLLECTED_TOPICS, Collector
from ninedtact_train.collecting.pair_selection import CollectSettings


@pytest.fixture(scope="module")
def sensor(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sensor like the default twin that knows its twin, made without calibrating."""
    return twin_folder(tmp_path_factory.mktemp("collecting") / "sensor")


def told(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> dict:
    assert main([*map(str, arguments), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ("--source sim --force-torque netft:1.2.3.4", "both sim"),
        ("--source 0 --force-torque gopher:1", "got 'gopher:1'"),
        ("--source no.mcap --force-torque no.mcap", "no such file"),
        ("--source sim --force-torque sim --min-difference 0", "min_difference above 0"),
        ("--source sim --force-torque sim --objects bal", "got 'bal'"),
        ("--source sim --force-torque sim --pairs 0", "pairs of at least 1"),
        ("--source sim --force-torque sim --seed -1", "seed of at least 0"),
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
    assert main(["collect", "--out", "x.mcap", "--sensor", str(sensor), *options.split()]) == 1
    (sentence,) = capsys.readouterr().err.strip().splitlines()
    assert sentence.startswith("ninedtact: expected") and said in sentence
    assert list(tmp_path.iterdir()) == []


def test_pairs_are_collected_from_a_recording_with_its_stamps_and_its_sensor(
    sensor: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source, out = tmp_path / "hand.mcap", tmp_path / "pairs.mcap"
    record_hand(source, sensor, UNTOUCHED_S + TOUCHES * TOUCH_S)
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
    record_hand(source, sensor, 0.5, delay_ms=42.0)
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
        assert (change.min() < -2) == (pair.wrench.force_n[2] < -0.25)
    figures = told(capsys, "info", out)
    assert figures["purpose"] == "collect" and figures["pairs"] == found["kinds"]


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
    with open_key_reader() as read_keys:
        assert read_keys() == ""
        os.write(ours, b"nu")
        time.sleep(0.05)
        assert read_keys() == "nu"
    assert termios.tcgetattr(theirs)[3] == before[3]
    reading, writing = os.pipe()
    monkeypatch.setattr("sys.stdin", os.fdopen(reading))
    os.write(writing, b"q")
    os.close(writing)
    with open_key_reader() as read_keys:
        assert [read_keys() for _ in range(3)] == ["q", "", ""]
