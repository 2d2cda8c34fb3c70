"""The paper's silicones: what is mixed for each layer, how long it cures (docs/references.md#9dtact)."""

from dataclasses import dataclass

from ninedtact.hardware.materials import MADE_OF

WASTE = 1.5
"""Silicone stays in cups and overflows moulds."""


@dataclass(frozen=True)
class Silicone:
    """One of the three layers."""

    part: str
    product: str
    ratio: str
    """Of its two components, by weight."""
    cure: str

    def grams(self, volume_mm3: float) -> float:
        """To mix for a layer of this volume: what it weighs, and what stays in the cup."""
        return volume_mm3 / 1000 * MADE_OF[self.part].g_per_cm3 * WASTE


TRANSPARENT = Silicone("transparent_gel", "Hongye Jie 9345 (Shore A 45)", "1 : 1", "4 h at 25 °C, then 6 h at 50 °C")
TRANSLUCENT = Silicone("translucent_gel", "Posilicone DRSGJ02 (Shore A 5)", "1 : 1", "6 h at 25 °C")
BLACK = Silicone(
    "black_gel", "Ecoflex 00-30 with black silicone pigment", "1 : 1", "as its maker says: 4 h at room temperature"
)
SILICONES = TRANSPARENT, TRANSLUCENT, BLACK
