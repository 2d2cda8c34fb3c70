"""The numbers of one height map against closed forms."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from skins import DEPTH_MM, RADIUS_MM, ball_print, grid, skin

from ninedtact.shape.coloured_height_map import shape_summary_sentence
from ninedtact.shape.surface import contact_mask, relief_of_deepest_patch_mm, summarise_shape


@pytest.mark.parametrize("camera_mm", [np.inf, 20.0])
def test_the_print_of_a_ball_measures_as_a_spherical_cap(camera_mm):
    height = ball_print(at=(1.5, -1.0), camera_mm=camera_mm)
    summary = summarise_shape(height, touched=height.z_mm < 0)
    assert summary.max_indentation_mm == pytest.approx(DEPTH_MM - 0.003, abs=1e-3)  # a mean over 0.4 mm
    assert summary.contact_area_mm2 == pytest.approx(np.pi * DEPTH_MM * (2 * RADIUS_MM - DEPTH_MM), rel=4e-3)
    assert summary.displaced_volume_mm3 == pytest.approx(np.pi * DEPTH_MM**2 * (RADIUS_MM - DEPTH_MM / 3), rel=1e-3)
    assert summary.contact_centre_mm == pytest.approx((1.5, -1.0), abs=2e-3)
    assert summary.max_bulge_mm == 0


@pytest.mark.parametrize("scale_mm", [0.3, 0.5])
def test_relief_of_a_ball_grows_with_the_square_of_the_scale_and_that_of_ridges_is_what_a_blur_leaves(scale_mm):
    ball = ball_print(at=(1.5, -1.0))
    assert relief_of_deepest_patch_mm(ball, scale_mm) == pytest.approx(scale_mm**2 / RADIUS_MM, rel=0.06)
    (x, _), wave_mm = grid(345, 460), 1.6
    ridges = skin(0.1 * np.cos(2 * np.pi * x / wave_mm) - 0.5)
    left = np.exp(-2 * (np.pi * scale_mm / wave_mm) ** 2)
    assert relief_of_deepest_patch_mm(ridges, scale_mm) == pytest.approx(0.1 * (1 - left), rel=0.12)


def test_noise_alone_is_no_contact_and_displaces_nothing():
    noise = np.random.default_rng(0).normal(0, 0.02, (345, 460))
    summary = summarise_shape(skin(noise, noise_mm=0.02))
    assert summary.contact_threshold_mm == pytest.approx(0.1)
    assert summary.contact_area_mm2 == summary.displaced_volume_mm3 == 0
    assert summary.contact_centre_mm is None


def test_a_loss_of_light_far_from_a_deep_press_is_no_contact_but_a_second_press_is():
    print_alone = ball_print(at=(-5.0, 0.0))
    two = np.minimum(print_alone.z_mm, ball_print(at=(6.0, 0.0)).z_mm * 0.5)
    dimmed = two.copy()
    dimmed[:40, :] -= 0.15 * DEPTH_MM
    assert summarise_shape(skin(dimmed)).contact_area_mm2 == pytest.approx(
        summarise_shape(skin(two)).contact_area_mm2, rel=1e-3
    )
    assert summarise_shape(skin(two)).contact_area_mm2 > 1.9 * summarise_shape(print_alone).contact_area_mm2


@pytest.mark.parametrize("half_px", [6, 60, 400])
def test_a_flat_face_of_any_size_is_in_contact_to_its_edge(half_px: int) -> None:
    rows, cols = np.indices((345, 460))
    inside = (np.abs(rows - 172) <= half_px) & (np.abs(cols - 230) <= half_px)
    noise = np.random.default_rng(0).normal(0, 0.01, inside.shape)
    found = contact_mask(skin(-0.8 * inside + noise, noise_mm=0.01))
    off_px = 4  # the edges are found on blocks of 0.2 mm
    deep_inside = (np.abs(rows - 172) <= half_px - off_px) & (np.abs(cols - 230) <= half_px - off_px)
    assert found[deep_inside].all() and not found[cv2.dilate(inside.astype(np.uint8), np.ones((9, 9))) == 0].any()


@pytest.mark.parametrize("touched_mm", [0.06, 0.8])
def test_a_wide_slope_beside_a_contact_is_no_contact(touched_mm: float) -> None:
    x, y = grid(345, 460)
    dragged_mm = 0.3 * np.clip(-x, 0, 6) / 6 * np.exp(-((y / 4) ** 2)) * (x > -9)
    dent_mm = np.maximum(touched_mm - (x**2 + y**2) / 8, 0)
    alone, both = (contact_mask(skin(-each)) for each in (dent_mm, np.maximum(dent_mm, touched_mm / 2 * dragged_mm)))
    assert both.sum() == pytest.approx(alone.sum(), rel=0.1) and alone.any()


@pytest.mark.parametrize(("deepest_mm", "touches"), [(0.04, False), (1.0, True)])
def test_a_depth_beyond_the_curve_is_a_lower_limit_with_and_without_contact(deepest_mm: float, touches: bool) -> None:
    z_mm = np.zeros((20, 30))
    z_mm[5:9, 5:9] = -deepest_mm
    for is_clipped in (False, True):
        summary = summarise_shape(replace(skin(z_mm), is_clipped=is_clipped))
        assert summary.is_deepest_clipped == is_clipped and (summary.contact_area_mm2 > 0) == touches
        assert ("lower limit" in str(summary.warnings)) == is_clipped
        sentence = shape_summary_sentence(summary)
        assert ("at least" in sentence) == is_clipped and ("no contact" in sentence) == (not touches and not is_clipped)
