"""The isolation ring and the acrylic window."""

from math import radians, tan

from build123d import Part

from ninedtact.hardware.design import HardwareDesign
from ninedtact.hardware.parts.base import THROUGH
from ninedtact.hardware.parts.solids import cone, disc, one_solid, slab


def isolation_ring(design: HardwareDesign) -> Part:
    """A square block with a bore that opens to a cone at the window."""
    ring, bottom, top = design.ring, design.levels.ring_bottom, design.levels.floor_top
    side = design.plan.ring_side
    mouth = side - 2 * ring.land_mm
    opens = top - (mouth - ring.bore_mm) / 2 / tan(radians(ring.cone_deg))
    body = slab((side, side), (bottom, top)) - disc(ring.bore_mm, (bottom - THROUGH, opens))
    return one_solid(body - cone(ring.bore_mm, mouth, (opens, top)))


def acrylic_window(design: HardwareDesign) -> Part:
    """The plate between camera and gel."""
    side = design.window.side_mm
    return slab((side, side), (design.levels.floor_top, design.levels.window_top))
