"""The bare LED board: its milled edge, its holes, and the bosses below it."""

from dataclasses import dataclass
from itertools import pairwise
from math import atan2, cos, hypot, pi, sin
from typing import Annotated

from ninedtact.design import Bounds, DesignImpossible
from ninedtact_hardware.part_dimensions import BoundedDimensions


class LedBoardImpossible(DesignImpossible):
    """Raised for a circuit board that cannot be laid out, made, or lit; the message names the rule."""


PointMm = tuple[float, float]
"""x and y in mm, in the frame that the package's docstring states."""


@dataclass(frozen=True)
class BoardOutline(BoundedDimensions, table="outline"):
    """A rectangle with a concave notch in each corner, a hole for the lens and four for the base's pins."""

    width_mm: Annotated[float, Bounds(24.0, 120.0)] = 28.0
    """Width along x: 0.25 less than the shell's cavity on each side. Below 24 the components do not fit."""
    height_mm: Annotated[float, Bounds(20.0, 100.0)] = 21.0
    """Height along y. Below 20 the LEDs lie over the lens hole."""
    thickness_mm: Annotated[float, Bounds(0.4, 2.0)] = 0.8
    """Thickness of the laminate. Board houses take 1.6 unless another is specified."""
    thickness_limit_mm: float = 1.08
    """Thickness at which the LEDs touch the shell; 1.08 in the published one."""
    lens_hole_mm: Annotated[float, Bounds(8.0, 10.4)] = 10.2
    """Diameter of the hole around the lens head of 10.00; above 10.4 the USB contacts have no pads left."""
    notch_radius_mm: Annotated[float, Bounds(0.5, 4.0)] = 2.8
    """Radius of the corner notches, 0.10 more than the shell's screw bosses."""
    notch_inset_mm: Annotated[PointMm, Bounds(0.0, 3.0)] = (0.5, 0.5)
    """Distance from the edges to the centre of a notch, which is the boss's axis."""
    locating_hole_mm: Annotated[float, Bounds(0.8, 3.0)] = 1.5
    """Diameter of the holes around the base's pins of 1.45."""
    locating_inset_mm: Annotated[PointMm, Bounds(1.2, 10.0)] = (1.5, 5.0)
    """Distance from the edges to the centre of a locating hole."""
    boss_inset_mm: Annotated[PointMm, Bounds(0.0, 30.0)] = (5.5, 2.75)
    """Distance from the edges to the axes of the base's insert bosses under the board."""
    boss_mm: Annotated[float, Bounds(2.0, 8.0)] = 5.3
    """Diameter of these bosses."""
    boss_gap_mm: Annotated[float, Bounds(0.0, 5.0)] = 1.0
    """Distance from a boss to the board; components above a boss are lower than this."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.thickness_mm <= self.thickness_limit_mm + 1e-9:
            raise LedBoardImpossible(
                f"expected outline.thickness_mm of at most {self.thickness_limit_mm:.4g}, at which the LEDs touch the shell, got "
                f"{self.thickness_mm:g}; take a thinner board"
            )
        if not self.notch_radius_mm > max(self.notch_inset_mm):
            raise LedBoardImpossible(
                f"expected outline.notch_radius_mm above the notches' inset of {max(self.notch_inset_mm):g}, "
                f"got {self.notch_radius_mm:g}; a smaller one is a hole, not a notch"
            )

    @property
    def half(self) -> PointMm:
        """Half the width and half the height."""
        return self.width_mm / 2, self.height_mm / 2

    def corners(self, inset_mm: PointMm) -> tuple[PointMm, ...]:
        """Return the four points at this distance inside the edges, counter-clockwise from the upper right."""
        x, y = self.half[0] - inset_mm[0], self.half[1] - inset_mm[1]
        return (x, y), (-x, y), (-x, -y), (x, -y)

    @property
    def notches(self) -> tuple[PointMm, ...]:
        """Centres of the corner notches."""
        return self.corners(self.notch_inset_mm)

    @property
    def locating_holes(self) -> tuple[PointMm, ...]:
        """Centres of the holes for the base's pins."""
        return self.corners(self.locating_inset_mm)

    @property
    def bosses(self) -> tuple[PointMm, ...]:
        """Axes of the base's insert bosses."""
        return self.corners(self.boss_inset_mm)

    @property
    def notch_ends(self) -> PointMm:
        """The x at which the upper and lower straight edges end, and the y at which the left and right ones do."""
        (x, y), r = self.notches[0], self.notch_radius_mm
        return x - (r**2 - self.notch_inset_mm[1] ** 2) ** 0.5, y - (r**2 - self.notch_inset_mm[0] ** 2) ** 0.5


@dataclass(frozen=True)
class OutlineSegment:
    """A segment of the milled edge: straight, or clockwise around a centre."""

    start_mm: PointMm
    end_mm: PointMm
    centre_mm: PointMm | None = None

    @property
    def middle(self) -> PointMm:
        """The point halfway along the segment."""
        (ax, ay), (bx, by) = self.start_mm, self.end_mm
        if self.centre_mm is None:
            return (ax + bx) / 2, (ay + by) / 2
        x, y = self.centre_mm
        start, end = atan2(ay - y, ax - x), atan2(by - y, bx - x)
        angle, radius = start - ((start - end) % (2 * pi) or 2 * pi) / 2, hypot(ax - x, ay - y)
        return x + radius * cos(angle), y + radius * sin(angle)


def outline_segments(outline: BoardOutline) -> tuple[OutlineSegment, ...]:
    """Return the segments of the rim with its notches, counter-clockwise, then those of the lens hole."""
    return (*_rim_segments(outline), *_lens_hole_segments(outline))


def _rim_segments(outline: BoardOutline) -> tuple[OutlineSegment, ...]:
    """Return the closed rim: each segment starts where the one before ends. Notches turn clockwise, into the board."""
    (x, y), (end_x, end_y), centres = outline.half, outline.notch_ends, outline.notches
    corners = (
        ((x, end_y), (end_x, y)),
        ((-end_x, y), (-x, end_y)),
        ((-x, -end_y), (-end_x, -y)),
        ((end_x, -y), (x, -end_y)),
    )
    notches = [OutlineSegment(start, end, centre) for (start, end), centre in zip(corners, centres, strict=True)]
    straights = [OutlineSegment(a.end_mm, b.start_mm) for a, b in pairwise((*notches, notches[0]))]
    return tuple(edge for pair in zip(notches, straights, strict=True) for edge in pair)


def _lens_hole_segments(outline: BoardOutline) -> tuple[OutlineSegment, ...]:
    """Return the lens hole in four quarters: some programs confuse the two halves of a circle."""
    radius, centre = outline.lens_hole_mm / 2, (0.0, 0.0)
    ends = ((radius, 0.0), (0.0, -radius), (-radius, 0.0), (0.0, radius))
    return tuple(OutlineSegment(start, end, centre) for start, end in pairwise((*ends, ends[0])))
