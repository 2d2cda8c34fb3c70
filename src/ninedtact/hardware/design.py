"""One sensor's hardware: the sensor design, and every dimension of the parts that make it. Lengths in mm.

Assembly frame: x along the long side, y along the short side, z towards the skin; origin in the middle of the base's
outer bottom face; the optical axis is z; cable and USB leave at -y.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

from ninedtact.design import SensorDesign
from ninedtact.hardware.dimensions.base import ORIGINAL_BASE, Base
from ninedtact.hardware.dimensions.bought import (
    ORIGINAL_BOARD,
    ORIGINAL_FASTENERS,
    Board,
    CameraBody,
    Fasteners,
)
from ninedtact.hardware.dimensions.gels import ORIGINAL_MOULDS, Gels, Moulds
from ninedtact.hardware.dimensions.pin_frame import PinFrame
from ninedtact.hardware.dimensions.ring import ORIGINAL_RING, Ring, Window
from ninedtact.hardware.dimensions.shell import ORIGINAL_SHELL, Shell
from ninedtact.hardware.levels import Levels
from ninedtact.hardware.plan import Plan

Variant = Literal["default", "original"]


@dataclass(frozen=True)
class HardwareDesign:
    """Choices of every part; `plan` and `levels` are what follows from them."""

    sensor: SensorDesign = SensorDesign()
    variant: Variant = "default"
    base: Base = Base()
    shell: Shell = Shell()
    ring: Ring = Ring()
    window: Window = Window()
    board: Board = Board()
    camera: CameraBody = CameraBody()
    gels: Gels = Gels()
    moulds: Moulds = Moulds()
    pin_frame: PinFrame = PinFrame()
    fasteners: Fasteners = Fasteners()

    @cached_property
    def plan(self) -> Plan:
        """Widths and places in x and y."""
        around = self.base, self.shell, self.ring, self.window, self.board
        return Plan(self.sensor, *around, self.gels, self.moulds, self.pin_frame)

    @cached_property
    def levels(self) -> Levels:
        """Heights."""
        around = self.base, self.shell, self.ring, self.window, self.board
        return Levels(self.sensor, *around, self.camera, self.gels)


def default_hardware(sensor: SensorDesign = SensorDesign()) -> HardwareDesign:
    """With the improvements that docs/hardware.md lists."""
    return HardwareDesign(sensor)


def original_hardware(sensor: SensorDesign = SensorDesign()) -> HardwareDesign:
    """With the dimensions of the original 9DTact."""
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


def hardware_for(sensor: SensorDesign, variant: Variant) -> HardwareDesign:
    """The variant by its name."""
    return original_hardware(sensor) if variant == "original" else default_hardware(sensor)
