"""The black base: plate, camera pocket, insert bosses, locating posts.

The white shell: gel cavity above, LED cavity below, the floor with its window between.

The black isolation ring: LED light must not reach the lens but through the gel.

The calibration board: a tray that fits over the shell, with pins on its floor.
"""

from dataclasses import dataclass
from typing import Annotated

from ninedtact.hardware.dimensions.bounds import Bounds, require_within_bounds


@dataclass(frozen=True)
class BaseDimensions:
    """Sensor base, 3D-printed in black."""

    plate_mm: Annotated[float, Bounds(2.0, 6.0)] = 3.0
    """Thickness: a pocket for the camera and a floor below it."""
    corner_radius_mm: Annotated[float, Bounds(0.0, 5.0)] = 2.0
    """Of the outline, as the shell's."""
    floor_mm: Annotated[float, Bounds(0.8, 3.0)] = 1.0
    """Below camera and inserts: what a screw head or a bolt is pulled against."""
    mount_inset_mm: Annotated[tuple[float, float], Bounds(2.0, 20.0)] = (5.75, 3.0)
    """From the shell's cavity walls to the four inserts that a robot is bolted to, x and y: a pattern of 17.0 x 15.5 in the
    published size, clear of posts and screw bosses in every size."""
    boss_mm: Annotated[float, Bounds(4.0, 8.0)] = 5.3
    """Diameter of the insert bosses: 1.2 of plastic round a heat-set insert."""
    boss_tall_mm: Annotated[float, Bounds(0.0, 4.0)] = 3.5
    """Above the plate; 1.0 stays below the circuit board."""
    bore_mm: Annotated[float, Bounds(2.5, 3.4)] = 2.82
    """For an M2 heat-set insert of 3.3 over its knurl."""
    bolt_mm: Annotated[float, Bounds(2.05, 3.0)] = 2.4
    """Through the floor below the inserts; M2 with the clearance of a printed hole (ISO 273 medium)."""
    post_mm: Annotated[float, Bounds(2.0, 4.0)] = 2.8
    """Diameter of the posts that carry the circuit board."""
    post_tall_mm: Annotated[float, Bounds(3.0, 8.0)] = 4.5
    """Above the plate, to the underside of the circuit board: above the micro-USB receptacle that hangs below it."""
    pin_mm: Annotated[float, Bounds(0.8, 2.5)] = 1.45
    """Diameter of the locating pins, in holes of 1.50."""
    pin_tall_mm: Annotated[float, Bounds(0.5, 1.2)] = 1.0
    """Above the posts: 0.20 more than the board is thick."""
    pin_round_mm: Annotated[float, Bounds(0.0, 0.5)] = 0.3
    """Fillet at the pins' tips, to find the holes."""
    shell_screw_mm: Annotated[float, Bounds(2.0, 3.0)] = 2.2
    """Clearance hole of the M2 screws into the shell; 2.00 as drawn originally binds where it is printed."""
    counterbore_mm: Annotated[float, Bounds(3.9, 5.0)] = 4.0
    """Diameter for heads of 3.9."""
    counterbore_deep_mm: Annotated[float, Bounds(0.5, 2.0)] = 1.0
    """Heads of 0.85 sit 0.15 below the face."""
    pocket_wide_mm: Annotated[float, Bounds(8.0, 15.0)] = 8.9
    """Of the camera's pocket; the camera is 8.70 wide, 0.10 stays on each side."""
    pocket_front_mm: Annotated[float, Bounds(4.0, 8.0)] = 4.45
    """From the optical axis to its wall at +y."""
    pocket_back_mm: Annotated[float, Bounds(4.0, 10.0)] = 7.75
    """From the optical axis to its shoulder at -y; the camera's stiffener ends at 7.65."""
    channel_wide_mm: Annotated[float, Bounds(6.0, 10.0)] = 6.4
    """For a flat cable of 6.00."""
    channel_round_mm: Annotated[float, Bounds(0.0, 1.0)] = 0.4
    """At the two entry corners, which the cable would catch on."""
    ramp_foot_mm: Annotated[float, Bounds(1.0, 6.0)] = 3.0
    """From the outer face to the foot of the ramp that lifts the cable to the shell's rim."""
    ramp_head_mm: Annotated[float, Bounds(0.1, 2.0)] = 0.5
    """From the outer face to its head."""
    ramp_gap_mm: Annotated[float, Bounds(0.3, 1.0)] = 0.5
    """Left for the cable under the shell's rim; it is modelled 0.40 thick."""
    ramp_foot_round_mm: Annotated[float, Bounds(0.0, 3.0)] = 2.0
    """Blend at the foot: the cable must not be bent sharply."""
    ramp_head_round_mm: Annotated[float, Bounds(0.0, 2.0)] = 1.0
    """Blend at the head."""

    def __post_init__(self) -> None:
        require_within_bounds("base", self)


