"""The bare board: its edge, its holes, and what stands under it."""

from dataclasses import dataclass
from typing import Annotated

from ninedtact.hardware.dimensions.between import Between, require_between
from ninedtact.hardware.led_board.refusal import BoardImpossible

Place = tuple[float, float]
"""x and y in mm, in the frame that the room's docstring states."""


@dataclass(frozen=True)
class BoardOutline:
    """A rectangle with a concave notch in each corner, a hole for the lens and four for the base's pins."""

    width_mm: Annotated[float, Between(24.0, 120.0)] = 28.0
    """Along x: 0.25 less than the shell's cavity on each side. Below 24 the parts find no place."""
    height_mm: Annotated[float, Between(20.0, 100.0)] = 21.0
    """Along y. Below 20 the LEDs stand over the lens hole."""
    thickness_mm: Annotated[float, Between(0.6, 1.08)] = 0.8
    """Of the laminate: at 1.08 the LEDs touch the shell; board houses take 1.6 unless told otherwise."""
    lens_hole_mm: Annotated[float, Between(8.0, 10.4)] = 10.2
    """Diameter of the hole round the lens head of 10.00; above 10.4 the USB contacts have no pads left."""
    notch_radius_mm: Annotated[float, Between(0.5, 4.0)] = 2.8
    """Of the corner notches, 0.10 more than the shell's screw bosses."""
    notch_inset_mm: Annotated[Place, Between(0.0, 3.0)] = (0.5, 0.5)
    """From the edges to the centre of a notch: the boss's axis."""
    locating_hole_mm: Annotated[float, Between(0.8, 3.0)] = 1.5
    """Diameter round the base's pins of 1.45."""
    locating_inset_mm: Annotated[Place, Between(1.2, 10.0)] = (1.5, 5.0)
    """From the edges to the centre of a locating hole."""
    boss_inset_mm: Annotated[Place, Between(0.0, 30.0)] = (5.5, 2.75)
    """From the edges to the axes of the base's insert bosses under the board."""
    boss_mm: Annotated[float, Between(2.0, 8.0)] = 5.3
    """Diameter of these bosses."""
    boss_gap_mm: Annotated[float, Between(0.0, 5.0)] = 1.0
    """From a boss to the board: parts above a boss are lower than this."""

    def __post_init__(self) -> None:
        require_between(self)
        if not self.notch_radius_mm > max(self.notch_inset_mm):
            raise BoardImpossible(
                f"expected outline.notch_radius_mm above the notches' inset of {max(self.notch_inset_mm):g}, "
                f"got {self.notch_radius_mm:g}; a smaller one is a hole, not a notch"
            )

    @property
    def half(self) -> Place:
        """Half the width, half the height."""
        return self.width_mm / 2, self.height_mm / 2

    def corners(self, inset_mm: Place) -> tuple[Place, ...]:
        """The four places that lie so far inside the edges, counter-clockwise from the upper right."""
        x, y = self.half[0] - inset_mm[0], self.half[1] - inset_mm[1]
        return (x, y), (-x, y), (-x, -y), (x, -y)

    @property
    def notches(self) -> tuple[Place, ...]:
        """Centres of the corner notches."""
        return self.corners(self.notch_inset_mm)

    @property
    def locating_holes(self) -> tuple[Place, ...]:
        """Centres of the holes for the base's pins."""
        return self.corners(self.locating_inset_mm)

    @property
    def bosses(self) -> tuple[Place, ...]:
        """Axes of the base's insert bosses."""
        return self.corners(self.boss_inset_mm)

    @property
    def notch_ends(self) -> Place:
        """The straight edges end at this x (upper and lower edge) and this y (left and right edge)."""
        (x, y), r = self.notches[0], self.notch_radius_mm
        return x - (r**2 - self.notch_inset_mm[1] ** 2) ** 0.5, y - (r**2 - self.notch_inset_mm[0] ** 2) ** 0.5
