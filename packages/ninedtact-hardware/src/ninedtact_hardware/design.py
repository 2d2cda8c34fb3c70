"""The hardware design of one sensor: its sensor design, every dimension of its parts, and the widths, positions and heights of the
assembled parts that follow from them; and what the lens sees, by refraction from its front through air, acrylic and silicone.
Lengths in mm, pairs are (x, y).

Assembly frame: x along the long side, y along the short side, z towards the skin. The origin lies in the middle of the
base's outer bottom face, z is the optical axis, and cable and USB leave at -y.
"""

from dataclasses import dataclass, fields
from functools import cached_property
from itertools import product
from math import asin, hypot, radians, sin, sqrt, tan
from typing import Literal

from ninedtact.bounds import require_within_bounds
from ninedtact.design import ACRYLIC_REFRACTIVE_INDEX, SILICONE_REFRACTIVE_INDEX, DesignImpossible, SensorDesign
from ninedtact_hardware.part_dimensions import (
    ORIGINAL_BASE,
    ORIGINAL_BOARD,
    ORIGINAL_FASTENERS,
    ORIGINAL_MOULDS,
    ORIGINAL_RING,
    ORIGINAL_SHELL,
    BaseDimensions,
    CalibrationBoardDimensions,
    CameraDimensions,
    FastenerDimensions,
    GelLayerDimensions,
    LedBoardDimensions,
    LightIsolationRingDimensions,
    MouldDimensions,
    ShellDimensions,
    WindowDimensions,
)

DesignVariant = Literal["default", "original"]


@dataclass(frozen=True)
class HardwareDesign:
    """The chosen dimensions of every part, by default with the improvements that docs/hardware.md lists; `heights` and
    `horizontal_dimensions` hold what follows from them."""

    sensor: SensorDesign = SensorDesign()
    variant: DesignVariant = "default"
    base: BaseDimensions = BaseDimensions()
    shell: ShellDimensions = ShellDimensions()
    ring: LightIsolationRingDimensions = LightIsolationRingDimensions()
    window: WindowDimensions = WindowDimensions()
    board: LedBoardDimensions = LedBoardDimensions()
    camera: CameraDimensions = CameraDimensions()
    gels: GelLayerDimensions = GelLayerDimensions()
    moulds: MouldDimensions = MouldDimensions()
    pin_frame: CalibrationBoardDimensions = CalibrationBoardDimensions()
    fasteners: FastenerDimensions = FastenerDimensions()

    def __post_init__(self) -> None:
        """Raise `DesignImpossible` for a dimension out of its bounds."""
        for table in PART_TABLES:
            require_within_bounds(getattr(self, table), table, DesignImpossible)
        tops = [self.camera.tall_mm, *(top for _, top in self.camera.lens_mm)]
        if tops != sorted(tops):
            raise DesignImpossible(
                expected="the tops of camera body, collar, barrel, neck and head one above the other",
                got=f"{tops} mm",
                remedy="correct the design",
            )

    @cached_property
    def horizontal_dimensions(self) -> "HorizontalDimensions":
        """Widths and positions in x and y."""
        return HorizontalDimensions(self)

    @cached_property
    def heights(self) -> "StackHeights":
        """Heights of the faces above the base's outer face, z."""
        return StackHeights(self)


PART_TABLES = tuple(field.name for field in fields(HardwareDesign) if field.name not in ("sensor", "variant"))
"""Names of the parts, which are those of their tables in a design file."""


def original_hardware_design(sensor: SensorDesign = SensorDesign()) -> HardwareDesign:
    """Return the design with the dimensions of the original 9DTact."""
    return HardwareDesign(
        sensor,
        "original",
        base=ORIGINAL_BASE,
        shell=ORIGINAL_SHELL,
        ring=ORIGINAL_RING,
        board=ORIGINAL_BOARD,
        moulds=ORIGINAL_MOULDS,
        fasteners=ORIGINAL_FASTENERS,
    )


def hardware_design_of_variant(sensor: SensorDesign, variant: DesignVariant) -> HardwareDesign:
    """Return the design of the variant with this name."""
    return original_hardware_design(sensor) if variant == "original" else HardwareDesign(sensor)


XY = tuple[float, float]
FRAME_ROOM_MM = 1.0
"""Distance between the window's frame and the gel cavity's wall where the sensing area is smaller than the window."""
RIM_BESIDE_GEL_MM = 3.0
"""Difference in width between shell and translucent layer in the published size. The mould plates are sized from the
layer, and grow with the shell where that is wider still."""


