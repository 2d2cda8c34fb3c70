"""Dimensions of each part: frozen dataclasses in which every field states its bounds and its reason. Lengths in mm.

Tables of a design file go in, checked dimensions come out: parts that are bought (camera, LED board, fasteners), modelled as far as
other parts must leave space for them, and parts that are made (base, shell, isolation ring, calibration board, the acrylic window,
the silicone layers above it and their moulds). Bounds stand beside the type; `HardwareDesign` checks them.
"""

from dataclasses import dataclass
from typing import Annotated

from msgspec import Meta

_CableMm = Annotated[float, Meta(ge=0.1, le=12.0)]
_LensMm = Annotated[float, Meta(ge=2.0, le=14.0)]
_InsetMm = Annotated[float, Meta(ge=1.0, le=10.0)]
_LedMm = Annotated[float, Meta(ge=0.3, le=6.0)]
_LedInsetMm = Annotated[float, Meta(ge=1.4, le=12.0)]
_LedShiftMm = Annotated[float, Meta(ge=-1.0, le=1.0)]
_UsbMm = Annotated[float, Meta(ge=1.0, le=9.0)]
_DriverMm = Annotated[float, Meta(ge=0.3, le=8.0)]
_DriverPlaceMm = Annotated[float, Meta(ge=-8.0, le=8.0)]
_InsertMm = Annotated[float, Meta(ge=2.0, le=8.0)]
_HeadMm = Annotated[float, Meta(ge=0.5, le=5.0)]
_MountInsetMm = Annotated[float, Meta(ge=2.0, le=20.0)]
_CavityMm = Annotated[float, Meta(ge=15.0, le=80.0)]
_BeyondMm = Annotated[float, Meta(ge=8.0, le=40.0)]
_PairMm = Annotated[float, Meta(ge=4.0, le=40.0)]
"""Bounds of each of several numbers."""


@dataclass(frozen=True)
class CameraDimensions:
    """The camera Frank-S15-V1.0-160 (OV5647), heights from its own bottom. No maker's drawing exists: measure yours."""

    side_mm: Annotated[float, Meta(ge=6.0, le=14.0)] = 8.7
    """Side of its square body."""
    tall_mm: Annotated[float, Meta(ge=2.0, le=8.0)] = 3.1
    """Height of its body."""
    stiffener_mm: Annotated[float, Meta(ge=4.0, le=12.0)] = 7.65
    """From the optical axis to the stiffener's end."""
    stiffener_tall_mm: Annotated[float, Meta(ge=0.5, le=3.0)] = 1.5
    """Height of the stiffener."""
    cable_mm: tuple[_CableMm, _CableMm] = (6.0, 0.4)
    """Width and thickness of the flat cable."""
    collar_mm: tuple[_LensMm, _LensMm] = (8.0, 4.2)
    """Lens collar: diameter, and height of its top."""
    barrel_mm: tuple[_LensMm, _LensMm] = (6.96, 6.35)
    """Lens barrel: diameter, and height of its top."""
    neck_mm: tuple[_LensMm, _LensMm] = (7.96, 7.35)
    """Neck below the lens head: diameter, and height of its top."""
    head_mm: tuple[_LensMm, _LensMm] = (10.0, 9.95)
    """Lens head: diameter, and height of its top, which is the lens front from which the camera distance is measured."""

    @property
    def lens_mm(self) -> tuple[tuple[float, float], ...]:
        """Steps of the lens from below: diameter, and height of the top."""
        return self.collar_mm, self.barrel_mm, self.neck_mm, self.head_mm


