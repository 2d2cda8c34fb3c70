"""Images of the parts and of the assembled sensor: whole, exploded and cut open."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import cv2
from build123d import Box, Part, Pos

from ninedtact.hardware.export.solid_files import triangulate_solid
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
"""Parts whose lower side shows more; they are drawn from both sides."""
SECTION_VIEW = ViewDirection(-68.0, 18.0)
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
    body = colour_bodies([AssemblyBody(part.name, part.solid)])
    above = render_solids(body, FROM_ABOVE)
    return cv2.hconcat([above, render_solids(body, FROM_BELOW)]) if part.name in PARTS_SHOWN_FROM_BELOW else above


def render_sensor(bodies: Sequence[AssemblyBody]) -> BgrImage:
    """Render the assembled sensor."""
    return render_solids(colour_bodies(bodies))


def render_exploded_view(bodies: Sequence[AssemblyBody]) -> BgrImage:
    """Render the bodies pulled apart along z, in the order of assembly."""
    further = explosion_scale(bodies)
    moved = [replace(body, solid=Pos(0, 0, further * _lift_mm(body)) * body.solid) for body in bodies]
    return render_solids(colour_bodies(moved), ViewDirection(-52.0, 20.0), (560, 1500))


def explosion_scale(bodies: Sequence[AssemblyBody]) -> float:
    """Return the factor by which the shell is larger than the published one, along its side that grew most; at least 1."""
    (shell,) = (body for body in bodies if body.name == "sensor_shell")
    sides = zip(tuple(shell.solid.bounding_box().size), PUBLISHED_SHELL_MM, strict=True)
    return max(1.0, *(side / published for side, published in sides))


def _lift_mm(body: AssemblyBody) -> float:
    """Return the height by which a body is raised; the shell's inserts rise with the shell."""
    if body.kind == "insert" and int(body.name.split("_")[1]) > 4:
        return LIFTS_MM["sensor_shell"]
    return LIFTS_MM[body.kind]


def render_section(bodies: Sequence[AssemblyBody]) -> BgrImage:
    """Render the sensor cut open through the middle, the half at -y removed."""
    return render_solids(colour_bodies(cut_bodies_open(bodies)), SECTION_VIEW, (1000, 800))


def cut_bodies_open(bodies: Sequence[AssemblyBody]) -> list[AssemblyBody]:
    """Return the halves at +y of a plane just beside the axis, so that it does not coincide with touching faces."""
    keep = Pos(0, FAR_MM + 0.01, 0) * Box(2 * FAR_MM, 2 * FAR_MM, 2 * FAR_MM)
    halves = ((body, body.solid & keep) for body in bodies)
    return [replace(body, solid=Part() + half) for body, half in halves if half is not None and half.volume > 0]


def colour_bodies(bodies: Iterable[AssemblyBody]) -> list[ColouredMesh]:
    """Triangulate bodies and give each the colour of its material."""
    return [ColouredMesh(triangulate_solid(body.solid), body.material.colour) for body in bodies]
