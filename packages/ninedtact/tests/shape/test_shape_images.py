"""Images: right colours at right places, and something to see for every kind of height map."""

import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from skins import ball_print, skin, with_hole

from ninedtact.quantities import HeightSource
from ninedtact.shape.coloured_height_map import (
    ColourScale,
    colourise_heights,
    draw_height_map_figure,
    round_up_to_1_2_5,
)
from ninedtact.shape.relief_image import exaggeration, render_relief
from ninedtact.shape.relief_renderer import (
    AMBIENT,
    LIGHT,
    RayTracedGel,
    near_multiple_mask,
    shading,
    trace_rays_to_relief,
    viewpoint_framing_corners,
)


def extrapolated_bottom(height):
    source = height.source.copy()
    source[(height.z_mm < -1.5) & height.in_view] = HeightSource.EXTRAPOLATED
    return skin(height.z_mm, source, noise_mm=0.01)


def test_pressed_is_blue_bulging_is_red_untouched_is_pale_and_unseen_is_grey():
    source = np.full((1, 6), HeightSource.MEASURED, np.uint8)
    source[0, 5] = HeightSource.OUT_OF_VIEW
    z_mm = np.array([[-9, -1, 0, 0.25, 9, np.nan]])
    colours = colourise_heights(skin(z_mm, source), ColourScale(2.0, 0.5))[0].astype(int)
    np.testing.assert_array_equal(colourise_heights(skin(z_mm, source))[0], colours)  # the default scale
    blue, green, red = colours.T
    assert (blue[:2] > red[:2] + 40).all()
    assert (red[3:5] > blue[3:5] + 40).all()
    assert colours[2].min() > 235
    assert blue[5] == green[5] == red[5] < 200


@pytest.mark.parametrize("draw", [draw_height_map_figure, render_relief])
@pytest.mark.parametrize(
    "height",
    [
        extrapolated_bottom(with_hole(ball_print())),
        ball_print(121, 90),
        skin(np.zeros((20, 30))),
        skin(np.full((20, 30), np.nan), np.zeros((20, 30), np.uint8)),
        skin(np.zeros((2, 2))),
    ],
    ids=["all kinds", "portrait", "untouched", "unseen", "tiny"],
)
def test_every_height_map_gives_a_image(draw, height):
    image = cv2.imdecode(np.frombuffer(draw(height), np.uint8), cv2.IMREAD_COLOR)
    assert 800 <= image.shape[1] <= 1200
    assert image.std() > 5
    if height.source.min() == HeightSource.OUT_OF_VIEW < height.source.max():
        assert_looks_as_it_did(image, draw.__name__)


def assert_looks_as_it_did(image, name):
    """Compare with an image of the same press, both a tenth as large; who changes the design on purpose writes it anew."""
    path = Path(__file__).with_name("expected") / f"{name}.png"
    expected, small = cv2.imread(str(path)), cv2.resize(image, None, fx=0.1, fy=0.1, interpolation=cv2.INTER_AREA)
    assert small.shape == expected.shape
    difference = np.abs(small.astype(int) - expected)
    assert difference.max() <= 16 and difference.mean() < 0.3


def test_sight_meets_the_skin_where_the_viewpoint_projects_it():
    block = RayTracedGel(ball_print(61, 80).z_mm, 0.051, -3.0)
    view = viewpoint_framing_corners(block.corners, (10.0, 10.0), (290.0, 190.0))
    seen = trace_rays_to_relief(block, view, 200, 300)
    row, col = np.argwhere(seen.on_skin)[::97].T
    x, y = block.low[0] + seen.col * 0.051, block.low[1] + seen.row * 0.051
    points = np.stack([x, y, seen.z], axis=-1)[row, col].astype(float)
    np.testing.assert_allclose(view.project(points), np.column_stack([col, row]), atol=0.05)
    np.testing.assert_allclose(seen.z[row, col], block.at(seen.col, seen.row)[row, col], atol=0.01)


def test_a_viewpoint_shows_the_whole_block():
    corners = RayTracedGel(ball_print(61, 80).z_mm, 0.051, -3.0).corners.astype(float)
    x, y = viewpoint_framing_corners(corners, (10.0, 20.0), (290.0, 190.0)).project(corners).T
    assert 10 - 1e-6 <= x.min() < x.max() <= 290 + 1e-6
    assert 20 - 1e-6 <= y.min() < y.max() <= 190 + 1e-6


@pytest.mark.parametrize(("at_least", "expected"), [(0.3, 0.5), (0.5, 0.5), (1.01, 2.0), (7.0, 10.0), (0.06, 0.1)])
def test_round_numbers(at_least, expected):
    assert round_up_to_1_2_5(at_least) == pytest.approx(expected)


def test_importing_the_images_does_not_import_matplotlib():
    check = "import sys, ninedtact.shape.coloured_height_map, ninedtact.shape.relief_image; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", check], check=False).returncode == 0


@pytest.mark.parametrize(("by_x", "by_y"), [(0.0, 0.0), (0.4, 0.0), (-0.3, 0.5)])
def test_skin_is_as_bright_as_it_faces_the_light(by_x, by_y):
    y, x = np.mgrid[:6, :7].astype(np.float32) * 0.1
    normal = np.array([-by_x, -by_y, 1]) / np.sqrt(1 + by_x**2 + by_y**2)
    expected = AMBIENT + (1 - AMBIENT) * (normal @ LIGHT) / LIGHT[2]
    np.testing.assert_allclose(shading(RayTracedGel(by_x * x + by_y * y, 0.1, -1.0)), expected, rtol=1e-5)


def test_heights_are_exaggerated_to_an_eighth_of_the_length_and_noise_is_not():
    flat = np.zeros((100, 200))
    room_mm = 200 * 0.051 / 8
    for times in (1, 2, 5, 10, 20):
        dent = flat.copy()
        dent[50, 100], dent[20, 20] = -0.8 * room_mm / times * 0.99, 0.2 * room_mm / times * 0.99
        assert exaggeration(skin(dent)) == times
        dent[50, 100] *= 1.03
        assert exaggeration(skin(dent)) == {1: 1, 2: 1, 5: 2, 10: 5, 20: 10}[times]
    assert exaggeration(skin(flat, noise_mm=room_mm / 60 / 5 * 0.99)) == 5
    assert exaggeration(skin(flat, noise_mm=room_mm / 60 / 5 * 1.01)) == 2


def test_millimetre_lines_are_as_wide_as_they_are_drawn():
    axis = np.arange(-600, 601, dtype=np.float32) / 100
    for distance, width in ((1.0, 0.05), (5.0, 0.11)):
        near = np.abs(axis[:, None] - distance * np.arange(-6, 7)).min(axis=1) < width / 2
        np.testing.assert_array_equal(near_multiple_mask(axis, distance, width), near)
