"""Recordings in Rerun, read back by its own reader; behind the marker of the doors, where rerun-sdk is installed."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from episodes import sample
from small_sensor import SkinCamera, sensor_folder

from ninedtact.calibration.sensor_folder import load_sensor
from ninedtact.cli import main
from ninedtact.quantities import EstimateWarning, Wrench, WrenchEstimate, diagonal_covariance
from ninedtact.recording.attached_sensor import sensor_folder_attachments
from ninedtact.recording.metadata import RecordingMetadata
from ninedtact.recording.reader import Recording
from ninedtact.recording.topics_and_messages import Topic
from ninedtact.recording.writer import RecordingWriter
from ninedtact.shape.coloured_height_map import colourise_heights

pytestmark = pytest.mark.interop
pytest.importorskip("rerun", reason="the extra 'rerun' is not installed")
from rerun.chunk import RrdReader  # noqa: E402

from ninedtact.interop.rerun import COMPONENTS, export_rerun  # noqa: E402

PRESSED, IMAGES, UNKNOWN = 60, 14, 11
STD = np.arange(1.0, 7.0)


@pytest.fixture
def recorded(tmp_path: Path) -> Path:
    """Ten images without contact, then a press, each with an estimate (one unknown); and samples of a force/torque sensor."""
    folder = load_sensor(sensor_folder(tmp_path / "small"))
    path, camera = tmp_path / "press.mcap", SkinCamera()
    topics = (Topic.IMAGES, Topic.MEASURED, Topic.ESTIMATED, Topic.COVARIANCE, Topic.WARNINGS)
    camera.open()
    with RecordingWriter(path, RecordingMetadata(folder.id), topics, sensor_folder_attachments(folder.path)) as writer:
        for number in range(IMAGES):
            camera.level = 100 if number < 10 else PRESSED
            frame = camera.read()
            writer.write_image(frame)
            wrench = sample(number)
            wrench = Wrench(wrench.force_n, wrench.torque_nm, stamp_ns=frame.stamp_ns)
            warnings = (EstimateWarning.OUT_OF_RANGE,) * (number == 12)
            std = np.full(6, np.inf) if number == UNKNOWN else STD
            estimate = WrenchEstimate(wrench, diagonal_covariance(std), touching=True, warnings=warnings)
            writer.write_estimated(estimate, frame.index)
            writer.write_measured(wrench)
    camera.close()
    return path


def columns(path: Path) -> dict[str, dict[str, list[Any]]]:
    """What Rerun's reader finds: of every entity its columns, all rows one after the other."""
    found: dict[str, dict[str, list[Any]]] = {}
    for chunk in RrdReader(path).stream().to_chunks():
        table = found.setdefault(chunk.entity_path, {})
        batch = chunk.to_record_batch()
        for name in batch.schema.names:
            column = batch.column(name)
            values = column.cast("int64") if name == "sensor_time" else column
            table.setdefault(name, []).extend(values.to_pylist())
    return found


