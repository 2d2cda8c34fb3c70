"""Folders of the original project come in and go out without loss, and damaged ones are refused in one sentence."""

import json
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from hashlib import sha256
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from known_sensor import LENS
from numpy import ndarray as Array
from upstream_folder import UpstreamFolder

from ninedtact.calibration.original_9dtact.folder_format import (
    COL_INDEX,
    ORIGINAL_FILES,
    PIXEL_TO_DEPTH,
    POSITION_SCALE,
    ROW_INDEX,
    read_finite_npy,
)
from ninedtact.calibration.original_9dtact.import_export import export_original_calibration, import_original_calibration
from ninedtact.calibration.save import to_sensor_toml
from ninedtact.calibration.sensor_folder import SENSOR_FILE, SensorFolderDamaged, load_sensor
from ninedtact.calibration.sensor_toml_schema import (
    SENSOR_FORMAT,
    DepthTable,
    GridTable,
    LensModelTable,
    SensorTomlRecord,
    StoredCalibrationImage,
)
from ninedtact.capture.strict_image_reading import read_image
from ninedtact.cli.original_calibration import ExportCalibrationCommand, ImportCalibrationCommand
from ninedtact.cli.reconstruct import ReconstructCommand
from ninedtact.design import SensorDesign
from ninedtact.errors import FileFormatError, OutputError
from ninedtact.quantities import Frame, HeightSource
from ninedtact.shape.depth import DepthCurve, Smoothing

REAL = "sensor_a/upstream_layout"
GREY = 160


def arrays(folder: Path) -> dict[str, Array]:
    return {file: np.load(folder / file, allow_pickle=False) for file in ORIGINAL_FILES}


def shown_by_original(folder: Path, grey: Array, rows: int = 345, cols: int = 460) -> Array:
    """What the original program shows, by its own arithmetic."""
    found = arrays(folder)
    centre = found[POSITION_SCALE]
    top, bottom = int(centre[0] - rows / 2), int(centre[0] + rows / 2)
    left, right = int(centre[1] - cols / 2), int(centre[1] + cols / 2)
    return grey[found[ROW_INDEX], found[COL_INDEX]][top:bottom, left:right]


def test_a_real_folder_survives_the_round_trip(real_data: Path, tmp_path: Path) -> None:
    sensor = import_original_calibration(real_data / REAL, tmp_path / "ours")
    export_original_calibration(sensor, tmp_path / "sensor_9")
    before, after = arrays(real_data / REAL / "sensor_1"), arrays(tmp_path / "sensor_9")
    for file in (ROW_INDEX, COL_INDEX, POSITION_SCALE):
        np.testing.assert_array_equal(after[file], before[file])
        assert after[file].dtype == before[file].dtype
    np.testing.assert_array_equal(after[PIXEL_TO_DEPTH][1:], before[PIXEL_TO_DEPTH][1:])
    assert after[PIXEL_TO_DEPTH][0] == 0


def test_an_imported_sensor_shows_what_the_original_shows(real_data: Path, tmp_path: Path) -> None:
    sensor = import_original_calibration(real_data / REAL, tmp_path / "ours", sensor_id="left finger")
    ball = read_image(real_data / "sensor_a/ball.png")
    grey = cv2.cvtColor(ball, cv2.COLOR_BGR2GRAY)
    ours = sensor.rectification(Frame(ball)).grey
    np.testing.assert_array_equal(ours, shown_by_original(real_data / REAL / "sensor_1", grey))
    height = sensor.shape.depth_reader(Frame(read_image(real_data / "sensor_a/ball_reference.png")))
    deepest_mm = height(sensor.rectification(Frame(ball))).indentation_mm.max()
    assert deepest_mm == pytest.approx(1.85, abs=0.1)
    assert (sensor.rectification.height_source == HeightSource.OUT_OF_VIEW).sum() == 38
    assert sensor.id == load_sensor(tmp_path / "ours").id == "left finger"
    with pytest.raises(SensorFolderDamaged, match="imported"):
        sensor.stored_image("ball_reference")


