"""A sensor's figures as the paper's Table I has them, beside those of other sensors."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from ninedtact.hardware.design import HardwareDesign

Size = tuple[float, float, float]


@dataclass(frozen=True)
class SensorFigures:
    """One row of the table."""

    name: str
    size_mm: Size
    sensing_mm: tuple[float, float]
    mass_g: float
    cost_usd: float

    @property
    def ratio_mm(self) -> float:
        """Dimension-to-area ratio: volume of the box over the sensing area."""
        x, y, z = self.size_mm
        return x * y * z / (self.sensing_mm[0] * self.sensing_mm[1])


PAPER = SensorFigures("9DTact, as published", (32.5, 25.5, 25.5), (24.0, 18.0), 20.0, 15.0)
"""docs/references.md#9dtact."""
DIGIT = SensorFigures("DIGIT, as published", (20.0, 27.0, 18.0), (19.0, 16.0), 20.0, 15.0)
"""docs/references.md#digit; its cost is of the parts of one of a thousand."""
OTHER_AREAS_MM2 = {"GelSight Mini": 18.6 * 14.3, "GelSlim 3.0": 675.0, "Insight (a dome)": 4800.0}
"""docs/references.md#sensing-areas. Of these, size, mass and cost as the paper's table has them are not known here."""


def sensor_size_mm(design: HardwareDesign) -> Size:
    """Of the finished sensor, without cable and plug."""
    return *design.plan.outer, design.levels.top


def sensor_figures(design: HardwareDesign, masses_g: Iterable[float], cost_usd: float) -> SensorFigures:
    """Of a design whose bodies were weighed and whose bill was added up."""
    area = design.sensor.sensing_area
    return SensorFigures(
        f"this design ({design.variant})",
        sensor_size_mm(design),
        (area.width_mm, area.height_mm),
        sum(masses_g),
        cost_usd,
    )


def table_one(rows: Iterable[SensorFigures]) -> Iterator[str]:
    """As text."""
    yield f"{'':28}{'size mm':>20}{'sensing mm':>14}{'D/A mm':>9}{'mass g':>9}{'cost $':>9}"
    for row in rows:
        size = " x ".join(f"{side:.1f}" for side in row.size_mm)
        area = " x ".join(f"{side:g}" for side in row.sensing_mm)
        yield f"{row.name:28}{size:>20}{area:>14}{row.ratio_mm:9.1f}{row.mass_g:9.1f}{row.cost_usd:9.1f}"
    areas = ", ".join(f"{name} {area:.0f}" for name, area in OTHER_AREAS_MM2.items())
    yield f"sensing areas of others, mm²: {areas}"
