"""A hardware design with everything derived from it: solids, assembly, clearances, bill of materials and check report."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

from ninedtact_hardware.bill_of_materials import BillItem, build_bill_of_materials, sensor_cost_usd
from ninedtact_hardware.buildability import require_buildable_design
from ninedtact_hardware.clearances import Clearance, list_clearances
from ninedtact_hardware.design import HardwareDesign, lens_view_radius_mm, sensing_corner_distance_mm
from ninedtact_hardware.led_board import describe_redrawing, list_board_differences
from ninedtact_hardware.published_specifications import (
    OTHER_PUBLISHED_SENSORS,
    PUBLISHED_9DTACT,
    SensorSpecification,
    format_sensor_comparison,
)
from ninedtact_hardware.sensor_assembly import (
    BodyPair,
    BuiltPart,
    build_parts,
    find_nearby_part_pairs,
    place_assembly_bodies,
)


@dataclass(frozen=True)
class BuildableDesign:
    """A design that keeps all rules; raises `DesignNotBuildable` for another. Its solids are built on first access."""

    design: HardwareDesign

    def __post_init__(self) -> None:
        require_buildable_design(self.design)

    @cached_property
    def parts(self) -> dict[str, BuiltPart]:
        """The built parts by name; raises `DesignImpossible`."""
        return build_parts(self.design)

    @cached_property
    def bodies(self) -> list[BuiltPart]:
        """The bodies of the assembled sensor."""
        return place_assembly_bodies(self.design, self.parts)

    @cached_property
    def adjacent_bodies(self) -> list[BodyPair]:
        """Pairs of bodies that are near each other."""
        return [*find_nearby_part_pairs(self.bodies)]

    @property
    def interferences(self) -> list[BodyPair]:
        """Pairs of bodies that overlap unintentionally."""
        return [pair for pair in self.adjacent_bodies if pair.interferes]

    @cached_property
    def clearances(self) -> list[Clearance]:
        """Clearances between parts, computed from their dimensions."""
        return [*list_clearances(self.design)]

    @cached_property
    def led_board_differences(self) -> list[str]:
        """In what the LED board of this design differs from the stored one; nothing if that one fits."""
        return list_board_differences(self.design)

    @cached_property
    def bill(self) -> list[BillItem]:
        """The bill of materials."""
        return build_bill_of_materials(self.design, {name: part.volume_mm3 for name, part in self.parts.items()})

    @cached_property
    def specification(self) -> SensorSpecification:
        """Size without cable and plug, sensing area, mass and cost, as a row of the paper's table."""
        design, area = self.design, self.design.sensor.sensing_area
        return SensorSpecification(
            f"this design ({design.variant})",
            (*design.horizontal_dimensions.outer, design.heights.top),
            area.width_mm * area.height_mm,
            sum(body.mass_g for body in self.bodies),
            sensor_cost_usd(self.bill),
            "parts, estimated",
        )

    def to_json_dict(self) -> dict[str, Any]:
        """Return the results of all checks as a dictionary that JSON can hold."""
        return {
            "variant": self.design.variant,
            "specification": {**asdict(self.specification), "ratio_mm": self.specification.ratio_mm},
            "paper": {**asdict(PUBLISHED_9DTACT), "ratio_mm": PUBLISHED_9DTACT.ratio_mm},
            "others": [{**asdict(other), "ratio_mm": other.ratio_mm} for other in OTHER_PUBLISHED_SENSORS],
            "lens_reach_mm": lens_view_radius_mm(self.design),
            "sensing_corner_distance_mm": sensing_corner_distance_mm(self.design),
            "interferences": [asdict(pair) for pair in self.interferences],
            "adjacent_bodies": [asdict(pair) for pair in self.adjacent_bodies],
            "led_board_differences": self.led_board_differences,
            "clearances": [{**asdict(clearance), "is_tight": clearance.is_tight} for clearance in self.clearances],
            "masses_g": {body.name: body.mass_g for body in self.bodies},
        }

    def check_report_lines(self) -> Iterator[str]:
        """Yield the results of all checks as lines of text."""
        tight = sum(clearance.is_tight for clearance in self.clearances)
        kept = f"no rule broken, but {tight} clearances are tight" if tight else "all rules kept"
        yield f"design {self.design.variant}: {kept}; {len(self.bodies)} bodies"
        yield from _format_interferences(self)
        differences = self.led_board_differences
        yield f"  LED board: {describe_redrawing(differences)}" if differences else "  the stored LED board fits"
        yield from _format_clearances(self.clearances)
        reach, corner = lens_view_radius_mm(self.design), sensing_corner_distance_mm(self.design)
        yield f"the lens reaches {reach:.2f} mm, the sensing area's corner is at {corner:.2f} mm"
        yield "comparison with Table I of the paper (mass of this design by assumed densities, its cost by estimated prices):"
        rows = (self.specification, PUBLISHED_9DTACT, *OTHER_PUBLISHED_SENSORS)
        yield from ("  " + line for line in format_sensor_comparison(rows))


def _format_interferences(sensor: BuildableDesign) -> Iterator[str]:
    for pair in sensor.interferences:
        yield f"  INTERFERES: {pair.first} and {pair.second} overlap by {pair.overlap_mm3:.3f} mm³"
    meant = sum(pair.overlap_mm3 > 0 and pair.is_intended for pair in sensor.adjacent_bodies)
    many = len(sensor.interferences)
    pairs = "1 pair interferes" if many == 1 else f"{many} pairs interfere"
    yield f"  {pairs}; {meant} inserts overlap with their bores, as intended: they melt into them"


def _format_clearances(clearances: list[Clearance]) -> Iterator[str]:
    yield "clearances in mm (required):"
    for clearance in clearances:
        tight = "   TIGHT" if clearance.is_tight else ""
        yield f"  {clearance.clearance_mm:7.3f} ({clearance.required_mm:.2f}) {clearance.faces}{tight}"
