"""Copper lines between pads, and what leads them through the board."""

from dataclasses import dataclass

from ninedtact.hardware.led_board.outline import Place
from ninedtact.hardware.led_board.placement import Side


@dataclass(frozen=True)
class Track:
    """A line of constant width with round ends, through these points."""

    net: str
    side: Side
    width_mm: float
    points: tuple[Place, ...]


@dataclass(frozen=True)
class Via:
    """A plated hole, covered by the solder mask on both sides."""

    net: str
    at_mm: Place
    diameter_mm: float
    drill_mm: float


@dataclass(frozen=True)
class Routes:
    """Tracks and vias."""

    tracks: tuple[Track, ...] = ()
    vias: tuple[Via, ...] = ()

    def __add__(self, other: "Routes") -> "Routes":
        return Routes(self.tracks + other.tracks, self.vias + other.vias)