@dataclass(frozen=True)
class LedBoardDimensions:
    """The LED board as a body for which the other parts must leave space."""

    gap_mm: Annotated[float, Meta(ge=0.1, le=1.0)] = 0.25
    """From its edges to the shell's cavity."""
    thick_mm: Annotated[float, Meta(ge=0.4, le=2.0)] = 0.8
    """Thickness of the bare board. Ordered at the usual 1.6, the LEDs would stand 0.5 mm inside the shell's floor."""
    lens_hole_mm: Annotated[float, Meta(ge=8.0, le=14.0)] = 10.2
    """Diameter of the hole around the lens head of 10.00; tracks forbid more."""
    notch_mm: Annotated[float, Meta(ge=1.0, le=5.0)] = 2.8
    """Radius of the corner notches around the shell's bosses of radius 2.70."""
    locating_mm: Annotated[float, Meta(ge=1.0, le=3.0)] = 1.5
    """Diameter of the holes for pins of 1.45."""
    locating_inset_mm: tuple[_InsetMm, _InsetMm] = (1.5, 5.0)
    """From the board's edges to these holes, x and y."""
    led_mm: tuple[_LedMm, _LedMm, _LedMm] = (3.5, 2.8, 0.72)
    """Body of a 2835 LED: along x, along y, height."""
    led_inset_mm: tuple[_LedInsetMm, _LedInsetMm] = (5.2, 3.0)
    """From the board's edges to the middle of the outer LEDs."""
    led_shift_mm: tuple[_LedShiftMm, _LedShiftMm, _LedShiftMm] = (0.0, 0.0, 0.0)
    """Offset along x of the left, middle and right LEDs from their nominal positions."""
    usb_mm: tuple[_UsbMm, _UsbMm, _UsbMm] = (7.5, 5.0, 2.65)
    """Micro-USB receptacle below the board: along x, along y, height."""
    usb_beyond_mm: Annotated[float, Meta(ge=0.0, le=2.0)] = 0.34
    """How far its mouth stands out over the board's -y edge."""
    driver_mm: tuple[_DriverMm, _DriverMm, _DriverMm] = (3.9, 4.9, 1.75)
    """Body of the LED driver below the board: along x, along y, height."""
    driver_at_mm: tuple[_DriverPlaceMm, _DriverPlaceMm] = (3.49, -2.6)
    """Centre of the LED driver: x, and y from the +y edge."""
    resistor_ohm: Annotated[float, Meta(ge=1200.0, le=30000.0)] = 20000.0
    """R1, which sets the LEDs' current: 1800 V / R in all (`LedOperatingPoint`). The driver follows from 1.2 to 30
    kOhm; below about 3.75 kOhm the current exceeds what LEDs or USB bear, which is refused too."""


ORIGINAL_BOARD = LedBoardDimensions(lens_hole_mm=10.0, led_shift_mm=(0.031, 0.131, 0.031))
"""The original's board, with LEDs a little off their rectangle and no clearance around the lens."""


M2_DIAMETER_MM = 2.0
"""Diameter of all screws of the sensor."""


@dataclass(frozen=True)
class FastenerDimensions:
    """Heat-set inserts and screws."""

    insert_mm: tuple[_InsertMm, _InsertMm] = (3.3, 5.09)
    """M2 insert: diameter over its knurl, length."""
    screw_mm: Annotated[float, Meta(ge=2.0, le=12.0)] = 6.0
    """Length of the M2 screws below their heads: the paper's list has M2-6."""
    head_mm: tuple[_HeadMm, _HeadMm] = (3.9, 0.85)
    """Screw heads: diameter, height."""


ORIGINAL_FASTENERS = FastenerDimensions(screw_mm=5.0)
"""The original's CAD has M2-5."""


