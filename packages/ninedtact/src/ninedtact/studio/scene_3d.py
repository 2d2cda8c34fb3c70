"""The 3D scene of one viewer: the skin, true to scale, on its block of gel with a mm scale, and the wrench on it.

A wrench is drawn as an arrow where its force passes through the skin, and as an arc for the torque about z there. Tractions are
arrows, the contact has an outline, and the object of a twin is drawn over the skin where it is at that moment.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from math import ceil, sqrt
from typing import Any, NamedTuple

import cv2
import numpy as np
from jaxtyping import Float32, Float64, UInt32
from numpy import ndarray as Array
from viser import ArrowsHandle, LineSegmentsHandle, MeshHandle, PointCloudHandle, SceneApi, ViserServer
from viser.transforms import SO3

from ninedtact.design import Gel
from ninedtact.mechanics.indenter import Indenter
from ninedtact.quantities import Wrench
from ninedtact.shape.calibrated_shape import CalibratedShape
from ninedtact.shape.surface import triangulate_view
from ninedtact.simulation.press import Press
from ninedtact.studio.followed_object import FollowedObject
from ninedtact.studio.reading_view import LIGHT_DIRECTION, SkinSurface

Point = tuple[float, float, float]
LINES_EVERY_MM = 5.0
DEPTHS_EVERY_MM = 1.0
AWAY_MM = 0.9
"""Distance of the numbers from their edge."""


class _Mark(NamedTuple):
    """A text at a position in mm in the sensor frame."""

    text: str
    at_mm: Point


@dataclass(frozen=True)
class GelBlock:
    """A block of gel with the undeformed skin at z = 0."""

    width_mm: float
    """Width along x."""
    length_mm: float
    """Length along y."""
    gel_mm: float

    @property
    def edges_mm(self) -> Float32[Array, "n 2 3"]:
        """The twelve edges, as pairs of ends."""
        x, y, z = self.width_mm / 2, self.length_mm / 2, self.gel_mm
        along_x = [((-x, v, w), (x, v, w)) for v in (-y, y) for w in (-z, 0)]
        along_y = [((u, -y, w), (u, y, w)) for u in (-x, x) for w in (-z, 0)]
        along_z = [((u, v, -z), (u, v, 0)) for u in (-x, x) for v in (-y, y)]
        return np.array([*along_x, *along_y, *along_z], np.float32)

    @property
    def floor_mm(self) -> Float32[Array, "n 2 3"]:
        """Lines every 5 mm on the window under the gel."""
        x, y, z = self.width_mm / 2, self.length_mm / 2, self.gel_mm
        along_y = [((u, -y, -z), (u, y, -z)) for u in _multiples_within(x, LINES_EVERY_MM)]
        along_x = [((-x, v, -z), (x, v, -z)) for v in _multiples_within(y, LINES_EVERY_MM)]
        return np.array([*along_y, *along_x], np.float32).reshape(-1, 2, 3)

    def marks(self) -> Iterator[_Mark]:
        """Numbers along the front (x), the right (y) and the corner between them (z)."""
        x, y, z = self.width_mm / 2, self.length_mm / 2, self.gel_mm
        for place in _multiples_within(x, LINES_EVERY_MM):
            yield _Mark(format_signed_tenths(place), (place, -y - AWAY_MM, -z))
        for place in _multiples_within(y, LINES_EVERY_MM):
            yield _Mark(format_signed_tenths(place), (x + AWAY_MM, place, -z))
        for depth in np.arange(0, z, DEPTHS_EVERY_MM):
            yield _Mark(format_signed_tenths(-float(depth)), (-x - AWAY_MM, -y, -float(depth)))
        yield _Mark("x (mm)", (0.0, -y - 3 * AWAY_MM, -z))
        yield _Mark("y (mm)", (x + AWAY_MM, y + AWAY_MM, -z))
        yield _Mark("z (mm)", (-x, -y, AWAY_MM))


def gel_block_under_skin(shape: CalibratedShape, gel: Gel) -> GelBlock:
    """Return the gel under all the skin that a sensor sees."""
    rows, cols, _ = shape.rectify.source_px.shape
    return GelBlock(cols * shape.rectify.mm_per_px, rows * shape.rectify.mm_per_px, gel.thickness_mm)


def _multiples_within(half_mm: float, every_mm: float) -> list[float]:
    """Return the multiples of `every_mm` between −`half_mm` and `half_mm`."""
    count = int(half_mm / every_mm)
    return [float(number * every_mm) for number in range(-count, count + 1)]


def format_signed_tenths(number: float) -> str:
    """Return a number as text, rounded to tenths, with a true minus sign; zero has no sign."""
    return f"{round(number, 1) + 0.0:g}".replace("-", "\N{MINUS SIGN}")


MM_PER_N = 0.5
ARC_DEG_PER_NMM = 4.0
MOST_ARC_DEG = 330.0
ARC_RADIUS_MM = 4.5
LIFT_MM = 0.6
"""Height of the arc above the skin, which bulges."""
LEAST_FORCE_N = 0.1
"""Smallest normal force whose position is meaningful."""
ARC_PIECES = 48
LEAST_ARC_DEG = 8.0
"""Smallest angle of an arc that is drawn; a shorter arc would be shorter than its arrow head."""
FORCE, TWIST = (201, 42, 42), (95, 61, 196)
SHAFT_MM, HEAD_MM, HEAD_LONG_MM = 0.22, 0.55, 1.2


class _WrenchArrows:
    """One wrench in the scene; the head of the arrow is where the force passes through the undeformed skin."""

    def __init__(self, scene: SceneApi, name: str) -> None:
        nothing = np.zeros((1, 2, 3), np.float32)
        sizes: dict[str, float] = {"shaft_radius": SHAFT_MM, "head_radius": HEAD_MM, "head_length": HEAD_LONG_MM}
        self._force, self._twist = (
            scene.add_arrows(f"{name}/{part}", nothing, colour, visible=False, **sizes)
            for part, colour in (("force", FORCE), ("twist", TWIST))
        )
        whole = np.zeros((ARC_PIECES, 2, 3), np.float32)
        self._arc = scene.add_line_segments(
            f"{name}/arc", whole, TWIST, thickness=4.0, thickness_units="screen", visible=False
        )

    def show(self, wrench: Wrench | None) -> None:
        """Draw a wrench, or nothing where nothing presses."""
        place = None if wrench is None else centre_of_pressure_mm(wrench)
        if wrench is None or place is None:
            self._force.visible = self._twist.visible = self._arc.visible = False
            return
        turn_deg = torque_arc_deg(float(wrench.about(place).torque_nm[2]))
        arc = torque_arc_points_mm(place, turn_deg)
        self._force.points = np.array([[place - wrench.force_n * MM_PER_N, place]], np.float32)
        self._arc.points, self._twist.points = np.stack([arc[:-1], arc[1:]], axis=1), arc[None, [-3, -1]]
        # The arrows become visible only now, so that no browser draws them at their old position.
        self._force.visible = True
        self._arc.visible = self._twist.visible = abs(turn_deg) > LEAST_ARC_DEG


def centre_of_pressure_mm(wrench: Wrench) -> Float64[Array, "3"] | None:
    """Return the centre of pressure: the point of the undeformed skin about which only the torque about z remains.

    None for a very small force.
    """
    force_z = float(wrench.force_n[2])
    if abs(force_z) < LEAST_FORCE_N:
        return None
    about = wrench.about(np.zeros(3)).torque_nm * 1e3
    return np.array([-about[1] / force_z, about[0] / force_z, 0.0])


def torque_arc_deg(torque_nm: float) -> float:
    """Return the signed angle of the arc that shows a torque about z."""
    return float(np.clip(1e3 * torque_nm * ARC_DEG_PER_NMM, -MOST_ARC_DEG, MOST_ARC_DEG))


def torque_arc_points_mm(place_mm: Float64[Array, "3"], turn_deg: float) -> Float32[Array, "n 3"]:
    """Return the points of an arc about a position, which starts at the front."""
    angle = np.linspace(0, np.radians(turn_deg), ARC_PIECES + 1) - np.pi / 2
    circle = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1) * ARC_RADIUS_MM
    return (place_mm + circle + [0, 0, LIFT_MM]).astype(np.float32)


SEEN, TRUE = (0, 114, 178), (230, 159, 0)
"""Colours of the path and turn of the object as they are seen, and as they are on a twin."""
_TURN_RADII_MM = 3.0, 3.7
"""Radii of the arcs of both turns, which hardly differ."""


class _ObjectPaths:
    """The path of the object over the skin, an arrow from where it touched first, and its turn as an arc from the x axis."""

    def __init__(self, scene: SceneApi, name: str) -> None:
        nothing = np.zeros((1, 2, 3), np.float32)
        sizes: dict[str, float] = {"shaft_radius": 0.08, "head_radius": 0.3, "head_length": 0.7}
        lines: dict[str, Any] = {"thickness_units": "screen", "visible": False}
        self._parts = [
            (
                scene.add_line_segments(f"{name}/{kind}/path", nothing, colour, thickness=width, **lines),
                scene.add_line_segments(f"{name}/{kind}/turn", nothing, colour, thickness=width, **lines),
                scene.add_arrows(f"{name}/{kind}/moved", nothing, colour, visible=False, **sizes),
                radius_mm,
            )
            for kind, colour, width, radius_mm in zip(
                ("seen", "true"), (SEEN, TRUE), (3.0, 5.0), _TURN_RADII_MM, strict=True
            )
        ]

    def show(self, followed: FollowedObject) -> None:
        """Draw what is seen and what is true; nothing where nothing touches."""
        for (path, turn, arrow, radius_mm), one in zip(self._parts, (followed.seen, followed.true), strict=True):
            points_mm = None if one is None else np.column_stack([one.places_mm, np.full(len(one.places_mm), LIFT_MM)])
            is_moved = points_mm is not None and float(np.linalg.norm(points_mm[-1] - points_mm[0])) > _LEAST_ARROW_MM
            is_turned = one is not None and bool(np.isfinite(one.turn_rad))
            if points_mm is not None and is_moved:
                path.points = np.stack([points_mm[:-1], points_mm[1:]], axis=1).astype(np.float32)
                arrow.points = points_mm[None, [0, -1]].astype(np.float32)
            if points_mm is not None and one is not None and is_turned:
                turn.points = _turn_lines_mm(points_mm[-1], one.turn_rad, radius_mm)
            path.visible = arrow.visible = is_moved
            turn.visible = is_turned


_LEAST_ARROW_MM = 0.1


def _turn_lines_mm(place_mm: Float64[Array, "3"], turn_rad: float, radius_mm: float) -> Float32[Array, "n 2 3"]:
    """Return an arc from the x axis to the turn between its two arms, as pieces of line."""
    angle = np.linspace(0, turn_rad, ARC_PIECES + 1)
    arc = place_mm + radius_mm * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)
    pieces = np.stack([arc[:-1], arc[1:]], axis=1)
    return np.concatenate([pieces, [[place_mm, arc[0]], [place_mm, arc[-1]]]]).astype(np.float32)


GEL, PAST = (150, 172, 196), (110, 114, 118)
"""Colours of the surface while it is current, and while it is not current."""
EDGES, FLOOR = (120, 128, 138), (205, 210, 216)
OUTLINE, PROFILE, TRACTION, OBJECT = (20, 20, 20), (204, 121, 167), (0, 114, 178), (95, 102, 115)
"""Colours of lines and arrows on the skin, and of the object; from the palette of Okabe and Ito."""
LIGHT, DARK = np.full((2, 2, 3), (236, 239, 242), np.uint8), np.full((2, 2, 3), (36, 38, 42), np.uint8)
"""The backgrounds of the scene."""
FIELD_OF_VIEW_RAD = 0.72
POINT_OVERLAP = 1.3
"""Ratio of point size to spacing, so that steep skin has no gaps."""


class SkinScene:
    """Draws the skin, the gel block, the wrench, tractions and the object in the scene of one viewer."""

    def __init__(self, scene: SceneApi, block: GelBlock, at: str = "", name: str = "") -> None:
        """at: node of the scene that it hangs under; none for the root. name: of the sensor, written behind the gel."""
        self._at = at
        empty, level = np.zeros((1, 3), np.float32), np.zeros((1, 3), np.uint32)
        self._mesh: MeshHandle = scene.add_mesh_simple(f"{at}/skin/surface", empty, level, color=GEL, side="double")
        self._points: PointCloudHandle = scene.add_point_cloud(
            f"{at}/skin/points", empty, GEL, point_shape="square", point_shading="flat"
        )
        self._block = [
            scene.add_line_segments(f"{at}/gel/{part}", lines, colour, thickness=1.5, thickness_units="screen")
            for part, lines, colour in (("floor", block.floor_mm, FLOOR), ("edges", block.edges_mm, EDGES))
        ]
        nothing = np.zeros((1, 2, 3), np.float32)
        self._outline, self._profile = (
            scene.add_line_segments(
                f"{at}/skin/{part}", nothing, colour, thickness=3.0, thickness_units="screen", visible=False
            )
            for part, colour in (("outline", OUTLINE), ("profile", PROFILE))
        )
        self._tractions = scene.add_arrows(
            f"{at}/skin/tractions",
            nothing,
            TRACTION,
            shaft_radius=0.06,
            head_radius=0.16,
            head_length=0.4,
            visible=False,
        )
        marks = [*block.marks(), *([_Mark(name, (0.0, block.length_mm / 2 + 3 * AWAY_MM, 0.0))] if name else [])]
        style: dict[str, Any] = {"font_screen_scale": 0.8, "anchor": "center-center"}
        self._marks = [
            (mark, scene.add_label(f"{at}/gel/mark_{n}", mark.text, **style)) for n, mark in enumerate(marks)
        ]
        self._wrench = _WrenchArrows(scene, f"{at}/wrench")
        self._paths = _ObjectPaths(scene, f"{at}/path")
        self._object: MeshHandle = scene.add_mesh_simple(f"{at}/object", empty, level, visible=False)
        self._indenter: Indenter | None = None
        self._scene, self._exaggeration = scene, 0.0
        self.exaggerate(1.0)

    def show_wrench(self, wrench: Wrench | None) -> None:
        """Draw the wrench; vertical exaggeration does not apply to forces."""
        self._wrench.show(wrench)

    def show_path(self, followed: FollowedObject) -> None:
        """Draw the path and turn of the object."""
        self._paths.show(followed)

    def show_surface(self, surface: SkinSurface, as_points: bool, is_past: bool) -> None:
        """Draw one surface, as coloured points or as a smooth surface in the colour of silicone."""
        if as_points:
            self._points.points, self._points.colors = surface.half_precision_points_mm, surface.colours
            self._points.point_size = surface.spacing_mm * POINT_OVERLAP / np.cbrt(self._exaggeration)
        else:
            self._mesh.vertices, self._mesh.faces = surface.points_mm, surface.faces
            self._mesh.color = PAST if is_past else GEL
        self._points.visible, self._mesh.visible = as_points, not as_points

    def show_lines(
        self, outline_mm: Float32[Array, "n 2 3"] | None, profile_mm: Float64[Array, "points 3"] | None
    ) -> None:
        """Draw the edge of the contact and the line of the profile; None hides them."""
        pieces = None if profile_mm is None else np.stack([profile_mm[:-1], profile_mm[1:]], axis=1).astype(np.float32)
        for lines, points in ((self._outline, outline_mm), (self._profile, pieces)):
            if points is not None:
                lines.points = points
            lines.visible = points is not None

    def show_tractions(self, arrows_mm: Float32[Array, "n 2 3"] | None) -> None:
        """Draw tractions as arrows; None or no arrows hides them."""
        if arrows_mm is not None and len(arrows_mm):
            self._tractions.points = arrows_mm
        self._tractions.visible = arrows_mm is not None and len(arrows_mm) > 0

    def show_object(self, press: Press | None) -> None:
        """Draw the object of a twin where it is; it is hidden while heights are exaggerated, because it is rigid."""
        if press is None or self._exaggeration != 1.0:
            self._object.visible = False
            return
        if press.indenter is not self._indenter:
            self._indenter = press.indenter
            vertices, faces = indenter_underside_mesh(press.indenter)
            self._object = self._scene.add_mesh_simple(
                f"{self._at}/object",
                vertices,
                faces,
                color=OBJECT,
                opacity=OBJECT_OPACITY,
                side="front",
                flat_shading=True,
            )
        x, y, z = press.pose.origin_mm.tolist()
        self._object.position = (x, y, z + OBJECT_LIFT_MM)
        self._object.wxyz = SO3.from_matrix(np.asarray(press.pose.rotation)).wxyz
        self._object.visible = True

    def exaggerate(self, exaggeration: float) -> None:
        """Enlarge heights by a factor."""
        if exaggeration == self._exaggeration:
            return
        self._exaggeration = exaggeration
        stretched: list[MeshHandle | PointCloudHandle | LineSegmentsHandle | ArrowsHandle] = [
            self._mesh,
            self._points,
            *self._block,
            self._outline,
            self._profile,
            self._tractions,
        ]
        for node in stretched:
            node.scale = (1.0, 1.0, exaggeration)
        for mark, label in self._marks:
            x, y, z = mark.at_mm
            label.position = (x, y, z * exaggeration)


OBJECT_OPACITY = 0.5
"""Lets the contact be seen through the object."""
OBJECT_PITCH_MM, OBJECT_HALF_MM, OBJECT_HEIGHT_MM = 0.3, 14.0, 3.0
"""Spacing of the drawn points of an object, half of the drawn square, and the height above its lowest point up to which it is
drawn."""
OBJECT_LIFT_MM = 0.2
"""Height of a drawn object over the skin that it touches, so that one of both is clearly in front."""
_FINER = 3
"""How many times finer the outline of an object is found than its points are drawn."""


def indenter_underside_mesh(indenter: Indenter) -> tuple[Float32[Array, "n 3"], UInt32[Array, "m 3"]]:
    """Return the lowest part of the underside of an object as vertices in mm in its own frame, and triangles."""
    pitch_mm = OBJECT_PITCH_MM / _FINER
    axis = np.arange(-OBJECT_HALF_MM, OBJECT_HALF_MM + pitch_mm, pitch_mm)
    x, y = np.meshgrid(axis, axis)
    z = np.asarray(indenter.underside_mm(x, y))
    is_low = (z < OBJECT_HEIGHT_MM).astype(np.uint8)
    outside, inside = (cv2.distanceTransform(one, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) for one in (1 - is_low, is_low))
    # The outermost points are moved onto the outline, so that the edge is no saw.
    distance_mm = cv2.GaussianBlur(pitch_mm * (outside - inside), (0, 0), _FINER / 2)
    slope = np.stack(np.gradient(distance_mm, pitch_mm))
    drawn_at = np.s_[::_FINER, ::_FINER]
    step_mm = np.where(is_low, 0, distance_mm * slope / np.maximum((slope**2).sum(axis=0), 0.25))[:, *drawn_at]
    x, y, z = x[drawn_at] - step_mm[1], y[drawn_at] - step_mm[0], z[drawn_at]
    drawn = cv2.dilate(is_low[drawn_at].copy(), np.ones((3, 3), np.uint8)) > 0
    vertices = np.stack([x[drawn], y[drawn], np.minimum(z, OBJECT_HEIGHT_MM)[drawn]], axis=-1).astype(np.float32)
    return vertices, triangulate_view(drawn).astype(np.uint32)


def set_up_view(server: ViserServer, block: GelBlock) -> None:
    """Place background, camera and lights for all viewers: from the front and above, with x to the right.

    The directional light shades the points too; the soft light has no shadows.
    """
    scene, camera, far = server.scene, server.initial_camera, max(block.width_mm, block.length_mm)
    scene.set_background_image(LIGHT)
    scene.set_up_direction("+z")
    camera.position, camera.look_at = _camera_pose(block, far)
    camera.fov, camera.near, camera.far = FIELD_OF_VIEW_RAD, 0.1, 400 * far
    scene.configure_default_lights(enabled=False, cast_shadow=False)
    scene.configure_environment_map(hdri=None)
    scene.add_light_ambient("/light/soft", intensity=1.1)
    towards = tuple(20 * LIGHT_DIRECTION.astype(float))
    scene.add_light_directional("/light/grazing", position=towards, intensity=2.2)


def _camera_pose(block: GelBlock, far: float) -> tuple[Point, Point]:
    """Return position and target of the camera from which `far` mm of skin are seen."""
    return (0.0, -1.7 * far, 1.4 * far), (0.0, -0.05 * far, -block.gel_mm)


def _shift_upwards_in_view(pose: tuple[Point, Point], share: float) -> tuple[Point, Point]:
    """Return position and target of the camera lowered so that what it sees stands higher, by a share of the view's height."""
    camera_mm, target_mm = map(np.array, pose)
    towards = target_mm - camera_mm
    across = np.cross(towards, (0.0, 0.0, 1.0))
    upwards = np.cross(across, towards)
    height_mm = 2 * np.linalg.norm(towards) * np.tan(FIELD_OF_VIEW_RAD / 2)
    shift_mm = share * height_mm * upwards / np.linalg.norm(upwards)
    moved = [tuple((point - shift_mm).tolist()) for point in (camera_mm, target_mm)]
    return moved[0], moved[1]


