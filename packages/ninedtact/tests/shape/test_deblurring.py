"""The point spread is undone: edges come back without ringing, smooth dents as they were, and what is uniform stays so."""

import cv2
import numpy as np
import pytest

from ninedtact.shape.deblurring import Deblurring, block_means, deconvolve_gaussian_blur, upsample

Y, X = np.mgrid[:90, :120].astype(np.float32)
SIGMA_PX, FLOOR = 2.0, 0.01


def blurred(field: np.ndarray) -> np.ndarray:
    return cv2.GaussianBlur(field.astype(np.float32), (25, 25), SIGMA_PX, borderType=cv2.BORDER_REFLECT)


def test_a_flat_print_comes_back_with_a_steeper_edge_and_without_ringing() -> None:
    disc = np.where(np.hypot(X - 60, Y - 45) < 15, -0.1, 0.0).astype(np.float32)
    seen = blurred(disc)
    sharp = deconvolve_gaussian_blur(seen, SIGMA_PX, FLOOR)
    assert sharp.min() > -0.11 and sharp.max() < 0.008
    off, before = (np.abs(field - disc).sum() for field in (sharp, seen))
    assert off < 0.6 * before
    np.testing.assert_allclose(deconvolve_gaussian_blur(seen.T.copy(), SIGMA_PX, FLOOR).T, sharp, atol=1e-3)


@pytest.mark.parametrize("place", [(60, 45), (0, 4)], ids=["inside", "at the border"])
def test_a_smooth_dent_comes_back_as_it_was(place: tuple[int, int]) -> None:
    dent = 1 - 0.2 * np.exp(-((X - place[0]) ** 2 + (Y - place[1]) ** 2) / (2 * 6.0**2))
    sharp = deconvolve_gaussian_blur(blurred(dent), SIGMA_PX, FLOOR)
    assert np.abs(blurred(dent) - dent).max() > 0.017 and np.abs(sharp - dent).max() < 0.014


@pytest.mark.parametrize(("rows", "cols"), [(240, 280), (241, 282)])
def test_the_coarser_grid_lies_where_the_image_does(rows: int, cols: int) -> None:
    slope = 1e-4 * np.add.outer(np.arange(rows), 2 * np.arange(cols)).astype(np.float32)
    deblurring = Deblurring(0.55)
    side = deblurring.coarseness(0.05)
    few = block_means(slope, side)
    assert side == 4 and few.shape == (-(-rows // side), -(-cols // side))
    again = upsample(deblurring(few, 0.05), slope.shape, side)
    assert again.shape == slope.shape and again.flags.c_contiguous
    inside = np.s_[90:-90, 90:-90]
    np.testing.assert_allclose(again[inside], slope[inside], atol=3e-4)
