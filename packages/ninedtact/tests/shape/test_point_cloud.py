"""Points and normals against closed forms."""

import numpy as np
import pytest
from skins import DEPTH_MM, MM_PER_PX, RADIUS_MM, ball_print, grid, plane, with_hole

from ninedtact.errors import InputError
from ninedtact.shape.export import export_shape
from ninedtact.shape.surface import point_cloud, surface_mesh


@pytest.mark.parametrize("shape", [(30, 41), (31, 40), (2, 2), (1, 5), (5, 1)])
def test_the_normals_of_a_plane_are_exact_up_to_the_border(shape):
    slope_x, slope_y = 0.3 * (shape[1] > 1), -0.2 * (shape[0] > 1)
    cloud = point_cloud(plane(*shape, slope_x, slope_y))
    expected = np.array([-slope_x, -slope_y, 1]) / np.sqrt(1 + slope_x**2 + slope_y**2)
    np.testing.assert_allclose(cloud.normals, np.tile(expected, (shape[0] * shape[1], 1)), atol=2e-6)


def test_a_tilted_plane_seen_from_nearby_is_that_plane():
    cloud = point_cloud(plane(61, 80, 0.3, -0.2, camera_mm=10.0))
    np.testing.assert_allclose(cloud.points_mm @ [-0.3, 0.2, 1], 0, atol=1e-6)
    np.testing.assert_allclose(cloud.normals @ [-0.3, 0.2, 1], np.sqrt(1.13), atol=1e-5)


@pytest.mark.parametrize("at", [(0.0, 0.0), (3.1, -2.2)])
@pytest.mark.parametrize("camera_mm", [np.inf, 20.0])
def test_the_print_of_a_ball_is_a_sphere_whose_normals_point_at_its_centre(at, camera_mm):
    cloud = point_cloud(ball_print(at=at, camera_mm=camera_mm))
    to_centre = (np.array([*at, RADIUS_MM - DEPTH_MM]) - cloud.points_mm) / RADIUS_MM
    inside = np.hypot(*to_centre[:, :2].T) < 0.8
    assert inside.sum() > 10_000
    np.testing.assert_allclose(np.linalg.norm(to_centre[inside], axis=1), 1, atol=1e-5)
    assert np.linalg.norm(to_centre[inside] - cloud.normals[inside], axis=1).max() < 0.004


def test_points_lie_on_the_axes_of_the_sensor_frame_in_the_order_of_the_pixels():
    height = ball_print(31, 40)
    cloud = point_cloud(height)
    expected = np.stack([*grid(31, 40), height.z_mm], axis=-1).reshape(-1, 3)
    np.testing.assert_allclose(cloud.points_mm, expected, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(cloud.normals, axis=1), 1, atol=1e-6)
    assert cloud.stamp_ns == 7
    assert cloud.points_mm.dtype == cloud.normals.dtype == np.float32
    assert np.abs(cloud.points_mm[0, :2]).tolist() == pytest.approx([19.5 * MM_PER_PX, 15 * MM_PER_PX])


@pytest.mark.parametrize("make", [ball_print, lambda: with_hole(ball_print())])
def test_a_cloud_shares_no_memory_with_the_next_nor_with_its_height_map(make):
    height = make()
    first = point_cloud(height)
    kept, z_mm = first.points_mm.copy(), height.z_mm.copy()
    second = point_cloud(height)
    second.points_mm[:], second.normals[:] = -1, -1
    np.testing.assert_array_equal(first.points_mm, kept)
    np.testing.assert_array_equal(height.z_mm, z_mm)
    assert not np.shares_memory(first.points_mm, first.normals)
    np.testing.assert_array_equal(point_cloud(height).points_mm, kept)


@pytest.mark.parametrize("every", [0, -1])
def test_a_spacing_below_one_is_refused_and_nothing_is_written(every, tmp_path):
    height = plane(30, 41, 0.3, -0.2)
    for make in (point_cloud, surface_mesh):
        with pytest.raises(InputError, match="at least 1"):
            make(height, every)
    for name in ("skin.ply", "skin.stl", "skin.obj"):
        with pytest.raises(InputError, match="at least 1"):
            export_shape(height, tmp_path / name, every)
    assert list(tmp_path.iterdir()) == []