_SPACING, _MARGIN = 1.4, 1.35
"""Distance of the middles of sensors that stand side by side, in lengths of a block; room around them."""
_SEEN_WIDTH = 1.65
"""Width at the middle of the view that the camera sees, in units of `far`, where the view is as wide as high."""


class SideBySideLayout:
    """The places of several sensors in the scene, in one column where the view is narrow, and the camera that sees all."""

    def __init__(self, block: GelBlock, sensors: int, aspect: float, covered: float = 0.0) -> None:
        """aspect: width over height of the view. covered: share of its height, from below, that panels cover, as on a phone."""
        length_mm = max(block.width_mm, block.length_mm)
        columns = 1 if sensors == 2 and aspect < 1 else ceil(sqrt(sensors))
        rows, step_mm = ceil(sensors / columns), _SPACING * length_mm
        grid = (divmod(number, columns) for number in range(sensors))
        self.places_mm: list[Point] = [
            ((column - (columns - 1) / 2) * step_mm, ((rows - 1) / 2 - row) * step_mm, 0.0) for row, column in grid
        ]
        """The middles of the sensors, row by row from the back, as text is read."""
        wide = (length_mm + (columns - 1) * step_mm) * _MARGIN / (_SEEN_WIDTH * aspect)
        deep = length_mm + 0.5 * (rows - 1) * step_mm
        far = max(wide, deep) if sensors > 1 or covered else length_mm
        self.camera_mm, self.target_mm = _shift_upwards_in_view(_camera_pose(block, far), 0.5 * covered)
