"""What the browser draws is the skin: in mm, true to scale, in the colours of the map, and not too much of it."""

from dataclasses import replace

import numpy as np
import pytest
from skins import DEPTH_MM, MM_PER_PX, RADIUS_MM, ball_print, plane

from ninedtact.shape.coloured_height_map import ColourScale, colourise_heights
from ninedtact.shape.surface import summarise_shape
from ninedtact.studio.followed_object import FollowedObject, ObjectPath
from ninedtact.studio.page_cards import followed_object_html, shape_summary_html
from ninedtact.studio.reading_view import MAX_SURFACE_POINTS, skin_surface
from ninedtact.tracking import SlipEstimate, SlipState

SCALE = ColourScale(2.0, 0.5)


def test_points_are_where_the_skin_is_and_few_enough() -> None:
    height = ball_print(at=(1.0, -2.0), camera_mm=14.05)
    surface = skin_surface(height, colourise_heights(height, SCALE))
    points = surface.points_mm
    assert len(points) <= MAX_SURFACE_POINTS < 4 * len(points)
    assert surface.spacing_mm == pytest.approx(2 * MM_PER_PX)
    deepest = points[points[:, 2].argmin()]
    assert deepest == pytest.approx([1.0, -2.0, -DEPTH_MM], abs=0.1)
    assert deepest[2] == pytest.approx(height.z_mm.min(), abs=0.002)
    on_ball = points[points[:, 2] < -0.1]
    distance = np.linalg.norm(on_ball - [1.0, -2.0, RADIUS_MM - DEPTH_MM], axis=1)
    assert np.abs(distance - RADIUS_MM).max() < 1e-3


def test_triangles_face_outwards_and_join_neighbours() -> None:
    height = plane(120, 160, slope_x=0.2, slope_y=-0.1)
    surface = skin_surface(height, colourise_heights(height, SCALE))
    corners = surface.points_mm[surface.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    assert normals == pytest.approx(np.tile([-0.2, 0.1, 1] / np.sqrt(1.05), (len(normals), 1)), abs=1e-3)
    assert np.linalg.norm(np.diff(corners, axis=1), axis=2).max() < 1.6 * surface.spacing_mm


def test_a_press_deeper_than_the_curve_is_shown_as_a_lower_limit() -> None:
    usual, deeper = (
        shape_summary_html(summarise_shape(replace(ball_print(), is_clipped=is_clipped)), False)
        for is_clipped in (False, True)
    )
    assert "≥" not in usual and "lower limit" not in usual
    assert "≥ 1.90" in deeper and "is a lower limit" in deeper


def test_the_slip_lamp_says_how_much_sticks_and_is_out_where_nothing_touches() -> None:
    path = ObjectPath(np.array([[0.0, 0.0], [0.5, -0.1]]), np.radians(12.3), np.radians(0.5), 0.34)
    dark, lit = (
        followed_object_html(one, False)
        for one in (FollowedObject(), FollowedObject(0, SlipEstimate(SlipState.INCIPIENT), path))
    )
    assert "incipient" not in dark and dark.count("\N{EN DASH}") == 4 and 'color:transparent">&#9679;' in dark
    assert "color:transparent" not in lit
    for text in ("incipient", "&#9679;", "+0.50", "\N{MINUS SIGN}0.10", "+12.3 ± 0.5°", "34%"):
        assert text in lit
    assert "true" not in lit
