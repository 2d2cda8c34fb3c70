"""Bought parts as reference bodies: room that others must leave, not models to make them from."""

from build123d import Box, Part, Pos

from ninedtact.hardware.design import HardwareDesign
from ninedtact.hardware.dimensions.bought import M2_MM
from ninedtact.hardware.parts.base import THROUGH
from ninedtact.hardware.parts.solids import along_x, along_y, disc, discs, one_solid, slab
from ninedtact.hardware.plan import Pair

Block = tuple[float, float, float]


def camera(design: HardwareDesign) -> Part:
    """Body, stiffener, lens in four steps, and the cable as it climbs the ramp."""
    body, floor = design.camera, design.base.floor_mm
    half = body.side_mm / 2
    made = slab((body.side_mm, body.side_mm), (floor, floor + body.tall_mm))
    long = body.stiffener_mm - half
    made += slab((body.side_mm, long), (floor, floor + body.stiffener_tall_mm), at=(0.0, -half - long / 2))
    below = floor + body.tall_mm
    for diameter, top in body.lens_mm:
        made += disc(diameter, (below, floor + top))
        below = floor + top
    return one_solid(made + cable(design))


def cable(design: HardwareDesign) -> Part:
    """Flat, in one slope from the stiffener to the gap under the shell's rim, a little short of the outer face."""
    (wide, thick), floor = design.camera.cable_mm, design.base.floor_mm
    side, start = design.plan.outer[1] / 2, -design.camera.stiffener_mm
    head, top = design.base.ramp_head_mm - side, design.levels.plate_top - design.base.ramp_gap_mm
    end, low = 0.1 - side, floor + 0.1
    below = [(start + 0.2, low), (start, low), (head, top), (end, top)]
    above = [(y, z + thick) for y, z in reversed(below)]
    return along_x([*below, *above], wide / 2)


def led_board(design: HardwareDesign) -> Part:
    """Bare board with its holes, LEDs above, receptacle and driver below."""
    plan, board, levels = design.plan, design.board, design.levels
    heights = levels.board_bottom, levels.board_top
    beyond = levels.board_bottom - THROUGH, levels.board_top + THROUGH
    made = slab(plan.circuit, heights)
    made -= discs(2 * board.notch_mm, beyond, plan.shell_screws)
    made -= discs(board.locating_mm, beyond, plan.posts)
    made -= disc(board.lens_hole_mm, beyond)
    made += [block(board.led_mm, place, levels.board_top) for place in plan.leds]
    made += usb_receptacle(design)
    tall = board.driver_mm[2]
    return one_solid(made + block(board.driver_mm, driver_at(design), levels.board_bottom - tall))


def usb_receptacle(design: HardwareDesign) -> Part:
    """Under the board's -y edge, its mouth a little beyond; the two corners at the board are slanted."""
    (wide, deep, _), mouth = design.board.usb_mm, -design.plan.usb_mouth
    half, low, high = wide / 2, design.levels.usb_bottom, design.levels.board_bottom
    right = [(half, low), (half, high - USB_SLANT_MM), (half - USB_SLANT_MM, high)]
    return along_y([*right, *[(-x, z) for x, z in reversed(right)]], (mouth + deep, mouth))


def driver_at(design: HardwareDesign) -> Pair:
    """Middle of the LED driver."""
    x, from_edge = design.board.driver_at_mm
    return x, design.plan.circuit[1] / 2 + from_edge


def block(size: Block, at: Pair, bottom: float) -> Part:
    """A box that stands on this height."""
    return Part() + Pos(*at, bottom + size[2] / 2) * Box(*size)


def insert(design: HardwareDesign, at: Pair, top: float) -> Part:
    """A heat-set insert, its thread as a bore of the screw's diameter, flush with this height."""
    diameter, long = design.fasteners.insert_mm
    return disc(diameter, (top - long, top), at) - disc(M2_MM, (top - long - THROUGH, top + THROUGH), at)


def screw(design: HardwareDesign, at: Pair) -> Part:
    """M2 from below through the base into the shell."""
    (head, tall), seat = design.fasteners.head_mm, design.base.counterbore_deep_mm
    shank = disc(M2_MM, (seat, seat + design.fasteners.screw_mm), at)
    return shank + disc(head, (seat - tall, seat), at)


USB_SLANT_MM = 1.0
"""Slanted corners of a micro-B receptacle."""
