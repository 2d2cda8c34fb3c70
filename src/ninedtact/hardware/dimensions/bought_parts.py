"""Dimensions of bought parts (camera, LED board, fasteners), modelled as far as other parts must leave space for them."""

from dataclasses import dataclass
from typing import Annotated

from ninedtact.design import DesignImpossible
from ninedtact.hardware.dimensions import BoundedDimensions, Bounds


@dataclass(frozen=True)
class CameraDimensions(BoundedDimensions, table="camera"):
    """The camera Frank-S15-V1.0-160 (OV5647), heights from its own bottom. No maker's drawing exists: measure yours."""

    side_mm: Annotated[float, Bounds(6.0, 14.0)] = 8.7
    """Side of its square body."""
    tall_mm: Annotated[float, Bounds(2.0, 8.0)] = 3.1
    """Height of its body."""
    stiffener_mm: Annotated[float, Bounds(4.0, 12.0)] = 7.65
    """From the optical axis to the stiffener's end."""
    stiffener_tall_mm: Annotated[float, Bounds(0.5, 3.0)] = 1.5
    """Height of the stiffener."""
    cable_mm: Annotated[tuple[float, float], Bounds(0.1, 12.0)] = (6.0, 0.4)
    """Width and thickness of the flat cable."""
    collar_mm: Annotated[tuple[float, float], Bounds(2.0, 14.0)] = (8.0, 4.2)
    """Lens collar: diameter, and height of its top."""
    barrel_mm: Annotated[tuple[float, float], Bounds(2.0, 14.0)] = (6.96, 6.35)
    """Lens barrel: diameter, and height of its top."""
    neck_mm: Annotated[tuple[float, float], Bounds(2.0, 14.0)] = (7.96, 7.35)
    """Neck below the lens head: diameter, and height of its top."""
    head_mm: Annotated[tuple[float, float], Bounds(2.0, 14.0)] = (10.0, 9.95)
    """Lens head: diameter, and height of its top, which is the lens front from which the camera distance is measured."""

    def __post_init__(self) -> None:
        super().__post_init__()
        tops = [self.tall_mm, *(top for _, top in self.lens_mm)]
        if tops != sorted(tops):
            raise DesignImpossible(
                f"expected the tops of camera body, collar, barrel, neck and head one above the other, got {tops} mm; correct "
                "the design"
            )

    @property
    def lens_mm(self) -> tuple[tuple[float, float], ...]:
        """Steps of the lens from below: diameter, and height of the top."""
        return self.collar_mm, self.barrel_mm, self.neck_mm, self.head_mm


@dataclass(frozen=True)
class LedBoardDimensions(BoundedDimensions, table="board"):
    """The LED board as a body for which the other parts must leave space."""

    gap_mm: Annotated[float, Bounds(0.1, 1.0)] = 0.25
    """From its edges to the shell's cavity."""
    thick_mm: Annotated[float, Bounds(0.4, 2.0)] = 0.8
    """Thickness of the bare board. Ordered at the usual 1.6, the LEDs would stand 0.5 mm inside the shell's floor."""
    lens_hole_mm: Annotated[float, Bounds(8.0, 14.0)] = 10.2
    """Diameter of the hole around the lens head of 10.00; tracks forbid more."""
    notch_mm: Annotated[float, Bounds(1.0, 5.0)] = 2.8
    """Radius of the corner notches around the shell's bosses of radius 2.70."""
    locating_mm: Annotated[float, Bounds(1.0, 3.0)] = 1.5
    """Diameter of the holes for pins of 1.45."""
    locating_inset_mm: Annotated[tuple[float, float], Bounds(1.0, 10.0)] = (1.5, 5.0)
    """From the board's edges to these holes, x and y."""
    led_mm: Annotated[tuple[float, float, float], Bounds(0.3, 6.0)] = (3.5, 2.8, 0.72)
    """Body of a 2835 LED: along x, along y, height."""
    led_inset_mm: Annotated[tuple[float, float], Bounds(1.4, 12.0)] = (5.2, 3.0)
    """From the board's edges to the middle of the outer LEDs."""
    led_shift_mm: Annotated[tuple[float, float, float], Bounds(-1.0, 1.0)] = (0.0, 0.0, 0.0)
    """Offset along x of the left, middle and right LEDs from their nominal positions."""
    usb_mm: Annotated[tuple[float, float, float], Bounds(1.0, 9.0)] = (7.5, 5.0, 2.65)
    """Micro-USB receptacle below the board: along x, along y, height."""
    usb_beyond_mm: Annotated[float, Bounds(0.0, 2.0)] = 0.34
    """How far its mouth stands out over the board's -y edge."""
    driver_mm: Annotated[tuple[float, float, float], Bounds(0.3, 8.0)] = (3.9, 4.9, 1.75)
    """Body of the LED driver below the board: along x, along y, height."""
    driver_at_mm: Annotated[tuple[float, float], Bounds(-8.0, 8.0)] = (3.49, -2.6)
    """Centre of the LED driver: x, and y from the +y edge."""
    resistor_ohm: Annotated[float, Bounds(1200.0, 30000.0)] = 20000.0
    """R1, which sets the LEDs' current: 1800 V / R in all (led_board/led_current.py). The driver follows from 1.2 to 30
    kOhm; below about 3.75 kOhm the current exceeds what LEDs or USB bear, which is refused too."""


ORIGINAL_BOARD = LedBoardDimensions(lens_hole_mm=10.0, led_shift_mm=(0.031, 0.131, 0.031))
"""The original's board, with LEDs a little off their rectangle and no clearance around the lens."""


M2_DIAMETER_MM = 2.0
"""Diameter of all screws of the sensor."""


@dataclass(frozen=True)
class FastenerDimensions(BoundedDimensions, table="fasteners"):
    """Heat-set inserts and screws."""

    insert_mm: Annotated[tuple[float, float], Bounds(2.0, 8.0)] = (3.3, 5.09)
    """M2 insert: diameter over its knurl, length."""
    screw_mm: Annotated[float, Bounds(2.0, 12.0)] = 6.0
    """Length of the M2 screws below their heads: the paper's list has M2-6."""
    head_mm: Annotated[tuple[float, float], Bounds(0.5, 5.0)] = (3.9, 0.85)
    """Screw heads: diameter, height."""


ORIGINAL_FASTENERS = FastenerDimensions(screw_mm=5.0)
"""The original's CAD has M2-5."""
