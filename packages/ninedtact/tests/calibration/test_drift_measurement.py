"""Motion and brightness of drawn skins whose change is known, and the sentences about them."""

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest

from ninedtact.calibration.board.board_fit import calibrated_area_mm
from ninedtact.calibration.brightness_change import BrightnessChange, different_skin_warnings
from ninedtact.calibration.drift.diagnosis import diagnose_drift
from ninedtact.calibration.drift.measurement import CalibratedReference, DriftMeasurement, measure_drift
from ninedtact.calibration.drift.reference_check import ReferenceImageChecker
from ninedtact.design import RectifiedImageSize, SensorDesign
from ninedtact.errors import InputError
from ninedtact.quantities import BgrImage, Frame, centred_axis_mm
from ninedtact.shape.depth import DepthCurve
from ninedtact.shape.lens_and_rectification import LensModel, rectification_of_projection
from ninedtact.shape.skin_identity import SkinMotion, measure_skin_motion

SIZE = RectifiedImageSize(150, 200, 64)
MM_PER_PX, RAW_PX_PER_MM = 0.1, 16.0
RAW_SHAPE = 240, 320
FLAT_LENS = LensModel(
    homography=(RAW_PX_PER_MM / 160, 0.0, 0.0, 0.0, RAW_PX_PER_MM / 160, 0.0, 0.0, 0.0),
    centre=(0.0, 0.0),
    radial=(0.0,),
    tangential=(0.0, 0.0),
    raw_shape=RAW_SHAPE,
)
CURVE = DepthCurve("ratio", (0.0, 0.3), (0.0, 1.8), (0.01, 0.01))
MM_PER_CHANGE = 6.0
SAME_SKIN = SkinMotion((0.0, 0.0), 0.0, 0.1, 0.02, correlation=0.9, contrast=2e-3)
SHAPE = SIZE.rows, SIZE.cols
X, Y = (axis.astype(float) for axis in np.meshgrid(*(centred_axis_mm(side, MM_PER_PX) for side in SHAPE[::-1])))


def texture(seed: int, shape: tuple[int, int] = RAW_SHAPE, contrast: float = 0.01) -> np.ndarray:
    """Brightness of a skin with specks, one on average."""
    specks = np.random.default_rng(seed).normal(0, 1, shape)
    fine = cv2.GaussianBlur(specks, (0, 0), 2.0)
    return np.asarray(1 + contrast * fine / fine.std())


def image_of(brightness: np.ndarray, seed: int = 0, grey: float = 150.0) -> BgrImage:
    """A raw image of skin with this brightness, with camera noise."""
    noise = np.random.default_rng(seed).normal(0, 0.5, brightness.shape)
    levels = np.clip(np.rint(grey * brightness + noise), 0, 255).astype(np.uint8)
    return np.repeat(levels[..., None], 3, axis=2)


@cache
def known() -> CalibratedReference:
    """A sensor that looks straight at its skin: 0.0625 mm for each pixel of the raw image."""
    design = replace(SensorDesign(), field_of_view=SIZE)
    rectify = rectification_of_projection(FLAT_LENS, SIZE, MM_PER_PX, RAW_SHAPE, calibrated_area_mm(design))
    return CalibratedReference(image_of(texture(0), 1), image_of(texture(0), 2), rectify, CURVE)


def unchanged(
    gain: float = 1.0, field: np.ndarray | float = 0.0, residue: np.ndarray | float = 0.0
) -> BrightnessChange:
    full = (np.broadcast_to(np.float32(part), SHAPE).copy() for part in (field, residue))
    return BrightnessChange(gain, *full, np.ones(SHAPE, bool), 1e-4, MM_PER_PX)


