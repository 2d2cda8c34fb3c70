"""The laser-cut mould plates, each lying on z = 0, and the three gels as they are in the finished sensor. Lengths in
mm."""

from build123d import Part

from ninedtact.hardware.assembly_dimensions import XY
from ninedtact.hardware.design import HardwareDesign
from ninedtact.hardware.parts.primitives import make_cylinders, make_plate, require_single_solid
from ninedtact.hardware.parts.printed_parts import CUT_MARGIN_MM


def build_base_board(design: HardwareDesign) -> Part:
    """Build the base board, on which the shell is screwed while the gels are poured."""
    thick = design.moulds.base_mm
    holes = make_cylinders(
        design.moulds.shell_screw_mm, (-CUT_MARGIN_MM, thick + CUT_MARGIN_MM), design.plan_view.shell_screws
    )
    return require_single_solid(_clamping_plate(design, thick) - holes)


def build_first_mould(design: HardwareDesign) -> Part:
    """Build the first mould, which is as thick as the translucent gel."""
    return _mould(design, design.heights.first_mould, design.plan_view.translucent, design.gels.rim_radius_mm)


def build_second_mould(design: HardwareDesign) -> Part:
    """Build the second mould, which is thicker and wider; black silicone fills the difference."""
    radius = design.gels.rim_radius_mm + design.gels.black_side_mm
    return _mould(design, design.heights.second_mould, design.plan_view.black, radius)


def _mould(design: HardwareDesign, thick: float, window: XY, radius: float) -> Part:
    """Return a clamping plate with a window."""
    return require_single_solid(
        _clamping_plate(design, thick) - make_plate(window, (-CUT_MARGIN_MM, thick + CUT_MARGIN_MM), radius)
    )


def _clamping_plate(design: HardwareDesign, thick: float) -> Part:
    """Return the outline and the clamping holes that all plates share."""
    body = make_plate(design.plan_view.plate, (0, thick), design.moulds.corner_radius_mm)
    return body - make_cylinders(
        design.moulds.hole_mm, (-CUT_MARGIN_MM, thick + CUT_MARGIN_MM), design.plan_view.clamps
    )


def build_transparent_gel(design: HardwareDesign) -> Part:
    """Build the transparent gel, which fills the shell above the window. The groove between window and frame stays
    empty."""
    shell, plan, levels = design.shell, design.plan_view, design.heights
    body = make_plate(plan.opening, (levels.floor_top, levels.rim), shell.opening_radius_mm)
    frame, window = plan.frame_outside, design.window.side_mm
    body -= make_plate((frame, frame), (levels.floor_top, levels.frame_top))
    return require_single_solid(body - make_plate((window, window), (levels.floor_top, levels.window_top)))


def build_translucent_gel(design: HardwareDesign) -> Part:
    """Build the translucent gel on the shell's rim, which scatters white light back."""
    return make_plate(
        design.plan_view.translucent, (design.heights.rim, design.heights.skin), design.gels.rim_radius_mm
    )


def build_black_gel(design: HardwareDesign) -> Part:
    """Build the black gel over and around the translucent one."""
    radius = design.gels.rim_radius_mm + design.gels.black_side_mm
    outside = make_plate(design.plan_view.black, (design.heights.rim, design.heights.top), radius)
    return require_single_solid(outside - build_translucent_gel(design))
