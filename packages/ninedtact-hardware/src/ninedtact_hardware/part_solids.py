"""Solids of the parts. Lengths in mm.

Primitive bodies (plates, cylinders, extruded polygons) compose the printed parts (base, shell, isolation ring, calibration
board), the cut ones (acrylic window; mould plates, which lie on z = 0) and the three gels as they are in the finished sensor.
Bought parts are reference bodies: the space that others must leave, not models to make them from.
"""

from collections.abc import Iterable
from copy import deepcopy
from functools import lru_cache
from math import hypot, radians, tan

from build123d import (
    Axis,
    Box,
    Circle,
    Cone,
    Face,
    Part,
    Plane,
    Polygon,
    Pos,
    Rectangle,
    RectangleRounded,
    Sketch,
    Sphere,
    extrude,
    fillet,
)

from ninedtact_hardware.design import XY, HardwareDesign
from ninedtact_hardware.part_dimensions import M2_DIAMETER_MM

ZRange = tuple[float, float]
_COINCIDENT_MM = 1e-4
"""Points nearer than this coincide."""


def _make_plate(size: XY, heights: ZRange, radius_mm: float = 0.0, at: XY = (0.0, 0.0)) -> Part:
    outline = deepcopy(_rounded_rectangle(size, radius_mm)) if radius_mm > _COINCIDENT_MM else Rectangle(*size)
    return _extrude_along_z(outline, heights, at)


@lru_cache(maxsize=64)
def _rounded_rectangle(size: XY, radius_mm: float) -> Sketch:
    """Return a rectangle with rounded corners. They take most of the time of a plate, and many plates have the same outline."""
    return RectangleRounded(*size, radius_mm)


def _make_cylinder(diameter_mm: float, heights: ZRange, at: XY = (0.0, 0.0)) -> Part:
    return _extrude_along_z(Circle(diameter_mm / 2), heights, at)


def _extrude_along_z(outline: Sketch | Face, heights: ZRange, at: XY = (0.0, 0.0)) -> Part:
    return Part() + extrude(Pos(*at, heights[0]) * outline, amount=heights[1] - heights[0])


def _make_cylinders_at(diameter_mm: float, heights: ZRange, places: Iterable[XY]) -> list[Part]:
    return [_make_cylinder(diameter_mm, heights, place) for place in places]


def _extrude_along_x(outline_yz: list[XY], half_width_mm: float, rounds: dict[XY, float] | None = None) -> Part:
    """Extrude a polygon in (y, z) to both sides along x; `rounds` are the fillet radii of its corners, by position."""
    face = _filleted_polygon(outline_yz, rounds or {})
    return Part() + extrude(Plane.YZ.location * face, amount=half_width_mm, both=True)


def _extrude_along_y(outline_xz: list[XY], y_mm: XY, rounds: dict[XY, float] | None = None) -> Part:
    """Extrude a polygon in (x, z) from one y to the other; `rounds` are the fillet radii of its corners, by position."""
    face = _filleted_polygon(outline_xz, rounds or {})
    start, end = y_mm
    plane = Plane(origin=(0, start, 0), x_dir=(1, 0, 0), z_dir=(0, -1, 0))
    return Part() + extrude(plane.location * face, amount=start - end)


def _filleted_polygon(corners: list[XY], rounds: dict[XY, float]) -> Face:
    outline = Polygon(*corners, align=None)
    for place, radius in rounds.items():
        if radius > _COINCIDENT_MM:
            corner = min(outline.vertices(), key=lambda vertex: hypot(vertex.X - place[0], vertex.Y - place[1]))
            outline = fillet(corner, radius)
    return Face(outline.face().wrapped)


def _add_mirror_image(right: list[XY]) -> list[XY]:
    """Return the closed outline of which these corners are the half at positive x, in their order."""
    return [*right, *((-x, other) for x, other in reversed(right))]


def _single_solid_of_part(part: Part) -> Part:
    """Return the single solid of a part; more or fewer are an error of the model, not of the design."""
    (solid,) = part.solids()
    return Part() + solid