@dataclass(frozen=True)
class BaseDimensions:
    """The base: plate, camera pocket, insert bosses and locating posts, 3D-printed in black."""

    plate_mm: Annotated[float, Meta(ge=2.0, le=6.0)] = 3.0
    """Thickness of the plate, which holds a pocket for the camera and a floor below it."""
    corner_radius_mm: Annotated[float, Meta(ge=0.0, le=5.0)] = 2.0
    """Radius of the outline's corners, as that of the shell."""
    floor_mm: Annotated[float, Meta(ge=0.8, le=3.0)] = 1.0
    """Thickness below camera and inserts, against which a screw head or a bolt pulls."""
    mount_inset_mm: tuple[_MountInsetMm, _MountInsetMm] = (5.75, 3.0)
    """From the shell's cavity walls to the four inserts to which a robot is bolted, x and y: a pattern of 17.0 x 15.5
    in the published size, clear of posts and screw bosses in every size."""
    boss_mm: Annotated[float, Meta(ge=4.0, le=8.0)] = 5.3
    """Diameter of the insert bosses, which leaves 1.2 of plastic around a heat-set insert."""
    boss_tall_mm: Annotated[float, Meta(ge=0.0, le=4.0)] = 3.5
    """Height of the bosses above the plate; 1.0 stays free below the circuit board."""
    bore_mm: Annotated[float, Meta(ge=2.5, le=3.4)] = 2.82
    """Bore for an M2 heat-set insert of 3.3 over its knurl."""
    bolt_mm: Annotated[float, Meta(ge=2.05, le=3.0)] = 2.4
    """Holes through the floor below the inserts: M2 with the clearance of a printed hole (ISO 273 medium)."""
    post_mm: Annotated[float, Meta(ge=2.0, le=4.0)] = 2.8
    """Diameter of the posts that carry the circuit board."""
    post_tall_mm: Annotated[float, Meta(ge=3.0, le=8.0)] = 4.5
    """Height of the posts from the plate to the underside of the circuit board, which clears the micro-USB receptacle
    that hangs below it."""
    pin_mm: Annotated[float, Meta(ge=0.8, le=2.5)] = 1.45
    """Diameter of the locating pins, in holes of 1.50."""
    pin_tall_mm: Annotated[float, Meta(ge=0.5, le=1.2)] = 1.0
    """Height of the pins above the posts: 0.20 more than the board is thick."""
    pin_round_mm: Annotated[float, Meta(ge=0.0, le=0.5)] = 0.3
    """Fillet at the tips of the pins, which helps to find the holes."""
    shell_screw_mm: Annotated[float, Meta(ge=2.0, le=3.0)] = 2.2
    """Clearance hole of the M2 screws into the shell; 2.00 as drawn originally binds where it is printed."""
    counterbore_mm: Annotated[float, Meta(ge=3.9, le=5.0)] = 4.0
    """Diameter of the counterbores for heads of 3.9."""
    counterbore_deep_mm: Annotated[float, Meta(ge=0.5, le=2.0)] = 1.0
    """Depth of the counterbores: heads of 0.85 sit 0.15 below the face."""
    pocket_wide_mm: Annotated[float, Meta(ge=8.0, le=15.0)] = 8.9
    """Width of the camera's pocket; the camera is 8.70 wide, which leaves 0.10 on each side."""
    pocket_front_mm: Annotated[float, Meta(ge=4.0, le=8.0)] = 4.45
    """From the optical axis to the pocket's wall at +y."""
    pocket_back_mm: Annotated[float, Meta(ge=4.0, le=10.0)] = 7.75
    """From the optical axis to the pocket's shoulder at -y; the camera's stiffener ends at 7.65."""
    channel_wide_mm: Annotated[float, Meta(ge=6.0, le=10.0)] = 6.4
    """Width of the channel for a flat cable of 6.00."""
    channel_round_mm: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.4
    """Fillet at the two entry corners, on which the cable would catch."""
    ramp_foot_mm: Annotated[float, Meta(ge=1.0, le=6.0)] = 3.0
    """From the outer face to the foot of the ramp that lifts the cable to the shell's rim."""
    ramp_head_mm: Annotated[float, Meta(ge=0.1, le=2.0)] = 0.5
    """From the outer face to the head of the ramp."""
    ramp_gap_mm: Annotated[float, Meta(ge=0.3, le=1.0)] = 0.5
    """Gap for the cable under the shell's rim; the cable is modelled 0.40 thick."""
    ramp_foot_round_mm: Annotated[float, Meta(ge=0.0, le=3.0)] = 2.0
    """Blend at the foot of the ramp: the cable must not be bent sharply."""
    ramp_head_round_mm: Annotated[float, Meta(ge=0.0, le=2.0)] = 1.0
    """Blend at the head of the ramp."""


ORIGINAL_BASE = BaseDimensions(
    bolt_mm=2.1, shell_screw_mm=2.0, pocket_wide_mm=8.7, pocket_front_mm=4.35, pocket_back_mm=7.55, ramp_gap_mm=0.4
)
"""The original's base, without clearances around camera, cable and screws."""