class HorizontalDimensions:
    """Widths and positions in x and y."""

    def __init__(self, design: HardwareDesign) -> None:
        shell, board, moulds, frame = design.shell, design.board, design.moulds, design.pin_frame
        area, pins = design.sensor.sensing_area, design.sensor.pin_board
        self.frame_inside = design.window.side_mm + 2 * shell.frame_gap_mm
        """Side of the square recess in which the window sits."""
        self.frame_outside = self.frame_inside + 2 * shell.frame_wall_mm
        """Outer side of the square frame around the window."""
        self.ring_side = shell.hole_mm - 2 * design.ring.gap_mm
        """Side of the square isolation ring, which sits in the shell's hole."""
        self.opening = _at_least(area.opening_mm, (self.frame_outside + 2 * FRAME_ROOM_MM,) * 2)
        """Size of the shell's opening towards the gel."""
        self.cavity = _at_least(self.opening, shell.smallest_cavity_mm)
        """Size of the shell's cavity around the circuit board."""
        self.outer = _enlarge(self.cavity, shell.wall_mm)
        """Outer size of base and shell."""
        corner = shell.corner_radius_mm - shell.opening_radius_mm
        walls = [(outer - opening) / 2 for outer, opening in zip(self.outer, self.opening, strict=True)]
        self.shell_corner = corner + sqrt(2) * (min(walls) - corner)
        """Thickness of the shell along the diagonal of a corner of the gel cavity."""
        self.translucent = _enlarge(self.opening, area.overlap_mm)
        """Size of the translucent gel, which overlaps the shell's rim."""
        self.black = _enlarge(self.translucent, design.gels.black_side_mm)
        """Outer size of the black gel around the translucent one."""
        self.led_board = _enlarge(self.cavity, -board.gap_mm)
        """Size of the LED board."""
        self.shell_screws = _mirrored_corners(self.cavity, (shell.boss_inset_mm, shell.boss_inset_mm))
        """Axes of the shell's screw bosses, of the screws through the base and of the LED board's notches."""
        self.mount_inserts = _mirrored_corners(self.cavity, design.base.mount_inset_mm)
        """Axes of the base's inserts, to which a robot is bolted."""
        self.posts = _mirrored_corners(self.led_board, board.locating_inset_mm)
        """Axes of the base's posts, which carry the LED board."""
        led_x, led_y = (side / 2 - inset for side, inset in zip(self.led_board, board.led_inset_mm, strict=True))
        left, middle, right = board.led_shift_mm
        self.led_columns = -led_x + left, middle, led_x + right
        """Positions of the LED columns along x."""
        self.led_rows = led_y, 0.0, -led_y
        """Positions of the LED rows along y."""
        self.leds = tuple((x, y) for y, x in product(self.led_rows, self.led_columns) if (x, y) != (middle, 0.0))
        """Centres of the eight LEDs, which form a rectangle with an empty middle."""
        self.usb_mouth = self.led_board[1] / 2 + board.usb_beyond_mm
        """Distance of the micro-USB receptacle's mouth from the optical axis, along -y."""
        wide, deep = _at_least(self.translucent, _enlarge(self.outer, -RIM_BESIDE_GEL_MM / 2))
        self.plate = wide + moulds.beyond_mm[0], deep + moulds.beyond_mm[1]
        """Size of the mould plates."""
        self.clamps = (
            *_mirrored_corners((2 * moulds.pairs_mm[0], self.plate[1]), (0.0, moulds.hole_inset_mm)),
            *_mirrored_corners((self.plate[0], 2 * moulds.pairs_mm[1]), (moulds.hole_inset_mm, 0.0)),
        )
        """Axes of the M3 screws that clamp the moulds."""
        self.tray = _enlarge(self.outer, frame.gap_mm)
        """Inner size of the calibration board's tray."""
        above_rim = design.sensor.gel.thickness_mm + design.gels.black_top_mm
        self.tray_tall = frame.floor_mm + frame.pin_tall_mm + above_rim + frame.guided_mm
        """Height of the calibration board: its floor, its pins, the gel above the shell's rim, and its guide."""
        rows, columns = (
            [(number - (many - 1) / 2) * pins.pitch_mm for number in range(many)] for many in (pins.rows, pins.cols)
        )
        self.pins = tuple((x, y) for y, x in product(rows, columns))
        """Axes of the calibration board's pins."""


def _at_least(size: XY, least: XY) -> XY:
    return max(size[0], least[0]), max(size[1], least[1])


def _enlarge(size: XY, each_side: float) -> XY:
    return size[0] + 2 * each_side, size[1] + 2 * each_side