_CUT_MARGIN_MM = 1.0
"""Cuts go this far beyond the faces that they open."""


def build_sensor_base(design: HardwareDesign) -> Part:
    """Build the base: plate, bosses and posts, then pocket, channel and holes."""
    base, plan, levels = design.base, design.horizontal_dimensions, design.heights
    body = _make_plate(plan.outer, (0, levels.plate_top), base.corner_radius_mm)
    body += _make_cylinders_at(base.boss_mm, (base.floor_mm, levels.boss_top), plan.mount_inserts)
    body += _make_cylinders_at(base.post_mm, (base.floor_mm, levels.board_bottom), plan.posts)
    body += _locating_pins(design)
    body -= _make_cylinders_at(base.bore_mm, (base.floor_mm, levels.boss_top + _CUT_MARGIN_MM), plan.mount_inserts)
    body -= _make_cylinders_at(base.bolt_mm, (-_CUT_MARGIN_MM, base.floor_mm), plan.mount_inserts)
    body -= _make_cylinders_at(base.shell_screw_mm, (0, levels.plate_top + _CUT_MARGIN_MM), plan.shell_screws)
    body -= _make_cylinders_at(base.counterbore_mm, (-_CUT_MARGIN_MM, base.counterbore_deep_mm), plan.shell_screws)
    room = _extrude_along_z(_pocket_outline(design), (base.floor_mm, levels.plate_top + _CUT_MARGIN_MM))
    return _single_solid_of_part(body - (room - _extrude_along_x(*_cable_ramp(design))))


def _locating_pins(design: HardwareDesign) -> list[Part]:
    base, levels = design.base, design.heights
    tip = levels.board_bottom + base.pin_tall_mm
    pins = _make_cylinders_at(base.pin_mm, (levels.plate_top, tip), design.horizontal_dimensions.posts)
    if not base.pin_round_mm:
        return pins
    return [fillet(pin.faces().sort_by(Axis.Z)[-1].edges(), base.pin_round_mm) for pin in pins]


def _pocket_outline(design: HardwareDesign) -> Face:
    base, side = design.base, design.horizontal_dimensions.outer[1] / 2 + _CUT_MARGIN_MM
    pocket, channel = base.pocket_wide_mm / 2, base.channel_wide_mm / 2
    front, back = base.pocket_front_mm, -base.pocket_back_mm
    right = [(channel, -side), (channel, back), (pocket, back), (pocket, front)]
    entry = (channel, back), (-channel, back)
    return _filleted_polygon(_add_mirror_image(right), dict.fromkeys(entry, base.channel_round_mm))


def _cable_ramp(design: HardwareDesign) -> tuple[list[tuple[float, float]], float, dict[tuple[float, float], float]]:
    """Return what stays under the cable: its outline in (y, z), its half width, and the fillets of its foot and head."""
    base, side = design.base, design.horizontal_dimensions.outer[1] / 2
    floor, top = base.floor_mm, design.heights.plate_top - base.ramp_gap_mm
    foot, head = (base.ramp_foot_mm - side, floor), (base.ramp_head_mm - side, top)
    below, beyond = floor - 0.5, -side - 2 * _CUT_MARGIN_MM
    outline = [(-base.pocket_back_mm, below), (-base.pocket_back_mm, floor), foot, head, (beyond, top), (beyond, below)]
    return outline, base.pocket_wide_mm, {foot: base.ramp_foot_round_mm, head: base.ramp_head_round_mm}


def build_sensor_shell(design: HardwareDesign) -> Part:
    """Build the shell: a block with the gel cavity above and the LED cavity below, the window's frame, bores and the
    USB slot."""
    shell, plan, levels = design.shell, design.horizontal_dimensions, design.heights
    body = _make_plate(plan.outer, (levels.plate_top, levels.rim), shell.corner_radius_mm)
    body -= _make_plate(plan.opening, (levels.floor_top, levels.rim + _CUT_MARGIN_MM), shell.opening_radius_mm)
    outside, inside, frame = plan.frame_outside, plan.frame_inside, (levels.floor_top, levels.frame_top)
    body += _make_plate((outside, outside), frame) - _make_plate((inside, inside), frame)
    body -= _led_cavity(design)
    hole = shell.hole_mm, shell.hole_mm
    body -= _make_plate(hole, (levels.ceiling - _CUT_MARGIN_MM, levels.floor_top + _CUT_MARGIN_MM))
    bottom = levels.plate_top
    body -= _make_cylinders_at(shell.bore_mm, (bottom - _CUT_MARGIN_MM, bottom + shell.bore_deep_mm), plan.shell_screws)
    return _single_solid_of_part(body - _usb_slot(design))


