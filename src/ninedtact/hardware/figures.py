"""A sensor's figures as the paper's Table I has them, and where paper, files and model disagree."""

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
"""docs/references.md#9dtact. Its table has other sensors too; their figures are not known here, so they are not repeated."""


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


@dataclass(frozen=True)
class Disagreement:
    """One thing that the paper and its files say differently, and what is done here."""

    thing: str
    paper: str
    files: str
    here: str


DISAGREEMENTS = (
    Disagreement("height", "25.5 mm", "25.30 by the moulds, 25.00 by the CAD", "25.30: 2.50 + 0.30 of gel on 22.50"),
    Disagreement(
        "sensing area",
        "24 x 18 mm",
        "no such feature: an opening of 28.50 x 21.50, a crop of 23.0 to 23.5",
        "24 x 18, nominal",
    ),
    Disagreement(
        "circuit board", "28 x 21 x 4 mm", "0.80 thick in the assembly, 1.6 in the order file", "order 0.80 mm"
    ),
    Disagreement("translucent gel", "2.5 mm (mould)", "2.5 in the cutting file, 2.00 in the CAD", "2.50"),
    Disagreement("black gel", "0.3 mm (mould 2.8)", "2.8 in the cutting file, 0.50 in the CAD", "0.30"),
    Disagreement("screws", "4 x M2-6", "M2-5", "M2-6 (original: M2-5); both fit"),
    Disagreement(
        "calibration board",
        "fits into the sensor shell",
        "33.00 x 26.00 inside: fits over it",
        "over it, 0.25 each side",
    ),
    Disagreement("LED resistor", "", "20 k in the order files, 3.75 k as text in the schematic", "20 k, a parameter"),
)
"""Of the published paper and files."""


def table_one(rows: Iterable[SensorFigures]) -> Iterator[str]:
    """As text."""
    yield f"{'':28}{'size mm':>20}{'sensing mm':>14}{'D/A mm':>9}{'mass g':>9}{'cost $':>9}"
    for row in rows:
        size = " x ".join(f"{side:.1f}" for side in row.size_mm)
        area = " x ".join(f"{side:g}" for side in row.sensing_mm)
        yield f"{row.name:28}{size:>20}{area:>14}{row.ratio_mm:9.1f}{row.mass_g:9.1f}{row.cost_usd:9.1f}"
