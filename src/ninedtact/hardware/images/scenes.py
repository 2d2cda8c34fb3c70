"""What images show: parts alone, the sensor whole, cut open, or pulled apart."""

from collections.abc import Iterable, Sequence

import cv2
from build123d import Box, Part, Pos

from ninedtact.hardware.assembly.bodies import Body
from ninedtact.hardware.images.shaded import ABOVE, BELOW, Coloured, Eye, Image, shaded
from ninedtact.hardware.images.triangles import triangles_of
from ninedtact.hardware.materials import MADE_OF
from ninedtact.hardware.parts.catalogue import BuiltPart

SEEN_FROM_BELOW = ("sensor_shell",)
"""Parts whose lower side has more to show; both are drawn."""
INTO_THE_CUT = Eye(-68.0, 18.0)
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


def part_image(part: BuiltPart) -> Image:
    """One part; from above, and beside it from below where that shows more."""
    body = [Coloured(triangles_of(part.solid), MADE_OF[part.name].colour)]
    above = shaded(body, ABOVE)
    return cv2.hconcat([above, shaded(body, BELOW)]) if part.name in SEEN_FROM_BELOW else above


def sensor_image(bodies: Sequence[Body]) -> Image:
    """The finished sensor."""
    return shaded(coloured(bodies))


def exploded_image(bodies: Sequence[Body]) -> Image:
    """Pulled apart along z, in the order of assembly."""
    further = larger(bodies)
    moved = [Body(body.name, Pos(0, 0, further * lift_mm(body.name)) * body.solid, body.material) for body in bodies]
    return shaded(coloured(moved), Eye(-52.0, 20.0), (560, 1500))


def larger(bodies: Sequence[Body]) -> float:
    """How often the published shell's size this one's is, by the side that grew most; at least once."""
    (shell,) = (body for body in bodies if body.name == "sensor_shell")
    sides = zip(tuple(shell.solid.bounding_box().size), PUBLISHED_SHELL_MM, strict=True)
    return max(1.0, *(side / published for side, published in sides))


def lift_mm(name: str) -> float:
    """Inserts of the shell rise with it."""
    kind = name.rstrip("0123456789").rstrip("_")
    if kind == "insert" and int(name.split("_")[1]) > 4:
        return LIFTS_MM["sensor_shell"]
    return LIFTS_MM[kind]


def section_image(bodies: Sequence[Body]) -> Image:
    """Cut open through the middle, the half at -y taken away."""
    return shaded(coloured(cut_open(bodies)), INTO_THE_CUT, (1000, 800))


def cut_open(bodies: Sequence[Body]) -> list[Body]:
    """What is left at +y of a plane just beside the axis, along which bodies touch."""
    keep = Pos(0, FAR_MM + 0.01, 0) * Box(2 * FAR_MM, 2 * FAR_MM, 2 * FAR_MM)
    halves = ((body, body.solid & keep) for body in bodies)
    return [
        Body(body.name, Part() + half, body.material) for body, half in halves if half is not None and half.volume > 0
    ]


def coloured(bodies: Iterable[Body]) -> list[Coloured]:
    """Each in its material's colour."""
    return [Coloured(triangles_of(body.solid), body.material.colour) for body in bodies]
