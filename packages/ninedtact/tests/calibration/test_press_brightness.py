"""Closed forms of the brightness of calibration images, and which images are refused."""

import numpy as np
import pytest

from ninedtact.calibration.brightness_change import (
    ImageUnusable,
    estimate_camera_noise,
    estimate_pixel_noise,
    find_exposure_fault,
    flat_fielded_brightness_change,
    relative_brightness,
    require_same_image_size,
    require_usable_exposure,
    smooth_gaussian,
)
from ninedtact.quantities import Rectified
from ninedtact.shape.lens_and_rectification import to_grey_float


def columns(*levels: float) -> np.ndarray:
    """An image with a column of each level."""
    return np.tile(np.array(levels, np.uint8)[:, None], (5, 1, 3))


def test_a_change_is_relative_and_in_levels_of_uniform_light() -> None:
    before, after = columns(200, 100, 10, 4, 0), columns(100, 150, 5, 8, 8)
    np.testing.assert_array_equal(to_grey_float(before)[0], [200, 100, 10, 4, 0])
    change = flat_fielded_brightness_change(before, after)
    expected = np.array([-0.5, 0.5, -0.5, 4 / 8, 1]) * 62.8  # black pixels count as 8 grey levels
    np.testing.assert_allclose(change, np.tile(expected, (5, 1)), rtol=1e-5)
    grey = [Rectified(np.array([[level, 0.5]], np.float32), 0.1) for level in (30, 120)]
    np.testing.assert_allclose(relative_brightness(*grey), [[0.25, 0.5]])
    np.testing.assert_allclose(relative_brightness(*grey[::-1]), [[4.0, 0.5]])


def test_the_noise_of_a_pixel_is_found_beside_smooth_content() -> None:
    y, x = np.mgrid[:200, :300]
    smooth = 40 * np.sin(x / 60) + 0.3 * y
    noisy = (smooth + np.random.default_rng(0).normal(0, 2, smooth.shape)).astype(np.float32)
    assert estimate_pixel_noise(noisy) == pytest.approx(2, rel=0.02)
    assert estimate_camera_noise(noisy) == pytest.approx(2 / np.sqrt(2), rel=0.02)
    assert estimate_pixel_noise(smooth.astype(np.float32)) == 0.1


@pytest.mark.parametrize(
    ("levels", "kind"),
    [
        ([15.0] * 10, None),
        ([14.0] * 10, "dark"),
        ([250, 250, *[120] * 8], None),
        ([250, 250, 250, *[120] * 8], "overexposed"),
        ([249] * 10, None),
    ],
)
def test_an_image_is_lit_and_at_most_a_fifth_of_it_overexposed(levels: list[float], kind: str | None) -> None:
    fault = find_exposure_fault(columns(*levels))
    assert (fault and fault.kind) == kind
    if kind is None:
        require_usable_exposure("image", columns(*levels))
    else:
        with pytest.raises(ImageUnusable, match="for the ball image, got"):
            require_usable_exposure("ball image", columns(*levels))


def test_images_of_two_sizes_are_refused_with_both() -> None:
    require_same_image_size("board image", columns(1, 2), columns(3, 4))
    with pytest.raises(ImageUnusable, match=r"the board image and its reference .* got 3x5 and 2x5"):
        require_same_image_size("board image", columns(1, 2), columns(3, 4, 5))


def test_the_border_is_repeated_by_smoothing() -> None:
    image = np.repeat([[1.0, 1.0, 5.0, 5.0]], 3, axis=0).astype(np.float32)
    smooth = smooth_gaussian(image, 0.6)
    assert smooth[:, 0] == pytest.approx(1, abs=0.2) and smooth[0].sum() == pytest.approx(12)
