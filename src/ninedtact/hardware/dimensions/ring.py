"""The black isolation ring: LED light must not reach the lens but through the gel."""

from dataclasses import dataclass
from typing import Annotated

from ninedtact.hardware.dimensions.between import Between, require_between


@dataclass(frozen=True)
class Ring:
    """Stands in the shell's window hole, its mouth at the window."""

    gap_mm: Annotated[float, Between(0.0, 0.5)] = 0.05
    """From its sides to the shell's hole."""
    bore_mm: Annotated[float, Between(10.0, 16.0)] = 10.1
    """Round the lens head of 10.00."""
    land_mm: Annotated[float, Between(0.0, 1.0)] = 0.15
    """Wall left at the mouth's mid-sides; without it they end in an edge that does not print."""
    above_board_mm: Annotated[float, Between(0.0, 1.0)] = 0.2
    """From the circuit board to its lower face: boards differ in thickness."""
    cone_deg: Annotated[float, Between(20.0, 70.0)] = 45.0
    """Half-angle of the mouth, which opens the view."""

    def __post_init__(self) -> None:
        require_between(self)


ORIGINAL_RING = Ring(land_mm=0.0)
"""Its mouth touches its sides."""


@dataclass(frozen=True)
class Window:
    """Clear acrylic, laser-cut: camera below, gel above."""

    side_mm: Annotated[float, Between(9.0, 24.0)] = 14.0
    """The hole of 12.00 and a ledge of 1.00 round it."""
    thick_mm: Annotated[float, Between(1.0, 5.0)] = 2.0
    """Of the sheet."""

    def __post_init__(self) -> None:
        require_between(self)
