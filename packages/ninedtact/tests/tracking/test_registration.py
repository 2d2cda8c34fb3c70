"""The motion between two surfaces: found where it can be seen, not claimed where it cannot, with errors that follow the laws."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ninedtact.quantities import HeightMap, HeightSource
from ninedtact.tracking import Registration, RigidMotion, TouchedSurface, extract_touched_surface
from ninedtact.tracking.rigid_motion import move_error, turn_error

SHAPE, MM_PER_PX, DISTANCE_MM = (173, 230), 0.1, 20.0
BUMPS_MM = np.array([(-2.4, -1.5), (1.9, -1.1), (0.4, 2.2), (-1.2, 1.4), (2.6, 1.6)])
ANGLES, SHIFTS = st.floats(-0.25, 0.25), st.floats(-1.0, 1.0)


def bumpy(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Height of the underside of an object with five bumps that differ."""
    height = np.zeros_like(x)
    for number, (bump_x, bump_y) in enumerate(BUMPS_MM):
        height -= (0.35 + 0.08 * number) * np.exp(-((x - bump_x) ** 2 + (y - bump_y) ** 2) / (0.5 + 0.1 * number))
    return height


def ball(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Height of a ball of 4 mm that is pressed 1 mm deep."""
    return 3.0 - np.sqrt(np.maximum(16 - x**2 - y**2, 0))


def star(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Height of the skin under a flat star with five rays, which falls to it within some tenths of a millimetre."""
    outline = 2.4 + 0.5 * np.cos(5 * np.arctan2(y, x))
    return -0.5 / (1 + np.exp((np.hypot(x, y) - outline) / 0.12))


def seen_height(underside, motion: RigidMotion, noise_mm: float = 0.0, seed: int = 0) -> HeightMap:
    """The height map of an object after a motion, by intersecting every line of sight with its surface."""
    rows, cols = SHAPE
    u, v = np.meshgrid((np.arange(cols) - (cols - 1) / 2) * MM_PER_PX, (np.arange(rows) - (rows - 1) / 2) * MM_PER_PX)
    z = np.zeros(SHAPE)
    back = motion.inverse
    for _ in range(25):
        scale = 1 + z / DISTANCE_MM
        at = back(np.stack([u * scale, v * scale, z], axis=-1))
        z = z + 0.8 * (underside(at[..., 0], at[..., 1]) - at[..., 2])
    noise = noise_mm * np.random.default_rng(seed).standard_normal(SHAPE)
    source = np.full(SHAPE, HeightSource.MEASURED.value, np.uint8)
    return HeightMap((z + noise).astype(np.float32), source, MM_PER_PX, 0.002, DISTANCE_MM)


def surface_of(height: HeightMap, deeper_than_mm: float = 0.03) -> TouchedSurface:
    found = extract_touched_surface(height, height.z_mm < -deeper_than_mm)
    assert found is not None
    return found


@settings(max_examples=12)
@given(SHIFTS, SHIFTS, st.floats(-0.15, 0.15), st.tuples(ANGLES, ANGLES, ANGLES))
def test_any_motion_of_an_object_that_differs_everywhere_is_found(
    x: float, y: float, z: float, turn: tuple[float, float, float]
) -> None:
    tilt_x, tilt_y, yaw = turn
    true = RigidMotion().perturbed(np.zeros(3), np.array([x, y, z, 0.1 * tilt_x, 0.1 * tilt_y, yaw]))
    before, after = (
        surface_of(seen_height(bumpy, motion, 0.002, seed)) for seed, motion in enumerate((RigidMotion(), true))
    )
    guess = RigidMotion(translation_mm=np.array([0.7 * x, 0.7 * y, 0.0]))
    found = Registration()(before, after, guess)
    assert found is not None
    error = found.motion.difference(true, before.centre_mm)
    assert np.abs(error[:3]).max() < 0.02 and np.degrees(np.abs(error[3:])).max() < 0.5
    assert (np.abs(error) < 3 * found.std).all()


def test_the_turn_of_a_ball_is_not_claimed() -> None:
    motion = RigidMotion().perturbed(np.zeros(3), np.array([0.3, -0.2, 0.0, 0.0, 0.0, 0.5]))
    before, after = (
        surface_of(seen_height(ball, one, 0.004, seed)) for seed, one in enumerate((RigidMotion(), motion))
    )
    found = Registration()(before, after)
    assert found is not None
    assert np.degrees(found.std[5]) > 60 and abs(found.motion.yaw_rad) < 0.02
    # A ball that rolls about its centre moves its lowest point and turns: what can be seen is the motion of the centre.
    centre_mm = np.array([0.0, 0.0, 3.0])
    assert found.motion(centre_mm)[:2] == pytest.approx(motion(centre_mm)[:2], abs=0.02)


def test_the_sliding_of_a_flat_face_is_not_claimed() -> None:
    def flat(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.full_like(x, -0.5)

    before, after = (surface_of(seen_height(flat, RigidMotion(), 0.004, seed)) for seed in (1, 2))
    found = Registration()(before, after)
    assert found is not None
    assert found.std[:2].min() > 2 and np.degrees(found.std[5]) > 60
    assert found.std[2] < 0.03 and np.degrees(found.std[3:5]).max() < 1
    assert np.abs(found.motion.translation_mm).max() < 0.01


@pytest.mark.parametrize("dragged_mm", [0.0, 0.03])
def test_the_outline_of_a_flat_face_shows_its_turn_while_skin_is_dragged_along(dragged_mm: float) -> None:
    true = RigidMotion().perturbed(np.zeros(3), np.array([0.2, -0.1, 0.0, 0.0, 0.0, np.radians(12)]))
    heights = [seen_height(star, motion, 0.004, seed) for seed, motion in enumerate((RigidMotion(), true))]
    x, y = heights[1].axes_mm
    smooth = dragged_mm * np.sin(x / 2.5) * np.cos(y[:, None] / 3.0)
    heights[1] = replace(heights[1], z_mm=heights[1].z_mm + smooth.astype(np.float32))
    before, after = (surface_of(height, 0.4) for height in heights)
    found = Registration()(before, after)
    assert found is not None
    error = found.motion.difference(true, before.centre_mm)
    assert np.abs(error[:2]).max() < 0.03 and np.degrees(abs(error[5])) < 0.5
    assert np.degrees(found.std[5]) < 1 and (np.abs(error) < 3 * found.std)[[0, 1, 5]].all()


def test_an_error_is_moved_and_turned_as_its_samples_are() -> None:
    rng = np.random.default_rng(3)
    root = 1e-3 * rng.standard_normal((6, 6))
    samples = rng.standard_normal((40_000, 6)) @ root.T
    at_mm, other_mm = np.array([1.0, -2.0, 0.5]), np.array([-1.5, 0.4, -0.6])
    moved = np.array([np.r_[one[:3] + np.cross(one[3:], other_mm - at_mm), one[3:]] for one in samples])
    covariance = move_error(root @ root.T, at_mm, other_mm)
    assert np.cov(moved.T) == pytest.approx(covariance, abs=0.05 * np.abs(covariance).max())
    turn = RigidMotion().perturbed(np.zeros(3), np.array([0, 0, 0, 0.3, -0.2, 0.9])).rotation
    turned = np.hstack([moved[:, :3] @ turn.T, moved[:, 3:] @ turn.T])
    expected = turn_error(covariance, turn)
    assert np.cov(turned.T) == pytest.approx(expected, abs=0.05 * np.abs(expected).max())


def test_motions_compose_and_their_difference_is_the_error_that_was_added() -> None:
    about_mm, error = np.array([0.5, 1.0, -0.3]), np.array([0.02, -0.01, 0.03, 0.004, -0.003, 0.01])
    first = RigidMotion().perturbed(np.zeros(3), np.array([1.0, 0.2, -0.1, 0.1, 0.2, 0.4]))
    second = RigidMotion().perturbed(np.ones(3), np.array([0.3, -0.5, 0.0, -0.1, 0.05, 0.7]))
    points = np.random.default_rng(0).standard_normal((5, 3))
    assert second.after(first)(points) == pytest.approx(second(first(points)))
    assert first.inverse.after(first)(points) == pytest.approx(points)
    wrong = first.perturbed(first(about_mm), error)
    assert wrong.difference(first, about_mm) == pytest.approx(error, abs=1e-12)


def test_the_displacement_of_an_upright_ball_is_seen_and_its_turn_is_not() -> None:
    moved = RigidMotion(translation_mm=np.array([0.6, -0.3, 0.0]))
    before, now = (surface_of(seen_height(ball, motion)) for motion in (RigidMotion(), moved))
    free, upright = Registration()(before, now), Registration(is_upright=True)(before, now)
    assert free is not None and upright is not None
    assert free.std[:2].min() > 0.5 and upright.std[:2].max() < 0.1
    assert np.abs(upright.motion.translation_mm - moved.translation_mm)[:2].max() < 0.03
    assert np.allclose(upright.motion.rotation, np.eye(3), atol=0.02) and np.degrees(upright.std[5]) > 45


def test_rotations_stay_rotations_over_hundreds_of_predicted_steps() -> None:
    motions = [RigidMotion().perturbed(np.zeros(3), np.array([0, 0, 0, 1e-3, -2e-3, angle])) for angle in (0.0, 0.01)]
    for _ in range(300):
        before, last = motions[-2:]
        predicted = last.after(before.inverse).after(last)
        motions.append(predicted.perturbed(np.zeros(3), np.zeros(6)))
    assert np.allclose(motions[-1].rotation @ motions[-1].rotation.T, np.eye(3), atol=1e-9)