@dataclass(frozen=True)
class ShellDimensions:
    """The shell, 3D-printed in white, translucent nylon: gel cavity above, LED cavity below, the floor with its window
    between."""

    wall_mm: Annotated[float, Meta(ge=0.0, le=6.0)] = 2.0
    """Thickness of the walls of both cavities; nylon below 0.8 is neither tight nor stiff (which a rule states, not
    this range)."""
    corner_radius_mm: Annotated[float, Meta(ge=0.0, le=5.0)] = 2.0
    """Radius of the outline's corners."""
    opening_radius_mm: Annotated[float, Meta(ge=0.0, le=4.0)] = 1.0
    """Radius of the gel cavity's corners."""
    floor_mm: Annotated[float, Meta(ge=0.8, le=4.0)] = 2.0
    """Thickness of the floor between the cavities, which carries the window and through which the LEDs shine."""
    hole_mm: Annotated[float, Meta(ge=8.0, le=20.0)] = 12.0
    """Side of the square window hole."""
    frame_wall_mm: Annotated[float, Meta(ge=0.0, le=2.0)] = 0.8
    """Wall of the small frame that keeps the window in its place while it is glued."""
    frame_tall_mm: Annotated[float, Meta(ge=0.3, le=2.0)] = 0.8
    """Height of the frame above the floor; the window stands above it, so that glue does not run onto it."""
    frame_gap_mm: Annotated[float, Meta(ge=0.05, le=0.5)] = 0.1
    """From the window to the frame, on each side."""
    led_cavity_mm: Annotated[float, Meta(ge=5.0, le=12.0)] = 6.3
    """Depth of the lower cavity: posts, circuit board and LEDs, and 0.28 of air above these."""
    smallest_cavity_mm: tuple[_CavityMm, _CavityMm] = (28.5, 21.5)
    """Least size of the lower cavity, which the components of the circuit board need however small the sensing area is."""
    boss_mm: Annotated[float, Meta(ge=4.0, le=8.0)] = 5.4
    """Diameter of the screw bosses in the lower cavity's corners."""
    boss_inset_mm: Annotated[float, Meta(ge=0.0, le=3.0)] = 0.75
    """From the cavity's walls to the bosses' axes."""
    fillet_mm: Annotated[float, Meta(ge=0.0, le=1.5)] = 0.95
    """Fillet around the lower cavity's ceiling, for stiffness."""
    bore_mm: Annotated[float, Meta(ge=2.5, le=3.4)] = 2.85
    """Bore for M2 heat-set inserts; nylon yields a little less than the base's plastic."""
    bore_deep_mm: Annotated[float, Meta(ge=4.0, le=8.0)] = 5.5
    """Depth of the bores: inserts are 5.09 long, and the rest takes the melted plastic."""
    slot_wide_mm: Annotated[float, Meta(ge=7.6, le=12.0)] = 9.0
    """Width of the micro-USB slot, which the receptacle's mouth enters."""
    slot_from_mm: Annotated[float, Meta(ge=0.0, le=4.0)] = 1.55
    """Lower edge of the slot above the shell's bottom rim."""
    slot_to_mm: Annotated[float, Meta(ge=3.0, le=7.0)] = 4.95
    """Upper edge of the slot above the shell's bottom rim."""
    slot_chamfer_mm: Annotated[float, Meta(ge=0.0, le=2.0)] = 1.0
    """Chamfer at the two upper corners of the slot, as the receptacle has."""
    slot_round_mm: Annotated[float, Meta(ge=0.0, le=0.7)] = 0.5
    """Fillet at all six corners of the slot."""
    relief_wide_mm: Annotated[float, Meta(ge=0.0, le=16.0)] = 11.0
    """Width of the relief around the slot outside, without which a plug's overmould stops at the wall 1.9 before its
    end position; 0 for none."""
    relief_left_mm: Annotated[float, Meta(ge=0.0, le=6.0)] = 0.9
    """Thickness of the wall behind the relief, however thick the wall is."""
    relief_tall_mm: Annotated[float, Meta(ge=0.0, le=12.0)] = 6.8
    """Height of the relief from the shell's bottom rim: half an overmould above the plug's middle."""

    @property
    def relief_deep_mm(self) -> float:
        """Depth of the relief around the slot."""
        return max(self.wall_mm - self.relief_left_mm, 0.0) if self.relief_wide_mm else 0.0


ORIGINAL_SHELL = ShellDimensions(slot_wide_mm=8.0, slot_from_mm=1.85, slot_to_mm=4.7, relief_wide_mm=0.0)
"""The original's shell, with a tight slot in a full wall."""


