"""Dimensions of the parts that are made: printed ones (base, shell, isolation ring, calibration board), the acrylic window, the
silicone layers above it and the moulds in which they are cast.
"""

from dataclasses import dataclass
from typing import Annotated

from ninedtact.hardware.dimensions import BoundedDimensions, Bounds


@dataclass(frozen=True)
class BaseDimensions(BoundedDimensions, table="base"):
    """The base: plate, camera pocket, insert bosses and locating posts, 3D-printed in black."""

    plate_mm: Annotated[float, Bounds(2.0, 6.0)] = 3.0
    """Thickness of the plate, which holds a pocket for the camera and a floor below it."""
    corner_radius_mm: Annotated[float, Bounds(0.0, 5.0)] = 2.0
    """Radius of the outline's corners, as that of the shell."""
    floor_mm: Annotated[float, Bounds(0.8, 3.0)] = 1.0
    """Thickness below camera and inserts, against which a screw head or a bolt pulls."""
    mount_inset_mm: Annotated[tuple[float, float], Bounds(2.0, 20.0)] = (5.75, 3.0)
    """From the shell's cavity walls to the four inserts to which a robot is bolted, x and y: a pattern of 17.0 x 15.5
    in the published size, clear of posts and screw bosses in every size."""
    boss_mm: Annotated[float, Bounds(4.0, 8.0)] = 5.3
    """Diameter of the insert bosses, which leaves 1.2 of plastic around a heat-set insert."""
    boss_tall_mm: Annotated[float, Bounds(0.0, 4.0)] = 3.5
    """Height of the bosses above the plate; 1.0 stays free below the circuit board."""
    bore_mm: Annotated[float, Bounds(2.5, 3.4)] = 2.82
    """Bore for an M2 heat-set insert of 3.3 over its knurl."""
    bolt_mm: Annotated[float, Bounds(2.05, 3.0)] = 2.4
    """Holes through the floor below the inserts: M2 with the clearance of a printed hole (ISO 273 medium)."""
    post_mm: Annotated[float, Bounds(2.0, 4.0)] = 2.8
    """Diameter of the posts that carry the circuit board."""
    post_tall_mm: Annotated[float, Bounds(3.0, 8.0)] = 4.5
    """Height of the posts from the plate to the underside of the circuit board, which clears the micro-USB receptacle
    that hangs below it."""
    pin_mm: Annotated[float, Bounds(0.8, 2.5)] = 1.45
    """Diameter of the locating pins, in holes of 1.50."""
    pin_tall_mm: Annotated[float, Bounds(0.5, 1.2)] = 1.0
    """Height of the pins above the posts: 0.20 more than the board is thick."""
    pin_round_mm: Annotated[float, Bounds(0.0, 0.5)] = 0.3
    """Fillet at the tips of the pins, which helps to find the holes."""
    shell_screw_mm: Annotated[float, Bounds(2.0, 3.0)] = 2.2
    """Clearance hole of the M2 screws into the shell; 2.00 as drawn originally binds where it is printed."""
    counterbore_mm: Annotated[float, Bounds(3.9, 5.0)] = 4.0
    """Diameter of the counterbores for heads of 3.9."""
    counterbore_deep_mm: Annotated[float, Bounds(0.5, 2.0)] = 1.0
    """Depth of the counterbores: heads of 0.85 sit 0.15 below the face."""
    pocket_wide_mm: Annotated[float, Bounds(8.0, 15.0)] = 8.9
    """Width of the camera's pocket; the camera is 8.70 wide, which leaves 0.10 on each side."""
    pocket_front_mm: Annotated[float, Bounds(4.0, 8.0)] = 4.45
    """From the optical axis to the pocket's wall at +y."""
    pocket_back_mm: Annotated[float, Bounds(4.0, 10.0)] = 7.75
    """From the optical axis to the pocket's shoulder at -y; the camera's stiffener ends at 7.65."""
    channel_wide_mm: Annotated[float, Bounds(6.0, 10.0)] = 6.4
    """Width of the channel for a flat cable of 6.00."""
    channel_round_mm: Annotated[float, Bounds(0.0, 1.0)] = 0.4
    """Fillet at the two entry corners, on which the cable would catch."""
    ramp_foot_mm: Annotated[float, Bounds(1.0, 6.0)] = 3.0
    """From the outer face to the foot of the ramp that lifts the cable to the shell's rim."""
    ramp_head_mm: Annotated[float, Bounds(0.1, 2.0)] = 0.5
    """From the outer face to the head of the ramp."""
    ramp_gap_mm: Annotated[float, Bounds(0.3, 1.0)] = 0.5
    """Gap for the cable under the shell's rim; the cable is modelled 0.40 thick."""
    ramp_foot_round_mm: Annotated[float, Bounds(0.0, 3.0)] = 2.0
    """Blend at the foot of the ramp: the cable must not be bent sharply."""
    ramp_head_round_mm: Annotated[float, Bounds(0.0, 2.0)] = 1.0
    """Blend at the head of the ramp."""


