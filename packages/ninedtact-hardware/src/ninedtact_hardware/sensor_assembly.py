"""The assembled sensor: every body in its position, and overlap and distance of neighbouring bodies measured on the
solids."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

from build123d import Part

from ninedtact_hardware.design import HardwareDesign
from ninedtact_hardware.materials import MATERIAL_OF_PART, Material
from ninedtact_hardware.part_catalogue import BuiltPart
from ninedtact_hardware.part_solids import build_heat_set_insert, build_screw

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
"""Parts of the assembled sensor from the bottom up; moulds and calibration board are tools."""


@dataclass(frozen=True)
class AssemblyBody:
    """A solid in its position within the assembled sensor."""

    name: str
    solid: Part

    @property
    def kind(self) -> str:
        """Name of its part: `insert` of `insert_1`."""
        return self.name.rstrip("0123456789").rstrip("_")

    @property
    def material(self) -> Material:
        """Material of its part."""
        return MATERIAL_OF_PART[self.kind]

    @property
    def mass_g(self) -> float:
        """Mass from volume and density of the material."""
        return float(self.solid.volume) / 1000 * self.material.g_per_cm3


def place_assembly_bodies(design: HardwareDesign, parts: Mapping[str, BuiltPart]) -> list[AssemblyBody]:
    """Return all bodies of the assembled sensor: parts are built in position, inserts and screws are placed and numbered."""
    plan, levels, long = design.horizontal_dimensions, design.heights, design.fasteners.insert_mm[1]
    inserts = [build_heat_set_insert(design, place, levels.boss_top) for place in plan.mount_inserts]
    inserts += [build_heat_set_insert(design, place, levels.plate_top + long) for place in plan.shell_screws]
    screws = [build_screw(design, place) for place in plan.shell_screws]
    return [
        *(AssemblyBody(name, parts[name].solid) for name in ASSEMBLY_PARTS),
        *(AssemblyBody(f"insert_{number}", solid) for number, solid in enumerate(inserts, start=1)),
        *(AssemblyBody(f"screw_{number}", solid) for number, solid in enumerate(screws, start=1)),
    ]


MIN_OVERLAP_MM3 = 1e-3
"""Least volume that counts as an overlap; smaller ones are rounding where faces touch."""
ADJACENT_MM = 1.0
"""Greatest distance of bodies that are listed as adjacent."""


@dataclass(frozen=True)
class BodyPair:
    """Two bodies near each other."""

    first: str
    second: str
    overlap_mm3: float
    """Volume that both bodies occupy."""
    distance_mm: float
    """Least distance; zero where they touch."""

    @property
    def is_intended(self) -> bool:
        """Whether an overlap is intended: the knurl of a heat-set insert melts into its bore."""
        names = self.first.split("_")[0], self.second.split("_")[0]
        return "insert" in names and "sensor" in names

    @property
    def interferes(self) -> bool:
        """Whether the bodies overlap unintentionally."""
        return self.overlap_mm3 > MIN_OVERLAP_MM3 and not self.is_intended


def find_nearby_part_pairs(bodies: Sequence[AssemblyBody]) -> Iterator[BodyPair]:
    """Yield all pairs of bodies that are near each other."""
    boxes = {body.name: body.solid.bounding_box() for body in bodies}
    for first, second in combinations(bodies, 2):
        one, other = boxes[first.name], boxes[second.name]
        if max(*(one.min - other.max), *(other.min - one.max)) <= ADJACENT_MM:  # along the axis of the largest gap
            pair = measure_body_pair(first, second)
            if pair.distance_mm <= ADJACENT_MM:
                yield pair


def measure_body_pair(first: AssemblyBody, second: AssemblyBody) -> BodyPair:
    """Measure distance and overlap of two bodies."""
    apart = float(first.solid.distance_to(second.solid))
    return BodyPair(first.name, second.name, _overlap_mm3(first, second) if apart < 1e-6 else 0.0, apart)


def _overlap_mm3(first: AssemblyBody, second: AssemblyBody) -> float:
    common = first.solid.intersect(second.solid)
    if common is None:
        return 0.0
    shapes = common if isinstance(common, list) else [common]
    return float(sum(shape.volume for shape in shapes))