def _mirrored_corners(size: XY, inset: XY) -> tuple[XY, ...]:
    """Return the four points that lie inside the corners of a rectangle by this inset."""
    x, y = size[0] / 2 - inset[0], size[1] / 2 - inset[1]
    return tuple((side_x * x, side_y * y) for side_x in (-1, 1) for side_y in (-1, 1))


def distance_to_edge_mm(place: XY, size: XY, radius_mm: float) -> float:
    """Return the distance of a point in a plate, with vertical corners of this radius, from the plate's edge; negative outside."""
    x, y = (size[axis] / 2 - abs(place[axis]) for axis in (0, 1))
    return radius_mm - hypot(radius_mm - x, radius_mm - y) if max(x, y) < radius_mm else min(x, y)


class StackHeights:
    """Heights of the faces above the base's outer face, z. The camera's distance to the skin, less the gel, gives the
    height of the shell."""

    def __init__(self, design: HardwareDesign) -> None:
        base, shell, board, gel_mm = design.base, design.shell, design.board, design.sensor.gel.thickness_mm
        self.plate_top = base.plate_mm
        """Top of the base plate, on which the shell stands."""
        self.boss_top = base.plate_mm + base.boss_tall_mm
        """Top of the base's insert bosses."""
        self.board_bottom = base.plate_mm + base.post_tall_mm
        """Underside of the LED board, which rests on the base's posts."""
        self.board_top = self.board_bottom + board.thick_mm
        """Top of the LED board, on which the LEDs stand."""
        self.led_top = self.board_top + board.led_mm[2]
        """Top of the LEDs."""
        self.usb_bottom = self.board_bottom - board.usb_mm[2]
        """Underside of the micro-USB receptacle, which hangs below the LED board."""
        self.ceiling = base.plate_mm + shell.led_cavity_mm
        """Underside of the shell's floor."""
        self.floor_top = self.ceiling + shell.floor_mm
        """Top of the shell's floor, which is the window's seat."""
        self.ring_bottom = self.board_top + design.ring.above_board_mm
        """Lower face of the isolation ring, whose mouth is at the window."""
        self.frame_top = self.floor_top + shell.frame_tall_mm
        """Top of the frame around the window."""
        self.window_top = self.floor_top + design.window.thick_mm
        """Upper face of the acrylic window."""
        self.lens_front = base.floor_mm + design.camera.head_mm[1]
        """Front of the lens, from which the camera distance is measured."""
        self.skin = self.lens_front + design.sensor.camera.distance_mm
        """Upper face of the translucent gel, which the camera sees."""
        self.rim = self.skin - gel_mm
        """Rim of the shell, on which the translucent gel lies."""
        self.first_mould = gel_mm
        """Thickness of the first mould, which is that of the translucent gel."""
        self.second_mould = gel_mm + design.gels.black_top_mm
        """Thickness of the second mould, which is that of both layers above the rim."""
        self.top = self.skin + design.gels.black_top_mm
        """Top of the black gel, which is the height of the sensor."""


def lens_view_radius_mm(design: HardwareDesign, height_mm: float | None = None) -> float:
    """Return the radius in mm that the lens sees at a height in the assembly, not below its front; at the skin if none is given.

    The pupil is taken to be at the lens front, where wide-angle lenses have it nearly.
    """
    levels, angle = design.heights, radians(design.sensor.camera.lens_angle_deg / 2)
    height = levels.skin if height_mm is None else height_mm
    air = min(height, levels.floor_top) - levels.lens_front
    acrylic = min(max(height - levels.floor_top, 0.0), design.window.thick_mm)
    silicone = max(height - levels.window_top, 0.0)
    return (
        air * tan(angle)
        + acrylic * _refracted_slope(angle, ACRYLIC_REFRACTIVE_INDEX)
        + silicone * _refracted_slope(angle, SILICONE_REFRACTIVE_INDEX)
    )


def sensing_corner_distance_mm(design: HardwareDesign) -> float:
    """Return the distance from the optical axis to a corner of the sensing area, which the lens must reach."""
    area = design.sensor.sensing_area
    return hypot(area.width_mm, area.height_mm) / 2


def required_camera_distance_mm(design: HardwareDesign) -> float:
    """Return the least camera distance from which the lens sees the corner of the sensing area."""
    slope = _refracted_slope(radians(design.sensor.camera.lens_angle_deg / 2), SILICONE_REFRACTIVE_INDEX)
    more = (sensing_corner_distance_mm(design) - lens_view_radius_mm(design)) / slope
    return design.sensor.camera.distance_mm + more


def _refracted_slope(angle_rad: float, index: float) -> float:
    """Return the radius gained per mm of height in a material, by Snell's law."""
    return tan(asin(sin(angle_rad) / index))
