"""Solids of the printed parts (base, shell, isolation ring, calibration board) and of the acrylic window. Lengths in mm."""

from math import radians, tan

from build123d import Axis, Part, Polygon, Pos, Sketch, Sphere, fillet

from ninedtact.hardware.design import HardwareDesign
from ninedtact.hardware.parts.primitives import (
    COINCIDENT_MM,
    extrude_along_x,
    extrude_along_y,
    extrude_along_z,
    make_cone,
    make_cylinder,
    make_cylinders_at,
    make_plate,
    nearest_vertex,
    require_single_solid,
)

CUT_MARGIN_MM = 1.0
"""Cuts go this far beyond the faces that they open."""


def build_sensor_base(design: HardwareDesign) -> Part:
    """Build the base: plate, bosses and posts, then pocket, channel and holes."""
    base, plan, levels = design.base, design.plan_view, design.heights
    body = make_plate(plan.outer, (0, levels.plate_top), base.corner_radius_mm)
    body += make_cylinders_at(base.boss_mm, (base.floor_mm, levels.boss_top), plan.mount_inserts)
    body += make_cylinders_at(base.post_mm, (base.floor_mm, levels.board_bottom), plan.posts)
    body += _locating_pins(design)
    body -= make_cylinders_at(base.bore_mm, (base.floor_mm, levels.boss_top + CUT_MARGIN_MM), plan.mount_inserts)
    body -= make_cylinders_at(base.bolt_mm, (-CUT_MARGIN_MM, base.floor_mm), plan.mount_inserts)
    body -= make_cylinders_at(base.shell_screw_mm, (0, levels.plate_top + CUT_MARGIN_MM), plan.shell_screws)
    body -= make_cylinders_at(base.counterbore_mm, (-CUT_MARGIN_MM, base.counterbore_deep_mm), plan.shell_screws)
    return require_single_solid(body - _camera_pocket(design))


def _locating_pins(design: HardwareDesign) -> list[Part]:
    """Return the locating pins on the posts, rounded at their tips."""
    base, levels = design.base, design.heights
    tip = levels.board_bottom + base.pin_tall_mm
    pins = make_cylinders_at(base.pin_mm, (levels.plate_top, tip), design.plan_view.posts)
    if not base.pin_round_mm:
        return pins
    return [fillet(pin.faces().sort_by(Axis.Z)[-1].edges(), base.pin_round_mm) for pin in pins]


def _camera_pocket(design: HardwareDesign) -> Part:
    """Return the camera's pocket with the channel in which its cable climbs to the shell's rim."""
    base, levels = design.base, design.heights
    room = extrude_along_z(_pocket_outline(design), (base.floor_mm, levels.plate_top + CUT_MARGIN_MM))
    return room - extrude_along_x(*_cable_ramp(design))


def _pocket_outline(design: HardwareDesign) -> Sketch:
    """Return the outline of pocket and channel, seen from above."""
    base, side = design.base, design.plan_view.outer[1] / 2 + CUT_MARGIN_MM
    pocket, channel = base.pocket_wide_mm / 2, base.channel_wide_mm / 2
    front, back = base.pocket_front_mm, -base.pocket_back_mm
    right = [(channel, -side), (channel, back), (pocket, back), (pocket, front)]
    outline = Polygon(*right, *[(-x, y) for x, y in reversed(right)], align=None)
    if not base.channel_round_mm:
        return outline
    corners = [nearest_vertex(outline.vertices(), (x, back)) for x in (channel, -channel)]
    return fillet(corners, base.channel_round_mm)


def _cable_ramp(design: HardwareDesign) -> tuple[list[tuple[float, float]], float, dict[tuple[float, float], float]]:
    """Return what stays under the cable: its outline in (y, z), its half width, and the fillets of its foot and head."""
    base, side = design.base, design.plan_view.outer[1] / 2
    floor, top = base.floor_mm, design.heights.plate_top - base.ramp_gap_mm
    foot, head = (base.ramp_foot_mm - side, floor), (base.ramp_head_mm - side, top)
    below, beyond = floor - 0.5, -side - 2 * CUT_MARGIN_MM
    outline = [(-base.pocket_back_mm, below), (-base.pocket_back_mm, floor), foot, head, (beyond, top), (beyond, below)]
    return outline, base.pocket_wide_mm, {foot: base.ramp_foot_round_mm, head: base.ramp_head_round_mm}


