"""What two bodies share, and how far apart they are, measured on the solids."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

from ninedtact.hardware.assembly.bodies import Body

SHARED_MM3 = 1e-3
"""Less is rounding where faces touch."""
NEAR_MM = 1.0
"""Pairs farther apart are not listed."""


@dataclass(frozen=True)
class Meeting:
    """Two bodies near each other."""

    first: str
    second: str
    shared_mm3: float
    """Volume that both claim."""
    apart_mm: float
    """Least distance; zero where they touch."""

    @property
    def meant(self) -> bool:
        """A heat-set insert melts its knurl into the bore."""
        names = self.first.split("_")[0], self.second.split("_")[0]
        return "insert" in names and "sensor" in names

    @property
    def interferes(self) -> bool:
        """Both cannot be there."""
        return self.shared_mm3 > SHARED_MM3 and not self.meant


def meetings(bodies: Sequence[Body]) -> Iterator[Meeting]:
    """All pairs that are near each other."""
    boxes = {body.name: body.solid.bounding_box() for body in bodies}
    for first, second in combinations(bodies, 2):
        if boxes_apart(boxes[first.name], boxes[second.name]) <= NEAR_MM:
            meeting = met(first, second)
            if meeting.apart_mm <= NEAR_MM:
                yield meeting


def met(first: Body, second: Body) -> Meeting:
    """One pair."""
    apart = float(first.solid.distance_to(second.solid))
    return Meeting(first.name, second.name, shared(first, second) if apart < 1e-6 else 0.0, apart)


def shared(first: Body, second: Body) -> float:
    """Volume of their intersection."""
    common = first.solid.intersect(second.solid)
    if common is None:
        return 0.0
    shapes = common if isinstance(common, list) else [common]
    return float(sum(shape.volume for shape in shapes))


def boxes_apart(first: object, second: object) -> float:
    """Largest gap between two boxes along an axis."""
    a, b = first, second
    gaps = [
        max(getattr(a.min, axis) - getattr(b.max, axis), getattr(b.min, axis) - getattr(a.max, axis))  # type: ignore[attr-defined]
        for axis in "XYZ"
    ]
    return float(max(gaps))
