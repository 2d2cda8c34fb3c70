"""Dimensions of the silicone layers above the window and of the moulds in which they are cast."""

from dataclasses import dataclass
from typing import Annotated

from ninedtact.hardware.dimensions.bounds import BoundedDimensions, Bounds


@dataclass(frozen=True)
class GelLayerDimensions(BoundedDimensions, table="gels"):
    """Dimensions of the layers other than the thickness of the translucent one, which belongs to the sensor design."""

    rim_radius_mm: Annotated[float, Bounds(0.0, 5.0)] = 1.0
    """Corner radius of the translucent layer."""
    black_top_mm: Annotated[float, Bounds(0.1, 2.0)] = 0.3
    """Thickness of the black layer above the translucent one: the difference of the two moulds, enough to stop all
    light."""
    black_side_mm: Annotated[float, Bounds(0.2, 2.0)] = 0.8
    """Thickness of the black layer around the sides."""


@dataclass(frozen=True)
class MouldDimensions(BoundedDimensions, table="moulds"):
    """Laser-cut acrylic plates, clamped by M3 screws; each mould is as thick as the layers that it forms."""

    base_mm: Annotated[float, Bounds(1.0, 8.0)] = 3.0
    """Thickness of the base board on which the shell is screwed."""
    beyond_mm: Annotated[tuple[float, float], Bounds(8.0, 40.0)] = (30.5, 27.5)
    """How much wider the plates are than the translucent layer, x and y: space for shell and screws."""
    corner_radius_mm: Annotated[float, Bounds(0.0, 20.0)] = 12.0
    """Corner radius of the plates."""
    hole_mm: Annotated[float, Bounds(3.05, 3.6)] = 3.1
    """Clearance holes for M3."""
    hole_inset_mm: Annotated[float, Bounds(2.5, 8.0)] = 3.0
    """From the plates' edges to the screws' axes."""
    pairs_mm: Annotated[tuple[float, float], Bounds(4.0, 40.0)] = (10.0, 8.0)
    """Positions of the screws: at the long sides, x from the middle; at the short sides, y from the middle."""
    shell_screw_mm: Annotated[float, Bounds(2.0, 3.0)] = 2.2
    """Holes through the base board into the shell's inserts."""


ORIGINAL_MOULDS = MouldDimensions(shell_screw_mm=2.1)
