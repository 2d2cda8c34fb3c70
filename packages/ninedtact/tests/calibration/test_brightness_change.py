"""A change of brightness is separated into light and marks, on fields whose parts are known."""

import numpy as np
import pytest

from ninedtact.calibration.brightness_change import BrightnessChange, separate_brightness_change
from ninedtact.quantities import Rectified, centred_axis_mm

SHAPE, MM_PER_PX = (172, 230), 0.104
X, Y = (axis.astype(float) for axis in np.meshgrid(*(centred_axis_mm(side, MM_PER_PX) for side in SHAPE[::-1])))
SEEN = np.ones(SHAPE, bool)


def spot(x_mm: float, y_mm: float, change: float, radius_mm: float) -> np.ndarray:
    """A change of brightness with soft borders."""
    return change * np.exp(-((((X - x_mm) ** 2 + (Y - y_mm) ** 2) / radius_mm**2) ** 2))


def change_of(factor: np.ndarray, noise: float = 1e-4, seen: np.ndarray = SEEN) -> BrightnessChange:
    """The change of skin with an uneven light by a factor."""
    then = 150 - 0.3 * (X**2 + Y**2)
    images = (Rectified(grey.astype(np.float32), MM_PER_PX) for grey in (then, then * factor))
    return separate_brightness_change(*images, seen, noise)


def test_light_is_gain_and_a_smooth_field_and_leaves_no_mark() -> None:
    change = change_of(0.9 * (1 + 0.004 * X))
    assert change.gain == pytest.approx(0.9, rel=1e-3)
    assert change.unevenness == pytest.approx(0.004 * X.max(), rel=0.03)
    np.testing.assert_allclose(change.field, 0.004 * X, atol=2e-3)
    assert np.abs(change.residue).max() < 2e-3 and change.marks == () and change.contact is None
    assert change.changed_share == 0 == change.changed_area_mm2
    assert change.noise == pytest.approx(1e-4 / (2 * np.sqrt(np.pi) * 0.15 / MM_PER_PX))


def test_marks_have_their_place_area_and_change_the_largest_first() -> None:
    change = change_of(1.05 * (1 + spot(-4, 2, -0.08, 0.8) + spot(5, -3, 0.06, 1.2)))
    bright, dark = change.marks
    assert (bright.x_mm, bright.y_mm) == pytest.approx((5, -3), abs=0.03)
    assert (dark.x_mm, dark.y_mm) == pytest.approx((-4, 2), abs=0.03)
    assert bright.change == pytest.approx(0.06, rel=0.05) and dark.change == pytest.approx(-0.08, rel=0.05)
    for mark, radius_mm in ((bright, 1.2), (dark, 0.8)):
        edge = np.sqrt(np.log(abs(mark.change) / change.mark_level)) ** 0.5 * radius_mm
        assert mark.area_mm2 == pytest.approx(np.pi * edge**2, rel=0.12)
    assert change.changed_area_mm2 == bright.area_mm2 + dark.area_mm2
    assert change.changed_share == pytest.approx(change.changed_area_mm2 / SEEN.size / MM_PER_PX**2, rel=1e-6)
    assert change.gain == pytest.approx(1.05, rel=2e-3) and change.unevenness < 5e-3


def plain(residue: np.ndarray, field: float = 0.0, noise: float = 0.0) -> BrightnessChange:
    return BrightnessChange(1.0, np.full(SHAPE, field, np.float32), residue.astype(np.float32), SEEN, noise, MM_PER_PX)


@pytest.mark.parametrize(("rim", "is_contact"), [(0.0, False), (0.005, False), (0.03, True)])
def test_pressed_skin_is_dark_with_a_bright_rim_and_a_stain_is_not(rim: float, is_contact: bool) -> None:
    distance = np.hypot(X - 1, Y + 2)
    residue = np.where(distance < 1.5, -0.06, np.where(distance < 2.5, rim, 0.0))
    contact = plain(residue).contact
    assert (contact is not None) == is_contact
    if contact is not None:
        assert (contact.x_mm, contact.y_mm) == pytest.approx((1, -2), abs=0.02)
        assert contact.area_mm2 == pytest.approx(np.pi * 1.5**2, rel=0.02)
        assert contact.change == pytest.approx(-0.06)