ORIGINAL_BASE = BaseDimensions(
    bolt_mm=2.1, shell_screw_mm=2.0, pocket_wide_mm=8.7, pocket_front_mm=4.35, pocket_back_mm=7.55, ramp_gap_mm=0.4
)
"""The original's base, without clearances around camera, cable and screws."""


@dataclass(frozen=True)
class ShellDimensions(BoundedDimensions, table="shell"):
    """The shell, 3D-printed in white, translucent nylon: gel cavity above, LED cavity below, the floor with its window
    between."""

    wall_mm: Annotated[float, Bounds(0.0, 6.0)] = 2.0
    """Thickness of the walls of both cavities; nylon below 0.8 is neither tight nor stiff (which a rule states, not
    this range)."""
    corner_radius_mm: Annotated[float, Bounds(0.0, 5.0)] = 2.0
    """Radius of the outline's corners."""
    opening_radius_mm: Annotated[float, Bounds(0.0, 4.0)] = 1.0
    """Radius of the gel cavity's corners."""
    floor_mm: Annotated[float, Bounds(0.8, 4.0)] = 2.0
    """Thickness of the floor between the cavities, which carries the window and through which the LEDs shine."""
    hole_mm: Annotated[float, Bounds(8.0, 20.0)] = 12.0
    """Side of the square window hole."""
    frame_wall_mm: Annotated[float, Bounds(0.0, 2.0)] = 0.8
    """Wall of the small frame that keeps the window in its place while it is glued."""
    frame_tall_mm: Annotated[float, Bounds(0.3, 2.0)] = 0.8
    """Height of the frame above the floor; the window stands above it, so that glue does not run onto it."""
    frame_gap_mm: Annotated[float, Bounds(0.05, 0.5)] = 0.1
    """From the window to the frame, on each side."""
    led_cavity_mm: Annotated[float, Bounds(5.0, 12.0)] = 6.3
    """Depth of the lower cavity: posts, circuit board and LEDs, and 0.28 of air above these."""
    smallest_cavity_mm: Annotated[tuple[float, float], Bounds(15.0, 80.0)] = (28.5, 21.5)
    """Least size of the lower cavity, which the components of the circuit board need however small the sensing area is."""
    boss_mm: Annotated[float, Bounds(4.0, 8.0)] = 5.4
    """Diameter of the screw bosses in the lower cavity's corners."""
    boss_inset_mm: Annotated[float, Bounds(0.0, 3.0)] = 0.75
    """From the cavity's walls to the bosses' axes."""
    fillet_mm: Annotated[float, Bounds(0.0, 1.5)] = 0.95
    """Fillet around the lower cavity's ceiling, for stiffness."""
    bore_mm: Annotated[float, Bounds(2.5, 3.4)] = 2.85
    """Bore for M2 heat-set inserts; nylon yields a little less than the base's plastic."""
    bore_deep_mm: Annotated[float, Bounds(4.0, 8.0)] = 5.5
    """Depth of the bores: inserts are 5.09 long, and the rest takes the melted plastic."""
    slot_wide_mm: Annotated[float, Bounds(7.6, 12.0)] = 9.0
    """Width of the micro-USB slot, which the receptacle's mouth enters."""
    slot_from_mm: Annotated[float, Bounds(0.0, 4.0)] = 1.55
    """Lower edge of the slot above the shell's bottom rim."""
    slot_to_mm: Annotated[float, Bounds(3.0, 7.0)] = 4.95
    """Upper edge of the slot above the shell's bottom rim."""
    slot_chamfer_mm: Annotated[float, Bounds(0.0, 2.0)] = 1.0
    """Chamfer at the two upper corners of the slot, as the receptacle has."""
    slot_round_mm: Annotated[float, Bounds(0.0, 0.7)] = 0.5
    """Fillet at all six corners of the slot."""
    relief_wide_mm: Annotated[float, Bounds(0.0, 16.0)] = 11.0
    """Width of the relief around the slot outside, without which a plug's overmould stops at the wall 1.9 before its
    end position; 0 for none."""
    relief_left_mm: Annotated[float, Bounds(0.0, 6.0)] = 0.9
    """Thickness of the wall behind the relief, however thick the wall is."""
    relief_tall_mm: Annotated[float, Bounds(0.0, 12.0)] = 6.8
    """Height of the relief from the shell's bottom rim: half an overmould above the plug's middle."""

    @property
    def relief_deep_mm(self) -> float:
        """Depth of the relief around the slot."""
        return max(self.wall_mm - self.relief_left_mm, 0.0) if self.relief_wide_mm else 0.0


