"""Recordings of `ninedtact collect` in a data set: rectified as the live sensor does it, with the sensor that rides along."""

import json
from datetime import UTC, datetime
from pathlib import Path

import msgspec
import numpy as np
import pytest
from built_sets import decoded, listed, references_in, rows_in
from little_sources import touched, untouched

from ninedtact.calibration.save import to_sensor_toml
from ninedtact.calibration.sensor_folder import SENSOR_FILE, SensorFolder
from ninedtact.calibration.sensor_toml_schema import (
    SENSOR_FORMAT,
    DepthTable,
    GridTable,
    LensModelTable,
    SensorTomlRecord,
)
from ninedtact.cli import main
from ninedtact.design import RectifiedImageSize, SensorDesign
from ninedtact.errors import DatasetError, InputError
from ninedtact.quantities import Frame, Wrench
from ninedtact.recording.attached_sensor import sensor_folder_attachments
from ninedtact.recording.metadata import RecordingMetadata
from ninedtact.recording.reader import RecordingCutShort
from ninedtact.recording.topics_and_messages import PairLabel, Topic
from ninedtact.recording.writer import RecordingWriter
from ninedtact.shape.depth import DepthCurve, Smoothing
from ninedtact_train.collecting.collected_pairs import read_recorded_pairs
from ninedtact_train.dataset.build import BuildResult, build_dataset
from ninedtact_train.dataset.sources.find_sources import find_sources
from ninedtact_train.dataset.sources.source import SourceConventions
from ninedtact_train.workflows.dataset_calibrations import load_dataset_sensors

RAW, MM_PER_PX = (48, 64), 0.5
PX_PER_MM = 1 / (MM_PER_PX * max(RAW) / 2)
SIX = np.array([0.5, 0, -3, 0.01, -0.02, 0.003])
TOPICS = (Topic.IMAGES, Topic.REFERENCE, Topic.MEASURED, Topic.LABELS)


@pytest.fixture
def sensor(tmp_path: Path) -> SensorFolder:
    """A lens without distortion, 40 x 30 rectified pixels."""
    record = SensorTomlRecord(
        format=SENSOR_FORMAT,
        id="little",
        created=datetime(2026, 1, 1, tzinfo=UTC),
        software="test",
        design=SensorDesign(field_of_view=RectifiedImageSize(30, 40, 64)),
        grid=GridTable(MM_PER_PX, *RAW, calibrated_area_mm=(-10.0, 10.0, -7.5, 7.5)),
        lens=LensModelTable((PX_PER_MM, 0.0, 0.0, 0.0, PX_PER_MM, 0.0, 0.0, 0.0), (0.0, 0.0), (0.0,), (0.0, 0.0)),
        depth=DepthTable("ratio", 0.001, Smoothing(), DepthCurve("ratio", (0.0, 0.5), (0.0, 2.0), (0.0, 0.01))),
    )
    (tmp_path / "sensor").mkdir()
    (tmp_path / "sensor" / SENSOR_FILE).write_bytes(to_sensor_toml(record))
    return SensorFolder(tmp_path / "sensor", record)


def episode(path: Path, attached: dict[str, bytes] | None = None) -> None:
    """Two tares, a pair after each; the second wrench is 30 ms late."""
    path.parent.mkdir(exist_ok=True)
    skin = untouched(rows=RAW[0], cols=RAW[1])
    with RecordingWriter(path, RecordingMetadata("little", id=path.stem), TOPICS, attached) as writer:
        for tare in (0, 1):
            begin_ns = 1_000_000_000 * (tare + 1)
            for index in range(2):
                writer.write_reference(Frame(skin, begin_ns + index, index), tare)
            frame = Frame(touched(skin, 3.0, tare), begin_ns + 100, 10 + tare)
            writer.write_image(frame)
            wrench = Wrench(SIX[:3], SIX[3:], stamp_ns=frame.stamp_ns)
            writer.write_label(
                PairLabel(frame.stamp_ns, frame.index, tare, f"cup_{tare}", f"{path.stem}-c{tare}", "rule", wrench)
            )


def built_from(out: Path, source: Path, conventions: SourceConventions = SourceConventions()) -> BuildResult:
    return build_dataset(out, find_sources([str(source)], conventions))


def test_the_calibrations_of_recordings_are_in_the_data_set_unless_they_contradict_each_other(
    sensor: SensorFolder, tmp_path: Path
) -> None:
    attached = sensor_folder_attachments(sensor.path)
    episode(tmp_path / "in" / "monday.mcap", attached)
    episode(tmp_path / "in" / "tuesday.mcap", attached)
    built_from(tmp_path / "one", tmp_path / "in")
    known = load_dataset_sensors(tmp_path / "one", None, 1, progress=False)
    assert list(known.by_name) == ["little"] and not known.refused
    assert (tmp_path / "one" / "sensors" / "little" / SENSOR_FILE).read_bytes() == attached[f"sensor/{SENSOR_FILE}"]
    other = attached[f"sensor/{SENSOR_FILE}"].replace(b'software = "test"', b'software = "another"')
    episode(tmp_path / "in" / "wednesday.mcap", {f"sensor/{SENSOR_FILE}": other})
    with pytest.raises(
        InputError, match=r"of sensor 'little', got different ones in .*monday.mcap and .*wednesday.mcap"
    ):
        built_from(tmp_path / "two", tmp_path / "in")
    assert not (tmp_path / "two").exists()
    built_from(tmp_path / "two", tmp_path / "in", SourceConventions(sensor=sensor.path))
    assert list(load_dataset_sensors(tmp_path / "two", None, 1, progress=False).by_name) == ["little"]


