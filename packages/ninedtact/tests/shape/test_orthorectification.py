"""Orthorectified heights, and the area that each pixel covers, against closed forms."""

import cv2
import numpy as np
import pytest
from skins import MM_PER_PX, ball_print, grid, plane, skin

from ninedtact.quantities import HeightMap, skin_grid_mm
from ninedtact.shape.orthorectification import (
    SkinGrid,
    find_pixels_of_skin_places,
    orthorectified_heights,
    orthorectify,
    sample_field,
)
from ninedtact.shape.surface import pixel_footprint_mm2


def by_bisection(seen: HeightMap) -> np.ndarray:
    return orthorectify(seen).z_mm


def by_iteration_on_the_map(seen: HeightMap) -> np.ndarray:
    place_mm, pitch_mm = np.stack(skin_grid_mm(seen.z_mm.shape, seen.mm_per_px)), (seen.mm_per_px, seen.mm_per_px)
    pixel = find_pixels_of_skin_places(seen.z_mm, pitch_mm, place_mm, seen.camera_distance_mm, iterations=12)
    return sample_field(seen.z_mm, pixel, cv2.INTER_LINEAR)


def on_a_grid(seen: HeightMap) -> np.ndarray:
    return orthorectified_heights(seen, SkinGrid(*seen.z_mm.shape, seen.mm_per_px))


@pytest.mark.parametrize("method", [by_bisection, by_iteration_on_the_map, on_a_grid])
@pytest.mark.parametrize("at", [(0.0, 0.0), (4.0, -3.0)])
def test_every_solver_finds_the_heights_that_a_far_camera_would_see(at, method):
    true = ball_print(at=at).z_mm
    found = method(ball_print(at=at, camera_mm=20.0))
    seen_off_mm, off_mm = (np.abs(z_mm - true).mean() for z_mm in (ball_print(at=at, camera_mm=20.0).z_mm, found))
    assert off_mm < 2e-3 and off_mm < 0.15 * seen_off_mm


def test_places_that_no_line_of_sight_reaches_are_out_of_view():
    straight = orthorectify(skin(np.full((41, 61), -1.0), camera_mm=4.0))
    x, y = grid(41, 61)
    reached = (np.abs(x) <= 30 * MM_PER_PX * 0.75) & (np.abs(y) <= 20 * MM_PER_PX * 0.75)
    assert (straight.in_view != reached).sum() <= 2 * (41 + 61)
    np.testing.assert_array_equal(straight.z_mm, -1)


def test_footprints_are_the_jacobian_of_places_by_pixels():
    height = plane(61, 80, 0.3, -0.2, camera_mm=10.0)
    spread = 1 + height.z_mm.astype(float) / 10
    x, y = (np.gradient(axis * spread) for axis in grid(61, 80))
    expected = x[1] * y[0] - x[0] * y[1]
    np.testing.assert_allclose(pixel_footprint_mm2(height)[1:-1, 1:-1], expected[1:-1, 1:-1], rtol=1e-4)
