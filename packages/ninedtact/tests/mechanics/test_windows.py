"""A part of the grid answers as the whole does; a grid with its margin answers nearly as endless skin does."""

import numpy as np
import pytest
from gels import BALL, DOUBLE, GEL, SMALL, Plate, model, pressed
from hypothesis import given, settings
from hypothesis import strategies as st

from ninedtact.mechanics import contact_model as contacts
from ninedtact.mechanics.active_region import (
    GridRectangle,
    SharedActiveRectangle,
    find_touchable_region,
    whole_grid_region,
)
from ninedtact.mechanics.contact_model import SolverSettings
from ninedtact.mechanics.contact_result import ContactLeavesGrid, periodic_image_error_mm
from ninedtact.mechanics.pose import Pose
from ninedtact.mechanics.skin import PeriodicGrid, gel_skin, padded_grid

MOVES = (Pose(depth_mm=0.8), Pose(0.4, -0.2, 0.9, 0.1))


@settings(max_examples=25, deadline=None)
@given(st.integers(20, 41), st.integers(20, 41), st.integers(1, 10), st.integers(1, 10), st.integers(0, 99))
def test_a_window_answers_exactly_as_the_patch_with_zeros_around_it(rows, cols, high, wide, seed):
    skin, random = gel_skin(PeriodicGrid(rows, cols, 0.5), GEL, DOUBLE), np.random.default_rng(seed)
    top, left = random.integers(0, rows - high), random.integers(0, cols - wide)
    inside = (..., slice(top, top + high), slice(left, left + wide))
    tractions = np.zeros((3, rows, cols))
    tractions[inside] = random.normal(size=(3, high, wide))
    whole = skin.operators.displacement_mm(tractions[0], tractions[1:])
    part = skin.cropped_operators(high, wide).displacement_mm(tractions[0][inside], tractions[1:][inside])
    for expected, found in zip(whole, part, strict=True):
        np.testing.assert_allclose(found, expected[inside], atol=1e-12 * np.abs(expected).max())


def test_a_contact_in_a_window_is_the_contact_on_the_patch(monkeypatch):
    in_window = pressed(model(), *MOVES)
    window = find_touchable_region(in_window.skin, -BALL.height_over_skin_mm(MOVES[0], *SMALL.positions_mm))
    assert window.operators.field_shape < SMALL.shape
    monkeypatch.setattr(contacts, "find_touchable_region", lambda skin, overlap: whole_grid_region(skin))
    on_patch = pressed(model(), *MOVES)
    np.testing.assert_allclose(in_window.pressure_mpa, on_patch.pressure_mpa, atol=1e-6)
    np.testing.assert_allclose(in_window.height_mm, on_patch.height_mm, atol=1e-6)


def test_skin_that_rises_into_the_object_beyond_the_window_is_seen(monkeypatch):
    honest = pressed(model(friction=3.0), Pose(depth_mm=0.5), Pose(x_mm=1.0, depth_mm=0.5))
    narrow = model(friction=3.0).skin.cropped_operators(8, 8)
    middle = GridRectangle(
        slice(SMALL.rows // 2 - 4, SMALL.rows // 2 + 4), slice(SMALL.cols // 2 - 4, SMALL.cols // 2 + 4)
    )
    monkeypatch.setattr(contacts, "find_touchable_region", lambda skin, _: SharedActiveRectangle(middle, skin, narrow))
    found = pressed(model(friction=3.0), Pose(depth_mm=0.5), Pose(x_mm=1.0, depth_mm=0.5))
    np.testing.assert_allclose(found.pressure_mpa, honest.pressure_mpa, atol=1e-5)


def test_the_margin_keeps_the_images_of_a_contact_away():
    """Figures of docs/mechanics.md: a ball 1.5 mm deep, dragged 0.5 mm, with the margin of the twins."""
    moves, rough = (
        [Pose(depth_mm=1.0), Pose(depth_mm=1.5), Pose(x_mm=0.5, depth_mm=1.5)],
        SolverSettings(tolerance=1e-2),
    )
    worst = [
        periodic_image_error_mm(pressed(model(grid=padded_grid(24, 18, 0.3, margin), settings=rough), *moves))
        for margin in (0, 4)
    ]
    near = [np.abs(error)[error.shape[0] // 2 - 10 : -(error.shape[0] // 2 - 10)].max() for error in worst]
    assert np.abs(worst[0]).max() < 0.04
    assert np.abs(worst[1]).max() < 0.008
    assert abs(worst[1][tuple(cells // 2 for cells in worst[1].shape)]) < 0.0005
    assert near[1] < near[0]


@pytest.mark.parametrize("depth", [0.1, 0.5])
def test_what_reaches_the_border_is_refused(depth):
    with pytest.raises(
        ContactLeavesGrid, match=r"expected the contact inside the grid of 21\.6 x 19\.2 mm, got it at .*; give"
    ):
        pressed(model(), Pose(depth_mm=depth), indenter=Plate())
    with pytest.raises(ContactLeavesGrid, match="left and right"):
        pressing = model(friction=0.0, settings=SolverSettings(max_rounds=2, max_iterations=20))
        pressing.step_to_load(pressing.initial_contact(), Plate(), Pose(), 1.0)
