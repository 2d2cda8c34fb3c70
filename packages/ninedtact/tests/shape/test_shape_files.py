"""Every format is read back by a reader that is not ours, or bit by bit by ours."""

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from skins import ball_print, with_hole

from ninedtact.errors import FileFormatError, InputError
from ninedtact.quantities import HeightMap, HeightSource
from ninedtact.shape.export import (
    decode_height_png,
    encode_height_png,
    export_shape,
    read_height_png,
    write_ply,
)
from ninedtact.shape.surface import point_cloud, surface_mesh

HEIGHT = with_hole(ball_print(61, 80, camera_mm=20.0))


def scales(height: HeightMap) -> tuple[float, ...]:
    return height.mm_per_px, height.noise_mm, height.camera_distance_mm, height.stamp_ns


@pytest.mark.parametrize("ending", [".ply", ".stl", ".obj", ".PLY"])
def test_a_mesh_is_read_by_another_program_with_its_size_area_and_orientation(tmp_path, ending):
    export_shape(HEIGHT, tmp_path / f"skin{ending}")
    read, wrote = trimesh.load(tmp_path / f"skin{ending}"), surface_mesh(HEIGHT)
    ours = trimesh.Trimesh(wrote.vertices_mm, wrote.faces)
    assert len(read.faces) == len(wrote.faces)
    np.testing.assert_allclose(read.bounds, ours.bounds, atol=1e-4)
    assert read.area == pytest.approx(ours.area, rel=1e-4)
    assert (read.face_normals[:, 2] > 0).all()


def test_a_ply_holds_points_with_normals_and_needs_no_triangles(tmp_path):
    cloud = point_cloud(HEIGHT)
    write_ply(tmp_path / "points.ply", cloud)
    read = trimesh.load(tmp_path / "points.ply")
    assert isinstance(read, trimesh.PointCloud)
    np.testing.assert_array_equal(read.vertices, cloud.points_mm)
    export_shape(HEIGHT, tmp_path / "mesh.ply")
    raw = trimesh.load(tmp_path / "mesh.ply", process=False).metadata["_ply_raw"]["vertex"]["data"]
    np.testing.assert_array_equal(np.column_stack([raw[name] for name in ("nx", "ny", "nz")]), cloud.normals)


def test_the_normals_of_an_stl_agree_with_its_corners(tmp_path):
    export_shape(HEIGHT, tmp_path / "skin.stl")
    triangle = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    triangles = np.frombuffer((tmp_path / "skin.stl").read_bytes()[84:], triangle)
    expected, _ = trimesh.triangles.normals(triangles["corners"])
    np.testing.assert_allclose(triangles["normal"], expected, atol=1e-4)


def test_npy_is_height_in_mm_and_nan_out_of_view(tmp_path):
    export_shape(HEIGHT, tmp_path / "z.npy")
    read = np.load(tmp_path / "z.npy")
    assert read.dtype == np.float32
    np.testing.assert_array_equal(read, np.where(HEIGHT.in_view, HEIGHT.z_mm, np.nan))


def test_a_height_image_reads_back_as_the_height_map_it_was(tmp_path):
    export_shape(HEIGHT, tmp_path / "z.png")
    read = read_height_png(tmp_path / "z.png")
    assert scales(read) == scales(HEIGHT)
    np.testing.assert_array_equal(read.in_view, HEIGHT.in_view)
    np.testing.assert_allclose(read.z_mm[read.in_view], HEIGHT.z_mm[read.in_view], atol=0.000501)


heights = array_shapes(min_dims=2, max_dims=2, max_side=9).flatmap(
    lambda shape: st.tuples(
        arrays(np.int32, shape, elements=st.integers(-32767, 32767)),
        arrays(np.uint8, shape, elements=st.sampled_from([HeightSource.OUT_OF_VIEW, HeightSource.MEASURED])),
    )
)


@given(heights, st.floats(1e-3, 1), st.floats(0, 1), st.floats(1, None), st.integers(0, 2**63 - 1))
def test_whole_micrometres_survive_a_height_image_exactly(map_and_view, mm_per_px, noise_mm, camera_mm, stamp_ns):
    micrometres, source = map_and_view
    z_mm = (micrometres / 1000).astype(np.float32)
    read = decode_height_png(encode_height_png(HeightMap(z_mm, source, mm_per_px, noise_mm, camera_mm, stamp_ns)))
    np.testing.assert_array_equal(read.source, source)
    np.testing.assert_array_equal(np.rint(read.z_mm[read.in_view] * 1000), micrometres[read.in_view])
    assert scales(read) == (mm_per_px, noise_mm, camera_mm, stamp_ns)


@given(st.data())
def test_a_damaged_height_image_is_refused(tmp_path_factory, data):
    whole = encode_height_png(HEIGHT)
    path = tmp_path_factory.getbasetemp() / "damaged.png"
    place = data.draw(st.integers(0, len(whole) - 1))
    flipped = bytes([whole[place] ^ data.draw(st.integers(1, 255))])
    path.write_bytes(data.draw(st.sampled_from([whole[:place], whole[:place] + flipped + whole[place + 1 :]])))
    with pytest.raises(FileFormatError, match="export it again"):
        read_height_png(path)


@pytest.mark.parametrize("name", ["skin", "skin.jpeg", ".ply/skin"])
def test_an_ending_that_nobody_can_write_is_refused_by_naming_those_that_can(tmp_path, name):
    with pytest.raises(InputError, match=r"\.npy, \.png, \.ply, \.stl or \.obj"):
        export_shape(HEIGHT, tmp_path / name)
