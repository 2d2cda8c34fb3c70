"""What presses the skin: one contract for all, generated shapes that differ, meshes of every quality."""

import importlib.util
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

from ninedtact.errors import MissingLibraryError, NinedtactError
from ninedtact.mechanics.height_grid_indenter import indenter_from_heights
from ninedtact.mechanics.indenter import NO_OBJECT_MM, Ball, Cone, Ellipsoid, FlatPunch, Indenter, LyingCylinder
from ninedtact.mechanics.pose import Pose
from ninedtact.simulation.objects.catalogue import (
    FAMILIES,
    OBJECT_GRID,
    PAPER_COUNT,
    generate_object,
    generate_objects,
    generated_object_names,
    indenter_from_name,
)
from ninedtact.simulation.objects.height_fields import DimensionSampler
from ninedtact.simulation.objects.mesh_objects import MeshPlacement, MeshUnusable, load_mesh_object

CLOSED_FORMS = [Ball(3.0), Ellipsoid(), LyingCylinder(), Cone(), FlatPunch()]
MEMBERS: dict[str, Indenter] = {
    **{indenter.name: indenter for indenter in CLOSED_FORMS},
    **{family: generate_object(f"{family}_01") for family in FAMILIES},
}
every_member = pytest.mark.parametrize("name", MEMBERS)
STEP = 0.1003
AXIS = (np.arange(240) - 119.5) * STEP
X, Y = np.meshgrid(AXIS, AXIS)


@every_member
def test_an_underside_touches_its_plane_and_stays_above(name: str) -> None:
    heights = MEMBERS[name].underside_mm(X, Y)
    assert np.isfinite(heights).all() and heights.min() >= 0 and heights.max() == NO_OBJECT_MM
    # The grid may straddle the lowest point of the steepest edge.
    assert heights.min() < 0.06
    footprint = heights < NO_OBJECT_MM
    reach = max(np.ptp(X[footprint]), np.ptp(Y[footprint]))
    assert 3.5 < reach < 21.8, "between what the skin can feel and what it can hold"


@every_member
def test_the_same_in_every_library_and_precision(name: str) -> None:
    wanted, pose = MEMBERS[name].underside_mm(X, Y), Pose(0.3, -0.4, 0.5, 0.2)
    single = MEMBERS[name].underside_mm(X.astype(np.float32), Y.astype(np.float32))
    on_torch = MEMBERS[name].underside_mm(
        *(torch.tensor(np.stack([axis, axis]), dtype=torch.float32) for axis in (X, Y))
    )
    assert (single.dtype, on_torch.dtype) == (np.float32, torch.float32)
    low = wanted < 3
    for found in (single, on_torch.numpy()[1]):
        assert np.percentile(abs(found - wanted)[low], 99.5) < 1e-3
    assert MEMBERS[name].height_over_skin_mm(pose, X.astype(np.float32), Y.astype(np.float32)).dtype == np.float32


