"""Published specifications of sensors: size, sensing area, mass and cost, as in Table I of the 9DTact paper."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass


@dataclass(frozen=True)
class SensorSpecification:
    """Size, sensing area, mass, cost and image rate of one sensor, published or designed."""

    name: str
    size_mm: tuple[float, float, float]
    sensing_mm2: float
    mass_g: float | None
    """None where the paper states none."""
    cost_usd: float
    cost_basis: str = "parts"
    """What the cost is the price of."""
    rate_hz: float | None = None
    """Camera images per second that the publication states; None for a design, whose camera board decides."""

    @property
    def ratio_mm(self) -> float:
        """Volume of the sensor's box over its sensing area, called dimension-to-area ratio in the paper."""
        x, y, z = self.size_mm
        return x * y * z / self.sensing_mm2


PUBLISHED_9DTACT = SensorSpecification(
    "9DTact, as published", (32.5, 25.5, 25.5), 24.0 * 18.0, 20.0, 15.0, rate_hz=90.0
)
"""The published 9DTact (docs/references.md#9dtact)."""
OTHER_PUBLISHED_SENSORS = (
    SensorSpecification("GelSight (2017)", (80.0, 40.0, 40.0), 252.0, None, 30.0, rate_hz=90.0),
    SensorSpecification("GelSlim 3.0", (80.0, 37.0, 20.0), 675.0, 45.0, 25.0, "parts of one of 1000", 90.0),
    SensorSpecification(
        "DIGIT", (36.0, 26.0, 33.0), 19.0 * 16.0, 20.0, 15.0, "parts of one of 1000; 300 if bought", 60.0
    ),
    SensorSpecification("GelSight Mini", (32.0, 28.5, 28.0), 19.0 * 15.0, 20.8, 499.0, "bought", 25.0),
    SensorSpecification("DTact", (45.0, 45.0, 47.0), 24.0 * 24.0, 78.0, 34.0, rate_hz=60.0),
)
"""The other rows of Table I of the 9DTact paper (docs/references.md#9dtact). The makers' own data sheets differ in places."""


def format_sensor_comparison(rows: Iterable[SensorSpecification]) -> Iterator[str]:
    """Yield a table that compares sensors, one line of text for each."""
    yield f"{'':24}{'size mm':>20}{'area mm²':>10}{'D/A mm':>8}{'mass g':>8}{'Hz':>5}{'cost $':>8}  of"
    for row in rows:
        size = " x ".join(f"{side:.1f}" for side in row.size_mm)
        mass = "-" if row.mass_g is None else f"{row.mass_g:.1f}"
        rate = "-" if row.rate_hz is None else f"{row.rate_hz:g}"
        yield (
            f"{row.name:24}{size:>20}{row.sensing_mm2:10.0f}{row.ratio_mm:8.1f}{mass:>8}{rate:>5}{row.cost_usd:8.1f}"
            f"  {row.cost_basis}"
        )
