"""What a folder of the original project may hold, from both sides of each limit."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ninedtact.calibration.original_9dtact import folder_format
from ninedtact.calibration.original_9dtact.folder_format import (
    OriginalCalibration,
    OriginalFolderDamaged,
    find_original_sensor_folder,
    read_original_calibration,
    write_original_calibration,
)
from ninedtact.design import RectifiedImageSize
from ninedtact.shape.rectification import OUT_OF_VIEW_PX

VIEW = RectifiedImageSize(30, 40)
ROWS, COLS = np.mgrid[:60, :80].astype(np.int32)
DEPTHS = 0.03 * np.arange(51)
GOOD = OriginalCalibration(ROWS, COLS, np.array([30.0, 40.0, 0.05]), DEPTHS)


def refusal(
    folder: Path, thickness_mm: float = 2.5, view: RectifiedImageSize = VIEW, **changed: np.ndarray
) -> str | None:
    """The sentence with which a folder is refused, None where it is read as it was written."""
    written = replace(GOOD, **changed)
    write_original_calibration(folder, written)
    try:
        found = read_original_calibration(folder, view, thickness_mm)
    except OriginalFolderDamaged as error:
        return str(error)
    for name, values in vars(written).items():
        np.testing.assert_array_equal(getattr(found, name), values)
    return None


@pytest.mark.parametrize(
    ("depths", "words"),
    [
        (DEPTHS, None),
        (0.0041 * np.arange(256), None),
        (0.0039 * np.arange(256), "about 0.03 mm more"),
        (0.24 * np.arange(10), None),
        (0.285 * np.arange(9), "about 0.03 mm more"),
        (0.009 * np.arange(257), "up to 256 grey levels"),
        (0 * DEPTHS, "of which 0 are depths"),
        (np.r_[0, 0, 0, DEPTHS[3:]], None),
        (np.r_[0, -0.01, DEPTHS[2:]], "none below zero"),
        (np.r_[-9.0, DEPTHS[1:]], None),  # the first number is never used
        (DEPTHS + 0.12 * (np.arange(51) % 2), None),
        (DEPTHS + 0.3 * (np.arange(51) % 2), "list that is 0.1"),
        (np.where(np.abs(np.arange(51) - 32) < 3, 0, DEPTHS), None),  # levels without a depth
        (np.r_[0, np.tile([0.9, 0.1], 15), np.linspace(1.01, 1.5, 20)], "rise with the darkening"),
    ],
)
def test_depths_rise_by_a_possible_slope(depths: np.ndarray, words: str | None, tmp_path: Path) -> None:
    found = refusal(tmp_path, pixel_to_depth_mm=depths)
    assert (found is None) == (words is None) and str(words) in str(found)


@pytest.mark.parametrize(("thickness_mm", "refused"), [(1.5, False), (1.49, True)])
def test_no_depth_is_beyond_the_gel(thickness_mm: float, refused: bool, tmp_path: Path) -> None:
    found = refusal(tmp_path, thickness_mm)
    assert bool(found and "up to the gel's thickness" in found) == refused


@pytest.mark.parametrize(
    ("scale", "refused"), [(0.0051, False), (0.005, True), (0.99, False), (1.0, True), (20.0, True)]
)
def test_the_scale_is_mm_per_pixel(scale: float, refused: bool, tmp_path: Path) -> None:
    found = refusal(tmp_path, position_scale=np.array([30.0, 40.0, scale]))
    assert bool(found and "if that is pixels" in found) == refused


@pytest.mark.parametrize(
    ("centre", "inside"),
    [
        ((15, 20), True),
        ((45, 60), True),
        ((14.9, 20), False),
        ((15, 19.9), False),
        ((45.1, 60), False),
        ((45, 60.1), False),
    ],
)
def test_the_crop_lies_inside_the_maps(centre: tuple[float, float], inside: bool, tmp_path: Path) -> None:
    found = refusal(tmp_path, position_scale=np.array([*centre, 0.05]))
    assert (found is None) == inside and (inside or "a crop of 30 x 40" in str(found))


def test_a_map_rises_at_about_the_same_rate_everywhere(tmp_path: Path) -> None:
    turned = {"row_index": 59 - ROWS, "col_index": 79 - COLS}  # by half a turn: not mirrored
    for changed, words in (
        (turned, None),
        ({"row_index": 59 - ROWS}, "mirrored"),
        ({"row_index": np.minimum(ROWS, 36)}, "smooth maps"),  # eight rows show one line
        ({"col_index": np.where(COLS % 40 == 0, 0, COLS)}, "smooth maps"),  # one column jumps, there and back
    ):
        found = refusal(tmp_path, **changed)
        assert (found is None) == (words is None) and str(words) in str(found)


@pytest.mark.parametrize(("slow", "refused"), [(0.2, False), (0.1, True)])
def test_a_lens_shows_no_place_far_smaller_than_most(slow: float, refused: bool, tmp_path: Path) -> None:
    rows = np.minimum(ROWS, np.rint(36 + slow * (ROWS - 36))).astype(np.int32)
    assert bool("smooth maps" in str(refusal(tmp_path, row_index=rows))) == refused


@pytest.mark.parametrize(("off", "refused"), [(8, False), (9, True)])
def test_the_central_pin_stays_in_place(off: int, refused: bool, tmp_path: Path) -> None:
    for axis, map_ in (("row_index", ROWS), ("col_index", COLS)):
        found = refusal(tmp_path, **{axis: np.clip(map_ - off, 0, None)})
        assert bool(found and "leave the central pin at row 30, column 40" in found) == refused


@pytest.mark.parametrize(("value", "refused"), [(-1, True), (0, False), (59, False), (60, True)])
def test_rows_are_those_of_the_image(value: int, refused: bool, tmp_path: Path) -> None:
    rows = ROWS.copy()
    rows[0, 0] = value
    found = refusal(tmp_path, row_index=rows)
    assert bool(found and "expected pixels 0 to 59" in found) == refused
    folder_format.write_npy(tmp_path / folder_format.ROW_INDEX, ROWS[:, :-1])
    with pytest.raises(OriginalFolderDamaged, match="of one size"):
        read_original_calibration(tmp_path, VIEW, 2.5)


def test_pixels_without_a_source_are_out_of_view() -> None:
    rows, cols = ROWS.copy(), COLS.copy()
    rows[20, 25] = cols[20, 25] = rows[21, 25] = cols[22, 25] = 0
    calibration = replace(GOOD, row_index=rows, col_index=cols, position_scale=np.array([30.7, 40.2, 0.05]))
    assert calibration.start(VIEW) == (15, 20) and calibration.mm_per_px == 0.05
    source = calibration.source_px(VIEW)
    assert source.shape == (30, 40, 2) and source[5, 5].tolist() == [OUT_OF_VIEW_PX] * 2
    assert source[6, 5].tolist() == [25, 0] and source[7, 5].tolist() == [0, 22]  # the borders of the image are seen
    assert source[0, 1].tolist() == [21, 15] and source[-1, -1].tolist() == [59, 44]


def test_the_only_sensor_in_a_folder_is_meant(tmp_path: Path) -> None:
    for name in ("sensor_1", "sensor_not this", "another_1"):
        (tmp_path / name).mkdir()
    (tmp_path / "sensor_2").write_bytes(b"")
    assert find_original_sensor_folder(tmp_path, ["here.npy"]) == tmp_path / "sensor_1"
    (tmp_path / "here.npy").write_bytes(b"")
    assert find_original_sensor_folder(tmp_path, ["there.npy", "here.npy"]) == tmp_path
    with pytest.raises(OriginalFolderDamaged, match="got none"):
        find_original_sensor_folder(tmp_path / "sensor_1", ["here.npy"])


def test_a_file_holds_one_array_of_numbers(tmp_path: Path) -> None:
    np.savez(tmp_path / "several.npz", numbers=np.arange(3.0))
    (tmp_path / "several.npz").rename(tmp_path / "several.npy")
    folder_format.write_npy(tmp_path / "new" / "folder" / "flags.npy", np.ones(3, bool))
    folder_format.write_npy(tmp_path / "new" / "folder" / "whole.npy", np.arange(3, dtype=np.uint8))
    for name in ("several.npy", "new/folder/flags.npy"):
        with pytest.raises(OriginalFolderDamaged, match="an array of numbers"):
            folder_format.read_finite_npy(tmp_path / name, 1)
    assert folder_format.read_finite_npy(tmp_path / "new" / "folder" / "whole.npy", 1).tolist() == [0, 1, 2]
    with pytest.raises(ValueError, match="Object arrays"):
        folder_format.write_npy(tmp_path / "objects.npy", np.array([{}, 1]))
