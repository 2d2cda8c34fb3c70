"""Published specifications of sensors: size, sensing area, mass and cost, as in Table I of the 9DTact paper; and the
discrepancies between that paper and its design files.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from ninedtact.hardware.design import HardwareDesign

BoxSize = tuple[float, float, float]


@dataclass(frozen=True)
class SensorSpecification:
    """One row of the comparison table."""

    name: str
    size_mm: BoxSize
    sensing_mm: tuple[float, float]
    mass_g: float
    cost_usd: float

    @property
    def ratio_mm(self) -> float:
        """Volume of the sensor's box over its sensing area, called dimension-to-area ratio in the paper."""
        x, y, z = self.size_mm
        return x * y * z / (self.sensing_mm[0] * self.sensing_mm[1])


PUBLISHED_9DTACT = SensorSpecification("9DTact, as published", (32.5, 25.5, 25.5), (24.0, 18.0), 20.0, 15.0)
"""The published 9DTact (docs/references.md#9dtact)."""
PUBLISHED_DIGIT = SensorSpecification("DIGIT, as published", (20.0, 27.0, 18.0), (19.0, 16.0), 20.0, 15.0)
"""The published DIGIT (docs/references.md#digit); its cost is that of the parts for one of a thousand."""
OTHER_SENSING_AREAS_MM2 = {"GelSight Mini": 18.6 * 14.3, "GelSlim 3.0": 675.0, "Insight (a dome)": 4800.0}
"""docs/references.md#sensing-areas. Size, mass and cost of these sensors, as the paper's table has them, are not known
here."""


def specification_of_design(design: HardwareDesign, masses_g: Iterable[float], cost_usd: float) -> SensorSpecification:
    """Return the row of the comparison table for a design, from the masses of its bodies and its cost.

    Its size is that of the finished sensor without cable and plug.
    """
    area = design.sensor.sensing_area
    return SensorSpecification(
        f"this design ({design.variant})",
        (*design.plan_view.outer, design.heights.top),
        (area.width_mm, area.height_mm),
        sum(masses_g),
        cost_usd,
    )


def format_specification_table(rows: Iterable[SensorSpecification]) -> Iterator[str]:
    """Yield the comparison table as lines of text."""
    yield f"{'':28}{'size mm':>20}{'sensing mm':>14}{'D/A mm':>9}{'mass g':>9}{'cost $':>9}"
    for row in rows:
        size = " x ".join(f"{side:.1f}" for side in row.size_mm)
        area = " x ".join(f"{side:g}" for side in row.sensing_mm)
        yield f"{row.name:28}{size:>20}{area:>14}{row.ratio_mm:9.1f}{row.mass_g:9.1f}{row.cost_usd:9.1f}"
    areas = ", ".join(f"{name} {area:.0f}" for name, area in OTHER_SENSING_AREAS_MM2.items())
    yield f"sensing areas of others, mm²: {areas}"


@dataclass(frozen=True)
class _PublicationDiscrepancy:
    """A property for which the paper and its design files give different values."""

    feature: str
    paper: str
    files: str
    here: str
    """The value that the default design uses."""


PUBLICATION_DISCREPANCIES = (
    _PublicationDiscrepancy(
        "height", "25.5 mm", "25.30 by the moulds, 25.00 by the CAD", "25.30: 2.50 + 0.30 of gel on 22.50"
    ),
    _PublicationDiscrepancy(
        "sensing area",
        "24 x 18 mm",
        "no such feature: an opening of 28.50 x 21.50, a crop of 23.0 to 23.5",
        "24 x 18, nominal",
    ),
    _PublicationDiscrepancy(
        "circuit board", "28 x 21 x 4 mm", "0.80 thick in the assembly, 1.6 in the order file", "order 0.80 mm"
    ),
    _PublicationDiscrepancy("translucent gel", "2.5 mm (mould)", "2.5 in the cutting file, 2.00 in the CAD", "2.50"),
    _PublicationDiscrepancy("black gel", "0.3 mm (mould 2.8)", "2.8 in the cutting file, 0.50 in the CAD", "0.30"),
    _PublicationDiscrepancy("screws", "4 x M2-6", "M2-5", "M2-6 (original: M2-5); both fit"),
    _PublicationDiscrepancy(
        "calibration board",
        "fits into the sensor shell",
        "33.00 x 26.00 inside: fits over it",
        "over it, 0.25 each side",
    ),
    _PublicationDiscrepancy(
        "LED resistor",
        "",
        "20 k in the order files, 3.75 k as text in the schematic",
        "20 k; [hardware.board] resistor_ohm",
    ),
)
"""Discrepancies between the published paper and its files, for the published size."""