def _led_cavity(design: HardwareDesign) -> Part:
    """Return the LED cavity below the floor, without the screw bosses and rounded at the ceiling."""
    shell, plan, levels = design.shell, design.horizontal_dimensions, design.heights
    heights = levels.plate_top - _CUT_MARGIN_MM, levels.ceiling
    air = _make_plate(plan.cavity, heights)
    air -= _make_cylinders_at(shell.boss_mm, heights, plan.shell_screws)
    if not shell.fillet_mm:
        return air
    return fillet(air.faces().sort_by(Axis.Z)[-1].edges(), shell.fillet_mm)


def _usb_slot(design: HardwareDesign) -> list[Part]:
    """Return the slot through the wall at -y, with the receptacle's two slanted corners, and the relief around it
    outside."""
    shell, plan, bottom = design.shell, design.horizontal_dimensions, design.heights.plate_top
    half, low, high, slant = shell.slot_wide_mm / 2, shell.slot_from_mm, shell.slot_to_mm, shell.slot_chamfer_mm
    right = [(half, bottom + low), (half, bottom + high - slant), (half - slant, bottom + high)]
    outline = _add_mirror_image(right)
    inside, outside = -plan.cavity[1] / 2 + _CUT_MARGIN_MM, -plan.outer[1] / 2 - _CUT_MARGIN_MM
    slot = _extrude_along_y(outline, (inside, outside), dict.fromkeys(outline, shell.slot_round_mm))
    if shell.relief_deep_mm < _COINCIDENT_MM:
        return [slot]
    size = shell.relief_wide_mm, 2 * shell.relief_deep_mm
    relief = _make_plate(size, (bottom - _CUT_MARGIN_MM, bottom + shell.relief_tall_mm), at=(0.0, -plan.outer[1] / 2))
    return [slot, relief]


def build_isolation_ring(design: HardwareDesign) -> Part:
    """Build the isolation ring: a square block with a bore that opens to a cone at the window."""
    ring, bottom, top = design.ring, design.heights.ring_bottom, design.heights.floor_top
    side = design.horizontal_dimensions.ring_side
    mouth = side - 2 * ring.land_mm
    opens = top - (mouth - ring.bore_mm) / 2 / tan(radians(ring.cone_deg))
    body = _make_plate((side, side), (bottom, top)) - _make_cylinder(ring.bore_mm, (bottom - _CUT_MARGIN_MM, opens))
    return _single_solid_of_part(body - Pos(0, 0, (opens + top) / 2) * Cone(ring.bore_mm / 2, mouth / 2, top - opens))


def build_acrylic_window(design: HardwareDesign) -> Part:
    """Build the acrylic window between camera and gel."""
    side = design.window.side_mm
    return _make_plate((side, side), (design.heights.floor_top, design.heights.window_top))


def build_calibration_board(design: HardwareDesign) -> Part:
    """Build the calibration board: a tray that slides over the shell, with round-tipped pins on its floor. It lies on
    its back, z = 0 is its outer face, and its pins point up."""
    frame, plan = design.pin_frame, design.horizontal_dimensions
    outside = plan.tray[0] + 2 * frame.wall_mm, plan.tray[1] + 2 * frame.wall_mm
    body = _make_plate(outside, (0, plan.tray_tall), frame.corner_radius_mm)
    inside_radius = max(frame.corner_radius_mm - frame.wall_mm, 0.0)
    body -= _make_plate(plan.tray, (frame.floor_mm, plan.tray_tall + _CUT_MARGIN_MM), inside_radius)
    # A pin is a hemisphere on a cylinder that is rooted in the floor.
    radius = design.sensor.pin_board.pin_diameter_mm / 2
    shoulder = frame.floor_mm + frame.pin_tall_mm - radius
    one = _make_cylinder(2 * radius, (frame.floor_mm / 2, shoulder)) + Pos(0, 0, shoulder) * Sphere(radius)
    return _single_solid_of_part(body + [Pos(x, y, 0) * one for x, y in plan.pins])