ORIGINAL_BASE = BaseDimensions(
    bolt_mm=2.1, shell_screw_mm=2.0, pocket_wide_mm=8.7, pocket_front_mm=4.35, pocket_back_mm=7.55, ramp_gap_mm=0.4
)
"""Without clearances round camera, cable and screws."""


@dataclass(frozen=True)
class ShellDimensions:
    """Sensor shell, 3D-printed in white, translucent nylon."""

    wall_mm: Annotated[float, Bounds(0.0, 6.0)] = 2.0
    """Round both cavities; nylon below 0.8 is neither tight nor stiff (a rule, not this range, says so)."""
    corner_radius_mm: Annotated[float, Bounds(0.0, 5.0)] = 2.0
    """Of the outline."""
    opening_radius_mm: Annotated[float, Bounds(0.0, 4.0)] = 1.0
    """Of the gel cavity's corners."""
    floor_mm: Annotated[float, Bounds(0.8, 4.0)] = 2.0
    """Between the cavities: it carries the window, and the LEDs shine through it."""
    hole_mm: Annotated[float, Bounds(8.0, 20.0)] = 12.0
    """Side of the square window hole."""
    frame_wall_mm: Annotated[float, Bounds(0.0, 2.0)] = 0.8
    """Of the little frame that keeps the window in its place while it is glued."""
    frame_tall_mm: Annotated[float, Bounds(0.3, 2.0)] = 0.8
    """Above the floor; the window stands above it, so that glue does not run onto it."""
    frame_gap_mm: Annotated[float, Bounds(0.05, 0.5)] = 0.1
    """From the window to the frame, on each side."""
    led_cavity_mm: Annotated[float, Bounds(5.0, 12.0)] = 6.3
    """Depth of the lower cavity: posts, circuit board and LEDs, and 0.28 of air above these."""
    smallest_cavity_mm: Annotated[tuple[float, float], Bounds(15.0, 80.0)] = (28.5, 21.5)
    """The parts of the circuit board need this much room, however small the sensing area is."""
    boss_mm: Annotated[float, Bounds(4.0, 8.0)] = 5.4
    """Diameter of the screw bosses left standing in the lower cavity's corners."""
    boss_inset_mm: Annotated[float, Bounds(0.0, 3.0)] = 0.75
    """From the cavity's walls to the bosses' axes."""
    fillet_mm: Annotated[float, Bounds(0.0, 1.5)] = 0.95
    """Round the lower cavity's ceiling, for stiffness."""
    bore_mm: Annotated[float, Bounds(2.5, 3.4)] = 2.85
    """For M2 heat-set inserts; nylon gives way a little less than the base's plastic."""
    bore_deep_mm: Annotated[float, Bounds(4.0, 8.0)] = 5.5
    """Inserts are 5.09 long; the rest takes what is melted away."""
    slot_wide_mm: Annotated[float, Bounds(7.6, 12.0)] = 9.0
    """Of the micro-USB slot; the receptacle's mouth enters it."""
    slot_from_mm: Annotated[float, Bounds(0.0, 4.0)] = 1.55
    """Its lower edge, above the shell's bottom rim."""
    slot_to_mm: Annotated[float, Bounds(3.0, 7.0)] = 4.95
    """Its upper edge."""
    slot_chamfer_mm: Annotated[float, Bounds(0.0, 2.0)] = 1.0
    """At its two upper corners, as the receptacle has."""
    slot_round_mm: Annotated[float, Bounds(0.0, 0.7)] = 0.5
    """At all six corners."""
    relief_wide_mm: Annotated[float, Bounds(0.0, 16.0)] = 11.0
    """A step outside round the slot, so that a plug's overmould does not stop at the wall 1.9 before it is home; 0: none."""
    relief_left_mm: Annotated[float, Bounds(0.0, 6.0)] = 0.9
    """Wall left behind that step, however thick the wall is."""
    relief_tall_mm: Annotated[float, Bounds(0.0, 12.0)] = 6.8
    """From the shell's bottom rim; half an overmould above the plug's middle."""

    def __post_init__(self) -> None:
        require_within_bounds("shell", self)

    @property
    def relief_deep_mm(self) -> float:
        """Of that step."""
        return max(self.wall_mm - self.relief_left_mm, 0.0) if self.relief_wide_mm else 0.0


