"""The sensor shell."""

from build123d import Axis, Part, fillet

from ninedtact.hardware.design import HardwareDesign
from ninedtact.hardware.parts.base import THROUGH
from ninedtact.hardware.parts.solids import SAME_MM, along_y, discs, one_solid, slab


def sensor_shell(design: HardwareDesign) -> Part:
    """A block with the gel cavity above and the LED cavity below, the window's frame, bores and the USB slot."""
    shell, plan, levels = design.shell, design.plan, design.levels
    body = slab(plan.outer, (levels.plate_top, levels.rim), shell.corner_radius_mm)
    body -= slab(plan.opening, (levels.floor_top, levels.rim + THROUGH), shell.opening_radius_mm)
    body += window_frame(design)
    body -= led_cavity(design)
    hole = shell.hole_mm, shell.hole_mm
    body -= slab(hole, (levels.ceiling - THROUGH, levels.floor_top + THROUGH))
    bottom = levels.plate_top
    body -= discs(shell.bore_mm, (bottom - THROUGH, bottom + shell.bore_deep_mm), plan.shell_screws)
    return one_solid(body - usb_slot(design))


def window_frame(design: HardwareDesign) -> Part:
    """Round the window's seat."""
    outside, inside = design.plan.frame_outside, design.plan.frame_inside
    heights = design.levels.floor_top, design.levels.frame_top
    return slab((outside, outside), heights) - slab((inside, inside), heights)


def led_cavity(design: HardwareDesign) -> Part:
    """The air below the floor: without the screw bosses, and rounded at the ceiling."""
    shell, plan, levels = design.shell, design.plan, design.levels
    heights = levels.plate_top - THROUGH, levels.ceiling
    air = slab(plan.cavity, heights)
    air -= discs(shell.boss_mm, heights, plan.shell_screws)
    if not shell.fillet_mm:
        return air
    return fillet(air.faces().sort_by(Axis.Z)[-1].edges(), shell.fillet_mm)


def usb_slot(design: HardwareDesign) -> list[Part]:
    """Through the wall at -y, with the receptacle's two slanted corners, and the step round it outside."""
    shell, plan, bottom = design.shell, design.plan, design.levels.plate_top
    half, low, high, slant = shell.slot_wide_mm / 2, shell.slot_from_mm, shell.slot_to_mm, shell.slot_chamfer_mm
    right = [(half, bottom + low), (half, bottom + high - slant), (half - slant, bottom + high)]
    outline = [*right, *[(-x, z) for x, z in reversed(right)]]
    inside, outside = -plan.cavity[1] / 2 + THROUGH, -plan.outer[1] / 2 - THROUGH
    slot = along_y(outline, (inside, outside), dict.fromkeys(outline, shell.slot_round_mm))
    if shell.relief_deep_mm < SAME_MM:
        return [slot]
    size = shell.relief_wide_mm, 2 * shell.relief_deep_mm
    relief = slab(size, (bottom - THROUGH, bottom + shell.relief_tall_mm), at=(0.0, -plan.outer[1] / 2))
    return [slot, relief]