def build_base_board(design: HardwareDesign) -> Part:
    """Build the base board, on which the shell is screwed while the gels are poured."""
    thick = design.moulds.base_mm
    holes = _make_cylinders_at(
        design.moulds.shell_screw_mm,
        (-_CUT_MARGIN_MM, thick + _CUT_MARGIN_MM),
        design.horizontal_dimensions.shell_screws,
    )
    return _single_solid_of_part(_clamping_plate(design, thick) - holes)


def build_first_mould(design: HardwareDesign) -> Part:
    """Build the first mould, which is as thick as the translucent gel."""
    return _mould(
        design, design.heights.first_mould, design.horizontal_dimensions.translucent, design.gels.rim_radius_mm
    )


def build_second_mould(design: HardwareDesign) -> Part:
    """Build the second mould, which is thicker and wider; black silicone fills the difference."""
    radius = design.gels.rim_radius_mm + design.gels.black_side_mm
    return _mould(design, design.heights.second_mould, design.horizontal_dimensions.black, radius)


def _mould(design: HardwareDesign, thick: float, window: XY, radius: float) -> Part:
    return _single_solid_of_part(
        _clamping_plate(design, thick) - _make_plate(window, (-_CUT_MARGIN_MM, thick + _CUT_MARGIN_MM), radius)
    )


def _clamping_plate(design: HardwareDesign, thick: float) -> Part:
    body = _make_plate(design.horizontal_dimensions.plate, (0, thick), design.moulds.corner_radius_mm)
    return body - _make_cylinders_at(
        design.moulds.hole_mm, (-_CUT_MARGIN_MM, thick + _CUT_MARGIN_MM), design.horizontal_dimensions.clamps
    )


def build_transparent_gel(design: HardwareDesign) -> Part:
    """Build the transparent gel, which fills the shell above window and frame. The groove between these stays empty."""
    shell, plan, levels = design.shell, design.horizontal_dimensions, design.heights
    body = _make_plate(plan.opening, (levels.floor_top, levels.rim), shell.opening_radius_mm)
    outside, inside, window = plan.frame_outside, plan.frame_inside, design.window.side_mm
    body -= _make_plate((outside, outside), (levels.floor_top, levels.frame_top))
    if levels.frame_top > levels.window_top:
        body += _make_plate((inside, inside), (levels.window_top, levels.frame_top))
    return _single_solid_of_part(body - _make_plate((window, window), (levels.floor_top, levels.window_top)))


def build_translucent_gel(design: HardwareDesign) -> Part:
    """Build the translucent gel on the shell's rim, which scatters white light back."""
    return _make_plate(
        design.horizontal_dimensions.translucent, (design.heights.rim, design.heights.skin), design.gels.rim_radius_mm
    )


def build_black_gel(design: HardwareDesign) -> Part:
    """Build the black gel over and around the translucent one."""
    radius = design.gels.rim_radius_mm + design.gels.black_side_mm
    outside = _make_plate(design.horizontal_dimensions.black, (design.heights.rim, design.heights.top), radius)
    return _single_solid_of_part(outside - build_translucent_gel(design))


_Block = tuple[float, float, float]


def build_camera(design: HardwareDesign) -> Part:
    """Build the camera: body, stiffener, lens in four steps, and the cable as it climbs the ramp."""
    body, floor = design.camera, design.base.floor_mm
    half = body.side_mm / 2
    made = _make_plate((body.side_mm, body.side_mm), (floor, floor + body.tall_mm))
    long = body.stiffener_mm - half
    made += _make_plate((body.side_mm, long), (floor, floor + body.stiffener_tall_mm), at=(0.0, -half - long / 2))
    below = floor + body.tall_mm
    for diameter, top in body.lens_mm:
        made += _make_cylinder(diameter, (below, floor + top))
        below = floor + top
    return _single_solid_of_part(made + _flat_cable(design))


