"""The rectified image is the raw one sampled where the lens says, and it says what it cannot see."""

import numpy as np
import pytest
from scipy import ndimage

from ninedtact.design import RectifiedImageSize
from ninedtact.quantities import Frame, HeightSource
from ninedtact.shape.lens_and_rectification import (
    LensModel,
    PixelNotOnSkin,
    Rectification,
    central_mm_per_px,
    rectification_of_projection,
)

LENS = LensModel(
    (0.059, -0.0003, 0.025, 0.0002, 0.059, 0.0005, 0.0005, -0.0008),
    (0.04, -0.01),
    (1.16, -1.5, 0.82),
    (-0.004, 0.003),
    (480, 640),
)
SCALE = central_mm_per_px(LENS, 2.5)
RAW = np.random.default_rng(0).integers(0, 255, (480, 640, 3), np.uint8)


def made(rows: int = 345, cols: int = 460, mm_per_px: float = SCALE) -> Rectification:
    return rectification_of_projection(
        LENS, RectifiedImageSize(rows, cols), mm_per_px, (480, 640), (-12.5, 12.5, -10.0, 10.0)
    )


@pytest.mark.parametrize("shape", [(345, 460), (344, 459), (121, 160)])
def test_brightness_comes_from_where_the_lens_says(shape: tuple[int, int]) -> None:
    rectify = made(*shape)
    grey = rectify(Frame(RAW)).grey
    raw = RAW @ np.array([0.114, 0.587, 0.299])
    expected = ndimage.map_coordinates(raw, np.moveaxis(rectify.source_px, -1, 0)[::-1], order=1, mode="nearest")
    seen = rectify.height_source != HeightSource.OUT_OF_VIEW
    # Grey is rounded to whole levels before it is resampled, and OpenCV's weights have steps of 1/32 pixel.
    assert np.abs(grey - expected)[seen].max() < 8
    assert np.abs(grey - expected)[seen].mean() < 0.8


def test_results_share_no_memory() -> None:
    rectify = made()
    first = rectify(Frame(RAW)).grey
    kept = first.copy()
    rectify(Frame(RAW[::-1].copy()))
    assert np.array_equal(first, kept)


def test_the_lens_backwards_is_the_lens() -> None:
    points = np.random.default_rng(1).uniform([-11, -8.5], [11, 8.5], (500, 2))
    assert LENS.to_mm(LENS.to_px(points)) == pytest.approx(points, abs=1e-6)
    with pytest.raises(PixelNotOnSkin):
        LENS.to_mm(np.array([[1e7, 1e7]]))


def test_derivatives_of_the_lens_are_those_of_difference_quotients() -> None:
    points, base, step = np.random.default_rng(2).uniform([-11, -8.5], [11, 8.5], (50, 2)), LENS.parameters, 1e-5
    by_point = [(LENS.to_px(points + d) - LENS.to_px(points - d)) / (2 * step) for d in np.eye(2) * step]
    assert LENS.px_per_mm(points) == pytest.approx(np.stack(by_point, axis=-1), abs=1e-5)
    lenses = [(LENS.with_parameters(base + d), LENS.with_parameters(base - d)) for d in np.eye(len(base)) * step]
    by_parameter = [(more.to_px(points) - less.to_px(points)) / (2 * step) for more, less in lenses]
    assert LENS.px_per_parameter(points) == pytest.approx(np.stack(by_parameter, axis=-1), rel=1e-4, abs=1e-2)