def lowest_and_highest(field: Callable[..., np.ndarray], x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of a field within 0.1 mm of each place: what can be asked of it at a wall."""
    steps = 0.1 * np.stack(np.meshgrid([-1, -0.5, 0, 0.5, 1], [-1, -0.5, 0, 0.5, 1]), axis=-1).reshape(-1, 1, 1, 2)
    near = field(x + steps[..., 0], y + steps[..., 1])
    return near.min(axis=0), near.max(axis=0)


@every_member
def test_tilt_moves_every_point_as_a_rigid_body(name: str) -> None:
    member, pose = MEMBERS[name], Pose(0.5, 0.2, 0.6, 0.3, np.radians(10), np.radians(-5))
    x, y = X[::3, ::3] + 0.01, Y[::3, ::3]
    found = member.height_over_skin_mm(pose, x, y)
    assert np.isfinite(found).all()
    # What is found belongs to the object.
    points = np.stack([x, y, found])[:, found < 3]
    own_x, own_y, own_z = ((points.T - pose.origin_mm) @ pose.rotation).T
    low, high = lowest_and_highest(member.underside_mm, own_x[None], own_y[None])
    assert np.mean((own_z > low - 0.02) & (own_z < high + 0.02)) > 0.998
    # No point of the object is lower than what is found.
    own = np.stack([x, y, member.underside_mm(x, y)])
    x, y, z = (own[:, own[2] < 3].T @ pose.rotation.T + pose.origin_mm).T
    low, _ = lowest_and_highest(lambda *place: member.height_over_skin_mm(pose, *place), x[None], y[None])
    assert np.mean(low < z + 0.02) > 0.998


def test_a_tilted_ball_is_a_ball_elsewhere() -> None:
    pose = Pose(depth_mm=1.0, tilt_x_rad=0.2, tilt_y_rad=-0.1)
    x, y, z = pose.origin_mm + pose.rotation @ [0, 0, 4]
    cap = z - np.sqrt(np.maximum(16 - (X - x) ** 2 - (Y - y) ** 2, 0))
    assert abs(Ball(4.0).height_over_skin_mm(pose, X, Y) - cap)[cap < 1.5].max() < 2e-3


def test_as_many_distinct_shapes_as_the_paper() -> None:
    made = list(generate_objects())
    assert [each.name for each in made] == generated_object_names() and len(
        set(generated_object_names())
    ) == PAPER_COUNT
    coarse = np.meshgrid(*2 * [np.arange(-11, 11.01, 0.3)])
    fields = np.stack([np.minimum(each.underside_mm(*coarse), 2.0).ravel() for each in made]).astype(np.float32)
    touched = fields < 2
    for index, field in enumerate(fields[:-1]):
        others = slice(index + 1, None)
        either = (touched[others] | touched[index]).sum(axis=1)
        difference = abs(fields[others] - field).sum(axis=1) / either
        assert difference.min() > 0.15, f"{made[index].name} and {made[index + 1 + difference.argmin()].name} are alike"


def test_an_object_is_its_seed_family_and_number_alone() -> None:
    assert generated_object_names(10) == generated_object_names(300)[:10]
    for name in ("gear_03", "fractal_02", "key_07"):
        family, number = name.rsplit("_", 1)
        again = indenter_from_heights(
            name,
            OBJECT_GRID.smooth(FAMILIES[family](DimensionSampler(0, family, int(number)), OBJECT_GRID)),
            OBJECT_GRID.pitch_mm,
        )
        assert (generate_object(name).heights_mm == again.heights_mm).all()
        other = generate_object(name, seed=1).heights_mm
        assert other.shape != again.heights_mm.shape or abs(other - again.heights_mm).max() > 0.1
    with pytest.raises(NinedtactError, match="expected seed of at least 0, got -1"):
        indenter_from_name("gear_07", seed=-1)
    assert generate_object("gear_7").name == indenter_from_name("gear_07").name == "gear_07"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    ball = trimesh.creation.icosphere(4, radius=4.0)
    ball.export(tmp_path / "ball.stl")
    trimesh.creation.box((10, 6, 4)).export(tmp_path / "box.obj")
    trimesh.creation.annulus(2, 5, 3).export(tmp_path / "ring.ply")
    for name, scale in (("metres", 1e-3), ("inches", 1 / 25.4), ("giant", 40.0), ("wide", 6.0)):
        ball.copy().apply_scale(scale).export(tmp_path / f"{name}.stl")
    opened = ball.submesh([ball.triangles_center[:, 2] < 3], append=True)
    opened.export(tmp_path / "open.stl")
    trimesh.PointCloud(np.random.default_rng(0).random((9, 3))).export(tmp_path / "points.ply")
    (tmp_path / "text.stl").write_text("This is no mesh.\n")
    (tmp_path / "nothing.stl").write_bytes(b"")
    (tmp_path / "nan.obj").write_text("v 0 0 0\nv 9 0 0\nv 0 nan 0\nf 1 2 3\n")
    sheets = [[0, 1, 2], [1, 3, 2]] * 1000
    corners = [[0, 0, 0], [40, 0, 1], [0, 40, 0], [40, 40, 0]]
    trimesh.Trimesh(corners, sheets, process=False).export(tmp_path / "sheets.ply")
    (tmp_path / "astray.obj").write_text("v 0 0 0\nv 9 0 0\nv 0 9 0\nf 1 2 8\n")
    return tmp_path


@pytest.mark.parametrize("name", ["inches.stl@in", "giant.stl@fit:8", "wide.stl@0.16666667@+x"])
def test_a_ball_as_a_mesh_is_a_ball(folder: Path, name: str) -> None:
    found, near = indenter_from_name(str(folder / name)).underside_mm(X, Y), np.hypot(X, Y) < 3.5
    assert abs(found - Ball(4.0).underside_mm(X, Y))[near].max() < 0.02
    assert (found[np.hypot(X, Y) > 4.15] == NO_OBJECT_MM).all()


def test_the_side_that_faces_the_skin_is_chosen(folder: Path) -> None:
    sizes = {
        side: load_mesh_object(folder / "box.obj", MeshPlacement(side=side)).relief.size_mm
        for side in ("-z", "+z", "-x", "+y")
    }
    assert sizes["-z"] == sizes["+z"] == pytest.approx((10, 6), abs=0.15)
    assert sizes["-x"] == pytest.approx((4, 6), abs=0.15) and sizes["+y"] == pytest.approx((10, 4), abs=0.15)
    ring = load_mesh_object(folder / "ring.ply").relief
    origin = np.zeros((1, 1))
    assert ring.underside_mm(origin, origin) == NO_OBJECT_MM and ring.underside_mm(origin + 3.5, origin) == 0


def test_a_mesh_is_closed_where_no_edge_belongs_to_one_triangle_alone(tmp_path: Path) -> None:
    box = trimesh.creation.box((6, 4, 3))
    lidless = trimesh.Trimesh(box.vertices, box.faces[box.face_normals[:, 2] < 0.5], process=False)
    beside = box.copy().apply_translation((6, 0, 0))

    def closed(mesh: trimesh.Trimesh, *more: list[int]) -> bool:
        faces = np.vstack([mesh.faces, *([face] for face in more)])
        trimesh.Trimesh(mesh.vertices, faces, process=False).export(tmp_path / "mesh.obj")
        return load_mesh_object(tmp_path / "mesh.obj").closed

    one = box.faces[0].tolist()
    assert closed(box, one, one) and closed(box, [one[0], one[0], one[1]])
    assert closed(trimesh.util.concatenate([box, beside])), "two boxes with a face in common"
    assert not closed(lidless, *lidless.faces[:, ::-1].tolist()), "a sheet with both sides"
    assert not closed(box, [one[0], one[1], one[1]], [0, 1, 7]), "a triangle with an edge of its own"


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("metres.stl", r"in metres it would be 8 x 8 x 8 mm \(give unit m\)"),
        ("inches.stl", r"in inches 8 x 8 x 8 mm \(give unit in\)"),
        ("giant.stl", "at most 60 mm across, got 320 x 320 x 320 mm"),
        ("points.ply", "expected triangles"),
        ("text.stl", "text"),
        ("nothing.stl", "nothing"),
        ("nan.obj", "not a number"),
        ("sheets.ply", "upon each other about 2\\d{3} times"),
        ("astray.obj", "astray"),
        ("missing.stl", "which is not there"),
        ("ball.stl@fit:0", "expected fit_mm above 0 .*, got 0"),
    ],
)
def test_bad_meshes_are_refused_in_one_sentence(folder: Path, name: str, said: str) -> None:
    with pytest.raises(MeshUnusable, match=said) as refusal:
        indenter_from_name(str(folder / name))
    assert str(refusal.value).startswith("expected ") and ", got " in str(refusal.value)


def test_solids_by_name_and_a_list_of_what_is_accepted() -> None:
    assert indenter_from_name("ball:4") == Ball(4.0) and indenter_from_name("cylinder:3,12") == LyingCylinder(3.0, 12.0)
    assert indenter_from_name("cone:30") == Cone(np.radians(30))
    for text in (
        "gaer_07",
        "",
        "gear",
        "gear_00",
        "ball:-1",
        "ball:1,2",
        "ball:x",
        "ball:1e300",
        "gear_" + 5000 * "9",
        "part.step",
    ):
        with pytest.raises(NinedtactError, match=r"expected .*gear_07|expected ball:RADIUS"):
            indenter_from_name(text)


def test_a_3mf_file_is_read_in_the_unit_that_it_states(tmp_path: Path) -> None:
    name, box = str(tmp_path / "box.3mf"), trimesh.creation.box((0.4, 0.3, 0.2))
    places = "".join("<vertex x='{}' y='{}' z='{}'/>".format(*place) for place in (10 * box.vertices).tolist())
    faces = "".join("<triangle v1='{}' v2='{}' v3='{}'/>".format(*face) for face in box.faces.tolist())
    mesh = f"<mesh><vertices>{places}</vertices><triangles>{faces}</triangles></mesh>"
    space = "xmlns='http://schemas.microsoft.com/3dmanufacturing/core/2015/02'"
    parts = f"<resources><object id='1' type='model'>{mesh}</object></resources><build><item objectid='1'/></build>"

    def write(unit: str) -> None:
        with zipfile.ZipFile(name, "w") as file:
            file.writestr("3D/3dmodel.model", f"<model {unit} {space}>{parts}</model>")

    write("unit='inch'")
    if importlib.util.find_spec("lxml") is None:
        with pytest.raises(MissingLibraryError, match=r"expected .*3mf files, got.*; run: pip install lxml networkx"):
            indenter_from_name(name)
        return
    with pytest.raises(MeshUnusable, match=r"expected box in mm, got a file that states the unit in; give unit in"):
        indenter_from_name(name)
    assert load_mesh_object(Path(name), MeshPlacement("in", scale=0.1)).size_mm == pytest.approx((10.16, 7.62, 5.08))
    assert load_mesh_object(Path(name), MeshPlacement(fit_mm=16)).size_mm == pytest.approx((16, 12, 8))
    for unit in ("", "unit='millimeter'"):
        write(unit)
        assert load_mesh_object(Path(name)).size_mm == pytest.approx((4, 3, 2))
    write("unit='micron'")
    with pytest.raises(MeshUnusable, match="states the unit micron; export it in millimetres"):
        indenter_from_name(name)
