"""What the board house can make, and how wide the copper is."""

from dataclasses import dataclass
from typing import Annotated

from ninedtact.hardware.dimensions.between import Between, require_between


@dataclass(frozen=True)
class Rules:
    """Least distances: what ordinary two-layer production keeps without extra charge, with a little to spare."""

    clearance_mm: Annotated[float, Between(0.1, 0.5)] = 0.2
    """Between copper of different nets."""
    copper_to_edge_mm: Annotated[float, Between(0.05, 1.0)] = 0.25
    """To the milled edge, lens hole and notches among them; board houses ask for 0.2."""
    copper_to_hole_mm: Annotated[float, Between(0.1, 1.0)] = 0.2
    """To a hole without copper in it."""
    hole_to_hole_mm: Annotated[float, Between(0.1, 1.0)] = 0.25
    """Between the rims of two drilled holes."""
    mask_margin_mm: Annotated[float, Between(0.0, 0.1)] = 0.05
    """By which the solder mask's openings are larger than the pads."""
    pour_gap_mm: Annotated[float, Between(0.1, 1.0)] = 0.25
    """From the ground pour to everything else."""
    least_pad_share: Annotated[float, Between(0.5, 1.0)] = 0.8
    """Of a pad's area that must be left where it gives way to the connector's holes, or the part solders badly."""

    def __post_init__(self) -> None:
        require_between(self)


@dataclass(frozen=True)
class Copper:
    """Widths of tracks, and the vias."""

    led_mm: Annotated[float, Between(0.15, 1.5)] = 0.6
    """Of the line to the anodes: along 66 mm of 0.254 the LEDs would not get the same voltage."""
    ground_mm: Annotated[float, Between(0.15, 1.5)] = 0.6
    """Of the line from the cathodes."""
    supply_mm: Annotated[float, Between(0.15, 1.5)] = 0.8
    """Of 5 V."""
    neck_mm: Annotated[float, Between(0.15, 0.6)] = 0.34
    """Of 5 V and ground where they squeeze past the connector and the driver: a few mm, 1 A at 10 K by IPC-2221."""
    signal_mm: Annotated[float, Between(0.15, 0.6)] = 0.25
    """Of everything else."""
    via_mm: Annotated[float, Between(0.4, 1.0)] = 0.6
    """Copper round a via."""
    via_drill_mm: Annotated[float, Between(0.2, 0.6)] = 0.3
    """Its hole."""
    pour: bool = True
    """Ground on both sides wherever nothing else is: it carries the driver's heat away. Nets hold together without it."""

    def __post_init__(self) -> None:
        require_between(self)
