"""A polygon with holes as one contour: from each hole a level cut of no width to what lies left of it."""

from collections.abc import Iterable
from itertools import pairwise

from shapely import Polygon

from ninedtact.hardware.led_board.outline import Place


def without_holes(polygon: Polygon) -> tuple[Place, ...]:
    """The contour, not closed. Gerber regions and KiCad's fills know no holes."""
    contour = ring(polygon.exterior.coords)
    for hole in sorted((from_leftmost(ring(interior.coords)) for interior in polygon.interiors), key=lambda h: h[0][0]):
        after, cut = left_of(contour, hole[0])
        contour = [*contour[: after + 1], cut, *hole, hole[0], cut, *contour[after + 1 :]]
    return tuple(contour)


def ring(coordinates: Iterable[tuple[float, ...]]) -> list[Place]:
    """Points of a closed ring without the last, which is the first again."""
    return [(x, y) for x, y in list(coordinates)[:-1]]


def from_leftmost(hole: list[Place]) -> list[Place]:
    """The same ring, begun at its leftmost point."""
    start = hole.index(min(hole))
    return hole[start:] + hole[:start]


def left_of(contour: list[Place], point: Place) -> tuple[int, Place]:
    """The nearest place of a contour straight left of a point, and the number of the edge that it is on."""
    x, y = point
    found = []
    for number, (a, b) in enumerate(pairwise([*contour, contour[0]])):
        if (a[1] > y) != (b[1] > y):
            cut = a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0])
            if cut < x:
                found.append((cut, number))
    cut, number = max(found)
    return number, (cut, y)
