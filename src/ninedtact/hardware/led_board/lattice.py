"""Where the LEDs stand: the rim of a lattice, so that the light comes from all around the lens."""

from dataclasses import dataclass
from itertools import pairwise

from ninedtact.hardware.led_board.outline import Place
from ninedtact.hardware.led_board.refusal import BoardImpossible

LED_PADS_MM = 4.39, 2.10
"""What the two pads of a 2835 LED cover together, along x and y."""


@dataclass(frozen=True)
class LedLattice:
    """Body centres of the LEDs: every crossing of these columns and rows on the rim, none inside."""

    columns_mm: tuple[float, ...] = (-8.8, 0.0, 8.8)
    """Left to right. A pitch of 8.8 lights the skin of 24 x 18 mm as the original does."""
    rows_mm: tuple[float, ...] = (7.5, 0.0, -7.5)
    """From the upper edge down."""

    def __post_init__(self) -> None:
        self._require_order("columns_mm", self.columns_mm, LED_PADS_MM[0])
        self._require_order("rows_mm", tuple(-row for row in self.rows_mm), LED_PADS_MM[1])

    def _require_order(self, name: str, places: tuple[float, ...], pad_mm: float) -> None:
        nearest = min((b - a for a, b in pairwise(places)), default=0.0)
        if not nearest >= pad_mm + 0.3:
            raise BoardImpossible(
                f"expected leds.{name} of two or more, in order and at least {pad_mm + 0.3:.2f} mm apart, got {nearest:.2f}; "
                "take fewer LEDs or a larger board"
            )

    @property
    def places(self) -> tuple[Place, ...]:
        """Of the LEDs in the order of their numbers: row by row from the upper left."""
        rim = {self.rows_mm[0], self.rows_mm[-1]}
        ends = {self.columns_mm[0], self.columns_mm[-1]}
        return tuple((x, y) for y in self.rows_mm for x in self.columns_mm if y in rim or x in ends)


def evenly(half_span_mm: float, count: int) -> tuple[float, ...]:
    """So many places from -half to +half of the span."""
    return tuple(half_span_mm * (2 * number / (count - 1) - 1) for number in range(count))
