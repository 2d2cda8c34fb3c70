"""Simple undersides in closed form, each touching its own plane at the origin."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from array_api_compat import array_namespace

from ninedtact.design import require_positive
from ninedtact.mechanics.indenter import NO_OBJECT_MM, Heights, Indenter


@dataclass(frozen=True)
class Ball(Indenter):
    """A sphere."""

    radius_mm: float = 4.0

    def __post_init__(self) -> None:
        require_positive("ball.radius_mm", self.radius_mm)

    @property
    def name(self) -> str:  # type: ignore[override]
        """Ball and diameter."""
        return f"ball_{2 * self.radius_mm:g}mm"

    def underside_mm(self, x_mm: Heights, y_mm: Heights) -> Heights:
        """The lower cap; nothing beyond the equator."""
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
        """Ellipsoid and its three diameters."""
        return f"ellipsoid_{2 * self.half_length_mm:g}x{2 * self.half_width_mm:g}x{2 * self.half_height_mm:g}mm"

    def underside_mm(self, x_mm: Heights, y_mm: Heights) -> Heights:
        """The lower half."""
        left = 1 - (x_mm / self.half_length_mm) ** 2 - (y_mm / self.half_width_mm) ** 2
        return self.half_height_mm + _lower_half_mm(left, self.half_height_mm)


def _lower_half_mm(left: Any, by_mm: float) -> Any:
    """Minus a half-axis times the root of what is left of one; nothing where nothing is left."""
    xp = array_namespace(left)
    return xp.where(left > 0, -by_mm * xp.sqrt(xp.where(left > 0, left, 0.0)), NO_OBJECT_MM - by_mm)


@dataclass(frozen=True)
class Cylinder(Indenter):
    """A cylinder lying on its side, its axis along x, with sharp ends."""

    radius_mm: float = 3.0
    length_mm: float = 12.0

    def __post_init__(self) -> None:
        require_positive("cylinder.radius_mm", self.radius_mm)
        require_positive("cylinder.length_mm", self.length_mm)

    @property
    def name(self) -> str:  # type: ignore[override]
        """Cylinder, diameter and length."""
        return f"cylinder_{2 * self.radius_mm:g}x{self.length_mm:g}mm"

    def underside_mm(self, x_mm: Heights, y_mm: Heights) -> Heights:
        """The lower half of the shell."""
        xp = array_namespace(x_mm)
        beside = xp.abs(x_mm) > self.length_mm / 2
        trough = self.radius_mm + _lower_half_mm(1 - (y_mm / self.radius_mm) ** 2, self.radius_mm)
        return xp.where(beside, NO_OBJECT_MM, trough)


@dataclass(frozen=True)
class Cone(Indenter):
    """A cone on its tip, which is a ball that the flank leaves without a kink."""

    slope_rad: float = 0.5
    """Of the flank over the skin's plane."""
    tip_radius_mm: float = 0.5
    radius_mm: float = 5.0
    """Of the base, where the cone ends."""

    def __post_init__(self) -> None:
        for name in ("slope_rad", "tip_radius_mm", "radius_mm"):
            require_positive(f"cone.{name}", getattr(self, name))
        require_positive("cone.slope_rad below a right angle", np.pi / 2 - self.slope_rad)

    @property
    def name(self) -> str:  # type: ignore[override]
        """Cone, slope of the flank and base."""
        return f"cone_{np.degrees(self.slope_rad):.0f}deg_{2 * self.radius_mm:g}mm"

    def underside_mm(self, x_mm: Heights, y_mm: Heights) -> Heights:
        """Cap, then flank."""
        xp, tip, steep = array_namespace(x_mm), self.tip_radius_mm, float(np.tan(self.slope_rad))
        radius = xp.sqrt(x_mm**2 + y_mm**2)
        on_cap = radius < tip * float(np.sin(self.slope_rad))
        cap = tip - xp.sqrt(xp.where(on_cap, tip**2 - radius**2, 0.0))
        flank = steep * radius + tip * (1 - 1 / float(np.cos(self.slope_rad)))
        return xp.where(radius > self.radius_mm, NO_OBJECT_MM, xp.where(on_cap, cap, flank))


@dataclass(frozen=True)
class FlatPunch(Indenter):
    """A round flat face with a rounded edge, which takes its radius off the face."""

    radius_mm: float = 3.0
    edge_mm: float = 0.2
    """Radius of the edge's rounding."""

    def __post_init__(self) -> None:
        require_positive("flat_punch.edge_mm", self.edge_mm)
        require_positive("flat_punch.radius_mm beyond its edge", self.radius_mm - self.edge_mm)

    @property
    def name(self) -> str:  # type: ignore[override]
        """Punch and diameter."""
        return f"punch_{2 * self.radius_mm:g}mm"

    def underside_mm(self, x_mm: Heights, y_mm: Heights) -> Heights:
        """Zero on the face, a quarter circle at its edge."""
        xp = array_namespace(x_mm)
        over = xp.sqrt(x_mm**2 + y_mm**2) - (self.radius_mm - self.edge_mm)
        edge = self.edge_mm + _lower_half_mm(1 - (xp.where(over > 0, over, 0.0) / self.edge_mm) ** 2, self.edge_mm)
        return xp.where(over > 0, edge, 0.0 * edge)
