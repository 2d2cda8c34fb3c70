"""Images of the parts and of the assembled sensor: whole, exploded and cut open.

They are drawn by a software renderer of solids in parallel projection: a depth buffer, shaded by the slope of the depth.
Image axes are x right and y down; depth grows away from the viewer.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from build123d import Box, Part, Pos
from jaxtyping import Float, Int, UInt8
from numpy import ndarray as Array

from ninedtact.simulation.objects.mesh_raster import lower_to_triangles, split_triangles_into_batches
from ninedtact_hardware.materials import Colour
from ninedtact_hardware.part_files import Triangles, triangulate_solid
from ninedtact_hardware.sensor_assembly import BuiltPart

SUPERSAMPLING = 2
"""Images are rendered this many times finer and averaged."""
MARGIN = 0.05
"""Share of the image's size that is left empty."""
_LIGHT_DIRECTION = np.array([-0.45, -0.6, -0.66])
"""Direction towards the light: from above left, in front."""
AMBIENT_LIGHT = 0.38
"""Brightness of faces that the light does not reach."""
BLACK_LIFT = 26.0
"""Grey levels added to all colours, so that black parts show their shape."""

COINCIDENT_DEPTH_MM = 1e-3
"""Faces closer to each other than this coincide; the body that was drawn first is shown."""

BgrImage = UInt8[Array, "rows cols 3"]
DepthImage = Float[Array, "rows cols"]


@dataclass(frozen=True)
class ViewAngles:
    """The direction from which bodies are seen: azimuth about z, then elevation above the horizon."""

    azimuth_deg: float = -52.0
    elevation_deg: float = 32.0

    @property
    def axes(self) -> Float[Array, "3 3"]:
        """Rows: right, down and away in the assembly frame."""
        turn, raised = np.radians(self.azimuth_deg), np.radians(self.elevation_deg)
        away = -np.array([np.cos(raised) * np.cos(turn), np.cos(raised) * np.sin(turn), np.sin(raised)])
        right = np.array([-np.sin(turn), np.cos(turn), 0.0])
        return np.stack([right, np.cross(away, right), away])


FROM_ABOVE = ViewAngles()
FROM_BELOW = ViewAngles(elevation_deg=-32.0)


@dataclass(frozen=True)
class ColouredMesh:
    """Triangles of one body with their colour."""

    triangles: Triangles
    colour: Colour


def render_solids(
    bodies: Sequence[ColouredMesh], eye: ViewAngles = FROM_ABOVE, size_px: tuple[int, int] = (900, 700)
) -> BgrImage:
    """Render bodies as large as they fit on white; returns BGR.

    size_px: columns and rows of the image.
    """
    cols, rows = (side * SUPERSAMPLING for side in size_px)
    seen = [body.triangles @ eye.axes.T for body in bodies]
    scale, shift = _fit_to_image(seen, cols, rows)
    depth, drawn = np.full((rows, cols), np.inf), np.full((rows, cols), len(bodies), np.int32)
    for number, places in enumerate(seen):
        placed = np.concatenate([places[..., :2] * scale + shift, places[..., 2:]], axis=-1)
        before = depth.copy()
        for portion in split_triangles_into_batches(placed):
            lower_to_triangles(depth, portion)
        drawn[depth < before - COINCIDENT_DEPTH_MM] = number
    colours = [np.minimum(np.array(body.colour[::-1]) + BLACK_LIFT, 255) for body in bodies]
    return _shade((scale * depth).astype(np.float32), drawn, np.array([*colours, [255.0] * 3], np.float32))


