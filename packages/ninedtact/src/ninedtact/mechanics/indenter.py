"""Rigid objects over the skin, given by the height of their underside, and how a pose puts that underside over the skin.

An indenter gives the height of its underside in its own frame. Only what faces down matters: under an overhang the lowest surface
is the underside. Ball, ellipsoid, lying cylinder, cone and flat punch have a closed form here, and each touches its own plane at
the origin; shapes sampled on a grid are in `height_grid_indenter`.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np
from array_api_compat import array_namespace
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact.design import require_positive
from ninedtact.errors import InputError
from ninedtact.mechanics.numpy_or_torch_arrays import ScalarPerContact, expand_over_grid, to_numpy
from ninedtact.mechanics.pose import Pose

Heights = Float[Any, "*batch rows cols"]
PosedHeights = Float[Any, "*posed rows cols"]
"""Heights under a pose, or under each of a batch of poses."""

NO_OBJECT_MM = 50.0
"""The height of the underside where there is no object."""
MAX_TILT_RAD = 1.0
"""The largest sum of the two tilts."""
_TILT_REACH_MM = 8.0
"""Parts of a tilted underside that are higher than this over its own plane count as no object, because no skin bulges so far."""
_TILT_DRIFT_MM = 0.3
"""How far a vertical line may move sideways in the frame of a tilted object between two search heights."""
_TILT_HALVINGS = 3
"""Bisections of the interval between two search heights, each after a secant: exact for smooth undersides, accurate enough
for walls."""


class Indenter(ABC):
    """A rigid object over the skin."""

    name: str
    """The object's name, which is also its identifier in a data set."""

    @property
    def half_size_mm(self) -> tuple[float, float]:
        """Own |x| and |y| beyond which there is no object; NO_OBJECT_MM where that is not known."""
        return NO_OBJECT_MM, NO_OBJECT_MM

    @abstractmethod
    def underside_mm(self, x_mm: Heights, y_mm: Heights) -> Heights:
        """Return the height of the underside over the object's own plane z = 0, which its lowest point touches."""

    def height_over_skin_mm(self, pose: Pose, x_mm: Heights, y_mm: Heights) -> PosedHeights:
        """Return the height of the posed underside over the undeformed skin at (x, y), negative where it is pressed in.

        Exact without tilt; with tilt see `_tilted_underside_mm`. Raises `InputError`.
        """
        if pose.is_level:
            return self.underside_mm(*_to_object_frame(pose, x_mm, y_mm)) - expand_over_grid(pose.depth_mm, x_mm)
        return _tilted_underside_mm(self, pose, x_mm, y_mm)


def _to_object_frame(pose: Pose, x_mm: Heights, y_mm: Heights) -> tuple[PosedHeights, PosedHeights]:
    """Return positions on the skin in the frame of an object without tilt."""
    x, y = x_mm - expand_over_grid(pose.x_mm, x_mm), y_mm - expand_over_grid(pose.y_mm, y_mm)
    cos, sin = expand_over_grid(np.cos(pose.twist_rad), x), expand_over_grid(np.sin(pose.twist_rad), x)
    return cos * x + sin * y, cos * y - sin * x


@dataclass(frozen=True)
class _VerticalLines:
    """The vertical lines through positions on the skin, in the frame of a tilted object."""

    indenter: Indenter
    rotation: list[list[Any]]
    """The rotation matrix of the object, or of each of a batch, by row and column."""
    x_mm: Any
    y_mm: Any

    def z_mm(self, own_height_mm: Any) -> Any:
        """Return z from the object's origin at which each line reaches a height over the object's own plane."""
        return (own_height_mm - self.rotation[0][2] * self.x_mm - self.rotation[1][2] * self.y_mm) / self.rotation[2][2]

    def depth_inside_mm(self, own_height_mm: Any) -> Any:
        """Return how deep inside the object each line is at that height, negative below the underside."""
        z = self.z_mm(own_height_mm)
        own = [
            self.rotation[0][axis] * self.x_mm + self.rotation[1][axis] * self.y_mm + self.rotation[2][axis] * z
            for axis in (0, 1)
        ]
        return own_height_mm - self.indenter.underside_mm(*own)


@dataclass
class _EntryBracket:
    """Two heights, below and inside the object, between which each line enters it, and the depth inside at both."""

    below_mm: Any
    inside_mm: Any
    below_depth_mm: Any
    inside_depth_mm: Any
    found: Any
    """Whether a height inside the object was found."""

    def narrow(self, xp: Any, height_mm: Any, depth_mm: Any, where: Any) -> None:
        """Replace one end of the bracket by another height of these lines."""
        inside = where & (depth_mm >= 0)
        below = where & ~inside
        self.inside_mm = xp.where(inside, height_mm, self.inside_mm)
        self.inside_depth_mm = xp.where(inside, depth_mm, self.inside_depth_mm)
        self.below_mm = xp.where(below, height_mm, self.below_mm)
        self.below_depth_mm = xp.where(below, depth_mm, self.below_depth_mm)
        self.found = self.found | inside

    @property
    def secant_mm(self) -> Any:
        """The height at which a straight line through both ends enters the object."""
        part = self.below_depth_mm / (self.below_depth_mm - self.inside_depth_mm)
        return self.below_mm + part * (self.inside_mm - self.below_mm)