ORIGINAL_SHELL = ShellDimensions(slot_wide_mm=8.0, slot_from_mm=1.85, slot_to_mm=4.7, relief_wide_mm=0.0)
"""The original's shell, with a tight slot in a full wall."""


@dataclass(frozen=True)
class IsolationRingDimensions(BoundedDimensions, table="ring"):
    """The black isolation ring in the shell's window hole, its mouth at the window: LED light must reach the lens
    through the gel only."""

    gap_mm: Annotated[float, Bounds(0.0, 0.5)] = 0.05
    """From its sides to the shell's hole."""
    bore_mm: Annotated[float, Bounds(10.0, 16.0)] = 10.1
    """Bore around the lens head of 10.00."""
    land_mm: Annotated[float, Bounds(0.0, 1.0)] = 0.15
    """Wall left at the middle of the mouth's sides; without it they end in an edge that does not print."""
    above_board_mm: Annotated[float, Bounds(0.0, 1.0)] = 0.2
    """Distance of its lower face from the circuit board, since boards differ in thickness."""
    cone_deg: Annotated[float, Bounds(20.0, 70.0)] = 45.0
    """Half-angle of the mouth, which opens the view."""


ORIGINAL_RING = IsolationRingDimensions(land_mm=0.0)
"""The original's ring, whose mouth touches its sides."""


@dataclass(frozen=True)
class WindowDimensions(BoundedDimensions, table="window"):
    """The window of clear acrylic, laser-cut, between camera and gel."""

    side_mm: Annotated[float, Bounds(9.0, 24.0)] = 14.0
    """Side of the window: the hole of 12.00 and a ledge of 1.00 around it."""
    thick_mm: Annotated[float, Bounds(1.0, 5.0)] = 2.0
    """Thickness of the sheet."""


@dataclass(frozen=True)
class CalibrationBoardDimensions(BoundedDimensions, table="pin_frame"):
    """The calibration board: a tray that slides over the shell. Number, pitch and diameter of its pins are those of the
    sensor design."""

    gap_mm: Annotated[float, Bounds(0.05, 1.0)] = 0.25
    """From the shell to the tray, on each side: it must slide and not turn."""
    wall_mm: Annotated[float, Bounds(0.8, 6.0)] = 2.0
    """Wall thickness of the tray."""
    floor_mm: Annotated[float, Bounds(1.0, 6.0)] = 2.5
    """Thickness of the floor below the pins, which must not bend."""
    guided_mm: Annotated[float, Bounds(2.0, 12.0)] = 4.2
    """How far the tray reaches down the shell when its pins touch the skin."""
    corner_radius_mm: Annotated[float, Bounds(0.0, 8.0)] = 4.0
    """Outer corner radius; inside it is less by the wall."""
    pin_tall_mm: Annotated[float, Bounds(0.8, 4.0)] = 1.5
    """Height of the pins above the floor, the round tip included."""


@dataclass(frozen=True)
class GelLayerDimensions(BoundedDimensions, table="gels"):
    """Dimensions of the layers other than the thickness of the translucent one, which belongs to the sensor design."""

    rim_radius_mm: Annotated[float, Bounds(0.0, 5.0)] = 1.0
    """Corner radius of the translucent layer."""
    black_top_mm: Annotated[float, Bounds(0.1, 2.0)] = 0.3
    """Thickness of the black layer above the translucent one: the difference of the two moulds, enough to stop all
    light."""
    black_side_mm: Annotated[float, Bounds(0.2, 2.0)] = 0.8
    """Thickness of the black layer around the sides."""


@dataclass(frozen=True)
class MouldDimensions(BoundedDimensions, table="moulds"):
    """Laser-cut acrylic plates, clamped by M3 screws; each mould is as thick as the layers that it forms."""

    base_mm: Annotated[float, Bounds(1.0, 8.0)] = 3.0
    """Thickness of the base board on which the shell is screwed."""
    beyond_mm: Annotated[tuple[float, float], Bounds(8.0, 40.0)] = (30.5, 27.5)
    """How much wider the plates are than the translucent layer, x and y: space for shell and screws."""
    corner_radius_mm: Annotated[float, Bounds(0.0, 20.0)] = 12.0
    """Corner radius of the plates."""
    hole_mm: Annotated[float, Bounds(3.05, 3.6)] = 3.1
    """Clearance holes for M3."""
    hole_inset_mm: Annotated[float, Bounds(2.5, 8.0)] = 3.0
    """From the plates' edges to the screws' axes."""
    pairs_mm: Annotated[tuple[float, float], Bounds(4.0, 40.0)] = (10.0, 8.0)
    """Positions of the screws: at the long sides, x from the middle; at the short sides, y from the middle."""
    shell_screw_mm: Annotated[float, Bounds(2.0, 3.0)] = 2.2
    """Holes through the base board into the shell's inserts."""


ORIGINAL_MOULDS = MouldDimensions(shell_screw_mm=2.1)
