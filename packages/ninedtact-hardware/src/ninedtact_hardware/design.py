"""The hardware design of one sensor: its sensor design, every dimension of its parts, and the widths, positions and heights of the
assembled parts that follow from them. Lengths in mm, pairs are (x, y).

Assembly frame: x along the long side, y along the short side, z towards the skin. The origin lies in the middle of the
base's outer bottom face, z is the optical axis, and cable and USB leave at -y.
"""

from collections.abc import Iterator
from dataclasses import dataclass, fields
from itertools import product
from math import hypot, sqrt
from typing import Literal

from ninedtact.design import DesignImpossible, SensorDesign
from ninedtact.field_bounds import require_within_bounds
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
    """The chosen dimensions of every part; `horizontal_dimensions` and `heights` hold what follows from them."""

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

    @property
    def horizontal_dimensions(self) -> "HorizontalDimensions":
        """Widths and positions in x and y."""
        return HorizontalDimensions(self)

    @property
    def heights(self) -> "StackHeights":
        """Heights of the faces above the base's outer face, z."""
        return StackHeights(self)


PART_TABLES = tuple(field.name for field in fields(HardwareDesign) if field.name not in ("sensor", "variant"))
"""Names of the parts, which are those of their tables in a design file."""


def default_hardware_design(sensor: SensorDesign = SensorDesign()) -> HardwareDesign:
    """Return the design with the improvements that docs/hardware.md lists."""
    return HardwareDesign(sensor)


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
    return original_hardware_design(sensor) if variant == "original" else default_hardware_design(sensor)


XY = tuple[float, float]
FRAME_ROOM_MM = 1.0
"""Distance between the window's frame and the gel cavity's wall where the sensing area is smaller than the window."""
RIM_BESIDE_GEL_MM = 3.0
"""Difference in width between shell and translucent layer in the published size. The mould plates are sized from the
layer, and grow with the shell where that is wider still."""


@dataclass(frozen=True)
class HorizontalDimensions:
    """Widths and positions in x and y, from the sensing area outwards."""

    design: HardwareDesign

    @property
    def frame_inside(self) -> float:
        """Side of the square recess in which the window sits."""
        return self.design.window.side_mm + 2 * self.design.shell.frame_gap_mm

    @property
    def frame_outside(self) -> float:
        """Outer side of the square frame around the window."""
        return self.frame_inside + 2 * self.design.shell.frame_wall_mm

    @property
    def ring_side(self) -> float:
        """Side of the square isolation ring, which sits in the shell's hole."""
        return self.design.shell.hole_mm - 2 * self.design.ring.gap_mm

    @property
    def opening(self) -> XY:
        """Size of the shell's opening towards the gel."""
        least = self.frame_outside + 2 * FRAME_ROOM_MM
        x, y = self.design.sensor.sensing_area.opening_mm
        return max(x, least), max(y, least)

    @property
    def cavity(self) -> XY:
        """Size of the shell's cavity around the circuit board."""
        (x, y), (least_x, least_y) = self.opening, self.design.shell.smallest_cavity_mm
        return max(x, least_x), max(y, least_y)

    @property
    def outer(self) -> XY:
        """Outer size of base and shell."""
        return _enlarge(self.cavity, self.design.shell.wall_mm)

    @property
    def shell_corner(self) -> float:
        """Thickness of the shell along the diagonal of a corner of the gel cavity."""
        outer, inner = self.design.shell.corner_radius_mm, self.design.shell.opening_radius_mm
        apart = [(self.outer[axis] / 2 - outer) - (self.opening[axis] / 2 - inner) for axis in (0, 1)]
        return outer - inner + sqrt(2) * min(apart)

    @property
    def translucent(self) -> XY:
        """Size of the translucent gel, which overlaps the shell's rim."""
        return _enlarge(self.opening, self.design.sensor.sensing_area.overlap_mm)

    @property
    def black(self) -> XY:
        """Outer size of the black gel around the translucent one."""
        return _enlarge(self.translucent, self.design.gels.black_side_mm)

    @property
    def led_board(self) -> XY:
        """Size of the LED board."""
        return _enlarge(self.cavity, -self.design.board.gap_mm)

    @property
    def shell_screws(self) -> Iterator[XY]:
        """Axes of the shell's screw bosses, which are also those of the screws through the base and of the LED board's
        notches."""
        inset = self.design.shell.boss_inset_mm
        return _mirrored_corners(self.cavity[0] / 2 - inset, self.cavity[1] / 2 - inset)

    @property
    def mount_inserts(self) -> Iterator[XY]:
        """Axes of the base's inserts, to which a robot is bolted."""
        x, y = self.design.base.mount_inset_mm
        return _mirrored_corners(self.cavity[0] / 2 - x, self.cavity[1] / 2 - y)

    @property
    def posts(self) -> Iterator[XY]:
        """Axes of the base's posts, which carry the LED board."""
        x, y = self.design.board.locating_inset_mm
        return _mirrored_corners(self.led_board[0] / 2 - x, self.led_board[1] / 2 - y)

    @property
    def led_columns(self) -> tuple[float, float, float]:
        """Positions of the LED columns along x."""
        left, middle, right = self.design.board.led_shift_mm
        x = self.led_board[0] / 2 - self.design.board.led_inset_mm[0]
        return -x + left, middle, x + right

    @property
    def led_rows(self) -> tuple[float, float, float]:
        """Positions of the LED rows along y."""
        y = self.led_board[1] / 2 - self.design.board.led_inset_mm[1]
        return y, 0.0, -y

    @property
    def leds(self) -> Iterator[XY]:
        """Centres of the eight LEDs, which form a rectangle with an empty middle."""
        middle = self.led_columns[1], self.led_rows[1]
        yield from ((x, y) for y, x in product(self.led_rows, self.led_columns) if (x, y) != middle)

    @property
    def usb_mouth(self) -> float:
        """Distance of the micro-USB receptacle's mouth from the optical axis, along -y."""
        return self.led_board[1] / 2 + self.design.board.usb_beyond_mm

    @property
    def plate(self) -> XY:
        """Size of the mould plates."""
        (x, y), (more_x, more_y) = self.translucent, self.design.moulds.beyond_mm
        return max(x, self.outer[0] - RIM_BESIDE_GEL_MM) + more_x, max(y, self.outer[1] - RIM_BESIDE_GEL_MM) + more_y

    @property
    def clamps(self) -> Iterator[XY]:
        """Axes of the M3 screws that clamp the moulds."""
        (x, y), inset = self.plate, self.design.moulds.hole_inset_mm
        yield from _mirrored_corners(self.design.moulds.pairs_mm[0], y / 2 - inset)
        yield from _mirrored_corners(x / 2 - inset, self.design.moulds.pairs_mm[1])

    @property
    def tray(self) -> XY:
        """Inner size of the calibration board's tray."""
        return _enlarge(self.outer, self.design.pin_frame.gap_mm)

    @property
    def tray_tall(self) -> float:
        """Height of the calibration board: its floor, its pins, the gel above the shell's rim, and its guide."""
        frame, above_rim = self.design.pin_frame, self.design.sensor.gel.thickness_mm + self.design.gels.black_top_mm
        return frame.floor_mm + frame.pin_tall_mm + above_rim + frame.guided_mm

    @property
    def pins(self) -> Iterator[XY]:
        """Axes of the calibration board's pins."""
        board = self.design.sensor.pin_board
        for row in range(board.rows):
            for col in range(board.cols):
                yield (
                    (col - (board.cols - 1) / 2) * board.pitch_mm,
                    (row - (board.rows - 1) / 2) * board.pitch_mm,
                )


