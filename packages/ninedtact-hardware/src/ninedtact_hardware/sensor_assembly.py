"""The parts of a design: name, manufacturing method and builder of each, the built solids, the assembled sensor with every body in
its position, and overlap and distance of neighbouring bodies measured on the solids."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import Literal

from build123d import Part

from ninedtact.design import DesignImpossible
from ninedtact_hardware.design import HardwareDesign
from ninedtact_hardware.materials import MATERIAL_OF_PART, Material
from ninedtact_hardware.part_solids import (
    build_acrylic_window,
    build_base_board,
    build_black_gel,
    build_calibration_board,
    build_camera,
    build_first_mould,
    build_heat_set_insert,
    build_isolation_ring,
    build_led_board,
    build_screw,
    build_second_mould,
    build_sensor_base,
    build_sensor_shell,
    build_translucent_gel,
    build_transparent_gel,
)

ManufacturingMethod = Literal["printed", "cut", "cast", "bought"]

PART_CATALOGUE: dict[str, tuple[ManufacturingMethod, Callable[[HardwareDesign], Part]]] = {
    "sensor_base": ("printed", build_sensor_base),
    "sensor_shell": ("printed", build_sensor_shell),
    "isolation_ring": ("printed", build_isolation_ring),
    "calibration_board": ("printed", build_calibration_board),
    "acrylic_window": ("cut", build_acrylic_window),
    "base_board": ("cut", build_base_board),
    "first_mould": ("cut", build_first_mould),
    "second_mould": ("cut", build_second_mould),
    "transparent_gel": ("cast", build_transparent_gel),
    "translucent_gel": ("cast", build_translucent_gel),
    "black_gel": ("cast", build_black_gel),
    "camera": ("bought", build_camera),
    "led_board": ("bought", build_led_board),
}
"""Manufacturing method and builder of every part."""
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
class BuiltPart:
    """One part of a design as a solid, in its position within the assembled sensor; moulds and tools lie on z = 0."""

    name: str
    solid: Part

    @property
    def kind(self) -> str:
        """Name of the part: `insert` of `insert_1`."""
        return self.name.rstrip("0123456789").rstrip("_")

    @property
    def method(self) -> ManufacturingMethod:
        """How it is made; inserts and screws are bought."""
        return PART_CATALOGUE[self.name][0] if self.name in PART_CATALOGUE else "bought"

    @property
    def material(self) -> Material:
        """Its material."""
        return MATERIAL_OF_PART[self.kind]

    @cached_property
    def size_mm(self) -> tuple[float, float, float]:
        """Size of its bounding box."""
        size = self.solid.bounding_box().size
        return float(size.X), float(size.Y), float(size.Z)

    @cached_property
    def volume_mm3(self) -> float:
        """Its volume."""
        return float(self.solid.volume)

    @property
    def mass_g(self) -> float:
        """Mass from volume and density of the material."""
        return self.volume_mm3 / 1000 * self.material.g_per_cm3


def build_parts(design: HardwareDesign) -> dict[str, BuiltPart]:
    """Build all parts of a design that keeps all rules and return them by name.

    Raises `DesignImpossible` for a part that the modelling library cannot build, mostly for a fillet that does not fit its edges.
    """
    parts = dict[str, BuiltPart]()
    for name, (_, build) in PART_CATALOGUE.items():
        try:
            parts[name] = BuiltPart(name, build(design))
        except (ValueError, RuntimeError) as trouble:
            raise DesignImpossible(
                f"expected dimensions from which the {name} can be modelled, got: {trouble}; change its fillets, its chamfers or "
                "the widths beside them"
            ) from trouble
    return parts


def place_assembly_bodies(design: HardwareDesign, parts: Mapping[str, BuiltPart]) -> list[BuiltPart]:
    """Return all bodies of the assembled sensor: parts are built in position, inserts and screws are placed and numbered."""
    plan, levels, long = design.horizontal_dimensions, design.heights, design.fasteners.insert_mm[1]
    inserts = [build_heat_set_insert(design, place, levels.boss_top) for place in plan.mount_inserts]
    inserts += [build_heat_set_insert(design, place, levels.plate_top + long) for place in plan.shell_screws]
    screws = [build_screw(design, place) for place in plan.shell_screws]
    return [
        *(parts[name] for name in ASSEMBLY_PARTS),
        *(BuiltPart(f"insert_{number}", solid) for number, solid in enumerate(inserts, start=1)),
        *(BuiltPart(f"screw_{number}", solid) for number, solid in enumerate(screws, start=1)),
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


def find_nearby_part_pairs(bodies: Sequence[BuiltPart]) -> Iterator[BodyPair]:
    """Yield all pairs of bodies that are near each other."""
    boxes = {body.name: body.solid.bounding_box() for body in bodies}
    for first, second in combinations(bodies, 2):
        one, other = boxes[first.name], boxes[second.name]
        if max(*(one.min - other.max), *(other.min - one.max)) <= ADJACENT_MM:  # along the axis of the largest gap
            pair = measure_body_pair(first, second)
            if pair.distance_mm <= ADJACENT_MM:
                yield pair


def measure_body_pair(first: BuiltPart, second: BuiltPart) -> BodyPair:
    """Measure distance and overlap of two bodies."""
    apart = float(first.solid.distance_to(second.solid))
    return BodyPair(first.name, second.name, _overlap_mm3(first, second) if apart < 1e-6 else 0.0, apart)


def _overlap_mm3(first: BuiltPart, second: BuiltPart) -> float:
    common = first.solid.intersect(second.solid)
    if common is None:
        return 0.0
    shapes = common if isinstance(common, list) else [common]
    return float(sum(shape.volume for shape in shapes))
