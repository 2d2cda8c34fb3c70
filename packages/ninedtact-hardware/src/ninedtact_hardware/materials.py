"""Materials of the parts: density, its source and the colour in images; the silicones of the paper with their mixing
ratios and curing times (docs/references.md#9dtact)."""

from dataclasses import dataclass

from ninedtact.design import shear_modulus_mpa_to_shore_a

Colour = tuple[int, int, int]


@dataclass(frozen=True)
class Material:
    """A material with its density, the source of that density, and its colour in images."""

    name: str
    g_per_cm3: float
    source: str
    colour: Colour
    """Red, green and blue in images."""


BLACK_PLASTIC = Material("black nylon, PETG or ABS print", 1.15, "between nylon 1.01 and PETG 1.27", (62, 64, 68))
"""Printed black plastic. It softens when heated, as heat-set inserts require; resin does not."""
BLACK_PRINT = Material("black print, resin for the finest", 1.15, "usual of SLA resins; nylon 1.01", (62, 64, 68))
WHITE_NYLON = Material("white nylon, laser-sintered", 1.01, "usual of PA12 prints", (236, 236, 230))
ACRYLIC = Material("clear acrylic", 1.19, "handbook value of PMMA", (160, 205, 225))
TRANSPARENT = Material(
    "transparent silicone, Shore A 45", 1.07, "assumed: usual of addition silicones", (205, 228, 240)
)
TRANSLUCENT = Material("translucent silicone", 1.07, "assumed: usual of addition silicones", (240, 222, 190))
BLACK_SILICONE = Material("Ecoflex 00-30 with black pigment", 1.07, "maker's specific gravity", (44, 44, 48))
BOARD = Material("FR4 with its parts", 2.0, "assumed: FR4 1.85, parts denser", (40, 120, 70))
CAMERA = Material("camera module", 1.4, "assumed: plastic barrel, glass, board", (90, 96, 112))
BRASS = Material("brass", 8.5, "handbook value", (205, 170, 80))
STEEL = Material("steel", 7.85, "handbook value", (150, 155, 160))

MATERIAL_OF_PART = {
    "sensor_base": BLACK_PLASTIC,
    "sensor_shell": WHITE_NYLON,
    "isolation_ring": BLACK_PRINT,
    "calibration_board": WHITE_NYLON,
    "acrylic_window": ACRYLIC,
    "base_board": ACRYLIC,
    "first_mould": ACRYLIC,
    "second_mould": ACRYLIC,
    "transparent_gel": TRANSPARENT,
    "translucent_gel": TRANSLUCENT,
    "black_gel": BLACK_SILICONE,
    "camera": CAMERA,
    "led_board": BOARD,
    "insert": BRASS,
    "screw": STEEL,
}
"""Material by the name of the part."""


WASTE_FACTOR = 1.5
"""Mass to mix over mass of the layer: silicone stays in cups and overflows moulds."""


@dataclass(frozen=True)
class GelSilicone:
    """The silicone of one of the three gel layers."""

    part: str
    product: str
    ratio: str
    """How its two components are mixed."""
    cure: str

    def grams(self, volume_cm3: float) -> float:
        """Return the mass in g to mix for a layer of this volume, waste included."""
        return volume_cm3 * MATERIAL_OF_PART[self.part].g_per_cm3 * WASTE_FACTOR


TRANSPARENT_SILICONE = GelSilicone(
    "transparent_gel", "Hongye Jie 9345 (Shore A 45)", "1 : 1 by weight", "4 h at 25 °C, then 6 h at 50 °C"
)
TRANSLUCENT_SILICONE = GelSilicone(
    "translucent_gel", "Posilicone DRSGJ02 (Shore A 5)", "1 : 1 by weight", "6 h at 25 °C"
)
BLACK_GEL_SILICONE = GelSilicone(
    "black_gel",
    "Ecoflex 00-30 with black silicone pigment",
    "1 : 1 by weight",
    "as its maker says: 4 h at room temperature",
)
TRANSLUCENT_SHORE_A = 5
"""Hardness of the paper's translucent silicone."""


def translucent_silicone_of_modulus(shear_modulus_mpa: float) -> GelSilicone:
    """Return the paper's translucent silicone if it is as hard as a gel of this shear modulus, otherwise what to look for."""
    shore_a = shear_modulus_mpa_to_shore_a(shear_modulus_mpa)
    if round(shore_a) == TRANSLUCENT_SHORE_A:
        return TRANSLUCENT_SILICONE
    hardness = f"about Shore A {shore_a:.0f}" if shore_a >= 1 else "less than Shore A 1"
    product = (
        f"translucent addition silicone of {hardness} (shear modulus {shear_modulus_mpa:g} MPa), in place of "
        f"{TRANSLUCENT_SILICONE.product}"
    )
    return GelSilicone(TRANSLUCENT_SILICONE.part, product, "mixed as its maker says", "as its maker says")
