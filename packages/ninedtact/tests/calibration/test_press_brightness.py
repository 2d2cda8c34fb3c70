"""Closed forms of the brightness of calibration images and its noise, and which images are refused."""

import numpy as np
import pytest

from ninedtact.calibration.brightness_change import (
    flat_fielded_brightness_change,
    require_same_image_size,
    require_usable_exposure,
)
from ninedtact.errors import CalibrationError


def columns(*levels: float) -> np.ndarray:
    """An image with a column of each level."""
    return np.tile(np.array(levels, np.uint8)[:, None], (5, 1, 3))


def test_a_change_is_that_under_uniform_light() -> None:
    change = flat_fielded_brightness_change(columns(200, 100, 60), columns(100, 150, 30))
    np.testing.assert_allclose(change, np.tile([-60, 60, -60], (5, 1)), rtol=1e-5)  # by half of 120, the mean


def test_dark_and_overexposed_images_and_two_sizes_are_refused() -> None:
    require_usable_exposure("ball image", columns(250, *[120] * 9))
    for levels, remedy in (([5], "switch the sensor's light on"), ([250, 250, 120], "lower exposure or gain")):
        with pytest.raises(CalibrationError, match=f"for the ball image, got .*; {remedy}"):
            require_usable_exposure("ball image", columns(*levels))
    require_same_image_size("board image", columns(1, 2), columns(3, 4))
    with pytest.raises(CalibrationError, match=r"the board image and its reference .* got 3x5 and 2x5"):
        require_same_image_size("board image", columns(1, 2), columns(3, 4, 5))