def _enlarge(size: XY, each_side: float) -> XY:
    """Return a size that is larger by `each_side` on every side."""
    return size[0] + 2 * each_side, size[1] + 2 * each_side


def distance_to_edge_mm(place: XY, size: XY, radius_mm: float) -> float:
    """Return the distance of a point in a plate, with vertical corners of this radius, from the plate's edge; negative outside."""
    x, y = (size[axis] / 2 - abs(place[axis]) for axis in (0, 1))
    return radius_mm - hypot(radius_mm - x, radius_mm - y) if max(x, y) < radius_mm else min(x, y)


def _mirrored_corners(x: float, y: float) -> Iterator[XY]:
    """Yield a point and its mirror images in both axes."""
    yield from ((side_x * x, side_y * y) for side_x in (-1, 1) for side_y in (-1, 1))


@dataclass(frozen=True)
class StackHeights:
    """Heights of the faces above the base's outer face, z. The camera's distance to the skin, less the gel, gives the
    height of the shell."""

    design: HardwareDesign

    @property
    def plate_top(self) -> float:
        """Top of the base plate, on which the shell stands."""
        return self.design.base.plate_mm

    @property
    def boss_top(self) -> float:
        """Top of the base's insert bosses."""
        return self.plate_top + self.design.base.boss_tall_mm

    @property
    def board_bottom(self) -> float:
        """Underside of the LED board, which rests on the base's posts."""
        return self.plate_top + self.design.base.post_tall_mm

    @property
    def board_top(self) -> float:
        """Top of the LED board, on which the LEDs stand."""
        return self.board_bottom + self.design.board.thick_mm

    @property
    def led_top(self) -> float:
        """Top of the LEDs."""
        return self.board_top + self.design.board.led_mm[2]

    @property
    def usb_bottom(self) -> float:
        """Underside of the micro-USB receptacle, which hangs below the LED board."""
        return self.board_bottom - self.design.board.usb_mm[2]

    @property
    def ceiling(self) -> float:
        """Underside of the shell's floor."""
        return self.plate_top + self.design.shell.led_cavity_mm

    @property
    def floor_top(self) -> float:
        """Top of the shell's floor, which is the window's seat."""
        return self.ceiling + self.design.shell.floor_mm

    @property
    def ring_bottom(self) -> float:
        """Lower face of the isolation ring, whose mouth is at the window."""
        return self.board_top + self.design.ring.above_board_mm

    @property
    def frame_top(self) -> float:
        """Top of the frame around the window."""
        return self.floor_top + self.design.shell.frame_tall_mm

    @property
    def window_top(self) -> float:
        """Upper face of the acrylic window."""
        return self.floor_top + self.design.window.thick_mm

    @property
    def lens_front(self) -> float:
        """Front of the lens, from which the camera distance is measured."""
        return self.design.base.floor_mm + self.design.camera.head_mm[1]

    @property
    def skin(self) -> float:
        """Upper face of the translucent gel, which the camera sees."""
        return self.lens_front + self.design.sensor.camera.distance_mm

    @property
    def rim(self) -> float:
        """Rim of the shell, on which the translucent gel lies."""
        return self.skin - self.design.sensor.gel.thickness_mm

    @property
    def first_mould(self) -> float:
        """Thickness of the first mould, which is that of the translucent gel."""
        return self.design.sensor.gel.thickness_mm

    @property
    def second_mould(self) -> float:
        """Thickness of the second mould, which is that of both layers above the rim."""
        return self.first_mould + self.design.gels.black_top_mm

    @property
    def top(self) -> float:
        """Top of the black gel, which is the height of the sensor."""
        return self.skin + self.design.gels.black_top_mm
