"""The tractions that explain an observation best: Gauss and Newton over the law of light, each round solved outright.

Minimised: ‖(seen − predicted)/σ‖² + ‖pressure‖² and ‖shear modes‖² in the measure of what is known of presses (`prior`),
with pressure nowhere negative, and both zero where the skin is not pressed in. σ is no choice: it is the noise of this
image and the error of this sensor's calibration, or what the best explanation leaves, where that is more (discrepancy
principle; docs/force_physics.md has the sources).
"""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from jaxtyping import Float32
from numpy import ndarray as Array

from ninedtact.force.traction.brightness import BrightnessLaw
from ninedtact.force.traction.explained import Effort, Explained, Guess
from ninedtact.force.traction.forward import Forward, Skin
from ninedtact.force.traction.kernels import Kernels
from ninedtact.force.traction.linearised import Linearised
from ninedtact.force.traction.observation import Observation
from ninedtact.force.traction.pivoting import lowest
from ninedtact.force.traction.prior import Prior, ShearModes
from ninedtact.force.traction.weigh import Weigh

View = Float32[Array, "rows cols"]

WINKLER_PER_MM = 3.9
"""Pressure over indentation in the middle of presses: the first guess."""
SHALLOWEST_MM = 0.02
"""Indentation below which the prior of pressure is not narrowed any more."""
LEVEL = 0.003
"""Standard deviation of the light that the whole image has more or less than it should, relative."""


@dataclass(frozen=True)
class Inversion:
    """One sensor's, ready for any number of observations."""

    forward: Forward
    law: BrightnessLaw
    prior: Prior = Prior()
    effort: Effort = Effort()

    @cached_property
    def modes(self) -> ShearModes:
        """Smooth ratios of shear to pressure."""
        return ShearModes(self.forward.cells, self.prior)

    @cached_property
    def kernels(self) -> Kernels:
        """What each cell does to the others."""
        return Kernels(self.forward, self.prior)

    def explain(self, seen: Observation, touched: View, last: Explained | None = None) -> Explained:
        """The tractions under this touch; the last answer, where it follows on, makes it quicker."""
        rounds = self.effort.rounds if last is None else self.effort.warm_rounds
        now = self.begun(seen, touched) if last is None else Guess(last.tractions, last.skin_mm, last.misfit)
        found = self.further(seen, touched, now)
        while found.rounds < rounds and found.off > self.effort.enough:
            found = self.further(seen, touched, found)
        return found

    def begun(self, seen: Observation, touched: View) -> Guess:
        """From the heights as they were read."""
        tractions = np.zeros((3, *touched.shape), np.float32)
        tractions[0] = np.maximum(-seen.z_mm, 0) * touched * np.float32(WINKLER_PER_MM)
        return Guess(tractions, self.around(seen.z_mm))

    def further(self, seen: Observation, touched: View, now: Guess | Explained) -> Explained:
        """One round."""
        line = self.linearised(seen, touched, now)
        flat = self.law(now.skin_mm) - line.slope * now.skin_mm
        problem = line.quadratic(seen.change - self.forward.scattered(flat))
        found = lowest(problem, line.free(now.tractions[0]), self.effort.solves)
        tractions = line.tractions(found.at)
        skin = self.forward.heights(tractions)
        bent = self.forward.scattered(self.law(skin) - flat - line.slope * skin)
        off = line.off(found, bent) if found.settled else np.inf
        return Explained(tractions, skin, line, found, self.misfit(seen, skin), off, now.rounds + 1)

    def linearised(self, seen: Observation, touched: View, now: Guess | Explained) -> Linearised:
        """About the skin as it is guessed."""
        depth_mm = max(float(np.sqrt((seen.z_mm[touched > 0] ** 2).mean())), SHALLOWEST_MM)
        slope, weigh = self.law.slope_per_mm(now.skin_mm), weighing(seen, now.misfit)
        carries = self.carrying(now.tractions[0], touched)
        return Linearised(self.kernels, self.modes, touched, carries, slope, weigh, depth_mm)

    def carrying(self, pressure: View, touched: View) -> View:
        """Smoothed pressure."""
        width_px = self.prior.smooth_mm / self.forward.cells.pitch_mm
        return np.asarray(cv2.GaussianBlur(pressure * touched, (0, 0), width_px) * touched)

    def misfit(self, seen: Observation, skin_mm: Skin) -> float:
        """What is left over its standard deviation, root mean square; at least one."""
        rest = seen.change - self.forward.scattered(self.law(skin_mm))
        weigh = weighing(seen, 1.0)
        square = float(np.vdot(rest, weigh(rest)))
        return float(np.sqrt(max(square / max(float(seen.in_view.sum()), 1.0), 1.0)))

    def around(self, z_mm: View) -> Skin:
        """Heights of the view, and beyond it those of its border."""
        cells = self.forward.cells
        row, col = (np.clip(cells.offsets(axis), 0, side - 1).astype(int) for axis, side in enumerate(cells.shape))
        return z_mm[np.ix_(row, col)]


def weighing(seen: Observation, misfit: float) -> Weigh:
    """Noise and the calibration's error together, raised to what was left."""
    error = np.sqrt(seen.error**2 + np.float32(seen.noise**2)) * np.float32(misfit)
    return Weigh(seen.in_view / error, LEVEL)
