"""The hardware design of one sensor: its sensor design, every dimension of its parts, and the widths, positions and heights of the
assembled parts that follow from them. Lengths in mm, pairs are (x, y).

Assembly frame: x along the long side, y along the short side, z towards the skin. The origin lies in the middle of the
base's outer bottom face, z is the optical axis, and cable and USB leave at -y.
"""

from dataclasses import dataclass, fields
from functools import cached_property
from itertools import product
from math import hypot, sqrt
from typing import Literal

from ninedtact.bounds_and_checked_reading import require_within_bounds
from ninedtact.design import DesignImpossible, SensorDesign
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
        return _horizontal_dimensions(self)

    @cached_property
    def heights(self) -> "StackHeights":
        """Heights of the faces above the base's outer face, z."""
        return _stack_heights(self)


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


@dataclass(frozen=True)
class HorizontalDimensions:
    """Widths and positions in x and y."""

    frame_inside: float
    """Side of the square recess in which the window sits."""
    frame_outside: float
    """Outer side of the square frame around the window."""
    ring_side: float
    """Side of the square isolation ring, which sits in the shell's hole."""
    opening: XY
    """Size of the shell's opening towards the gel."""
    cavity: XY
    """Size of the shell's cavity around the circuit board."""
    outer: XY
    """Outer size of base and shell."""
    shell_corner: float
    """Thickness of the shell along the diagonal of a corner of the gel cavity."""
    translucent: XY
    """Size of the translucent gel, which overlaps the shell's rim."""
    black: XY
    """Outer size of the black gel around the translucent one."""
    led_board: XY
    """Size of the LED board."""
    shell_screws: tuple[XY, ...]
    """Axes of the shell's screw bosses, of the screws through the base and of the LED board's notches."""
    mount_inserts: tuple[XY, ...]
    """Axes of the base's inserts, to which a robot is bolted."""
    posts: tuple[XY, ...]
    """Axes of the base's posts, which carry the LED board."""
    led_columns: tuple[float, float, float]
    """Positions of the LED columns along x."""
    led_rows: tuple[float, float, float]
    """Positions of the LED rows along y."""
    leds: tuple[XY, ...]
    """Centres of the eight LEDs, which form a rectangle with an empty middle."""
    usb_mouth: float
    """Distance of the micro-USB receptacle's mouth from the optical axis, along -y."""
    plate: XY
    """Size of the mould plates."""
    clamps: tuple[XY, ...]
    """Axes of the M3 screws that clamp the moulds."""
    tray: XY
    """Inner size of the calibration board's tray."""
    tray_tall: float
    """Height of the calibration board: its floor, its pins, the gel above the shell's rim, and its guide."""
    pins: tuple[XY, ...]
    """Axes of the calibration board's pins."""


