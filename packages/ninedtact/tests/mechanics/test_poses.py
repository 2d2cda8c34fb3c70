"""Rigid motion, and what is refused of it."""

import numpy as np
import pytest
from gels import BALL, model, pressed
from hypothesis import given, settings
from hypothesis import strategies as st

from ninedtact.errors import NinedtactError
from ninedtact.mechanics.contact_result import NonPositiveLoad
from ninedtact.mechanics.pose import InvalidPose, Pose, rigid_displacement_mm

numbers = st.floats(-1, 1)
poses = st.builds(Pose, numbers, numbers, numbers, numbers, numbers, numbers)


@settings(max_examples=50, deadline=None)
@given(poses, poses)
def test_a_rigid_object_carries_its_points_rigidly(before, after):
    place = np.random.default_rng(0).normal(size=(2, 3, 4))
    points = np.concatenate([place, np.zeros((1, 3, 4))]).reshape(3, -1)
    own = before.rotation.T @ (points - before.origin_mm[:, None])
    moved = after.rotation @ own + after.origin_mm[:, None] - points
    np.testing.assert_allclose(rigid_displacement_mm(before, after, place).reshape(2, -1), moved[:2], atol=1e-12)
    np.testing.assert_allclose(before.rotation @ before.rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(before.rotation) == pytest.approx(1)


@settings(max_examples=20, deadline=None)
@given(st.lists(poses, min_size=1, max_size=4))
def test_a_batch_of_poses_is_its_poses(single):
    batch = Pose.stack(single)
    assert batch.unstack() == single
    assert batch.batch_shape == (len(single),)
    np.testing.assert_allclose(batch.rotation, [pose.rotation for pose in single], atol=1e-15)
    np.testing.assert_allclose(batch.origin_mm, [pose.origin_mm for pose in single])
    for pose, frame in zip(
        [batch, *single], [Pose.from_frame(one.origin_mm, one.rotation) for one in (batch, *single)], strict=True
    ):
        np.testing.assert_allclose(
            list(vars(frame).values()), [getattr(pose, name) for name in vars(frame)], atol=1e-12
        )


@pytest.mark.parametrize("wrong", [np.nan, np.inf, np.array([0.1, np.nan])])
def test_a_pose_is_finite(wrong):
    with pytest.raises(
        NinedtactError, match=r"expected (a finite depth_mm|depth_mm of Pose to be a number).*, got .*(nan|inf)"
    ):
        Pose(depth_mm=wrong)


def test_an_object_stays_above_the_base():
    with pytest.raises(
        InvalidPose, match=r"expected the object less deep .* allows, 2\.5 mm, got 2\.6\d* mm; press less"
    ):
        pressed(model(), Pose(depth_mm=2.7))
    pressing = model()
    with pytest.raises(InvalidPose, match=r"allows, 2\.5 mm"):
        pressing.step_to_load(pressing.initial_contact(), BALL, Pose(depth_mm=1.0), 100.0)


@pytest.mark.parametrize("load", [0.0, -1.0, np.nan, np.inf])
def test_a_load_presses(load):
    pressing = model()
    with pytest.raises(NonPositiveLoad, match=r"expected a load above zero, got .* N; press with a force, or lift"):
        pressing.step_to_load(pressing.initial_contact(), BALL, Pose(depth_mm=1.0), load)


def test_an_object_above_the_skin_leaves_it_untouched():
    contact = pressed(model(), Pose(depth_mm=1.0), Pose(1.0, 1.0, -0.01))
    assert not contact.touches
    assert not contact.height_mm.any()
    assert not contact.wrench().six.any()
