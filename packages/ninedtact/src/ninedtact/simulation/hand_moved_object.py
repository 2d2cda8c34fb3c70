"""An object that a person moves over a twin: to a depth or under a load, dragged, twisted and tilted.

A person states a target at any time; `SimulatedHand.step` moves the object towards it in steps that are small enough for friction,
which depends on the path. A step that mechanics refuse leaves the object where it was, or lifts it straight up where it is to
be lifted; `refusal` says why.
"""

from contextlib import suppress
from dataclasses import dataclass, replace
from threading import Lock

import numpy as np

from ninedtact.errors import NinedtactError
from ninedtact.mechanics.indenter import Indenter
from ninedtact.mechanics.pose import Pose
from ninedtact.simulation.press import Press
from ninedtact.simulation.trajectory import HOVER_MM
from ninedtact.simulation.twin import Twin

STEP_DEPTH_MM, STEP_DRAG_MM, STEP_TURN_RAD, STEP_LOAD_N = 0.3, 0.3, np.radians(4.0), 3.0
"""The longest changes of one step; those of a scripted press, and less in depth because the object may be dragged meanwhile."""
_LIGHTEST_N = 0.05
"""Load below which the object is lifted off."""


@dataclass(frozen=True)
class HandTarget:
    """Where a person holds the object."""

    pose: Pose = Pose(depth_mm=-HOVER_MM)
    """Position, twist and tilts; the depth where no load is given."""
    load_n: float | None = None
    """Load instead of a depth."""


class SimulatedHand:
    """A hand that takes an object, holds it at a target and moves it in steps; it may be set and read from different threads."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._indenter: Indenter | None = None
        self._target = HandTarget()
        self._grasps = 0
        self._refusal = ""

    @property
    def held_object(self) -> Indenter | None:
        """The object in the hand; None while the hand is empty."""
        with self._lock:
            return self._indenter

    @property
    def target(self) -> HandTarget:
        """Where the object is held."""
        with self._lock:
            return self._target

    @property
    def grasp(self) -> tuple[int, Indenter | None]:
        """Number of objects that were taken until now, and the one in the hand, of the same moment.

        A new object starts on undeformed skin.
        """
        with self._lock:
            return self._grasps, self._indenter

    @property
    def refusal(self) -> str:
        """Why the object does not go where it is held; empty where it does."""
        with self._lock:
            return self._refusal

    def take(self, indenter: Indenter) -> None:
        """Take an object into the hand, in place of the last one."""
        with self._lock:
            self._indenter, self._grasps, self._refusal = indenter, self._grasps + 1, ""

    def aim(self, target: HandTarget) -> None:
        """Hold the object somewhere else."""
        with self._lock:
            self._target = target

    def release(self) -> None:
        """Empty the hand."""
        with self._lock:
            self._indenter, self._refusal = None, ""

    def step(self, twin: Twin, last: Press, indenter: Indenter, after_s: float = 0.0) -> Press:
        """Return the press one step nearer to the target, after some time.

        Where the twin refuses that step, the object is lifted straight up if it is to be lifted, and otherwise stays as it was.
        """
        target, refusal = self.target, ""
        try:
            press = _step(twin, last, indenter, target, after_s)
        except NinedtactError as trouble:
            press, refusal = last, f"{trouble.got}; {trouble.remedy}"
        if refusal and target.load_n is None and target.pose.depth_mm < last.pose.depth_mm:
            with suppress(NinedtactError):
                upwards = HandTarget(replace(last.pose, depth_mm=target.pose.depth_mm))
                press = _step(twin, last, indenter, upwards, after_s)
        with self._lock:
            self._refusal = refusal
        return press

    def hover(self, twin: Twin, indenter: Indenter) -> Press:
        """Return undeformed skin with an object above it, at the place of the target."""
        return twin.hover(indenter, replace(self.target.pose, depth_mm=-HOVER_MM))


def _step(twin: Twin, last: Press, indenter: Indenter, target: HandTarget, after_s: float) -> Press:
    """Return the press one step nearer to a target; raises what `Twin.press` raises."""
    if target.load_n is None:
        return twin.press(last, indenter, _approach(last.pose, target.pose), after_s=after_s)
    lifted = replace(target.pose, depth_mm=-HOVER_MM)
    if target.load_n < _LIGHTEST_N:
        return twin.press(last, indenter, _approach(last.pose, lifted), after_s=after_s)
    return _step_to_load(twin, last, indenter, target.pose, target.load_n, after_s)


def _step_to_load(twin: Twin, last: Press, indenter: Indenter, wanted: Pose, load_n: float, after_s: float) -> Press:
    """Return the press under a load that is one step nearer to the wanted one; without contact the object comes down first."""
    if not last.touches:
        return twin.press(
            last, indenter, _approach(last.pose, replace(wanted, depth_mm=last.pose.depth_mm + STEP_DEPTH_MM))
        )
    next_n = last.load_n + float(np.clip(load_n - last.load_n, -STEP_LOAD_N, STEP_LOAD_N))
    pose = _approach(last.pose, replace(wanted, depth_mm=last.pose.depth_mm))
    return twin.press(last, indenter, pose, max(next_n, _LIGHTEST_N), after_s=after_s)


def _approach(last: Pose, wanted: Pose) -> Pose:
    """Return the pose one step nearer to the wanted one, in a straight line."""
    drag = np.hypot(wanted.x_mm - last.x_mm, wanted.y_mm - last.y_mm) / STEP_DRAG_MM
    angles = ("twist_rad", "tilt_x_rad", "tilt_y_rad")
    turn = max(abs(getattr(wanted, name) - getattr(last, name)) for name in angles) / STEP_TURN_RAD
    along = last.interpolate(wanted, 1 / max(drag, turn, 1.0))
    deeper = float(np.clip(wanted.depth_mm - last.depth_mm, -STEP_DEPTH_MM, STEP_DEPTH_MM))
    return replace(along, depth_mm=float(last.depth_mm) + deeper)
