"""Widths and places in x and y, from the sensing area outwards. Lengths in mm; pairs are (x, y)."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

from ninedtact.design import SensorDesign
from ninedtact.hardware.dimensions.base import Base
from ninedtact.hardware.dimensions.bought import Board
from ninedtact.hardware.dimensions.gels import Gels, Moulds
from ninedtact.hardware.dimensions.pin_frame import PinFrame
from ninedtact.hardware.dimensions.ring import Ring, Window
from ninedtact.hardware.dimensions.shell import Shell

Pair = tuple[float, float]
FRAME_ROOM_MM = 1.0
"""Between the window's frame and the gel cavity's wall, where the sensing area is smaller than the window."""
RIM_BESIDE_GEL_MM = 3.0
"""By how much the shell is wider than the translucent layer in the published size; the moulds' plates, told from the layer,
grow with the shell where that is wider still."""


@dataclass(frozen=True)
class Plan:
    """How wide everything is and where it stands."""

    sensor: SensorDesign
    base: Base
    shell: Shell
    ring: Ring
    window: Window
    board: Board
    gels: Gels
    moulds: Moulds
    pin_frame: PinFrame

    @property
    def frame_inside(self) -> float:
        """Side of the square seat of the window."""
        return self.window.side_mm + 2 * self.shell.frame_gap_mm

    @property
    def frame_outside(self) -> float:
        """Side of the frame round it."""
        return self.frame_inside + 2 * self.shell.frame_wall_mm

    @property
    def ring_side(self) -> float:
        """Of the square isolation ring, in the shell's hole."""
        return self.shell.hole_mm - 2 * self.ring.gap_mm

    @property
    def opening(self) -> Pair:
        """Of the shell towards the gel."""
        least = self.frame_outside + 2 * FRAME_ROOM_MM
        x, y = self.sensor.sensing_area.opening_mm
        return max(x, least), max(y, least)

    @property
    def cavity(self) -> Pair:
        """Of the shell round the circuit board."""
        (x, y), (least_x, least_y) = self.opening, self.shell.smallest_cavity_mm
        return max(x, least_x), max(y, least_y)

    @property
    def outer(self) -> Pair:
        """Of base and shell."""
        return wider(self.cavity, self.shell.wall_mm)

    @property
    def translucent(self) -> Pair:
        """Of the translucent gel: it overlaps the shell's rim."""
        return wider(self.opening, self.sensor.sensing_area.overlap_mm)

    @property
    def black(self) -> Pair:
        """Of the black gel round it."""
        return wider(self.translucent, self.gels.black_side_mm)

    @property
    def circuit(self) -> Pair:
        """Of the LED board."""
        return wider(self.cavity, -self.board.gap_mm)

    @property
    def shell_screws(self) -> Iterator[Pair]:
        """Bosses of the shell, screws through the base, notches of the LED board."""
        inset = self.shell.boss_inset_mm
        return corners(self.cavity[0] / 2 - inset, self.cavity[1] / 2 - inset)

    @property
    def mount_inserts(self) -> Iterator[Pair]:
        """Inserts of the base, to which a robot is bolted."""
        x, y = self.base.mount_inset_mm
        return corners(self.cavity[0] / 2 - x, self.cavity[1] / 2 - y)

    @property
    def posts(self) -> Iterator[Pair]:
        """Of the base, which carry the LED board."""
        x, y = self.board.locating_inset_mm
        return corners(self.circuit[0] / 2 - x, self.circuit[1] / 2 - y)

    @property
    def led_columns(self) -> tuple[float, float, float]:
        """x of the LEDs."""
        left, middle, right = self.board.led_shift_mm
        x = self.circuit[0] / 2 - self.board.led_inset_mm[0]
        return -x + left, middle, x + right

    @property
    def led_rows(self) -> tuple[float, float, float]:
        """y of the LEDs."""
        y = self.circuit[1] / 2 - self.board.led_inset_mm[1]
        return y, 0.0, -y

    @property
    def leds(self) -> Iterator[Pair]:
        """Middles of the eight LEDs: a rectangle without its middle."""
        middle = self.led_columns[1], self.led_rows[1]
        yield from ((x, y) for y, x in product(self.led_rows, self.led_columns) if (x, y) != middle)

    @property
    def usb_mouth(self) -> float:
        """Of the micro-USB receptacle: from the middle along -y."""
        return self.circuit[1] / 2 + self.board.usb_beyond_mm

    @property
    def plate(self) -> Pair:
        """Of the moulds."""
        (x, y), (more_x, more_y) = self.translucent, self.moulds.beyond_mm
        return max(x, self.outer[0] - RIM_BESIDE_GEL_MM) + more_x, max(y, self.outer[1] - RIM_BESIDE_GEL_MM) + more_y

    @property
    def clamps(self) -> Iterator[Pair]:
        """M3 screws through the moulds."""
        (x, y), inset = self.plate, self.moulds.hole_inset_mm
        yield from corners(self.moulds.pairs_mm[0], y / 2 - inset)
        yield from corners(x / 2 - inset, self.moulds.pairs_mm[1])

    @property
    def tray(self) -> Pair:
        """Inside of the calibration board."""
        return wider(self.outer, self.pin_frame.gap_mm)

    @property
    def tray_tall(self) -> float:
        """Of the calibration board: floor, pins, the gel above the shell's rim, and its guide."""
        frame, above_rim = self.pin_frame, self.sensor.gel.thickness_mm + self.gels.black_top_mm
        return frame.floor_mm + frame.pin_tall_mm + above_rim + frame.guided_mm

    @property
    def pins(self) -> Iterator[Pair]:
        """Of the calibration board."""
        board = self.sensor.pin_board
        for row in range(board.rows):
            for col in range(board.cols):
                yield (
                    (col - (board.cols - 1) / 2) * board.pitch_mm,
                    (row - (board.rows - 1) / 2) * board.pitch_mm,
                )


def wider(size: Pair, each_side: float) -> Pair:
    """The same with this much more on every side."""
    return size[0] + 2 * each_side, size[1] + 2 * each_side


def corners(x: float, y: float) -> Iterator[Pair]:
    """Four places, mirrored in both axes."""
    yield from ((side_x * x, side_y * y) for side_x in (-1, 1) for side_y in (-1, 1))
