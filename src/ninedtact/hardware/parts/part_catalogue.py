"""The catalogue of parts: name, manufacturing method and builder of each part, and the built parts of a design.

It also builds the laser-cut mould plates, each lying on z = 0, and the three gels as they are in the finished sensor. Lengths
in mm.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from build123d import Part

from ninedtact.design import DesignImpossible
from ninedtact.hardware.assembly_dimensions import XY
from ninedtact.hardware.design import HardwareDesign
from ninedtact.hardware.parts.solids import (
    CUT_MARGIN_MM,
    build_acrylic_window,
    build_calibration_board,
    build_camera,
    build_isolation_ring,
    build_led_board,
    build_sensor_base,
    build_sensor_shell,
    make_cylinders_at,
    make_plate,
    single_solid_of_part,
)


def build_base_board(design: HardwareDesign) -> Part:
    """Build the base board, on which the shell is screwed while the gels are poured."""
    thick = design.moulds.base_mm
    holes = make_cylinders_at(
        design.moulds.shell_screw_mm, (-CUT_MARGIN_MM, thick + CUT_MARGIN_MM), design.horizontal_dimensions.shell_screws
    )
    return single_solid_of_part(_clamping_plate(design, thick) - holes)


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
    """Return a clamping plate with a window."""
    return single_solid_of_part(
        _clamping_plate(design, thick) - make_plate(window, (-CUT_MARGIN_MM, thick + CUT_MARGIN_MM), radius)
    )


def _clamping_plate(design: HardwareDesign, thick: float) -> Part:
    """Return the outline and the clamping holes that all plates share."""
    body = make_plate(design.horizontal_dimensions.plate, (0, thick), design.moulds.corner_radius_mm)
    return body - make_cylinders_at(
        design.moulds.hole_mm, (-CUT_MARGIN_MM, thick + CUT_MARGIN_MM), design.horizontal_dimensions.clamps
    )


def build_transparent_gel(design: HardwareDesign) -> Part:
    """Build the transparent gel, which fills the shell above window and frame. The groove between these stays empty."""
    shell, plan, levels = design.shell, design.horizontal_dimensions, design.heights
    body = make_plate(plan.opening, (levels.floor_top, levels.rim), shell.opening_radius_mm)
    outside, inside, window = plan.frame_outside, plan.frame_inside, design.window.side_mm
    body -= make_plate((outside, outside), (levels.floor_top, levels.frame_top))
    if levels.frame_top > levels.window_top:
        body += make_plate((inside, inside), (levels.window_top, levels.frame_top))
    return single_solid_of_part(body - make_plate((window, window), (levels.floor_top, levels.window_top)))


def build_translucent_gel(design: HardwareDesign) -> Part:
    """Build the translucent gel on the shell's rim, which scatters white light back."""
    return make_plate(
        design.horizontal_dimensions.translucent, (design.heights.rim, design.heights.skin), design.gels.rim_radius_mm
    )


def build_black_gel(design: HardwareDesign) -> Part:
    """Build the black gel over and around the translucent one."""
    radius = design.gels.rim_radius_mm + design.gels.black_side_mm
    outside = make_plate(design.horizontal_dimensions.black, (design.heights.rim, design.heights.top), radius)
    return single_solid_of_part(outside - build_translucent_gel(design))


ManufacturingMethod = Literal["printed", "cut", "cast", "bought"]


@dataclass(frozen=True)
class _CatalogueEntry:
    """Name, manufacturing method and builder of one part."""

    name: str
    method: ManufacturingMethod
    build: Callable[[HardwareDesign], Part]


PART_CATALOGUE = (
    _CatalogueEntry("sensor_base", "printed", build_sensor_base),
    _CatalogueEntry("sensor_shell", "printed", build_sensor_shell),
    _CatalogueEntry("isolation_ring", "printed", build_isolation_ring),
    _CatalogueEntry("calibration_board", "printed", build_calibration_board),
    _CatalogueEntry("acrylic_window", "cut", build_acrylic_window),
    _CatalogueEntry("base_board", "cut", build_base_board),
    _CatalogueEntry("first_mould", "cut", build_first_mould),
    _CatalogueEntry("second_mould", "cut", build_second_mould),
    _CatalogueEntry("transparent_gel", "cast", build_transparent_gel),
    _CatalogueEntry("translucent_gel", "cast", build_translucent_gel),
    _CatalogueEntry("black_gel", "cast", build_black_gel),
    _CatalogueEntry("camera", "bought", build_camera),
    _CatalogueEntry("led_board", "bought", build_led_board),
)
METHODS_WITH_FILES = ("printed", "cut")
"""Manufacturing methods that need files. Gels come from moulds, bought parts from shops."""


@dataclass(frozen=True)
class BuiltPart:
    """One part of one design as a solid."""

    name: str
    method: ManufacturingMethod
    solid: Part

    @property
    def size_mm(self) -> tuple[float, float, float]:
        """Size of the part's bounding box."""
        size = self.solid.bounding_box().size
        return float(size.X), float(size.Y), float(size.Z)

    @property
    def volume_mm3(self) -> float:
        """Volume of the part."""
        return float(self.solid.volume)


class PartNotModelled(DesignImpossible):
    """Raised for a part that the modelling library cannot build, mostly for a fillet that does not fit its edges."""


def build_parts(design: HardwareDesign) -> dict[str, BuiltPart]:
    """Build all parts of a design and return them by name. The design must keep all rules: see `buildability`.

    Raises `PartNotModelled`.
    """
    return {made.name: BuiltPart(made.name, made.method, _build_part(made, design)) for made in PART_CATALOGUE}


def _build_part(made: _CatalogueEntry, design: HardwareDesign) -> Part:
    """Build one part; raises `PartNotModelled`."""
    try:
        return made.build(design)
    except (ValueError, RuntimeError) as trouble:
        raise PartNotModelled(
            f"expected dimensions from which the {made.name} can be modelled, got: {trouble}; change its fillets, its chamfers or "
            "the widths beside them"
        ) from trouble