def _shade(
    depth_px: DepthImage, drawn: Int[Array, "rows cols"], palette: Float[Array, "colours 3"]
) -> UInt8[Array, "averaged_rows averaged_cols 3"]:
    """Return the averaged image, white beside the bodies; `drawn` has the number of each pixel's colour."""
    far_px = float(depth_px[np.isfinite(depth_px)].max()) + 50.0
    shaded = _darken_edges(palette[drawn] * _brightness(depth_px)[..., None], depth_px, far_px)
    rows, cols = (side // SUPERSAMPLING for side in drawn.shape)
    return cv2.resize(shaded, (cols, rows), interpolation=cv2.INTER_AREA).astype(np.uint8)


def _fit_to_image(seen: Sequence[Triangles], cols: int, rows: int) -> tuple[float, Float[Array, "2"]]:
    places = np.concatenate([part.reshape(-1, 3)[:, :2] for part in seen])
    low, high = places.min(axis=0), places.max(axis=0)
    room = np.array([cols, rows]) * (1 - 2 * MARGIN)
    scale = float((room / np.maximum(high - low, 1e-9)).min())
    return scale, np.array([cols, rows]) / 2 - scale * (low + high) / 2


def _brightness(depth_px: DepthImage) -> DepthImage:
    """Return the brightness of every pixel under the light, from the slopes of the depth; 1 beside the bodies."""
    down, right = (_depth_slope(depth_px, axis) for axis in (0, 1))
    lamp = (_LIGHT_DIRECTION / np.linalg.norm(_LIGHT_DIRECTION)).astype(np.float32)
    towards = (right * lamp[0] + down * lamp[1] - lamp[2]) / np.sqrt(right**2 + down**2 + 1)
    light = AMBIENT_LIGHT + (1 - AMBIENT_LIGHT) * np.clip(towards, 0, 1)
    return np.where(np.isfinite(depth_px), light, 1.0)


def _depth_slope(depth: DepthImage, axis: int) -> DepthImage:
    """Return the slope towards the neighbour that differs less; at an edge this is the slope of the pixel's own face."""
    with np.errstate(invalid="ignore"):
        step = np.diff(depth, axis=axis)
    beside = [(1, 1) if side == axis else (0, 0) for side in (0, 1)]
    step = np.pad(np.where(np.isfinite(step), step, np.inf), beside, constant_values=np.inf)
    before, after = (step[:-1], step[1:]) if axis == 0 else (step[:, :-1], step[:, 1:])
    nearer = np.where(np.abs(before) <= np.abs(after), before, after)
    return np.where(np.isfinite(nearer), nearer, 0.0)


def _darken_edges(
    image: Float[Array, "rows cols 3"], depth_px: DepthImage, far_px: float
) -> Float[Array, "rows cols 3"]:
    """Draw dark lines where depth bends or jumps; beside the bodies it is `far_px`."""
    depth = np.where(np.isfinite(depth_px), depth_px, far_px)
    bend = np.abs(cv2.Laplacian(depth, cv2.CV_32F))
    strength = cv2.GaussianBlur(np.clip((bend - 0.35) / 1.2, 0, 1), (0, 0), 0.8)
    return np.asarray(image * (1 - 0.62 * strength[..., None]))


PARTS_SHOWN_FROM_BELOW = ("sensor_shell",)
"""Parts whose lower side shows more; they are drawn from both sides."""
SECTION_VIEW = ViewAngles(-68.0, 18.0)
FAR_MM = 500.0
"""Half the side of a block that is larger than any sensor."""
LIFTS_MM = {
    "screw": -26.0,
    "insert": 0.0,
    "sensor_base": 0.0,
    "camera": 12.0,
    "led_board": 24.0,
    "isolation_ring": 34.0,
    "sensor_shell": 48.0,
    "acrylic_window": 68.0,
    "transparent_gel": 80.0,
    "translucent_gel": 92.0,
    "black_gel": 102.0,
}
"""Height by which the exploded view raises each body in the published size; the lifts grow with larger sensors."""
PUBLISHED_SHELL_MM = 32.5, 25.5, 19.5
"""Size of the shell in the published size."""


def render_part(part: BuiltPart) -> BgrImage:
    """Render one part from above, and beside it from below where that shows more."""
    body = colour_bodies([part])
    above = render_solids(body, FROM_ABOVE)
    return cv2.hconcat([above, render_solids(body, FROM_BELOW)]) if part.name in PARTS_SHOWN_FROM_BELOW else above


def render_sensor(bodies: Sequence[BuiltPart]) -> BgrImage:
    """Render the assembled sensor."""
    return render_solids(colour_bodies(bodies))


def render_exploded_view(bodies: Sequence[BuiltPart]) -> BgrImage:
    """Render the bodies pulled apart along z, in the order of assembly."""
    further = shell_enlargement_factor(bodies)
    moved = [replace(body, solid=Pos(0, 0, further * _lift_mm(body)) * body.solid) for body in bodies]
    return render_solids(colour_bodies(moved), ViewAngles(-52.0, 20.0), (560, 1500))


def shell_enlargement_factor(bodies: Sequence[BuiltPart]) -> float:
    """Return the factor by which the shell is larger than the published one, along its side that grew most; at least 1."""
    (shell,) = (body for body in bodies if body.name == "sensor_shell")
    sides = zip(tuple(shell.solid.bounding_box().size), PUBLISHED_SHELL_MM, strict=True)
    return max(1.0, *(side / published for side, published in sides))


def _lift_mm(body: BuiltPart) -> float:
    """Return the height by which a body is raised; the shell's inserts rise with the shell."""
    if body.kind == "insert" and int(body.name.split("_")[1]) > 4:
        return LIFTS_MM["sensor_shell"]
    return LIFTS_MM[body.kind]


def render_section(bodies: Sequence[BuiltPart]) -> BgrImage:
    """Render the sensor cut open through the middle, the half at -y removed."""
    return render_solids(colour_bodies(cut_bodies_open(bodies)), SECTION_VIEW, (1000, 800))


def cut_bodies_open(bodies: Sequence[BuiltPart]) -> list[BuiltPart]:
    """Return the halves at +y of a plane just beside the axis, so that it does not coincide with touching faces."""
    keep = Pos(0, FAR_MM + 0.01, 0) * Box(2 * FAR_MM, 2 * FAR_MM, 2 * FAR_MM)
    halves = ((body, body.solid & keep) for body in bodies)
    return [replace(body, solid=Part() + half) for body, half in halves if half is not None and half.volume > 0]


def colour_bodies(bodies: Iterable[BuiltPart]) -> list[ColouredMesh]:
    """Triangulate bodies and give each the colour of its material."""
    return [ColouredMesh(triangulate_solid(body.solid), body.material.colour) for body in bodies]