def _horizontal_dimensions(design: HardwareDesign) -> HorizontalDimensions:
    shell, board, moulds, frame = design.shell, design.board, design.moulds, design.pin_frame
    area, pins = design.sensor.sensing_area, design.sensor.pin_board
    frame_inside = design.window.side_mm + 2 * shell.frame_gap_mm
    frame_outside = frame_inside + 2 * shell.frame_wall_mm
    opening = _at_least(area.opening_mm, (frame_outside + 2 * FRAME_ROOM_MM,) * 2)
    cavity = _at_least(opening, shell.smallest_cavity_mm)
    outer = _enlarge(cavity, shell.wall_mm)
    corner = shell.corner_radius_mm - shell.opening_radius_mm
    translucent = _enlarge(opening, area.overlap_mm)
    led_board = _enlarge(cavity, -board.gap_mm)
    led_x, led_y = (side / 2 - inset for side, inset in zip(led_board, board.led_inset_mm, strict=True))
    left, middle, right = board.led_shift_mm
    led_columns, led_rows = (-led_x + left, middle, led_x + right), (led_y, 0.0, -led_y)
    plate_x, plate_y = _at_least(translucent, (outer[0] - RIM_BESIDE_GEL_MM, outer[1] - RIM_BESIDE_GEL_MM))
    plate = plate_x + moulds.beyond_mm[0], plate_y + moulds.beyond_mm[1]
    above_rim = design.sensor.gel.thickness_mm + design.gels.black_top_mm
    pin_rows, pin_columns = (
        [(number - (many - 1) / 2) * pins.pitch_mm for number in range(many)] for many in (pins.rows, pins.cols)
    )
    return HorizontalDimensions(
        frame_inside=frame_inside,
        frame_outside=frame_outside,
        ring_side=shell.hole_mm - 2 * design.ring.gap_mm,
        opening=opening,
        cavity=cavity,
        outer=outer,
        shell_corner=corner + sqrt(2) * min((outer[axis] - opening[axis]) / 2 - corner for axis in (0, 1)),
        translucent=translucent,
        black=_enlarge(translucent, design.gels.black_side_mm),
        led_board=led_board,
        shell_screws=_mirrored_corners(cavity, (shell.boss_inset_mm, shell.boss_inset_mm)),
        mount_inserts=_mirrored_corners(cavity, design.base.mount_inset_mm),
        posts=_mirrored_corners(led_board, board.locating_inset_mm),
        led_columns=led_columns,
        led_rows=led_rows,
        leds=tuple((x, y) for y, x in product(led_rows, led_columns) if (x, y) != (middle, 0.0)),
        usb_mouth=led_board[1] / 2 + board.usb_beyond_mm,
        plate=plate,
        clamps=(
            *_mirrored_corners((2 * moulds.pairs_mm[0], plate[1]), (0.0, moulds.hole_inset_mm)),
            *_mirrored_corners((plate[0], 2 * moulds.pairs_mm[1]), (moulds.hole_inset_mm, 0.0)),
        ),
        tray=_enlarge(outer, frame.gap_mm),
        tray_tall=frame.floor_mm + frame.pin_tall_mm + above_rim + frame.guided_mm,
        pins=tuple((x, y) for y, x in product(pin_rows, pin_columns)),
    )


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


@dataclass(frozen=True)
class StackHeights:
    """Heights of the faces above the base's outer face, z. The camera's distance to the skin, less the gel, gives the
    height of the shell."""

    plate_top: float
    """Top of the base plate, on which the shell stands."""
    boss_top: float
    """Top of the base's insert bosses."""
    board_bottom: float
    """Underside of the LED board, which rests on the base's posts."""
    board_top: float
    """Top of the LED board, on which the LEDs stand."""
    led_top: float
    """Top of the LEDs."""
    usb_bottom: float
    """Underside of the micro-USB receptacle, which hangs below the LED board."""
    ceiling: float
    """Underside of the shell's floor."""
    floor_top: float
    """Top of the shell's floor, which is the window's seat."""
    ring_bottom: float
    """Lower face of the isolation ring, whose mouth is at the window."""
    frame_top: float
    """Top of the frame around the window."""
    window_top: float
    """Upper face of the acrylic window."""
    lens_front: float
    """Front of the lens, from which the camera distance is measured."""
    skin: float
    """Upper face of the translucent gel, which the camera sees."""
    rim: float
    """Rim of the shell, on which the translucent gel lies."""
    first_mould: float
    """Thickness of the first mould, which is that of the translucent gel."""
    second_mould: float
    """Thickness of the second mould, which is that of both layers above the rim."""
    top: float
    """Top of the black gel, which is the height of the sensor."""


def _stack_heights(design: HardwareDesign) -> StackHeights:
    base, shell, board, gel_mm = design.base, design.shell, design.board, design.sensor.gel.thickness_mm
    board_bottom = base.plate_mm + base.post_tall_mm
    board_top = board_bottom + board.thick_mm
    ceiling = base.plate_mm + shell.led_cavity_mm
    floor_top = ceiling + shell.floor_mm
    lens_front = base.floor_mm + design.camera.head_mm[1]
    skin = lens_front + design.sensor.camera.distance_mm
    return StackHeights(
        plate_top=base.plate_mm,
        boss_top=base.plate_mm + base.boss_tall_mm,
        board_bottom=board_bottom,
        board_top=board_top,
        led_top=board_top + board.led_mm[2],
        usb_bottom=board_bottom - board.usb_mm[2],
        ceiling=ceiling,
        floor_top=floor_top,
        ring_bottom=board_top + design.ring.above_board_mm,
        frame_top=floor_top + shell.frame_tall_mm,
        window_top=floor_top + design.window.thick_mm,
        lens_front=lens_front,
        skin=skin,
        rim=skin - gel_mm,
        first_mould=gel_mm,
        second_mould=gel_mm + design.gels.black_top_mm,
        top=skin + design.gels.black_top_mm,
    )