ORIGINAL_SHELL = ShellDimensions(slot_wide_mm=8.0, slot_from_mm=1.85, slot_to_mm=4.7, relief_wide_mm=0.0)
"""With the tight slot in a full wall."""


@dataclass(frozen=True)
class IsolationRingDimensions:
    """Stands in the shell's window hole, its mouth at the window."""

    gap_mm: Annotated[float, Bounds(0.0, 0.5)] = 0.05
    """From its sides to the shell's hole."""
    bore_mm: Annotated[float, Bounds(10.0, 16.0)] = 10.1
    """Round the lens head of 10.00."""
    land_mm: Annotated[float, Bounds(0.0, 1.0)] = 0.15
    """Wall left at the mouth's mid-sides; without it they end in an edge that does not print."""
    above_board_mm: Annotated[float, Bounds(0.0, 1.0)] = 0.2
    """From the circuit board to its lower face: boards differ in thickness."""
    cone_deg: Annotated[float, Bounds(20.0, 70.0)] = 45.0
    """Half-angle of the mouth, which opens the view."""

    def __post_init__(self) -> None:
        require_within_bounds("ring", self)


ORIGINAL_RING = IsolationRingDimensions(land_mm=0.0)
"""Its mouth touches its sides."""


@dataclass(frozen=True)
class WindowDimensions:
    """Clear acrylic, laser-cut: camera below, gel above."""

    side_mm: Annotated[float, Bounds(9.0, 24.0)] = 14.0
    """The hole of 12.00 and a ledge of 1.00 round it."""
    thick_mm: Annotated[float, Bounds(1.0, 5.0)] = 2.0
    """Of the sheet."""

    def __post_init__(self) -> None:
        require_within_bounds("window", self)


@dataclass(frozen=True)
class CalibrationBoardDimensions:
    """What the board has beside its pins, whose count, pitch and diameter are the sensor design's."""

    gap_mm: Annotated[float, Bounds(0.05, 1.0)] = 0.25
    """From the shell to the tray, on each side: it must slide and not turn."""
    wall_mm: Annotated[float, Bounds(0.8, 6.0)] = 2.0
    """Of the tray."""
    floor_mm: Annotated[float, Bounds(1.0, 6.0)] = 2.5
    """Below the pins; it must not bend."""
    guided_mm: Annotated[float, Bounds(2.0, 12.0)] = 4.2
    """How far the tray reaches down the shell when its pins touch the skin."""
    corner_radius_mm: Annotated[float, Bounds(0.0, 8.0)] = 4.0
    """Outside; inside it is less by the wall."""
    pin_tall_mm: Annotated[float, Bounds(0.8, 4.0)] = 1.5
    """Above the floor, the round tip included."""

    def __post_init__(self) -> None:
        require_within_bounds("pin_frame", self)
