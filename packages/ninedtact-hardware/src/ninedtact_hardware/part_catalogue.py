"""The catalogue of parts: name, manufacturing method and builder of each part, and the built parts of a design."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

from build123d import Part

from ninedtact.design import DesignImpossible
from ninedtact_hardware.design import HardwareDesign
from ninedtact_hardware.part_solids import (
    build_acrylic_window,
    build_base_board,
    build_black_gel,
    build_calibration_board,
    build_camera,
    build_first_mould,
    build_isolation_ring,
    build_led_board,
    build_second_mould,
    build_sensor_base,
    build_sensor_shell,
    build_translucent_gel,
    build_transparent_gel,
)

ManufacturingMethod = Literal["printed", "cut", "cast", "bought"]


PART_CATALOGUE: dict[str, tuple[ManufacturingMethod, Callable[[HardwareDesign], Part]]] = {
    "sensor_base": ("printed", build_sensor_base),
    "sensor_shell": ("printed", build_sensor_shell),
    "isolation_ring": ("printed", build_isolation_ring),
    "calibration_board": ("printed", build_calibration_board),
    "acrylic_window": ("cut", build_acrylic_window),
    "base_board": ("cut", build_base_board),
    "first_mould": ("cut", build_first_mould),
    "second_mould": ("cut", build_second_mould),
    "transparent_gel": ("cast", build_transparent_gel),
    "translucent_gel": ("cast", build_translucent_gel),
    "black_gel": ("cast", build_black_gel),
    "camera": ("bought", build_camera),
    "led_board": ("bought", build_led_board),
}
"""Manufacturing method and builder of every part."""
METHODS_WITH_FILES = ("printed", "cut")
"""Manufacturing methods that need files. Gels come from moulds, bought parts from shops."""


@dataclass(frozen=True)
class BuiltPart:
    """One part of one design as a solid."""

    name: str
    method: ManufacturingMethod
    solid: Part

    @cached_property
    def size_mm(self) -> tuple[float, float, float]:
        """Size of the part's bounding box."""
        size = self.solid.bounding_box().size
        return float(size.X), float(size.Y), float(size.Z)

    @cached_property
    def volume_mm3(self) -> float:
        """Volume of the part."""
        return float(self.solid.volume)


def build_parts(design: HardwareDesign) -> dict[str, BuiltPart]:
    """Build all parts of a design that keeps all rules and return them by name.

    Raises `DesignImpossible` for a part that the modelling library cannot build, mostly for a fillet that does not fit its edges.
    """
    parts = dict[str, BuiltPart]()
    for name, (method, build) in PART_CATALOGUE.items():
        try:
            parts[name] = BuiltPart(name, method, build(design))
        except (ValueError, RuntimeError) as trouble:
            raise DesignImpossible(
                f"expected dimensions from which the {name} can be modelled, got: {trouble}; change its fillets, its chamfers or "
                "the widths beside them"
            ) from trouble
    return parts
