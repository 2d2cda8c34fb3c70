"""A scripted press: one quasi-static press of an object on a twin, down to a depth or a load, then dragged and twisted."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ninedtact.errors import InputError
from ninedtact.mechanics.alternating_solver import SolverSettings
from ninedtact.mechanics.contact_result import Contact
from ninedtact.mechanics.indenter import Indenter
from ninedtact.mechanics.pose import Pose
from ninedtact.simulation.twin import Twin

DOWN_MM, ALONG_MM, ROUND_RAD = 0.5, 0.3, np.radians(4.0)
"""The longest steps of depth, drag and twist. Friction depends on the path, so steps must be small."""
PRESS_SOLVER_SETTINGS = SolverSettings(tolerance=2e-3)


class InvalidPress(InputError):
    """Raised for a press without a positive depth or load, or one that does not stay within the gel."""


@dataclass(frozen=True)
class ScriptedPress:
    """A press to a depth or to a load at a position, followed by a drag and a twist at that depth or load."""

    depth_mm: float | None = None
    load_n: float | None = None
    at_mm: tuple[float, float] = (0.0, 0.0)
    """Position of the first contact, x and y."""
    drag_mm: tuple[float, float] = (0.0, 0.0)
    twist_rad: float = 0.0
    tilt_rad: tuple[float, float] = (0.0, 0.0)
    """Tilts about x and y, which the object has from the beginning."""

    def __post_init__(self) -> None:
        if (self.depth_mm is None) == (self.load_n is None):
            got = "both" if self.depth_mm is not None else "neither"
            raise InvalidPress(f"expected a depth or a load, got {got}; give one of them")
        wanted, unit = (self.depth_mm, "mm deep") if self.load_n is None else (self.load_n, "N")
        if not 0 < (wanted or 0.0) < np.inf:
            raise InvalidPress(f"expected a press above zero, got {wanted:g} {unit}; press the skin")

    def poses(self) -> Iterator[Pose]:
        """Yield all poses; those of a press to a load have depth zero, which `simulate` replaces."""
        depth = self.depth_mm or 0.0
        pressed = Pose(*self.at_mm, depth, 0.0, *self.tilt_rad)
        for number in range(1, _step_count(depth, DOWN_MM) + 1):
            yield replace(pressed, depth_mm=depth * number / _step_count(depth, DOWN_MM))
        (x, y), (along_x, along_y) = self.at_mm, self.drag_mm
        dragged = Pose(x + along_x, y + along_y, depth, self.twist_rad, *self.tilt_rad)
        # Drag and twist happen at the same time, as in a press by hand.
        many = max(_step_count(float(np.hypot(*self.drag_mm)), ALONG_MM), _step_count(abs(self.twist_rad), ROUND_RAD))
        if dragged != pressed:
            yield from (pressed.interpolate(dragged, number / many) for number in range(1, many + 1))

    def simulate(
        self, twin: Twin, indenter: Indenter, solver_settings: SolverSettings | None = PRESS_SOLVER_SETTINGS
    ) -> Contact:
        """Return the contact at the end of the press; raises `InvalidPress` and what `Twin.step` raises.

        solver_settings: None keeps those of the twin.
        """
        self._require_within_gel(twin)
        twin = twin if solver_settings is None else replace(twin, solver_settings=solver_settings)
        contact = twin.model.initial_contact()
        for pose in self.poses():
            deeper = pose if self.load_n is None else replace(pose, depth_mm=contact.pose.depth_mm)
            contact = twin.step(contact, indenter, deeper, self.load_n)
        return twin.correct_contact(contact)

    def _require_within_gel(self, twin: Twin) -> None:
        """Refuse a depth at which the object would go through the gel; raises `InvalidPress`."""
        if self.depth_mm is not None and self.depth_mm >= twin.thickness_mm:
            raise InvalidPress(
                f"expected a press less deep than the gel is thick, {twin.thickness_mm:g} mm, got {self.depth_mm:g} mm; press less"
            )


def _step_count(distance: float, longest: float) -> int:
    """Return the number of equal steps that are no longer than the longest."""
    return max(int(np.ceil(distance / longest - 1e-9)), 1)
