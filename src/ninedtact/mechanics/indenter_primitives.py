"""Indenters in closed form: ball, ellipsoid, lying cylinder, cone and flat punch. Each touches its own plane at the origin."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from array_api_compat import array_namespace

from ninedtact.design import require_positive
from ninedtact.mechanics.indenter import NO_OBJECT_MM, Heights, Indenter


@dataclass(frozen=True)
class Ball(Indenter):
    """A sphere of this radius."""

    radius_mm: float = 4.0

    def __post_init__(self) -> None:
        require_positive("ball.radius_mm", self.radius_mm)

    @property
    def name(self) -> str:  # type: ignore[override]
        """The shape with its diameter in mm."""
        return f"ball_{2 * self.radius_mm:g}mm"

    def underside_mm(self, x_mm: Heights, y_mm: Heights) -> Heights:
        """Return the lower cap; no object beyond the equator."""
        xp = array_namespace(x_mm)
        below = self.radius_mm**2 - x_mm**2 - y_mm**2
        cap = self.radius_mm - xp.sqrt(xp.where(below > 0, below, 0.0))
        return xp.where(below > 0, cap, NO_OBJECT_MM)


@dataclass(frozen=True)
class Ellipsoid(Indenter):
    """An ellipsoid with its axes along x, y and z."""

    half_length_mm: float = 5.0
    half_width_mm: float = 3.0
    half_height_mm: float = 3.0

    def __post_init__(self) -> None:
        for name in ("half_length_mm", "half_width_mm", "half_height_mm"):
            require_positive(f"ellipsoid.{name}", getattr(self, name))

    @property
    def name(self) -> str:  # type: ignore[override]
        """The shape with its three diameters in mm."""
        return f"ellipsoid_{2 * self.half_length_mm:g}x{2 * self.half_width_mm:g}x{2 * self.half_height_mm:g}mm"

    def underside_mm(self, x_mm: Heights, y_mm: Heights) -> Heights:
        """Return the lower half; no object beyond it."""
        left = 1 - (x_mm / self.half_length_mm) ** 2 - (y_mm / self.half_width_mm) ** 2
        return self.half_height_mm + _lower_half_mm(left, self.half_height_mm)


def _lower_half_mm(remainder: Any, half_axis_mm: float) -> Any:
    """Return −half_axis·√remainder, the lower half of a quadric over its centre; no object where the remainder is not positive."""
    xp = array_namespace(remainder)
    root = xp.sqrt(xp.where(remainder > 0, remainder, 0.0))
    return xp.where(remainder > 0, -half_axis_mm * root, NO_OBJECT_MM - half_axis_mm)


@dataclass(frozen=True)
class LyingCylinder(Indenter):
    """A cylinder lying on its side, its axis along x, with sharp ends."""

    radius_mm: float = 3.0
    length_mm: float = 12.0

    def __post_init__(self) -> None:
        require_positive("cylinder.radius_mm", self.radius_mm)
        require_positive("cylinder.length_mm", self.length_mm)

    @property
    def name(self) -> str:  # type: ignore[override]
        """The shape with its diameter and length in mm."""
        return f"cylinder_{2 * self.radius_mm:g}x{self.length_mm:g}mm"

    def underside_mm(self, x_mm: Heights, y_mm: Heights) -> Heights:
        """Return the lower half of the shell; no object beyond its ends."""
        xp = array_namespace(x_mm)
        beside = xp.abs(x_mm) > self.length_mm / 2
        trough = self.radius_mm + _lower_half_mm(1 - (y_mm / self.radius_mm) ** 2, self.radius_mm)
        return xp.where(beside, NO_OBJECT_MM, trough)


@dataclass(frozen=True)
class Cone(Indenter):
    """A cone on its rounded tip: a spherical cap that the flank continues without a kink."""

    slope_rad: float = 0.5
    """Inclination of the flank to the skin's plane."""
    tip_radius_mm: float = 0.5
    radius_mm: float = 5.0
    """Radius of the base, where the cone ends."""

    def __post_init__(self) -> None:
        for name in ("slope_rad", "tip_radius_mm", "radius_mm"):
            require_positive(f"cone.{name}", getattr(self, name))
        require_positive("cone.slope_rad below a right angle", np.pi / 2 - self.slope_rad)

    @property
    def name(self) -> str:  # type: ignore[override]
        """The shape with the slope of its flank in degrees and the diameter of its base in mm."""
        return f"cone_{np.degrees(self.slope_rad):.0f}deg_{2 * self.radius_mm:g}mm"

    def underside_mm(self, x_mm: Heights, y_mm: Heights) -> Heights:
        """Return the cap, continued by the flank; no object beyond the base."""
        xp, tip, steep = array_namespace(x_mm), self.tip_radius_mm, float(np.tan(self.slope_rad))
        radius = xp.sqrt(x_mm**2 + y_mm**2)
        on_cap = radius < tip * float(np.sin(self.slope_rad))
        cap = tip - xp.sqrt(xp.where(on_cap, tip**2 - radius**2, 0.0))
        flank = steep * radius + tip * (1 - 1 / float(np.cos(self.slope_rad)))
        return xp.where(radius > self.radius_mm, NO_OBJECT_MM, xp.where(on_cap, cap, flank))


@dataclass(frozen=True)
class FlatPunch(Indenter):
    """A round flat face with a rounded edge; the rounding lies within the radius."""

    radius_mm: float = 3.0
    edge_mm: float = 0.2
    """Radius of the rounded edge."""

    def __post_init__(self) -> None:
        require_positive("flat_punch.edge_mm", self.edge_mm)
        require_positive("flat_punch.radius_mm beyond its edge", self.radius_mm - self.edge_mm)

    @property
    def name(self) -> str:  # type: ignore[override]
        """The shape with its diameter in mm."""
        return f"punch_{2 * self.radius_mm:g}mm"

    def underside_mm(self, x_mm: Heights, y_mm: Heights) -> Heights:
        """Return zero on the face and a quarter circle at its edge."""
        xp = array_namespace(x_mm)
        over = xp.sqrt(x_mm**2 + y_mm**2) - (self.radius_mm - self.edge_mm)
        edge = self.edge_mm + _lower_half_mm(1 - (xp.where(over > 0, over, 0.0) / self.edge_mm) ** 2, self.edge_mm)
        return xp.where(over > 0, edge, 0.0 * edge)