def drift(
    moved: SkinMotion = SAME_SKIN,
    nearest: SkinMotion = SAME_SKIN,
    flipped: str | None = None,
    change: BrightnessChange | None = None,
    colour: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> DriftMeasurement:
    return DriftMeasurement(known(), moved, nearest, flipped, change or unchanged(), colour, 0.123)


def names(measured: DriftMeasurement) -> list[str]:
    return [finding.diagnosis for finding in diagnose_drift(measured)]


def test_a_motion_is_stated_in_millimetres_of_the_skin_with_the_height_that_it_would_feign() -> None:
    assert known().mm_per_raw_px == pytest.approx(1 / RAW_PX_PER_MM, rel=1e-3)
    (finding,) = diagnose_drift(drift(moved=replace(SAME_SKIN, shift_px=(6.0, 8.0), turn_deg=-0.5)))
    assert "10.0 ± 0.1 px (0.62 mm) away and turned by -0.5°" in finding.sentence
    assert finding.height_mm is not None and 0.01 < finding.height_mm < 0.3
    (flipped,) = diagnose_drift(drift(flipped="mirrored left to right", change=unchanged(gain=0.5)))
    assert (flipped.diagnosis, flipped.height_mm) == ("image mirrored", 0.123)
    assert "the calibrated one mirrored left to right" in flipped.sentence


def places(*changes: tuple[float, float, float]) -> np.ndarray:
    """Squares of a millimetre with a change each."""
    residue = np.zeros(SHAPE)
    for x_mm, y_mm, change in changes:
        residue[(np.abs(X - x_mm) < 0.5) & (np.abs(Y - y_mm) < 0.5)] = change
    return residue


UNKNOWN = replace(SAME_SKIN, correlation=0.29)
FEATURELESS = replace(SAME_SKIN, correlation=0.0, contrast=6e-4)
PRESSED = np.where(np.hypot(X, Y) < 2, -0.1, np.where(np.hypot(X, Y) < 3, 0.05, 0.0))
PRESSED_ALL_OVER = np.where(np.abs(Y) < 2, -0.1, np.where(np.abs(Y) < 3, 0.05, 0.0))


def shifted(brightness: np.ndarray, x_px: float, y_px: float, clockwise_deg: float) -> np.ndarray:
    rows, cols = brightness.shape
    matrix = cv2.getRotationMatrix2D(((cols - 1) / 2, (rows - 1) / 2), -clockwise_deg, 1)
    matrix[:, 2] += x_px, y_px
    return np.asarray(
        cv2.warpAffine(brightness, matrix, (cols, rows), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_WRAP)
    )


@pytest.mark.parametrize(("x", "y", "turn"), [(1.3, -0.7, 0.4), (30.0, -17.0, 0.2)])
@pytest.mark.parametrize("scale", [1, 2])
def test_the_motion_of_a_drawn_skin_is_found_at_any_size(x: float, y: float, turn: float, scale: int) -> None:
    """The raw image may be larger than the size at which skins are compared; shifts are in its own pixels."""
    skin = texture(3, contrast=0.02)
    there = [cv2.resize(each, None, fx=scale, fy=scale) for each in (skin, shifted(skin, x, y, turn))]
    found = measure_skin_motion(image_of(there[0], 5), image_of(there[1], 6))
    allowed = 0.06 * scale
    assert np.subtract(found.shift_px, (x * scale, y * scale)) == pytest.approx((0, 0), abs=allowed + 0.002 * abs(x))
    assert found.turn_deg == pytest.approx(turn, abs=0.03)
    assert found.correlation > 0.8 and found.is_same_skin
    assert 0 < found.shift_error_px < 0.1 * scale and 0 < found.turn_error_deg < 0.05
    back = found.undone(image_of(there[1], 6))
    inside = np.s_[20 * scale : -20 * scale, 50 * scale : -50 * scale, 0]
    assert np.corrcoef(back[inside].ravel(), image_of(there[0], 7)[inside].ravel())[0, 1] > 0.9


def test_findings_state_where_how_much_and_the_height_that_they_would_feign() -> None:
    slope = -0.08 * (X + 0.01 * Y) / (X + 0.01 * Y).max()  # dimmest at the lower right, by 8 %
    findings = diagnose_drift(drift(change=unchanged(gain=1.1, field=slope), colour=(-0.1, 0.0, 0.1)))
    assert [finding.diagnosis for finding in findings] == ["light uneven", "gain changed", "light colour changed"]
    uneven, brighter, colour = findings
    assert "8.0% dimmer at (10, 7) mm" in uneven.sentence or "8.0% brighter at (-10, -7) mm" in uneven.sentence
    assert uneven.height_mm == pytest.approx(0.08 * MM_PER_CHANGE, rel=1e-4)
    assert "10.0% brighter" in brighter.sentence and brighter.height_mm == pytest.approx(0.1 * MM_PER_CHANGE, rel=1e-4)
    assert "blue -10.0%, green +0.0%, red +10.0%" in colour.sentence and colour.height_mm is None
    residue = np.zeros(SHAPE)
    for x_mm, y_mm, change in ((-5, 2, -0.04), (0, 0, 0.06), (5, 3, 0.03), (5, -3, 0.02)):
        residue[(np.abs(X - x_mm) < 0.5) & (np.abs(Y - y_mm) < 0.5)] = change
    (marks,) = diagnose_drift(drift(change=unchanged(residue=residue)))
    assert marks.diagnosis == "dirt or damage" and "changed in 4 places" in marks.sentence
    assert marks.sentence.count(" mm² at ") == 3 and " and 1 smaller;" in marks.sentence
    assert marks.height_mm == pytest.approx(0.06 * MM_PER_CHANGE, rel=1e-4)


@pytest.mark.parametrize(
    ("nearest", "flipped", "field", "residue", "found"),
    [
        (UNKNOWN, None, 0.0, 0.0, []),  # nothing has changed: the structure has faded at most
        (UNKNOWN, None, 0.2, 0.0, ["another sensor's gel"]),
        (UNKNOWN, None, 0.0, PRESSED, ["another sensor's gel"]),
        (UNKNOWN, None, 0.0, PRESSED_ALL_OVER, ["something touches the gel"]),
        (UNKNOWN, "turned by 180°", 0.0, PRESSED, ["image mirrored"]),
        (FEATURELESS, None, 0.0, PRESSED, ["something touches the gel"]),
        (FEATURELESS, None, 0.2, PRESSED, ["another sensor's gel"]),
        (FEATURELESS, None, 0.2, 0.0, ["light uneven"]),
        (SAME_SKIN, None, 0.2, PRESSED, ["something touches the gel"]),
    ],
)
def test_another_gel_is_told_from_a_press(
    nearest: SkinMotion, flipped: str | None, field: float, residue: np.ndarray | float, found: list[str]
) -> None:
    uneven = np.zeros(SHAPE)
    uneven[0, 0] = field
    measured = drift(nearest=nearest, flipped=flipped, change=unchanged(field=uneven, residue=residue))
    assert names(measured) == found


def test_the_motion_since_the_board_is_told_from_that_since_the_ball() -> None:
    today = image_of(texture(0), 4)
    board = replace(known(), lens_image=image_of(shifted(texture(0), 3, 0, 0), 8))
    after_board = measure_drift(board, today)
    assert after_board.moved.shift_px == pytest.approx((-3, 0), abs=0.1)
    assert after_board.nearest.shift_px == pytest.approx((0, 0), abs=0.1)
    other_lens = replace(known(), lens_image=image_of(texture(9), 8))  # a board that was photographed elsewhere
    assert measure_drift(other_lens, today).moved.shift_px == pytest.approx((0, 0), abs=0.1)


def test_a_reference_with_a_contact_or_of_another_sensor_is_refused_and_slow_changes_are_not() -> None:
    check = ReferenceImageChecker("small", known())
    untouched = texture(0)
    press = cv2.resize(1 + PRESSED, RAW_SHAPE[::-1])
    for brightness, fault in (
        (untouched, None),
        (0.8 * untouched, None),
        (shifted(untouched, 4, 0, 0), None),
        (untouched * press, "something touches the gel"),
        (texture(9) * (1 + 0.1 * np.linspace(-1, 1, RAW_SHAPE[1])), "another sensor's gel"),
        (untouched[:, ::-1], "image mirrored"),
    ):
        found = check.find_faults([Frame(image_of(brightness, 4)), Frame(image_of(brightness, 5))])
        assert [each.partition(":")[0] for each in found] == ([] if fault is None else [fault])
    with pytest.raises(InputError, match="show sensor small without contact, got a fault; something"):
        check.require_faultless([Frame(image_of(untouched * press, 4))])
    assert ReferenceImageChecker("imported", None).find_faults([Frame(image_of(untouched * press, 4))]) == ()


def test_two_skins_or_a_moved_camera_between_the_presses_are_warned_of() -> None:
    skin, before = texture(0), image_of(texture(0), 1)
    assert different_skin_warnings(before, image_of(0.9 * skin, 2)) == ()
    assert different_skin_warnings(before, image_of(shifted(skin, 0.4, 0.3, 0.0), 2)) == ()
    (moved,) = different_skin_warnings(before, image_of(shifted(skin, 2.4, -1.8, 0.5), 2))
    assert moved.startswith("the camera or the gel moved by 3.0 px and 0.5° between the presses of board and ball")
    (other,) = different_skin_warnings(before, image_of(texture(9), 2))
    assert "does not show the skin of the image before the board" in other and "pressed on two sensors" in other
    plain = np.ones(RAW_SHAPE)
    assert different_skin_warnings(image_of(plain, 1), image_of(plain, 2)) == ()  # too uniform to tell
    assert different_skin_warnings(before, image_of(texture(9)[:200], 2)) == ()