def build_sensor_shell(design: HardwareDesign) -> Part:
    """Build the shell: a block with the gel cavity above and the LED cavity below, the window's frame, bores and the
    USB slot."""
    shell, plan, levels = design.shell, design.plan_view, design.heights
    body = make_plate(plan.outer, (levels.plate_top, levels.rim), shell.corner_radius_mm)
    body -= make_plate(plan.opening, (levels.floor_top, levels.rim + CUT_MARGIN_MM), shell.opening_radius_mm)
    body += _window_frame(design)
    body -= _led_cavity(design)
    hole = shell.hole_mm, shell.hole_mm
    body -= make_plate(hole, (levels.ceiling - CUT_MARGIN_MM, levels.floor_top + CUT_MARGIN_MM))
    bottom = levels.plate_top
    body -= make_cylinders_at(shell.bore_mm, (bottom - CUT_MARGIN_MM, bottom + shell.bore_deep_mm), plan.shell_screws)
    return require_single_solid(body - _usb_slot(design))


def _window_frame(design: HardwareDesign) -> Part:
    """Return the frame around the window's seat."""
    outside, inside = design.plan_view.frame_outside, design.plan_view.frame_inside
    heights = design.heights.floor_top, design.heights.frame_top
    return make_plate((outside, outside), heights) - make_plate((inside, inside), heights)


def _led_cavity(design: HardwareDesign) -> Part:
    """Return the LED cavity below the floor, without the screw bosses and rounded at the ceiling."""
    shell, plan, levels = design.shell, design.plan_view, design.heights
    heights = levels.plate_top - CUT_MARGIN_MM, levels.ceiling
    air = make_plate(plan.cavity, heights)
    air -= make_cylinders_at(shell.boss_mm, heights, plan.shell_screws)
    if not shell.fillet_mm:
        return air
    return fillet(air.faces().sort_by(Axis.Z)[-1].edges(), shell.fillet_mm)


def _usb_slot(design: HardwareDesign) -> list[Part]:
    """Return the slot through the wall at -y, with the receptacle's two slanted corners, and the relief around it
    outside."""
    shell, plan, bottom = design.shell, design.plan_view, design.heights.plate_top
    half, low, high, slant = shell.slot_wide_mm / 2, shell.slot_from_mm, shell.slot_to_mm, shell.slot_chamfer_mm
    right = [(half, bottom + low), (half, bottom + high - slant), (half - slant, bottom + high)]
    outline = [*right, *[(-x, z) for x, z in reversed(right)]]
    inside, outside = -plan.cavity[1] / 2 + CUT_MARGIN_MM, -plan.outer[1] / 2 - CUT_MARGIN_MM
    slot = extrude_along_y(outline, (inside, outside), dict.fromkeys(outline, shell.slot_round_mm))
    if shell.relief_deep_mm < COINCIDENT_MM:
        return [slot]
    size = shell.relief_wide_mm, 2 * shell.relief_deep_mm
    relief = make_plate(size, (bottom - CUT_MARGIN_MM, bottom + shell.relief_tall_mm), at=(0.0, -plan.outer[1] / 2))
    return [slot, relief]


def build_isolation_ring(design: HardwareDesign) -> Part:
    """Build the isolation ring: a square block with a bore that opens to a cone at the window."""
    ring, bottom, top = design.ring, design.heights.ring_bottom, design.heights.floor_top
    side = design.plan_view.ring_side
    mouth = side - 2 * ring.land_mm
    opens = top - (mouth - ring.bore_mm) / 2 / tan(radians(ring.cone_deg))
    body = make_plate((side, side), (bottom, top)) - make_cylinder(ring.bore_mm, (bottom - CUT_MARGIN_MM, opens))
    return require_single_solid(body - make_cone(ring.bore_mm, mouth, (opens, top)))


def build_acrylic_window(design: HardwareDesign) -> Part:
    """Build the acrylic window between camera and gel."""
    side = design.window.side_mm
    return make_plate((side, side), (design.heights.floor_top, design.heights.window_top))


def build_calibration_board(design: HardwareDesign) -> Part:
    """Build the calibration board: a tray that slides over the shell, with round-tipped pins on its floor. It lies on
    its back, z = 0 is its outer face, and its pins point up."""
    frame, plan = design.pin_frame, design.plan_view
    outside = plan.tray[0] + 2 * frame.wall_mm, plan.tray[1] + 2 * frame.wall_mm
    body = make_plate(outside, (0, plan.tray_tall), frame.corner_radius_mm)
    inside_radius = max(frame.corner_radius_mm - frame.wall_mm, 0.0)
    body -= make_plate(plan.tray, (frame.floor_mm, plan.tray_tall + CUT_MARGIN_MM), inside_radius)
    one = _calibration_pin(design)
    return require_single_solid(body + [Pos(x, y, 0) * one for x, y in plan.pins])


def _calibration_pin(design: HardwareDesign) -> Part:
    """Return one pin: a hemisphere on a cylinder that is rooted in the floor."""
    frame, radius = design.pin_frame, design.sensor.pin_board.pin_diameter_mm / 2
    shoulder = frame.floor_mm + frame.pin_tall_mm - radius
    shaft = make_cylinder(2 * radius, (frame.floor_mm / 2, shoulder))
    return shaft + Pos(0, 0, shoulder) * Sphere(radius)
