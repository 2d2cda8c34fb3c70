"""What the tractions add up to."""

import numpy as np
import pytest
from gels import BALL, SMALL, model, pressed
from hypothesis import given, settings
from hypothesis import strategies as st

from ninedtact.mechanics.contact_model import SolverSettings
from ninedtact.mechanics.pose import Pose

FINE = SolverSettings(tolerance=1e-5)


def test_a_straight_press_has_neither_shear_nor_torque():
    six = pressed(model(), Pose(depth_mm=1.2)).wrench().six
    assert six[2] < -3
    np.testing.assert_allclose(np.delete(six, 2), 0, atol=1e-7)


@settings(max_examples=5, deadline=None)
@given(st.floats(-8, 8), st.floats(-6, 6), st.floats(0.2, 1.2))
def test_a_press_beside_the_middle_is_the_same_press(x, y, depth):
    poses = [Pose(depth_mm=depth), Pose(0.3, 0.1, depth)]
    middle = pressed(model(settings=FINE), *poses)
    beside = pressed(model(settings=FINE), *(Pose(x + pose.x_mm, y + pose.y_mm, pose.depth_mm) for pose in poses))
    np.testing.assert_allclose(beside.height_mm, middle.height_mm, atol=1e-6)
    there = np.array([x, y, 0.0])
    np.testing.assert_allclose(beside.wrench(about_mm=there).six, middle.wrench().six, atol=1e-5)
    np.testing.assert_allclose(
        beside.surface_points_mm - middle.surface_points_mm,
        (there[:, None, None]) + 0 * middle.surface_points_mm,
        atol=1e-6,
    )


def test_the_object_is_pushed_back_as_it_pushes():
    """Newton's third law: what the skin does to the object, summed over the object's own underside, turns the sign of all six."""
    contact = pressed(model(), Pose(2.0, 1.0, 1.0), Pose(2.3, 1.2, 1.0, 0.2, tilt_x_rad=0.05))
    x, y = SMALL.positions_mm
    z = BALL.height_over_skin_mm(contact.pose, x + contact.pose.x_mm, y + contact.pose.y_mm)
    reach = contact.pressure_mpa > 0
    point = np.stack([x + contact.pose.x_mm, y + contact.pose.y_mm, z])[:, reach]
    force = -np.stack([*contact.shear_mpa, -contact.pressure_mpa])[:, reach] * SMALL.cell_area_mm2
    torque = np.cross(point, force, axis=0).sum(axis=1) / 1e3
    six = np.concatenate([force.sum(axis=1), torque])
    assert np.abs(contact.wrench().six).min() > 1e-6
    np.testing.assert_allclose(six, -contact.wrench().six, rtol=1e-5, atol=1e-9)


def test_a_torque_is_moved_as_statics_say():
    wrench, point = pressed(model(), Pose(depth_mm=1.0), Pose(0.3, 0.0, 1.0)).wrench(), np.array([1.0, -2.0, -35.0])
    moved = wrench.about(point)
    np.testing.assert_allclose(moved.torque_nm + np.cross(point, wrench.force_n) / 1e3, wrench.torque_nm, atol=1e-12)
    np.testing.assert_allclose(moved.about(np.zeros(3)).six, wrench.six, atol=1e-12)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10**6))
def test_displacements_of_tractions_add_up_and_work_both_ways(seed):
    """Superposition, and Betti's law: what one load does along another's displacement, the other does along the first's."""
    operators, random = model().skin.operators, np.random.default_rng(seed)
    (p1, p2), (q1, q2) = random.normal(size=(2, *SMALL.shape)), random.normal(size=(2, 2, *SMALL.shape))
    (z1, t1), (z2, t2), (z, t) = (
        operators.displacement_mm(*load) for load in ((p1, q1), (p2, q2), (p1 - 2 * p2, q1 - 2 * q2))
    )
    np.testing.assert_allclose(z, z1 - 2 * z2, atol=1e-9)
    np.testing.assert_allclose(t, t1 - 2 * t2, atol=1e-9)
    first, second = (q1 * t2).sum() - (p1 * z2).sum(), (q2 * t1).sum() - (p2 * z1).sum()
    assert first == pytest.approx(second, rel=1e-9, abs=1e-6)
    assert (q1 * t1).sum() - (p1 * z1).sum() > 0
