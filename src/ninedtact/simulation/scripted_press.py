"""One press of an object, from above the skin to where it ends: down, then dragged and twisted."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ninedtact.errors import NinedtactError
from ninedtact.mechanics.alternating_solver import SolverSettings
from ninedtact.mechanics.contact import Contact
from ninedtact.mechanics.indenter import Indenter
from ninedtact.mechanics.pose import Pose
from ninedtact.simulation.twin import Twin

DOWN_MM, ALONG_MM, ROUND_RAD = 0.5, 0.3, np.radians(4.0)
"""The longest steps: friction remembers the way, so it matters."""
PRESS_SOLVER_SETTINGS = SolverSettings(tolerance=2e-3)


class InvalidPress(NinedtactError):
    """A press that says nothing, or two things, about how hard."""


@dataclass(frozen=True)
class ScriptedPress:
    """How an object is pressed: to a depth or to a load, at a place; then dragged and twisted as deep or as hard."""

    depth_mm: float | None = None
    load_n: float | None = None
    at_mm: tuple[float, float] = (0.0, 0.0)
    """Where it first touches."""
    drag_mm: tuple[float, float] = (0.0, 0.0)
    twist_rad: float = 0.0
    tilt_rad: tuple[float, float] = (0.0, 0.0)
    """About x and y, from before it touches."""

    def __post_init__(self) -> None:
        if (self.depth_mm is None) == (self.load_n is None):
            got = "both" if self.depth_mm is not None else "neither"
            raise InvalidPress(f"expected a depth or a load, got {got}; give one of them")
        wanted, unit = (self.depth_mm, "mm deep") if self.load_n is None else (self.load_n, "N")
        if not 0 < (wanted or 0.0) < np.inf:
            raise InvalidPress(f"expected a press above zero, got {wanted:g} {unit}; press the skin")

    def poses(self) -> Iterator[Pose]:
        """The way, as deep as is known beforehand."""
        depth = self.depth_mm or 0.0
        pressed = Pose(*self.at_mm, depth, 0.0, *self.tilt_rad)
        for number in range(1, _step_count(depth, DOWN_MM) + 1):
            yield replace(pressed, depth_mm=depth * number / _step_count(depth, DOWN_MM))
        (x, y), (along_x, along_y) = self.at_mm, self.drag_mm
        dragged = Pose(x + along_x, y + along_y, depth, self.twist_rad, *self.tilt_rad)
        # Dragged and twisted at once, as a hand does.
        many = max(_step_count(float(np.hypot(*self.drag_mm)), ALONG_MM), _step_count(abs(self.twist_rad), ROUND_RAD))
        if dragged != pressed:
            yield from (pressed.towards(dragged, number / many) for number in range(1, many + 1))

    def on(self, twin: Twin, indenter: Indenter, effort: SolverSettings | None = PRESS_SOLVER_SETTINGS) -> Contact:
        """The contact at its end. effort: None leaves the twin's own. Raises what `Twin.step` raises."""
        self.require_above_base(twin)
        twin = twin if effort is None else replace(twin, effort=effort)
        contact = twin.model.untouched()
        for pose in self.poses():
            deeper = pose if self.load_n is None else replace(pose, depth_mm=contact.pose.depth_mm)
            contact = twin.step(contact, indenter, deeper, self.load_n)
        return twin.felt(contact)

    def require_above_base(self, twin: Twin) -> None:
        """Refuse a depth at which the object would reach through the gel."""
        if self.depth_mm is not None and self.depth_mm >= twin.thickness_mm:
            raise InvalidPress(
                f"expected a press less deep than the gel is thick, {twin.thickness_mm:g} mm, got {self.depth_mm:g} mm; press less"
            )


def _step_count(way: float, longest: float) -> int:
    """In how many equal steps to go."""
    return max(int(np.ceil(way / longest - 1e-9)), 1)
