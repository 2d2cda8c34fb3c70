"""Distances between bodies that take more than a subtraction; negative where they overlap. Lengths in mm."""

from itertools import pairwise, product
from math import hypot, inf, sqrt

from ninedtact.hardware.design import HardwareDesign


def lens_wide_mm(design: HardwareDesign, above_mm: float, below_mm: float = inf) -> float:
    """The widest step of the lens that reaches above the one level and begins below the other."""
    camera, floor = design.camera, design.base.floor_mm
    tops = [floor + camera.tall_mm, *(floor + top for _, top in camera.lens_mm)]
    steps = zip(camera.lens_mm, pairwise(tops), strict=True)
    return max((wide for (wide, _), (bottom, top) in steps if top > above_mm and bottom < below_mm), default=0.0)


def lens_to_parts_below(design: HardwareDesign) -> float:
    """Receptacle and LED driver below the board to the lens between them."""
    board, levels = design.board, design.levels
    (wide, deep, tall), (x, from_edge) = board.driver_mm, board.driver_at_mm
    y = design.plan.circuit[1] / 2 + from_edge
    driver = apart_mm(abs(x) - wide / 2, abs(y) - deep / 2)
    receptacle = design.plan.usb_mouth - board.usb_mm[1]
    lowest = min(levels.usb_bottom, levels.board_bottom - tall)
    return min(driver, receptacle) - lens_wide_mm(design, lowest, levels.board_bottom) / 2


def board_to_ceiling(design: HardwareDesign) -> float:
    """The board's upper edge to the fillet between wall or boss and ceiling; to the wall where the fillet begins above it."""
    radius, levels = design.shell.fillet_mm, design.levels
    beside = min(design.board.gap_mm, design.board.notch_mm - design.shell.boss_mm / 2)
    above_start = levels.board_top - (levels.ceiling - radius)
    return radius - hypot(max(radius - beside, 0.0), above_start) if above_start > 0 else beside


def led_to_ring(design: HardwareDesign) -> float:
    """Nearest LED edge to the ring's square, seen from above."""
    half, (wide, deep, _) = design.plan.ring_side / 2, design.board.led_mm
    return min(apart_mm(abs(x) - wide / 2 - half, abs(y) - deep / 2 - half) for x, y in design.plan.leds)


def led_to_side(design: HardwareDesign) -> float:
    """LEDs to the walls and screw bosses beside them, less what the ceiling's fillet takes at the LEDs' tops."""
    plan, radius, (wide, deep, _) = design.plan, design.shell.fillet_mm, design.board.led_mm
    up = max(design.levels.led_top - (design.levels.ceiling - radius), 0.0)
    fillet = radius - sqrt(max(radius**2 - up**2, 0.0))
    walls = [min(plan.cavity[0] / 2 - abs(x) - wide / 2, plan.cavity[1] / 2 - abs(y) - deep / 2) for x, y in plan.leds]
    bosses = [
        apart_mm(abs(x - led_x) - wide / 2, abs(y - led_y) - deep / 2) - design.shell.boss_mm / 2
        for (x, y), (led_x, led_y) in product(plan.shell_screws, plan.leds)
    ]
    return min(walls + bosses) - fillet


def apart_mm(along_x: float, along_y: float) -> float:
    """Distance of two rectangles by the gaps between them along x and y; negative where they overlap."""
    return max(along_x, along_y) if max(along_x, along_y) < 0 else hypot(max(along_x, 0.0), max(along_y, 0.0))


def plug_stopped_mm(design: HardwareDesign) -> float:
    """How far behind the face that stops a plug's overmould the receptacle's mouth is."""
    return design.plan.outer[1] / 2 - design.shell.relief_deep_mm - design.plan.usb_mouth