def test_the_reader_of_rerun_finds_images_surfaces_and_wrenches_with_their_bands(
    recorded: Path, tmp_path: Path
) -> None:
    out = tmp_path / "press.rrd"
    assert main(["export", str(recorded), "--out", str(out), "--to", "rerun", "--points-every", "2"]) == 0
    found = columns(out)
    with Recording(recorded) as recording:
        readings, wrenches = list(recording.readings()), list(recording.wrenches(Topic.ESTIMATED))
        stamps = [recording.metadata.wall_ns(one.stamp_ns) for one in readings]
    assert len(readings) == IMAGES
    surface = found["/small/surface"]
    assert surface["sensor_time"] == stamps
    assert surface["image"] == [one.frame.index for one in readings] == found["/small/image"]["image"]
    for points_mm, colours, reading in zip(
        surface["Points3D:positions"], surface["Points3D:colors"], readings, strict=True
    ):
        assert np.min(points_mm, 0)[2] == pytest.approx(reading.height.z_mm[::2, ::2].min(), abs=1e-6)
        assert len(points_mm) == len(colours) == 15 * 20
    for name, shown in (("image", readings[-1].image), ("heights", colourise_heights(readings[-1].height))):
        jpeg = cv2.imdecode(np.array(found[f"/small/{name}"]["EncodedImage:blob"][-1][0], np.uint8), cv2.IMREAD_COLOR)
        assert np.quantile(abs(jpeg.astype(int) - shown), 0.9) < 12
    assert [row[0] for row in found["/small/indentation"]["Scalars:scalars"]] == pytest.approx(
        [one.max_indentation_mm for one in readings]
    )
    assert max(one.max_indentation_mm for one in readings) > 1
    for number, component in enumerate(COMPONENTS):
        rows = found[f"/small/wrench_estimated/{component}"]["Scalars:scalars"]
        for image, (row, wrench) in enumerate(zip(rows, wrenches, strict=True)):
            value, low, high = row
            assert value == pytest.approx(wrench.six[number])
            std = np.nan if image == UNKNOWN else STD[number]
            assert (value - low, high - value) == pytest.approx((std, std), nan_ok=True)
    outlines, areas = found["/small/contacts"]["LineStrips3D:strips"], [one.contact_area_mm2 for one in readings]
    assert [len(strips or ()) for strips in outlines] == [0] * 10 + [1] * 4 and min(areas[10:]) > 1
    (outline,) = outlines[-1]
    assert outline[0] == outline[-1] and {point[2] for point in outline} == {np.float32(0.2)}
    assert [len(points or ()) for points in found["/small/object"]["Points3D:positions"]][-1] <= 1
    assert len(found["/small/motion/yaw_deg"]["Scalars:scalars"]) == IMAGES
    assert len(found["/small/slip/p_gross"]["Scalars:scalars"]) == IMAGES
    assert len(found["/small/wrench_measured/torque_z"]["Scalars:scalars"][0]) == 1
    assert [row[0] for row in found["/small/warnings"]["TextLog:text"]] == ["out of range"]
    colours = [found[f"/small/wrench_{kind}/force_z"]["SeriesLines:colors"][0][0] for kind in ("estimated", "measured")]
    assert colours[0] != colours[1]
    assert "log_time" not in surface and "log_tick" not in surface


def test_an_export_that_is_refused_or_fails_leaves_no_file(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["export", str(recorded), "--to", "rerun", "--out"]
    for out in (tmp_path / "folder", recorded):
        assert main([*words, str(out)]) == 1
        assert "expected --out to be a new file ending in .rrd" in capsys.readouterr().err
    before = sorted(tmp_path.iterdir())

    def stop() -> None:
        raise KeyboardInterrupt

    with Recording(recorded) as recording, pytest.raises(KeyboardInterrupt):
        export_rerun(recording, tmp_path / "stopped.rrd", on_image=stop)
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize("limit_bytes", [0, 30_000, 150_000])
def test_a_disk_that_fills_is_one_sentence_and_leaves_no_file(recorded: Path, tmp_path: Path, limit_bytes: int) -> None:
    out = tmp_path / "full" / "press.rrd"
    code = f"""
import resource
from ninedtact.cli import main
resource.setrlimit(resource.RLIMIT_FSIZE, ({limit_bytes}, {limit_bytes}))
raise SystemExit(main(["export", {str(recorded)!r}, "--to", "rerun", "--points-every", "1", "--out", {str(out)!r}]))
"""
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300, check=False)
    said = [line for line in ended.stderr.splitlines() if line.startswith("ninedtact: expected")]
    assert ended.returncode == 1 and len(said) == 1 and "Traceback" not in ended.stderr
    assert said[0].startswith(f"ninedtact: expected to write {out}, got: File too large; free the disk")
    assert not any(out.parent.iterdir())
