"""The calibration board: a tray that fits over the shell, with pins on its floor."""

from dataclasses import dataclass
from typing import Annotated

from ninedtact.hardware.dimensions.between import Between, require_between


@dataclass(frozen=True)
class PinFrame:
    """What the board has beside its pins, whose count, pitch and diameter are the sensor design's."""

    gap_mm: Annotated[float, Between(0.05, 1.0)] = 0.25
    """From the shell to the tray, on each side: it must slide and not turn."""
    wall_mm: Annotated[float, Between(0.8, 6.0)] = 2.0
    """Of the tray."""
    floor_mm: Annotated[float, Between(1.0, 6.0)] = 2.5
    """Below the pins; it must not bend."""
    guided_mm: Annotated[float, Between(2.0, 12.0)] = 4.2
    """How far the tray reaches down the shell when its pins touch the skin."""
    corner_radius_mm: Annotated[float, Between(0.0, 8.0)] = 4.0
    """Outside; inside it is less by the wall."""
    pin_tall_mm: Annotated[float, Between(0.8, 4.0)] = 1.5
    """Above the floor, the round tip included."""

    def __post_init__(self) -> None:
        require_between(self)