def test_pixels_without_a_source_are_out_of_view_and_an_image_may_be_turned_by_180_degrees(tmp_path: Path) -> None:
    rows, cols = np.mgrid[:480, :640].astype(np.int32)
    for name, turn in (("sensor_1", 1), ("sensor_2", -1)):
        row_index, col_index = rows[::turn, ::turn].copy(), cols[::turn, ::turn].copy()
        row_index[200, 250] = col_index[200, 250] = col_index[210, 250] = 0
        folder = UpstreamFolder(row_index, col_index, np.array([240.0, 320.0, 0.0511])).write(tmp_path / name)
        sensor = import_original_calibration(folder, tmp_path / "ours")
        row, col = 200 - (240 - 345 // 2 - 1), 250 - (320 - 460 // 2)
        assert sensor.rectification.height_source[row, col] == HeightSource.OUT_OF_VIEW
        assert sensor.rectification.height_source[row + 10, col] != HeightSource.OUT_OF_VIEW  # the border is seen
        shown = sensor.rectification.source_px[row + 1, col].tolist()
        assert shown == [col_index[201, 250], row_index[201, 250]]


Spoil = Callable[[UpstreamFolder], object]
SPOILT: dict[str, tuple[Spoil, str]] = {
    "index beyond the image": (lambda f: f.row_index.__setitem__((3, 4), 480), "pixels 0 to 479 .*row_index"),
    "negative index": (lambda f: f.col_index.__setitem__((3, 4), -1), "pixels 0 to 639 .*col_index"),
    "maps of two sizes": (lambda f: setattr(f, "col_index", f.col_index[:400]), "one size"),
    "fractions": (lambda f: setattr(f, "row_index", f.row_index * 0.9), "whole numbers"),
    "letters": (lambda f: setattr(f, "row_index", f.row_index.astype(str)), "array of numbers"),
    "not a number": (lambda f: f.pixel_to_depth.__setitem__(7, np.nan), "finite numbers .*Pixel_to_Depth"),
    "no depths": (lambda f: f.pixel_to_depth.fill(0), "0 are depths"),
    "pixels per mm": (lambda f: f.position_scale.__setitem__(2, 19.6), "got 19.6.* inverse"),
    "centre at the border": (lambda f: f.position_scale.__setitem__(0, 100.0), "reaches beyond.*crop_size"),
    "constant map": (lambda f: f.col_index.fill(300), "smooth maps .*col_index.* not on 100.0%"),
    "rows upside down": (lambda f: setattr(f, "row_index", f.row_index[::-1]), "got mirrored ones"),
    "columns beside": (lambda f: np.add(f.col_index, 9, out=f.col_index), "central pin at row 240, .*column 327"),
    "scale twice as coarse": (
        lambda f: f.position_scale.__imul__([1, 1, 2]),
        "got 460 x 345 pixels of 0.1022 mm, 47.0",
    ),
    "first depths alone": (
        lambda f: setattr(f, "pixel_to_depth", f.pixel_to_depth[:10]),
        "10 levels that ends at 0.26",
    ),
    "one depth for all": (lambda f: f.pixel_to_depth.fill(1), "98% of its end from even"),
    "depths beyond the gel": (lambda f: f.pixel_to_depth.__imul__(1.5), "2.5 mm .*got 2.7 mm; .*--gel-mm"),
    "depths that fall": (
        lambda f: (
            f.pixel_to_depth[1:].sort()
            or f.pixel_to_depth.__setitem__(40, 0.02)
            or f.pixel_to_depth.__setitem__(np.s_[50:], 0.1)
        ),
        "rise with the darkening",
    ),
    "depths below zero": (lambda f: f.pixel_to_depth.__setitem__(9, -0.3), "none below zero"),
    "Python objects": (lambda f: setattr(f, "pixel_to_depth", np.array([{}, 1])), "without Python objects"),
}


@pytest.mark.parametrize(("spoil", "sentence"), SPOILT.values(), ids=SPOILT)
def test_wrong_numbers_are_refused_and_nothing_is_written(tmp_path: Path, spoil: Spoil, sentence: str) -> None:
    folder = UpstreamFolder()
    spoil(folder)
    folder.write(tmp_path / "sensor_2")
    assert_refused(tmp_path / "sensor_2", sentence)


@pytest.mark.parametrize("file", ORIGINAL_FILES)
def test_missing_and_truncated_files_are_refused(tmp_path: Path, file: str) -> None:
    path = UpstreamFolder().write(tmp_path / "sensor_2") / file
    path.write_bytes(path.read_bytes()[:-9])
    assert_refused(tmp_path / "sensor_2", f"whole .npy file .*{Path(file).name}")
    path.unlink()
    assert_refused(tmp_path / "sensor_2", f"{Path(file).name}, got no such file")


def test_a_folder_that_is_not_one_sensor_is_refused(tmp_path: Path) -> None:
    assert_refused(tmp_path / "nowhere", "got no such folder")
    (tmp_path / "empty").mkdir()
    assert_refused(tmp_path / "empty", "got none")
    for name in ("sensor_1", "sensor_2"):
        UpstreamFolder().write(tmp_path / "two" / name)
    assert_refused(tmp_path / "two", "got sensor_1, sensor_2")


def assert_refused(folder: Path, sentence: str) -> None:
    out = folder.parent / "out" / "ours"
    with pytest.raises(FileFormatError, match=sentence):
        import_original_calibration(folder, out)
    assert not out.parent.exists() or not any(out.parent.iterdir())


@given(position=st.integers(0, 200), byte=st.integers(0, 255), cut=st.integers(1, 200))
@example(position=20, byte=ord("O"), cut=200)
@settings(max_examples=100, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
def test_any_damage_to_a_file_is_refused_or_harmless(tmp_path: Path, position: int, byte: int, cut: int) -> None:
    path = tmp_path / "list.npy"
    np.save(path, np.arange(9.0))
    content = bytearray(path.read_bytes())
    content[position % len(content)] = byte
    path.write_bytes(bytes(content[:cut] if cut < 200 else content))
    try:
        numbers = read_finite_npy(path, 1)
    except FileFormatError as refusal:
        assert "\n" not in str(refusal)
    else:
        assert np.isfinite(numbers).all()


RATIO_CURVE = DepthCurve("ratio", (0.0, 0.1, 0.3), (0.0, 0.5, 1.2), (0.01,) * 3)


def lens_sensor(
    folder: Path,
    raw_shape: tuple[int, int] = (480, 640),
    design: SensorDesign = SensorDesign(),
    curve: DepthCurve = RATIO_CURVE,
) -> Path:
    """One of our own sensor folders, with a lens and a curve of ratios."""
    reference = np.full((*raw_shape, 3), GREY, np.uint8)
    content = cv2.imencode(".png", reference)[1].tobytes()
    folder.mkdir()
    (folder / "reference.png").write_bytes(content)
    record = SensorTomlRecord(
        format=SENSOR_FORMAT,
        id="ours",
        created=datetime(2024, 1, 1, tzinfo=UTC),
        software="test",
        design=design,
        grid=GridTable(0.0521, *raw_shape, (-12.5, 12.5, -10.0, 10.0)),
        lens=LensModelTable(LENS.homography, LENS.centre, LENS.radial, LENS.tangential),  # type: ignore[arg-type]
        depth=DepthTable("ratio", 0.001, Smoothing(), curve),
        images={"ball_reference": StoredCalibrationImage("reference.png", sha256(content).hexdigest())},
    )
    (folder / SENSOR_FILE).write_bytes(to_sensor_toml(record))
    return folder


def test_the_original_shows_one_of_our_sensors_to_the_nearest_pixel(tmp_path: Path) -> None:
    sensor = load_sensor(lens_sensor(tmp_path / "ours"))
    export_original_calibration(sensor, tmp_path / "sensor_1")
    rows, cols = np.indices((480, 640))
    shown = np.stack([shown_by_original(tmp_path / "sensor_1", axis) for axis in (cols, rows)], axis=-1)
    seen = sensor.rectification.height_source != HeightSource.OUT_OF_VIEW
    assert np.abs(shown - sensor.rectification.source_px)[seen].max() <= 0.5 + 1e-3
    found = arrays(tmp_path / "sensor_1")
    assert found[POSITION_SCALE][2] == sensor.record.grid.mm_per_px
    levels = np.arange(len(found[PIXEL_TO_DEPTH]))
    assert levels[-1] == 48
    np.testing.assert_allclose(found[PIXEL_TO_DEPTH], np.interp(levels / GREY, [0, 0.1, 0.3], [0, 0.5, 1.2]), rtol=1e-6)
    row, col, mm_per_px = int(found[POSITION_SCALE][0] - 345 / 2), int(found[POSITION_SCALE][1] - 460 / 2), 0.0521
    beside_mm = np.array([[(50 - 229.5) * mm_per_px, (-10 - 172) * mm_per_px]])
    beside = [found[file][row - 10, col + 50] for file in (COL_INDEX, ROW_INDEX)]
    np.testing.assert_array_equal(beside, np.rint(LENS.to_px(beside_mm))[0])
    steep = lens_sensor(tmp_path / "steep", curve=replace(RATIO_CURVE, darkening=(0.0, 0.1, 2.4)))
    export_original_calibration(load_sensor(steep), tmp_path / "sensor_4")
    assert len(arrays(tmp_path / "sensor_4")[PIXEL_TO_DEPTH]) == 256  # no image is darker by more grey levels
    back = import_original_calibration(tmp_path / "sensor_1", tmp_path / "back")
    assert np.abs(back.rectification.source_px - sensor.rectification.source_px)[seen].max() <= 0.5 + 1e-3


def test_an_export_that_would_lose_something_is_refused(tmp_path: Path) -> None:
    small = load_sensor(lens_sensor(tmp_path / "small", (240, 320)))
    with pytest.raises(OutputError, match="at least 460 x 345 pixels"):
        export_original_calibration(small, tmp_path / "sensor_1")
    assert not (tmp_path / "sensor_1").exists()
    ours = load_sensor(lens_sensor(tmp_path / "ours"))
    with pytest.raises(OutputError, match="new or an empty folder"):
        export_original_calibration(ours, tmp_path / "ours")
    with pytest.raises(OutputError, match="new or an empty folder"):
        export_original_calibration(ours, tmp_path / "ours" / SENSOR_FILE)
    imported = import_original_calibration(UpstreamFolder().write(tmp_path / "sensor_2"), tmp_path / "imported")
    UpstreamFolder(position_scale=np.array([239.0, 318.0, 0.0511])).write(imported.path / "original_9dtact")
    with pytest.raises(FileFormatError, match="as it was imported"):
        export_original_calibration(imported, tmp_path / "sensor_1")


def test_a_press_deeper_than_the_list_is_printed_as_a_lower_limit(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = UpstreamFolder(pixel_to_depth=np.linspace(0, 0.6, 21)).write(tmp_path / "sensor_2")
    import_original_calibration(folder, tmp_path / "ours")
    image = np.full((480, 640, 3), GREY, np.uint8)
    paths = [tmp_path / name for name in ("reference.png", "shallow.png", "deep.png")]
    for path, darker in zip(paths, (0, 10, 60), strict=True):
        pressed = cv2.circle(image.copy(), (320, 240), 60, (GREY - darker,) * 3, -1)
        pressed = cv2.GaussianBlur(pressed, (0, 0), 12)  # a sharp edge is that of dirt
        path.write_bytes(cv2.imencode(".png", pressed)[1].tobytes())
    command = ReconstructCommand(tmp_path / "ours", (paths[0],), tuple(paths[1:]), tmp_path / "out", ("npy",), False)
    assert command.run() == 0
    shallow, _, deep, warning, *_ = capsys.readouterr().out.splitlines()
    assert "maximum indentation 0.300 ± 0.0" in shallow and "maximum indentation at least 0.600 mm, contact" in deep
    assert warning == "  the maximum indentation lies beyond the calibrated range and is a lower limit"
    assert replace(command, json=True).run() == 0
    shallow, deep = json.loads(capsys.readouterr().out)["images"]
    assert shallow["max_indentation_error_mm"] > 0 and shallow["warnings"] == []
    assert deep["max_indentation_error_mm"] is None and deep["is_deepest_clipped"]


def test_the_commands_say_in_json_what_they_did(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    UpstreamFolder().write(tmp_path / "sensor_2")
    assert ImportCalibrationCommand(tmp_path, tmp_path / "ours", json=True).run() == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["id"], found["mm_per_px"], found["crop_size"]) == ("sensor_2", 0.0511, [345, 460])
    assert ExportCalibrationCommand(tmp_path / "ours", tmp_path / "sensor_7", json=True).run() == 0
    assert all(Path(file).is_file() for file in json.loads(capsys.readouterr().out)["files"])
    (tmp_path / "ours" / "camera.toml").write_text("delay_ms = 20.0\nerror_ms = 1.0\n")
    assert ImportCalibrationCommand(tmp_path / "sensor_2", tmp_path / "ours", json=True).run() == 0
    assert "the delay of the camera" in (said := capsys.readouterr().err) and "was removed with the older" in said
