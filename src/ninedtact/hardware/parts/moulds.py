"""The laser-cut plates: base board and the two moulds, each lying on z = 0."""

from build123d import Part

from ninedtact.hardware.design import HardwareDesign
from ninedtact.hardware.parts.base import THROUGH
from ninedtact.hardware.parts.solids import discs, one_solid, slab
from ninedtact.hardware.plan import Pair


def base_board(design: HardwareDesign) -> Part:
    """The shell is screwed on it while the gels are poured."""
    thick = design.moulds.base_mm
    holes = discs(design.moulds.shell_screw_mm, (-THROUGH, thick + THROUGH), design.plan.shell_screws)
    return one_solid(plate(design, thick) - holes)


def first_mould(design: HardwareDesign) -> Part:
    """As thick as the translucent gel."""
    return mould(design, design.levels.first_mould, design.plan.translucent, design.gels.rim_radius_mm)


def second_mould(design: HardwareDesign) -> Part:
    """Thicker and wider: the difference is filled with black."""
    radius = design.gels.rim_radius_mm + design.gels.black_side_mm
    return mould(design, design.levels.second_mould, design.plan.black, radius)


def mould(design: HardwareDesign, thick: float, window: Pair, radius: float) -> Part:
    """A plate with a window."""
    return one_solid(plate(design, thick) - slab(window, (-THROUGH, thick + THROUGH), radius))


def plate(design: HardwareDesign, thick: float) -> Part:
    """Outline and clamping holes that all plates share."""
    body = slab(design.plan.plate, (0, thick), design.moulds.corner_radius_mm)
    return body - discs(design.moulds.hole_mm, (-THROUGH, thick + THROUGH), design.plan.clamps)
