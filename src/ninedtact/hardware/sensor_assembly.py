"""All bodies of the finished sensor, placed.

What two bodies share, and how far apart they are, measured on the solids.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

from build123d import Part

from ninedtact.hardware.design import HardwareDesign
from ninedtact.hardware.materials import MATERIAL_OF_PART, Material
from ninedtact.hardware.parts.bought_parts import build_insert, build_screw
from ninedtact.hardware.parts.part_catalogue import BuiltPart, build_parts

ASSEMBLY_PARTS = (
    "sensor_base",
    "camera",
    "led_board",
    "isolation_ring",
    "sensor_shell",
    "acrylic_window",
    "transparent_gel",
    "translucent_gel",
    "black_gel",
)
"""From below; tools (moulds, calibration board) are not in it."""


@dataclass(frozen=True)
class AssemblyBody:
    """One body at its place."""

    name: str
    solid: Part
    material: Material

    @property
    def mass_g(self) -> float:
        """By its volume and its material's density."""
        return float(self.solid.volume) / 1000 * self.material.g_per_cm3


def place_assembly_bodies(design: HardwareDesign, parts: Mapping[str, BuiltPart] | None = None) -> list[AssemblyBody]:
    """Parts are built where they belong; fasteners are placed. parts: those built already."""
    parts = build_parts(design) if parts is None else parts
    placed = [AssemblyBody(name, parts[name].solid, MATERIAL_OF_PART[name]) for name in ASSEMBLY_PARTS]
    return [*placed, *_place_fasteners(design)]


def _place_fasteners(design: HardwareDesign) -> Iterator[AssemblyBody]:
    """Inserts and screws, each a body of its own."""
    plan, levels = design.plan_view, design.heights
    long = design.fasteners.insert_mm[1]
    inserts = [build_insert(design, place, levels.boss_top) for place in plan.mount_inserts]
    inserts += [build_insert(design, place, levels.plate_top + long) for place in plan.shell_screws]
    yield from _number_bodies("insert", inserts)
    yield from _number_bodies("screw", (build_screw(design, place) for place in plan.shell_screws))


def _number_bodies(name: str, solids: Iterable[Part]) -> Iterator[AssemblyBody]:
    """`insert_1`, `insert_2` and so on."""
    for number, solid in enumerate(solids, start=1):
        yield AssemblyBody(f"{name}_{number}", solid, MATERIAL_OF_PART[name])


MIN_OVERLAP_MM3 = 1e-3
"""Less is rounding where faces touch."""
ADJACENT_MM = 1.0
"""Pairs farther apart are not listed."""


@dataclass(frozen=True)
class BodyPair:
    """Two bodies near each other."""

    first: str
    second: str
    overlap_mm3: float
    """Volume that both claim."""
    distance_mm: float
    """Least distance; zero where they touch."""

    @property
    def is_intended(self) -> bool:
        """A heat-set insert melts its knurl into the bore."""
        names = self.first.split("_")[0], self.second.split("_")[0]
        return "insert" in names and "sensor" in names

    @property
    def interferes(self) -> bool:
        """Both cannot be there."""
        return self.overlap_mm3 > MIN_OVERLAP_MM3 and not self.is_intended


def find_adjacent_bodies(bodies: Sequence[AssemblyBody]) -> Iterator[BodyPair]:
    """All pairs that are near each other."""
    boxes = {body.name: body.solid.bounding_box() for body in bodies}
    for first, second in combinations(bodies, 2):
        if _box_distance_mm(boxes[first.name], boxes[second.name]) <= ADJACENT_MM:
            pair = measure_body_pair(first, second)
            if pair.distance_mm <= ADJACENT_MM:
                yield pair


def measure_body_pair(first: AssemblyBody, second: AssemblyBody) -> BodyPair:
    """One pair."""
    apart = float(first.solid.distance_to(second.solid))
    return BodyPair(first.name, second.name, _overlap_mm3(first, second) if apart < 1e-6 else 0.0, apart)


def _overlap_mm3(first: AssemblyBody, second: AssemblyBody) -> float:
    """Volume of their intersection."""
    common = first.solid.intersect(second.solid)
    if common is None:
        return 0.0
    shapes = common if isinstance(common, list) else [common]
    return float(sum(shape.volume for shape in shapes))


def _box_distance_mm(first: object, second: object) -> float:
    """Largest gap between two boxes along an axis."""
    a, b = first, second
    gaps = [
        max(getattr(a.min, axis) - getattr(b.max, axis), getattr(b.min, axis) - getattr(a.max, axis))  # type: ignore[attr-defined]
        for axis in "XYZ"
    ]
    return float(max(gaps))
