"""The milled edge as straight lines and arcs."""

from dataclasses import dataclass
from itertools import pairwise
from math import atan2, cos, hypot, pi, sin

from ninedtact.hardware.led_board.outline import BoardOutline, Place


@dataclass(frozen=True)
class Edge:
    """From start to end: straight, or clockwise round a centre."""

    start_mm: Place
    end_mm: Place
    centre_mm: Place | None = None

    @property
    def middle(self) -> Place:
        """Half-way along."""
        (ax, ay), (bx, by) = self.start_mm, self.end_mm
        if self.centre_mm is None:
            return (ax + bx) / 2, (ay + by) / 2
        x, y = self.centre_mm
        start, end = atan2(ay - y, ax - x), atan2(by - y, bx - x)
        angle, radius = start - ((start - end) % (2 * pi) or 2 * pi) / 2, hypot(ax - x, ay - y)
        return x + radius * cos(angle), y + radius * sin(angle)


def edges(outline: BoardOutline) -> tuple[Edge, ...]:
    """The rim with its notches, counter-clockwise, then the lens hole."""
    return (*rim_edges(outline), *lens_edges(outline))


def rim_edges(outline: BoardOutline) -> tuple[Edge, ...]:
    """Closed: each edge starts where the one before ended. Notches are cut into the board, so they turn clockwise."""
    (x, y), (end_x, end_y), centres = outline.half, outline.notch_ends, outline.notches
    corners = (
        ((x, end_y), (end_x, y)),
        ((-end_x, y), (-x, end_y)),
        ((-x, -end_y), (-end_x, -y)),
        ((end_x, -y), (x, -end_y)),
    )
    notches = [Edge(start, end, centre) for (start, end), centre in zip(corners, centres, strict=True)]
    straights = [Edge(a.end_mm, b.start_mm) for a, b in pairwise((*notches, notches[0]))]
    return tuple(edge for pair in zip(notches, straights, strict=True) for edge in pair)


def lens_edges(outline: BoardOutline) -> tuple[Edge, ...]:
    """Four quarters: some programs take a half circle's two halves for the same one."""
    radius, centre = outline.lens_hole_mm / 2, (0.0, 0.0)
    ends = ((radius, 0.0), (0.0, -radius), (-radius, 0.0), (0.0, radius))
    return tuple(Edge(start, end, centre) for start, end in pairwise((*ends, ends[0])))
