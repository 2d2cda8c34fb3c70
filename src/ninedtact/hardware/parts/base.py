"""The sensor base."""

from build123d import Axis, Part, Polygon, Sketch, fillet

from ninedtact.hardware.design import HardwareDesign
from ninedtact.hardware.parts.solids import along_x, discs, one_solid, slab, upright, vertex_at

THROUGH = 1.0
"""Cuts go this far beyond the faces that they open."""


def sensor_base(design: HardwareDesign) -> Part:
    """Plate, bosses and posts; then pocket, channel and holes."""
    base, plan, levels = design.base, design.plan, design.levels
    body = slab(plan.outer, (0, levels.plate_top), base.corner_radius_mm)
    body += discs(base.boss_mm, (base.floor_mm, levels.boss_top), plan.mount_inserts)
    body += discs(base.post_mm, (base.floor_mm, levels.board_bottom), plan.posts)
    body += locating_pins(design)
    body -= discs(base.bore_mm, (base.floor_mm, levels.boss_top + THROUGH), plan.mount_inserts)
    body -= discs(base.bolt_mm, (-THROUGH, base.floor_mm), plan.mount_inserts)
    body -= discs(base.shell_screw_mm, (0, levels.plate_top + THROUGH), plan.shell_screws)
    body -= discs(base.counterbore_mm, (-THROUGH, base.counterbore_deep_mm), plan.shell_screws)
    return one_solid(body - camera_room(design))


def locating_pins(design: HardwareDesign) -> list[Part]:
    """On the posts, rounded at their tips."""
    base, levels = design.base, design.levels
    tip = levels.board_bottom + base.pin_tall_mm
    pins = discs(base.pin_mm, (levels.plate_top, tip), design.plan.posts)
    if not base.pin_round_mm:
        return pins
    return [fillet(pin.faces().sort_by(Axis.Z)[-1].edges(), base.pin_round_mm) for pin in pins]


def camera_room(design: HardwareDesign) -> Part:
    """The camera's pocket, and the channel in which its cable climbs to the shell's rim."""
    base, levels = design.base, design.levels
    room = upright(pocket_and_channel(design), (base.floor_mm, levels.plate_top + THROUGH))
    return room - along_x(*ramp(design))


def pocket_and_channel(design: HardwareDesign) -> Sketch:
    """Their outline from above."""
    base, side = design.base, design.plan.outer[1] / 2 + THROUGH
    pocket, channel = base.pocket_wide_mm / 2, base.channel_wide_mm / 2
    front, back = base.pocket_front_mm, -base.pocket_back_mm
    right = [(channel, -side), (channel, back), (pocket, back), (pocket, front)]
    outline = Polygon(*right, *[(-x, y) for x, y in reversed(right)], align=None)
    if not base.channel_round_mm:
        return outline
    corners = [vertex_at(outline.vertices(), (x, back)) for x in (channel, -channel)]
    return fillet(corners, base.channel_round_mm)


def ramp(design: HardwareDesign) -> tuple[list[tuple[float, float]], float, dict[tuple[float, float], float]]:
    """What stays under the cable: outline in (y, z), half width, and fillets of its foot and head."""
    base, side = design.base, design.plan.outer[1] / 2
    floor, top = base.floor_mm, design.levels.plate_top - base.ramp_gap_mm
    foot, head = (base.ramp_foot_mm - side, floor), (base.ramp_head_mm - side, top)
    below, beyond = floor - 0.5, -side - 2 * THROUGH
    outline = [(-base.pocket_back_mm, below), (-base.pocket_back_mm, floor), foot, head, (beyond, top), (beyond, below)]
    return outline, base.pocket_wide_mm, {foot: base.ramp_foot_round_mm, head: base.ramp_head_round_mm}
