"""The white shell: gel cavity above, LED cavity below, the floor with its window between."""

from dataclasses import dataclass
from typing import Annotated

from ninedtact.hardware.dimensions.between import Between, require_between


@dataclass(frozen=True)
class Shell:
    """Sensor shell, 3D-printed in white, translucent nylon."""

    wall_mm: Annotated[float, Between(0.0, 6.0)] = 2.0
    """Round both cavities; nylon below 0.8 is neither tight nor stiff (a rule, not this range, says so)."""
    corner_radius_mm: Annotated[float, Between(0.0, 5.0)] = 2.0
    """Of the outline."""
    opening_radius_mm: Annotated[float, Between(0.0, 4.0)] = 1.0
    """Of the gel cavity's corners."""
    floor_mm: Annotated[float, Between(0.8, 4.0)] = 2.0
    """Between the cavities: it carries the window, and the LEDs shine through it."""
    hole_mm: Annotated[float, Between(8.0, 20.0)] = 12.0
    """Side of the square window hole."""
    frame_wall_mm: Annotated[float, Between(0.0, 2.0)] = 0.8
    """Of the little frame that keeps the window in its place while it is glued."""
    frame_tall_mm: Annotated[float, Between(0.3, 2.0)] = 0.8
    """Above the floor; the window stands above it, so that glue does not run onto it."""
    frame_gap_mm: Annotated[float, Between(0.05, 0.5)] = 0.1
    """From the window to the frame, on each side."""
    led_cavity_mm: Annotated[float, Between(5.0, 12.0)] = 6.3
    """Depth of the lower cavity: posts, circuit board and LEDs, and 0.28 of air above these."""
    smallest_cavity_mm: Annotated[tuple[float, float], Between(15.0, 80.0)] = (28.5, 21.5)
    """The parts of the circuit board need this much room, however small the sensing area is."""
    boss_mm: Annotated[float, Between(4.0, 8.0)] = 5.4
    """Diameter of the screw bosses left standing in the lower cavity's corners."""
    boss_inset_mm: Annotated[float, Between(0.0, 3.0)] = 0.75
    """From the cavity's walls to the bosses' axes."""
    fillet_mm: Annotated[float, Between(0.0, 1.5)] = 0.95
    """Round the lower cavity's ceiling, for stiffness."""
    bore_mm: Annotated[float, Between(2.5, 3.4)] = 2.85
    """For M2 heat-set inserts; nylon gives way a little less than the base's plastic."""
    bore_deep_mm: Annotated[float, Between(4.0, 8.0)] = 5.5
    """Inserts are 5.09 long; the rest takes what is melted away."""
    slot_wide_mm: Annotated[float, Between(7.6, 12.0)] = 9.0
    """Of the micro-USB slot; the receptacle's mouth enters it."""
    slot_from_mm: Annotated[float, Between(0.0, 4.0)] = 1.55
    """Its lower edge, above the shell's bottom rim."""
    slot_to_mm: Annotated[float, Between(3.0, 7.0)] = 4.95
    """Its upper edge."""
    slot_chamfer_mm: Annotated[float, Between(0.0, 2.0)] = 1.0
    """At its two upper corners, as the receptacle has."""
    slot_round_mm: Annotated[float, Between(0.0, 0.7)] = 0.5
    """At all six corners."""
    relief_wide_mm: Annotated[float, Between(0.0, 16.0)] = 11.0
    """A step outside round the slot, so that a plug's overmould does not stop at the wall 1.9 before it is home; 0: none."""
    relief_left_mm: Annotated[float, Between(0.0, 6.0)] = 0.9
    """Wall left behind that step, however thick the wall is."""
    relief_tall_mm: Annotated[float, Between(0.0, 12.0)] = 6.8
    """From the shell's bottom rim; half an overmould above the plug's middle."""

    def __post_init__(self) -> None:
        require_between(self)

    @property
    def relief_deep_mm(self) -> float:
        """Of that step."""
        return max(self.wall_mm - self.relief_left_mm, 0.0) if self.relief_wide_mm else 0.0


ORIGINAL_SHELL = Shell(slot_wide_mm=8.0, slot_from_mm=1.85, slot_to_mm=4.7, relief_wide_mm=0.0)
"""With the tight slot in a full wall."""
