"""Triangles: which way they face, what they enclose, what they leave out."""

import numpy as np
import pytest
import trimesh
from skins import MM_PER_PX, ball_print, plane, with_hole

from ninedtact.quantities import Mesh
from ninedtact.shape.surface import point_cloud, surface_mesh


def solid(mesh: Mesh) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices_mm, mesh.faces, process=False)


def test_every_triangle_of_the_surface_faces_outwards_and_none_is_missing():
    mesh = surface_mesh(ball_print(61, 80))
    assert len(mesh.faces) == 2 * 60 * 79
    assert (solid(mesh).face_normals[:, 2] > 0).all()


def test_a_tilted_plane_has_the_area_of_a_tilted_plane():
    flat_mm2 = 30 * 40 * MM_PER_PX**2
    assert solid(surface_mesh(plane(31, 41, 0.75, 0))).area == pytest.approx(flat_mm2 * 1.25, rel=1e-5)


def test_only_squares_wholly_in_view_are_covered_and_vertices_are_the_points_of_the_cloud():
    height = with_hole(ball_print(31, 40))
    mesh = surface_mesh(height)
    seen = height.in_view
    whole = seen[:-1, :-1] & seen[1:, :-1] & seen[:-1, 1:] & seen[1:, 1:]
    assert len(mesh.faces) == 2 * whole.sum()
    assert solid(mesh).edges_unique_length.max() < 3 * MM_PER_PX
    np.testing.assert_array_equal(mesh.vertices_mm, point_cloud(height).points_mm)
