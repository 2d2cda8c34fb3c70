"""Images: right colours at right places, and something to see for every kind of height map."""

import cv2
import numpy as np
import pytest
from skins import ball_print, plane, skin, with_hole

from ninedtact.quantities import HeightSource
from ninedtact.shape.coloured_height_map import (
    AMBIENT,
    TOWARDS_LIGHT,
    ColourScale,
    colourise_heights,
    draw_height_map_figure,
    facing_light,
    render_relief,
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


@pytest.mark.parametrize(("by_x", "by_y"), [(0.0, 0.0), (0.4, 0.0), (-0.3, 0.5)])
def test_skin_is_as_bright_as_it_faces_the_light(by_x, by_y):
    normal = np.array([-by_x, -by_y, 1]) / np.sqrt(1 + by_x**2 + by_y**2)
    expected = AMBIENT + (1 - AMBIENT) * (normal @ TOWARDS_LIGHT) / TOWARDS_LIGHT[2]
    slope = plane(6, 7, by_x, by_y)
    np.testing.assert_allclose(facing_light(slope.z_mm, slope.mm_per_px), expected, rtol=1e-5)