@dataclass(frozen=True)
class LightIsolationRingDimensions:
    """The black isolation ring in the shell's window hole, its mouth at the window: LED light must reach the lens
    through the gel only."""

    gap_mm: Annotated[float, Meta(ge=0.0, le=0.5)] = 0.05
    """From its sides to the shell's hole."""
    bore_mm: Annotated[float, Meta(ge=10.0, le=16.0)] = 10.1
    """Bore around the lens head of 10.00."""
    land_mm: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.15
    """Wall left at the middle of the mouth's sides; without it they end in an edge that does not print."""
    above_board_mm: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.2
    """Distance of its lower face from the circuit board, since boards differ in thickness."""
    cone_deg: Annotated[float, Meta(ge=20.0, le=70.0)] = 45.0
    """Half-angle of the mouth, which opens the view."""


ORIGINAL_RING = LightIsolationRingDimensions(land_mm=0.0)
"""The original's ring, whose mouth touches its sides."""


@dataclass(frozen=True)
class WindowDimensions:
    """The window of clear acrylic, laser-cut, between camera and gel."""

    side_mm: Annotated[float, Meta(ge=9.0, le=24.0)] = 14.0
    """Side of the window: the hole of 12.00 and a ledge of 1.00 around it."""
    thick_mm: Annotated[float, Meta(ge=1.0, le=5.0)] = 2.0
    """Thickness of the sheet."""


@dataclass(frozen=True)
class CalibrationBoardDimensions:
    """The calibration board: a tray that slides over the shell. Number, pitch and diameter of its pins are those of the
    sensor design."""

    gap_mm: Annotated[float, Meta(ge=0.05, le=1.0)] = 0.25
    """From the shell to the tray, on each side: it must slide and not turn."""
    wall_mm: Annotated[float, Meta(ge=0.8, le=6.0)] = 2.0
    """Wall thickness of the tray."""
    floor_mm: Annotated[float, Meta(ge=1.0, le=6.0)] = 2.5
    """Thickness of the floor below the pins, which must not bend."""
    guided_mm: Annotated[float, Meta(ge=2.0, le=12.0)] = 4.2
    """How far the tray reaches down the shell when its pins touch the skin."""
    corner_radius_mm: Annotated[float, Meta(ge=0.0, le=8.0)] = 4.0
    """Outer corner radius; inside it is less by the wall."""
    pin_tall_mm: Annotated[float, Meta(ge=0.8, le=4.0)] = 1.5
    """Height of the pins above the floor, the round tip included."""


@dataclass(frozen=True)
class GelLayerDimensions:
    """Dimensions of the layers other than the thickness of the translucent one, which belongs to the sensor design."""

    rim_radius_mm: Annotated[float, Meta(ge=0.0, le=5.0)] = 1.0
    """Corner radius of the translucent layer."""
    black_top_mm: Annotated[float, Meta(ge=0.1, le=2.0)] = 0.3
    """Thickness of the black layer above the translucent one: the difference of the two moulds, enough to stop all
    light."""
    black_side_mm: Annotated[float, Meta(ge=0.2, le=2.0)] = 0.8
    """Thickness of the black layer around the sides."""


@dataclass(frozen=True)
class MouldDimensions:
    """Laser-cut acrylic plates, clamped by M3 screws; each mould is as thick as the layers that it forms."""

    base_mm: Annotated[float, Meta(ge=1.0, le=8.0)] = 3.0
    """Thickness of the base board on which the shell is screwed."""
    beyond_mm: tuple[_BeyondMm, _BeyondMm] = (30.5, 27.5)
    """How much wider the plates are than the translucent layer, x and y: space for shell and screws."""
    corner_radius_mm: Annotated[float, Meta(ge=0.0, le=20.0)] = 12.0
    """Corner radius of the plates."""
    hole_mm: Annotated[float, Meta(ge=3.05, le=3.6)] = 3.1
    """Clearance holes for M3."""
    hole_inset_mm: Annotated[float, Meta(ge=2.5, le=8.0)] = 3.0
    """From the plates' edges to the screws' axes."""
    pairs_mm: tuple[_PairMm, _PairMm] = (10.0, 8.0)
    """Positions of the screws: at the long sides, x from the middle; at the short sides, y from the middle."""
    shell_screw_mm: Annotated[float, Meta(ge=2.0, le=3.0)] = 2.2
    """Holes through the base board into the shell's inserts."""


ORIGINAL_MOULDS = MouldDimensions(shell_screw_mm=2.1)
