"""What images show: parts alone, the sensor whole, cut open, or pulled apart."""

from collections.abc import Iterable, Sequence

import cv2
from build123d import Box, Part, Pos

from ninedtact.hardware.export.solid_files import triangulate_solid
from ninedtact.hardware.materials import MATERIAL_OF_PART
from ninedtact.hardware.parts.part_catalogue import BuiltPart
from ninedtact.hardware.sensor_assembly import AssemblyBody
from ninedtact.hardware.solid_renderer import (
    FROM_ABOVE,
    FROM_BELOW,
    BgrImage,
    ColouredMesh,
    ViewDirection,
    render_solids,
)

PARTS_SHOWN_FROM_BELOW = ("sensor_shell",)
"""Parts whose lower side has more to show; both are drawn."""
SECTION_VIEW = ViewDirection(-68.0, 18.0)
FAR_MM = 500.0
"""Half a block that is larger than any sensor."""
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
"""How far the exploded view raises each body of the published size; larger sensors are pulled apart as much further."""
PUBLISHED_SHELL_MM = 32.5, 25.5, 19.5
"""Of that size."""


def render_part(part: BuiltPart) -> BgrImage:
    """One part; from above, and beside it from below where that shows more."""
    body = [ColouredMesh(triangulate_solid(part.solid), MATERIAL_OF_PART[part.name].colour)]
    above = render_solids(body, FROM_ABOVE)
    return cv2.hconcat([above, render_solids(body, FROM_BELOW)]) if part.name in PARTS_SHOWN_FROM_BELOW else above


def render_sensor(bodies: Sequence[AssemblyBody]) -> BgrImage:
    """The finished sensor."""
    return render_solids(colour_bodies(bodies))


def render_exploded_view(bodies: Sequence[AssemblyBody]) -> BgrImage:
    """Pulled apart along z, in the order of assembly."""
    further = explosion_scale(bodies)
    moved = [
        AssemblyBody(body.name, Pos(0, 0, further * _lift_mm(body.name)) * body.solid, body.material) for body in bodies
    ]
    return render_solids(colour_bodies(moved), ViewDirection(-52.0, 20.0), (560, 1500))


def explosion_scale(bodies: Sequence[AssemblyBody]) -> float:
    """How often the published shell's size this one's is, by the side that grew most; at least once."""
    (shell,) = (body for body in bodies if body.name == "sensor_shell")
    sides = zip(tuple(shell.solid.bounding_box().size), PUBLISHED_SHELL_MM, strict=True)
    return max(1.0, *(side / published for side, published in sides))


def _lift_mm(name: str) -> float:
    """Inserts of the shell rise with it."""
    kind = name.rstrip("0123456789").rstrip("_")
    if kind == "insert" and int(name.split("_")[1]) > 4:
        return LIFTS_MM["sensor_shell"]
    return LIFTS_MM[kind]


def render_section(bodies: Sequence[AssemblyBody]) -> BgrImage:
    """Cut open through the middle, the half at -y taken away."""
    return render_solids(colour_bodies(cut_bodies_open(bodies)), SECTION_VIEW, (1000, 800))


def cut_bodies_open(bodies: Sequence[AssemblyBody]) -> list[AssemblyBody]:
    """What is left at +y of a plane just beside the axis, along which bodies touch."""
    keep = Pos(0, FAR_MM + 0.01, 0) * Box(2 * FAR_MM, 2 * FAR_MM, 2 * FAR_MM)
    halves = ((body, body.solid & keep) for body in bodies)
    return [
        AssemblyBody(body.name, Part() + half, body.material)
        for body, half in halves
        if half is not None and half.volume > 0
    ]


def colour_bodies(bodies: Iterable[AssemblyBody]) -> list[ColouredMesh]:
    """Each in its material's colour."""
    return [ColouredMesh(triangulate_solid(body.solid), body.material.colour) for body in bodies]
