"""The calibration board, lying on its back: z = 0 is its outer face, its pins point up."""

from build123d import Part, Pos, Sphere

from ninedtact.hardware.design import HardwareDesign
from ninedtact.hardware.parts.base import THROUGH
from ninedtact.hardware.parts.solids import disc, one_solid, slab


def calibration_board(design: HardwareDesign) -> Part:
    """A tray that slides over the shell, with round-tipped pins on its floor."""
    frame, plan = design.pin_frame, design.plan
    outside = plan.tray[0] + 2 * frame.wall_mm, plan.tray[1] + 2 * frame.wall_mm
    body = slab(outside, (0, plan.tray_tall), frame.corner_radius_mm)
    inside_radius = max(frame.corner_radius_mm - frame.wall_mm, 0.0)
    body -= slab(plan.tray, (frame.floor_mm, plan.tray_tall + THROUGH), inside_radius)
    one = pin(design)
    return one_solid(body + [Pos(x, y, 0) * one for x, y in plan.pins])


def pin(design: HardwareDesign) -> Part:
    """A hemisphere on a cylinder, rooted in the floor."""
    frame, radius = design.pin_frame, design.sensor.pin_board.pin_diameter_mm / 2
    shoulder = frame.floor_mm + frame.pin_tall_mm - radius
    shaft = disc(2 * radius, (frame.floor_mm / 2, shoulder))
    return shaft + Pos(0, 0, shoulder) * Sphere(radius)
