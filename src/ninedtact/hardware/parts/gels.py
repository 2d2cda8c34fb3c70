"""The three gels, as they are in the finished sensor."""

from build123d import Part

from ninedtact.hardware.design import HardwareDesign
from ninedtact.hardware.parts.solids import one_solid, slab


def transparent_gel(design: HardwareDesign) -> Part:
    """Fills the shell above the window; the groove between window and frame stays empty."""
    shell, plan, levels = design.shell, design.plan, design.levels
    body = slab(plan.opening, (levels.floor_top, levels.rim), shell.opening_radius_mm)
    frame, window = plan.frame_outside, design.window.side_mm
    body -= slab((frame, frame), (levels.floor_top, levels.frame_top))
    return one_solid(body - slab((window, window), (levels.floor_top, levels.window_top)))


def translucent_gel(design: HardwareDesign) -> Part:
    """On the shell's rim; white light comes back from it."""
    return slab(design.plan.translucent, (design.levels.rim, design.levels.skin), design.gels.rim_radius_mm)


def black_gel(design: HardwareDesign) -> Part:
    """Over and round the translucent one."""
    radius = design.gels.rim_radius_mm + design.gels.black_side_mm
    outside = slab(design.plan.black, (design.levels.rim, design.levels.top), radius)
    return one_solid(outside - translucent_gel(design))