def test_pairs_are_rectified_with_the_sensor_that_rides_along(sensor: SensorFolder, tmp_path: Path) -> None:
    episode(tmp_path / "in" / "monday.mcap", sensor_folder_attachments(sensor.path))
    built = built_from(tmp_path / "out", tmp_path / "in")
    assert built.report.findings == []
    rows = rows_in(tmp_path / "out")
    assert [row["id"] for row in rows] == ["monday-c0/000", "monday-c1/000"]
    skin = untouched(rows=RAW[0], cols=RAW[1])
    references = references_in(tmp_path / "out")
    assert len(references) == 2
    for tare, row in enumerate(rows):
        images = (touched(skin, 3.0, tare), skin)
        expected = [np.rint(sensor.rectification(Frame(image)).grey).astype(np.uint8) for image in images]
        assert np.array_equal(decoded(row["image"]), expected[0])
        assert np.array_equal(references[row["reference_id"]], expected[1])
        assert row["wrench"] == pytest.approx(SIX, abs=1e-6)
        assert (row["object"], row["sensor"], row["kind"]) == (f"cup_{tare}", "little", "rule")
        assert (row["wrench_delay_ms"], row["time_ns"]) == (0, 1_000_000_000 * (tare + 1) + 100)
        assert row["mm_per_px"] == pytest.approx(MM_PER_PX)


def test_a_recording_without_its_sensor_needs_one_named(sensor: SensorFolder, tmp_path: Path) -> None:
    episode(tmp_path / "in" / "bare.mcap")
    with pytest.raises(DatasetError, match="1 unreadable"):
        built_from(tmp_path / "none", tmp_path / "in")
    stated = SourceConventions(sensor=sensor.path)
    assert built_from(tmp_path / "out", tmp_path / "in" / "bare.mcap", stated).statistics.pairs == 2


def test_the_folder_of_another_sensor_does_not_rectify_a_recording(sensor: SensorFolder, tmp_path: Path) -> None:
    attached = sensor_folder_attachments(sensor.path)
    episode(tmp_path / "in" / "monday.mcap", attached)
    again = built_from(tmp_path / "again", tmp_path / "in", SourceConventions(sensor=sensor.path))
    assert again.statistics.pairs == 2
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / SENSOR_FILE).write_bytes(to_sensor_toml(msgspec.structs.replace(sensor.record, id="other")))
    with pytest.raises(DatasetError):
        built_from(tmp_path / "out", tmp_path / "in", SourceConventions(sensor=tmp_path / "other"))
    report = (tmp_path / "out" / "report.json").read_text()
    assert "expected the sensor folder of 'little'" in report and "got that of 'other'" in report


def test_a_damaged_recording_is_listed_and_the_others_are_read(sensor: SensorFolder, tmp_path: Path) -> None:
    for name in ("good", "odd"):
        episode(tmp_path / "in" / f"{name}.mcap", sensor_folder_attachments(sensor.path))
    (tmp_path / "in" / "odd.mcap").write_bytes(b"no recording")
    built = built_from(tmp_path / "out", tmp_path / "in")
    assert listed(built.report) == {("unreadable", "in/odd")}
    assert built.statistics.pairs == 2


def test_a_recording_that_was_cut_short_is_named_with_its_pairs_which_are_kept(
    sensor: SensorFolder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cut, out = tmp_path / "in" / "cut.mcap", tmp_path / "out"
    episode(cut, sensor_folder_attachments(sensor.path))
    whole = cut.read_bytes()
    kept = []
    for share in range(100, 0, -1):  # down to the last one that has one of its two pairs
        cut.write_bytes(whole[: len(whole) * share // 100])
        kept = []
        try:
            kept.extend(read_recorded_pairs(cut))
        except RecordingCutShort as error:
            counted = f"and {len(kept)} {'pair' if len(kept) == 1 else 'pairs'} of a recording that was cut short"
            assert share < 100 and counted in str(error)
        assert share < 100 or len(kept) == 2
        if len(kept) == 1:
            break
    assert [pair.object for pair in kept] == ["cup_0"]

    command = ["dataset", "build", str(tmp_path / "in"), f"--out={out}", "--json"]
    for _ in range(2):  # the second finds the data set finished
        assert main(command) == 0
        said = capsys.readouterr()
        counted = json.loads(said.out)
        assert (counted["pairs"], counted["without_fault"], counted["faults"]) == (1, 1, {"missing end": 1})
        assert f"expected all of {cut}, got 0.0 s and 1 pair of a recording that was cut short" in said.err
    assert "1 missing end: a recording that was cut short" in (out / "README.md").read_text()
    assert main([*command, "--strict"]) == 1
    assert "expected no faults, got 1 missing end" in capsys.readouterr().err