def _tilted_underside_mm(indenter: Indenter, pose: Pose, x_mm: Heights, y_mm: Heights) -> PosedHeights:
    """Return the height over the skin of a tilted underside: where a vertical line first enters the object.

    The object is searched from its own plane upwards until a line is inside; secants and bisections narrow the
    interval in which it entered. This finds one entry at walls, overhangs and edges, where a fixed-point iteration would oscillate.
    Lines beside the object are not searched.
    """
    if not np.all(np.abs(pose.tilt_x_rad) + np.abs(pose.tilt_y_rad) < MAX_TILT_RAD):
        raise InputError(
            expected=f"tilts of at most {MAX_TILT_RAD:g} rad together",
            got=f"{pose.tilt_x_rad} and {pose.tilt_y_rad} rad",
            remedy="turn the object itself, so that another side faces the skin",
        )
    rotation = [[expand_over_grid(pose.rotation[..., row, col], x_mm) for col in range(3)] for row in range(3)]
    x, y = x_mm - expand_over_grid(pose.x_mm, x_mm), y_mm - expand_over_grid(pose.y_mm, y_mm)
    near = _lines_near_object(indenter, pose, x, y)
    lines = _VerticalLines(indenter, rotation, x[near], y[near])
    bracket = _bracket_first_entry(lines, np.hypot(*pose.rotation[..., 2, :2].T) / pose.rotation[..., 2, 2])
    xp = array_namespace(x_mm)
    for _ in range(_TILT_HALVINGS):
        for height in (bracket.secant_mm, (bracket.below_mm + bracket.inside_mm) / 2):
            bracket.narrow(xp, height, lines.depth_inside_mm(height), bracket.found)
    entry = xp.zeros_like(x) + (NO_OBJECT_MM - expand_over_grid(pose.depth_mm, x_mm))
    found = xp.where(bracket.found, lines.z_mm(bracket.secant_mm), NO_OBJECT_MM)
    entry[near] = found - expand_over_grid(pose.depth_mm, x_mm)
    return entry


def _lines_near_object(indenter: Indenter, pose: Pose, x_mm: Heights, y_mm: Heights) -> Any:
    """Return the index of the rectangle of vertical lines that may meet the object under any pose of a batch.

    x_mm, y_mm: positions of the lines from the object's origin.
    """
    ends = np.stack(np.meshgrid(*((-half, half) for half in indenter.half_size_mm), (0.0, _TILT_REACH_MM)))
    across = pose.rotation[..., :2, :] @ ends.reshape(3, -1)
    near = (x_mm >= across[..., 0, :].min()) & (x_mm <= across[..., 0, :].max())
    near = near & (y_mm >= across[..., 1, :].min()) & (y_mm <= across[..., 1, :].max())
    near = to_numpy(array_namespace(near).any(near, axis=tuple(range(near.ndim - 2)))) > 0
    sides = (np.flatnonzero(near.any(axis=axis)) for axis in (1, 0))
    return (..., *(slice(int(side[0]), int(side[-1]) + 1) if len(side) else slice(0, 1) for side in sides))


def _bracket_first_entry(lines: _VerticalLines, slope: ScalarPerContact) -> _EntryBracket:
    """Return the lowest interval of search heights in which each line enters the object.

    Search heights are closest near the object's plane. In a batch each object has as many as it would have alone; its last one is
    repeated while other objects have more.
    """
    xp, zero = array_namespace(lines.x_mm), lines.x_mm * 0
    bracket = _EntryBracket(zero, zero, zero - 1, zero + 1, zero > 0)
    for part in _search_height_fractions(slope):
        height = zero + expand_over_grid(_TILT_REACH_MM * part**2, zero)
        bracket.narrow(xp, height, lines.depth_inside_mm(height), ~bracket.found)
    return bracket


def _search_height_fractions(slope: ScalarPerContact) -> Float[Array, "heights ..."]:
    """Return the search heights as fractions, 0 to 1, of the search reach; one repeated for objects that need fewer."""
    counts = np.floor(2 * _TILT_REACH_MM * np.asarray(slope) / _TILT_DRIFT_MM) + 3
    numbers = np.arange(np.max(counts)).reshape(-1, *[1] * counts.ndim)
    return np.minimum(numbers / (counts - 1), 1.0)


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
