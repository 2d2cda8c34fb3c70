"""The z levels of the assembly, from the base's outer face up, and the thicknesses that follow. Lengths in mm."""

from dataclasses import dataclass

from ninedtact.design import SensorDesign
from ninedtact.hardware.dimensions.base import Base
from ninedtact.hardware.dimensions.bought import Board, CameraBody
from ninedtact.hardware.dimensions.gels import Gels
from ninedtact.hardware.dimensions.ring import Ring, Window
from ninedtact.hardware.dimensions.shell import Shell


@dataclass(frozen=True)
class Levels:
    """Where each face lies. The camera's distance to the skin, less the gel, gives the height of the shell."""

    sensor: SensorDesign
    base: Base
    shell: Shell
    ring: Ring
    window: Window
    board: Board
    camera: CameraBody
    gels: Gels

    @property
    def plate_top(self) -> float:
        """Of the base; the shell stands on it."""
        return self.base.plate_mm

    @property
    def boss_top(self) -> float:
        """Of the base's insert bosses."""
        return self.plate_top + self.base.boss_tall_mm

    @property
    def board_bottom(self) -> float:
        """Of the circuit board, on the base's posts."""
        return self.plate_top + self.base.post_tall_mm

    @property
    def board_top(self) -> float:
        """Of the circuit board; LEDs stand on it."""
        return self.board_bottom + self.board.thick_mm

    @property
    def led_top(self) -> float:
        """Of the LEDs."""
        return self.board_top + self.board.led_mm[2]

    @property
    def usb_bottom(self) -> float:
        """Of the micro-USB receptacle."""
        return self.board_bottom - self.board.usb_mm[2]

    @property
    def ceiling(self) -> float:
        """Underside of the shell's floor."""
        return self.plate_top + self.shell.led_cavity_mm

    @property
    def floor_top(self) -> float:
        """Upper side of the shell's floor: the window's seat."""
        return self.ceiling + self.shell.floor_mm

    @property
    def ring_bottom(self) -> float:
        """Lower face of the isolation ring; its mouth is at the window."""
        return self.board_top + self.ring.above_board_mm

    @property
    def frame_top(self) -> float:
        """Of the frame round the window."""
        return self.floor_top + self.shell.frame_tall_mm

    @property
    def window_top(self) -> float:
        """Of the acrylic window."""
        return self.floor_top + self.window.thick_mm

    @property
    def lens_front(self) -> float:
        """From where the camera looks."""
        return self.base.floor_mm + self.camera.head_mm[1]

    @property
    def skin(self) -> float:
        """Upper face of the translucent gel, which the camera sees."""
        return self.lens_front + self.sensor.camera.distance_mm

    @property
    def rim(self) -> float:
        """Of the shell; the translucent gel lies on it."""
        return self.skin - self.sensor.gel.thickness_mm

    @property
    def first_mould(self) -> float:
        """Thickness of the first mould: the translucent gel's."""
        return self.sensor.gel.thickness_mm

    @property
    def second_mould(self) -> float:
        """Thickness of the second: of both layers above the rim."""
        return self.first_mould + self.gels.black_top_mm

    @property
    def top(self) -> float:
        """Of the black gel: the sensor's height."""
        return self.skin + self.gels.black_top_mm