def _flat_cable(design: HardwareDesign) -> Part:
    """Return the cable, in one slope from the stiffener to the gap under the shell's rim, a little short of the outer
    face."""
    (wide, thick), floor = design.camera.cable_mm, design.base.floor_mm
    side, start = design.horizontal_dimensions.outer[1] / 2, -design.camera.stiffener_mm
    head, top = design.base.ramp_head_mm - side, design.heights.plate_top - design.base.ramp_gap_mm
    end, low = 0.1 - side, floor + 0.1
    below = [(start + 0.2, low), (start, low), (head, top), (end, top)]
    above = [(y, z + thick) for y, z in reversed(below)]
    return _extrude_along_x([*below, *above], wide / 2)


def build_bare_board(design: HardwareDesign) -> Part:
    """Build the LED board without its components: outline, corner notches and holes."""
    plan, board, levels = design.horizontal_dimensions, design.board, design.heights
    heights = levels.board_bottom, levels.board_top
    beyond = levels.board_bottom - _CUT_MARGIN_MM, levels.board_top + _CUT_MARGIN_MM
    made = _make_plate(plan.led_board, heights)
    made -= _make_cylinders_at(2 * board.notch_mm, beyond, plan.shell_screws)
    made -= _make_cylinders_at(board.locating_mm, beyond, plan.posts)
    return made - _make_cylinder(board.lens_hole_mm, beyond)


def build_led_board(design: HardwareDesign) -> Part:
    """Build the LED board as a body: the bare board, LEDs above, receptacle and driver below."""
    plan, board, levels = design.horizontal_dimensions, design.board, design.heights
    made = build_bare_board(design)
    made += [_box_on(board.led_mm, place, levels.board_top) for place in plan.leds]
    made += _usb_receptacle(design)
    (x, from_edge), tall = board.driver_at_mm, board.driver_mm[2]
    at = x, plan.led_board[1] / 2 + from_edge
    return _single_solid_of_part(made + _box_on(board.driver_mm, at, levels.board_bottom - tall))


def _usb_receptacle(design: HardwareDesign) -> Part:
    """Return the receptacle under the board's -y edge, its mouth a little beyond and its two corners at the board
    slanted."""
    (wide, deep, _), mouth = design.board.usb_mm, -design.horizontal_dimensions.usb_mouth
    half, low, high = wide / 2, design.heights.usb_bottom, design.heights.board_bottom
    right = [(half, low), (half, high - USB_SLANT_MM), (half - USB_SLANT_MM, high)]
    return _extrude_along_y(_add_mirror_image(right), (mouth + deep, mouth))


def _box_on(size: _Block, at: XY, bottom: float) -> Part:
    return Part() + Pos(*at, bottom + size[2] / 2) * Box(*size)


def build_heat_set_insert(design: HardwareDesign, at: XY, top: float) -> Part:
    """Build a heat-set insert, flush with this height, its thread as a bore of the screw's diameter."""
    diameter, long = design.fasteners.insert_mm
    return _make_cylinder(diameter, (top - long, top), at) - _make_cylinder(
        M2_DIAMETER_MM, (top - long - _CUT_MARGIN_MM, top + _CUT_MARGIN_MM), at
    )


def build_screw(design: HardwareDesign, at: XY) -> Part:
    """Build an M2 screw from below through the base into the shell."""
    (head, tall), seat = design.fasteners.head_mm, design.base.counterbore_deep_mm
    shank = _make_cylinder(M2_DIAMETER_MM, (seat, seat + design.fasteners.screw_mm), at)
    return shank + _make_cylinder(head, (seat - tall, seat), at)


USB_SLANT_MM = 1.0
"""Height of the slanted corners of a micro-B receptacle."""
