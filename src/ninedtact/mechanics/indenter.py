"""What touches the skin: a rigid underside over the skin's plane.

An indenter gives the height of its underside in its own frame; a pose puts it over the skin. Only what looks down
matters: under an overhang the lowest surface is the underside.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np
from array_api_compat import array_namespace
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact.errors import InputError
from ninedtact.mechanics.batching import ScalarPerContact, expand_over_grid
from ninedtact.mechanics.pose import Pose

Heights = Float[Any, "*batch rows cols"]
PosedHeights = Float[Any, "*posed rows cols"]
"""Heights under a pose, or under each of a batch of poses."""

NO_OBJECT_MM = 50.0
"""Height of the underside where there is no object."""
_TILT_REACH_MM = 8.0
"""Of a tilted underside, what is higher than this over its own plane counts as nothing: no skin yields so far."""
_TILT_DRIFT_MM = 0.3
"""How far a vertical line may move sideways in the frame of a tilted object between two layers that are looked at."""
_TILT_HALVINGS = 3
"""Of the stretch between two layers, each after a secant: exact for smooth undersides, near enough for walls."""
MAX_TILT_RAD = 1.0


class TiltTooSteep(InputError):
    """An underside can no longer be told from a side."""


class Indenter(ABC):
    """A rigid object over the skin."""

    name: str
    """What to call it; also its id in a data set."""

    @abstractmethod
    def underside_mm(self, x_mm: Heights, y_mm: Heights) -> Heights:
        """Height of the underside over the object's own plane z = 0, which its lowest point touches."""

    def over_skin_mm(self, pose: Pose, x_mm: Heights, y_mm: Heights) -> PosedHeights:
        """Height of the posed underside over the untouched skin at these places, negative where it is pressed in.

        Exact without tilt; with it, see `_tilted_underside_mm`. Raises `TiltTooSteep`.
        """
        if pose.level:
            return self.underside_mm(*_to_object_frame(pose, x_mm, y_mm)) - expand_over_grid(pose.depth_mm, x_mm)
        return _tilted_underside_mm(self, pose, x_mm, y_mm)


def _to_object_frame(pose: Pose, x_mm: Heights, y_mm: Heights) -> tuple[PosedHeights, PosedHeights]:
    """Places of the skin in the frame of an object without tilt."""
    x, y = x_mm - expand_over_grid(pose.x_mm, x_mm), y_mm - expand_over_grid(pose.y_mm, y_mm)
    cos, sin = expand_over_grid(np.cos(pose.twist_rad), x), expand_over_grid(np.sin(pose.twist_rad), x)
    return cos * x + sin * y, cos * y - sin * x


@dataclass(frozen=True)
class _VerticalLines:
    """The vertical lines through places of the skin, in the frame of a tilted object."""

    indenter: Indenter
    turn: list[list[Any]]
    """Rotation of the object; of each in a batch."""
    x_mm: Any
    y_mm: Any

    def z_mm(self, own_height_mm: Any) -> Any:
        """Where they reach a height over the object's own plane, from its origin."""
        return (own_height_mm - self.turn[0][2] * self.x_mm - self.turn[1][2] * self.y_mm) / self.turn[2][2]

    def excess_mm(self, own_height_mm: Any) -> Any:
        """How deep inside the object they are at that height, negative below its underside."""
        z = self.z_mm(own_height_mm)
        own = [
            self.turn[0][axis] * self.x_mm + self.turn[1][axis] * self.y_mm + self.turn[2][axis] * z for axis in (0, 1)
        ]
        return own_height_mm - self.indenter.underside_mm(*own)


@dataclass
class _EntryBracket:
    """Heights below and inside the object, between which each line enters it, and how deep inside both are."""

    below_mm: Any
    inside_mm: Any
    below_excess_mm: Any
    inside_excess_mm: Any
    found: Any

    def take(self, xp: Any, height_mm: Any, excess_mm: Any, where: Any) -> None:
        """Look at another height of these lines."""
        inside = where & (excess_mm >= 0)
        below = where & ~inside
        self.inside_mm = xp.where(inside, height_mm, self.inside_mm)
        self.inside_excess_mm = xp.where(inside, excess_mm, self.inside_excess_mm)
        self.below_mm = xp.where(below, height_mm, self.below_mm)
        self.below_excess_mm = xp.where(below, excess_mm, self.below_excess_mm)
        self.found = self.found | inside

    @property
    def secant_mm(self) -> Any:
        """Where a straight line through both would enter."""
        part = self.below_excess_mm / (self.below_excess_mm - self.inside_excess_mm)
        return self.below_mm + part * (self.inside_mm - self.below_mm)


def _tilted_underside_mm(indenter: Indenter, pose: Pose, x_mm: Heights, y_mm: Heights) -> PosedHeights:
    """Height over the skin of a tilted underside: where a vertical line first enters the object.

    Layers of the object are looked at from its own plane upwards until a line is inside; secants and halvings narrow the
    stretch where it entered. Walls, overhangs and edges have one such place, where a fixed point would jump to and fro.
    """
    if not np.all(np.abs(pose.tilt_x_rad) + np.abs(pose.tilt_y_rad) < MAX_TILT_RAD):
        raise TiltTooSteep(
            f"expected tilts of at most {MAX_TILT_RAD:g} rad together, got {pose.tilt_x_rad} and "
            f"{pose.tilt_y_rad} rad; turn the object itself, so that another side faces the skin"
        )
    turn = [[expand_over_grid(pose.rotation[..., row, col], x_mm) for col in range(3)] for row in range(3)]
    lines = _VerticalLines(
        indenter, turn, x_mm - expand_over_grid(pose.x_mm, x_mm), y_mm - expand_over_grid(pose.y_mm, y_mm)
    )
    bracket = _bracket_first_entry(lines, np.hypot(*pose.rotation[..., 2, :2].T) / pose.rotation[..., 2, 2])
    xp = array_namespace(x_mm)
    for _ in range(_TILT_HALVINGS):
        for height in (bracket.secant_mm, (bracket.below_mm + bracket.inside_mm) / 2):
            bracket.take(xp, height, lines.excess_mm(height), bracket.found)
    return xp.where(bracket.found, lines.z_mm(bracket.secant_mm), NO_OBJECT_MM) - expand_over_grid(pose.depth_mm, x_mm)


def _bracket_first_entry(lines: _VerticalLines, slope: ScalarPerContact) -> _EntryBracket:
    """The lowest layer of the object in which each line is inside it; layers are closest near the object's plane.

    In a batch each object has as many as it would have alone; the last one is looked at again while others have more.
    """
    xp, zero = array_namespace(lines.x_mm), lines.x_mm * 0
    bracket = _EntryBracket(zero, zero, zero - 1, zero + 1, zero > 0)
    for part in _search_height_fractions(slope):
        height = zero + expand_over_grid(_TILT_REACH_MM * part**2, zero)
        bracket.take(xp, height, lines.excess_mm(height), ~bracket.found)
    return bracket


def _search_height_fractions(slope: ScalarPerContact) -> Float[Array, "layers ..."]:
    """Parts of the reach, from zero to one, in as many layers as each object has, and one for the rest."""
    counts = [int(2 * _TILT_REACH_MM * one / _TILT_DRIFT_MM) + 3 for one in np.ravel(slope).tolist()]
    each = [np.append(np.linspace(0, 1, count), np.ones(max(counts) - count)) for count in counts]
    return np.stack(each, axis=-1).reshape(-1, *np.shape(slope))
