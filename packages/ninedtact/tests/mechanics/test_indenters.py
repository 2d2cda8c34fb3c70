"""Undersides in closed form and on grids of heights, at their ends too, and where a tilted one is searched."""

import numpy as np
import pytest
from gels import SMALL
from hypothesis import given, settings
from hypothesis import strategies as st

from ninedtact.design import DesignImpossible
from ninedtact.mechanics.height_grid_indenter import HeightGridIndenter, indenter_from_heights
from ninedtact.mechanics.indenter import (
    _TILT_DRIFT_MM,
    _TILT_REACH_MM,
    NO_OBJECT_MM,
    Ball,
    Cone,
    Ellipsoid,
    FlatPunch,
    Indenter,
    LyingCylinder,
    _search_height_fractions,
)
from ninedtact.mechanics.pose import Pose

CONE = Cone(slope_rad=np.pi / 4, tip_radius_mm=1.0, radius_mm=3.0)
TIP_MM = np.sqrt(0.5)
HEIGHTS = [
    (Ball(2.0), (0.0, 0.0), 0.0),
    (Ball(2.0), (1.2, 0.0), 0.4),
    (Ball(2.0), (0.0, 1.999), 2 - np.sqrt(4 - 1.999**2)),
    (Ball(2.0), (1.5, 1.5), NO_OBJECT_MM),
    (Ellipsoid(5.0, 2.5, 1.0), (3.0, 0.0), 0.2),
    (Ellipsoid(5.0, 2.5, 1.0), (0.0, 1.5), 0.2),
    (Ellipsoid(5.0, 2.5, 1.0), (4.0, 2.0), NO_OBJECT_MM),
    (LyingCylinder(2.0, 6.0), (2.99, 1.2), 0.4),
    (LyingCylinder(2.0, 6.0), (-3.0, 0.0), 0.0),
    (LyingCylinder(2.0, 6.0), (3.01, 0.0), NO_OBJECT_MM),
    (LyingCylinder(2.0, 6.0), (0.0, 2.01), NO_OBJECT_MM),
    (CONE, (0.0, 0.6), 0.2),
    (CONE, (0.6, -0.8), 1 - np.sqrt(2) + 1.0),
    (CONE, (TIP_MM, 0.0), 1 - TIP_MM),
    (CONE, (3.0, 0.0), 4 - np.sqrt(2)),
    (CONE, (3.01, 0.0), NO_OBJECT_MM),
    (FlatPunch(3.0, 0.5), (1.5, 2.0), 0.0),
    (FlatPunch(3.0, 0.5), (2.8, 0.0), 0.1),
    (FlatPunch(3.0, 0.5), (0.0, 3.01), NO_OBJECT_MM),
]


@pytest.mark.parametrize(("indenter", "at_mm", "height_mm"), HEIGHTS, ids=lambda value: getattr(value, "name", None))
def test_an_underside_has_its_height_up_to_its_end(
    indenter: Indenter, at_mm: tuple[float, float], height_mm: float
) -> None:
    found = indenter.underside_mm(*(np.full((1, 1), each) for each in at_mm))
    assert found == pytest.approx(height_mm, abs=1e-9)


@pytest.mark.parametrize("wrong", [0.0, -1.0])
def test_dimensions_are_above_zero_and_fit_together(wrong: float) -> None:
    for make in (Ball, Ellipsoid, LyingCylinder, Cone, FlatPunch):
        with pytest.raises(DesignImpossible):
            make(wrong)
    for make, values in ((LyingCylinder, (1.0, wrong)), (FlatPunch, (0.5, 0.5)), (Cone, (np.pi / 2, 0.5, 5.0))):
        with pytest.raises(DesignImpossible):
            make(*values)


def test_a_grid_of_heights_is_bilinear_between_samples_and_walled_at_its_ends() -> None:
    rows, cols = np.mgrid[:3, :4].astype(float)
    grid = indenter_from_heights("ramp", 0.1 * cols + 0.3 * rows + 5.0, 0.5)
    assert grid.size_mm == (2.0, 1.5)
    x, y = (np.array([each]) for each in ([-0.75, 0.0, 0.3, 0.75, 0.75, 1.25], [-0.5, 0.0, 0.2, 0.5, 0.75, 0.0]))
    expected = [0.0, 0.45, 0.3 * 1.4 + 0.1 * 2.1, 0.9, (0.9 + NO_OBJECT_MM) / 2, NO_OBJECT_MM]
    np.testing.assert_allclose(grid.underside_mm(x, y)[0], expected, atol=1e-9)


@pytest.mark.parametrize("slope", [0.0, 0.05, 0.3, 0.9])
def test_a_tilted_object_is_searched_so_closely_that_it_hardly_drifts_aside(slope: float) -> None:
    fractions = _search_height_fractions(slope)
    heights = _TILT_REACH_MM * fractions**2
    assert (heights[0], heights[-1]) == (0, _TILT_REACH_MM)
    drift = slope * np.diff(heights).max()
    assert drift <= _TILT_DRIFT_MM
    assert len(fractions) == 3 or drift > 0.8 * _TILT_DRIFT_MM * (1 - 3 / len(fractions))
    both = _search_height_fractions(np.array([slope, 1.0]))
    assert both.shape == (len(_search_height_fractions(1.0)), 2)
    np.testing.assert_array_equal(both[: len(fractions), 0], fractions)
    assert (both[len(fractions) :, 0] == 1).all()


def test_a_tilted_ball_is_the_ball_about_its_lowest_point() -> None:
    ball, pose = Ball(3.0), Pose(0.4, -0.2, 0.5, 0.3, 0.15, -0.1)
    x, y = (np.array([[*side]]) for side in ([0.4, 1.0, -0.7, 2.0], [-0.2, 0.3, -1.0, 1.1]))
    centre = pose.origin_mm + pose.rotation @ [0, 0, 3.0]
    expected = centre[2] - np.sqrt(9 - (x - centre[0]) ** 2 - (y - centre[1]) ** 2)
    np.testing.assert_allclose(ball.height_over_skin_mm(pose, x, y), expected, atol=1e-6)


@settings(max_examples=10, deadline=None)
@given(st.floats(-0.4, 0.4), st.floats(-0.4, 0.4), st.floats(-3, 3))
def test_only_the_lines_near_a_tilted_object_need_a_search(tilt_x, tilt_y, twist):
    ridge = np.full((9, 31), 12.0)
    ridge[3:6] = np.linspace(0, 2, 31)  # high at one end
    narrow = HeightGridIndenter("ridge", ridge, 0.2)
    pose = Pose(1.0, -0.5, 0.7, twist, tilt_x, tilt_y)
    near = narrow.height_over_skin_mm(pose, *SMALL.positions_mm)
    with pytest.MonkeyPatch.context() as everywhere:
        everywhere.setattr(HeightGridIndenter, "half_size_mm", (50.0, 50.0))
        np.testing.assert_array_equal(near, narrow.height_over_skin_mm(pose, *SMALL.positions_mm))
    assert near.min() < 1
