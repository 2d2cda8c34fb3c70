"""Bought parts as reference bodies: the space that other parts must leave, not models to make them from. Lengths in mm."""

from build123d import Box, Part, Pos

from ninedtact.hardware.assembly_dimensions import XY
from ninedtact.hardware.design import HardwareDesign
from ninedtact.hardware.dimensions.bought_parts import M2_DIAMETER_MM
from ninedtact.hardware.parts.primitives import (
    extrude_along_x,
    extrude_along_y,
    make_cylinder,
    make_cylinders_at,
    make_plate,
    require_single_solid,
)
from ninedtact.hardware.parts.printed_and_cut_parts import CUT_MARGIN_MM

Block = tuple[float, float, float]


def build_camera(design: HardwareDesign) -> Part:
    """Build the camera: body, stiffener, lens in four steps, and the cable as it climbs the ramp."""
    body, floor = design.camera, design.base.floor_mm
    half = body.side_mm / 2
    made = make_plate((body.side_mm, body.side_mm), (floor, floor + body.tall_mm))
    long = body.stiffener_mm - half
    made += make_plate((body.side_mm, long), (floor, floor + body.stiffener_tall_mm), at=(0.0, -half - long / 2))
    below = floor + body.tall_mm
    for diameter, top in body.lens_mm:
        made += make_cylinder(diameter, (below, floor + top))
        below = floor + top
    return require_single_solid(made + _flat_cable(design))


def _flat_cable(design: HardwareDesign) -> Part:
    """Return the cable, in one slope from the stiffener to the gap under the shell's rim, a little short of the outer
    face."""
    (wide, thick), floor = design.camera.cable_mm, design.base.floor_mm
    side, start = design.plan_view.outer[1] / 2, -design.camera.stiffener_mm
    head, top = design.base.ramp_head_mm - side, design.heights.plate_top - design.base.ramp_gap_mm
    end, low = 0.1 - side, floor + 0.1
    below = [(start + 0.2, low), (start, low), (head, top), (end, top)]
    above = [(y, z + thick) for y, z in reversed(below)]
    return extrude_along_x([*below, *above], wide / 2)


def build_led_board(design: HardwareDesign) -> Part:
    """Build the LED board as a body: the bare board with its holes, LEDs above, receptacle and driver below."""
    plan, board, levels = design.plan_view, design.board, design.heights
    heights = levels.board_bottom, levels.board_top
    beyond = levels.board_bottom - CUT_MARGIN_MM, levels.board_top + CUT_MARGIN_MM
    made = make_plate(plan.led_board, heights)
    made -= make_cylinders_at(2 * board.notch_mm, beyond, plan.shell_screws)
    made -= make_cylinders_at(board.locating_mm, beyond, plan.posts)
    made -= make_cylinder(board.lens_hole_mm, beyond)
    made += [_box_on(board.led_mm, place, levels.board_top) for place in plan.leds]
    made += _usb_receptacle(design)
    tall = board.driver_mm[2]
    return require_single_solid(made + _box_on(board.driver_mm, _driver_position(design), levels.board_bottom - tall))


def _usb_receptacle(design: HardwareDesign) -> Part:
    """Return the receptacle under the board's -y edge, its mouth a little beyond and its two corners at the board
    slanted."""
    (wide, deep, _), mouth = design.board.usb_mm, -design.plan_view.usb_mouth
    half, low, high = wide / 2, design.heights.usb_bottom, design.heights.board_bottom
    right = [(half, low), (half, high - USB_SLANT_MM), (half - USB_SLANT_MM, high)]
    return extrude_along_y([*right, *[(-x, z) for x, z in reversed(right)]], (mouth + deep, mouth))


def _driver_position(design: HardwareDesign) -> XY:
    """Return the centre of the LED driver."""
    x, from_edge = design.board.driver_at_mm
    return x, design.plan_view.led_board[1] / 2 + from_edge


def _box_on(size: Block, at: XY, bottom: float) -> Part:
    """Return a box that stands at this height."""
    return Part() + Pos(*at, bottom + size[2] / 2) * Box(*size)


def build_heat_set_insert(design: HardwareDesign, at: XY, top: float) -> Part:
    """Build a heat-set insert, flush with this height, its thread as a bore of the screw's diameter."""
    diameter, long = design.fasteners.insert_mm
    return make_cylinder(diameter, (top - long, top), at) - make_cylinder(
        M2_DIAMETER_MM, (top - long - CUT_MARGIN_MM, top + CUT_MARGIN_MM), at
    )


def build_screw(design: HardwareDesign, at: XY) -> Part:
    """Build an M2 screw from below through the base into the shell."""
    (head, tall), seat = design.fasteners.head_mm, design.base.counterbore_deep_mm
    shank = make_cylinder(M2_DIAMETER_MM, (seat, seat + design.fasteners.screw_mm), at)
    return shank + make_cylinder(head, (seat - tall, seat), at)


USB_SLANT_MM = 1.0
"""Height of the slanted corners of a micro-B receptacle."""
