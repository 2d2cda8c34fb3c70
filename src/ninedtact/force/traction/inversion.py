"""The tractions that explain an observation best: Gauss and Newton over the law of light, conjugate gradients inside.

Minimised: ‖(seen − predicted)/σ‖² + ‖pressure‖² and ‖shear modes‖² in the measure of what is known of presses (`prior`),
with pressure nowhere negative, and both zero where the skin is not pressed in. σ is no choice: it is the noise of this
picture and the error of this sensor's calibration, or what the best explanation leaves, where that is more (discrepancy
principle; docs/force_physics.md has the sources).
"""

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from jaxtyping import Float32
from numpy import ndarray as Array

from ninedtact.force.traction.block_problem import block_problem
from ninedtact.force.traction.blocks import Blocks
from ninedtact.force.traction.brightness import BrightnessLaw
from ninedtact.force.traction.descent import Unknown, descended
from ninedtact.force.traction.forward import Forward, Skin, Tractions
from ninedtact.force.traction.linearised import Linearised
from ninedtact.force.traction.observation import Observation
from ninedtact.force.traction.prior import Prior, ShearModes, stiffness
from ninedtact.force.traction.weigh import Weigh

View = Float32[Array, "rows cols"]

WINKLER_PER_MM = 3.9
"""Pressure over indentation in the middle of presses: the first guess."""
SHALLOWEST_MM = 0.02
"""Indentation below which the prior of pressure is not narrowed any more."""
LEVEL = 0.003
"""Standard deviation of the light that the whole picture has more or less than it should, relative."""


@dataclass(frozen=True)
class Effort:
    """When the search ends."""

    rounds: int = 6
    """Of linearising, from a cold start."""
    warm_rounds: int = 1
    """The same where the last picture's answer is at hand."""
    iterations: int = 12
    """In each round."""
    warm_iterations: int = 9
    """The same where the last picture's answer is at hand."""
    enough: float = 0.3
    """Standard deviations of any sum of the unknowns by which an answer may be off for the search to end."""
    settled: float = 10.0
    """The same, for the answer to be believed: wrenches of answers that are off by as much differ by a fiftieth of their size."""


@dataclass(frozen=True)
class Explained:
    """The tractions that were found, over the shear modulus."""

    unknown: Unknown
    tractions: Tractions
    skin_mm: Skin
    """Height of all skin under them."""
    round: Linearised
    misfit: float
    """Root mean square of what is left, over its standard deviation; at least one."""
    iterations: int = 0
    off: float = 0.0
    """How far from the optimum, at most: standard deviations of any sum of the unknowns."""


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
    def blocks(self) -> Blocks:
        """The coarse problem's kernels."""
        return Blocks(self.forward, self.modes, self.prior)

    @cached_property
    def stiffness(self) -> Array:
        """Of the prior of pressure, for an indentation of 1 mm."""
        return stiffness(self.forward.wave, self.prior, self.forward.cells.pitch_mm)

    def explain(self, seen: Observation, touched: View, last: Explained | None = None) -> Explained:
        """The tractions under this touch; the last answer, where it follows on, makes it quicker."""
        effort = self.effort
        if last is not None:
            effort = replace(effort, rounds=effort.warm_rounds, iterations=effort.warm_iterations)
        now = self.begun(seen, touched) if last is None else self.begun_from(last, touched)
        found = self.further(seen, touched, now, effort)
        for _ in range(effort.rounds - 1):
            before, found = found.iterations, self.further(seen, touched, found, effort)
            if found.iterations <= before + 1 and found.off <= effort.enough:
                break
        return found

    def begun(self, seen: Observation, touched: View) -> "Guess":
        """From the heights as they were read."""
        pressure = np.maximum(-seen.z_mm, 0) * touched * np.float32(WINKLER_PER_MM)
        weights = np.zeros((2, self.modes.count), np.float32)
        return Guess(Unknown(pressure, weights), self.around(seen.z_mm), 1.0)

    def begun_from(self, last: Explained, touched: View) -> "Guess":
        """From the last answer."""
        return Guess(last.unknown.on(touched), last.skin_mm, last.misfit)

    def further(self, seen: Observation, touched: View, now: "Guess | Explained", effort: Effort) -> Explained:
        """One round."""
        line = self.linearised(seen, touched, now)
        flat = self.law(now.skin_mm) - line.slope * now.skin_mm
        problem = line.quadratic(seen.change - self.forward.scattered(flat))
        found = descended(problem, now.unknown, effort.iterations, effort.enough)
        tractions = line.tractions(found.at)
        skin = self.forward.heights(tractions)
        misfit = self.misfit(seen, skin)
        return Explained(found.at, tractions, skin, line, misfit, now.iterations + found.iterations, found.off)

    def linearised(self, seen: Observation, touched: View, now: "Guess | Explained") -> Linearised:
        """About the skin as it is guessed."""
        depth_mm = max(float(np.sqrt((seen.z_mm[touched > 0] ** 2).mean())), SHALLOWEST_MM)
        width_px = self.prior.smooth_mm / self.forward.cells.pitch_mm
        carries = cv2.GaussianBlur(now.unknown.pressure, (0, 0), width_px) * touched
        slope, weigh = self.law.slope_per_mm(now.skin_mm), weighing(seen, now.misfit)
        blocks = block_problem(self.blocks, touched, carries, self.blocks.of_skin(slope), weigh, depth_mm)
        stiff = self.stiffness / np.float32(depth_mm**2)
        return Linearised(self.forward, self.modes, stiff, touched, carries, slope, weigh, blocks)

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


@dataclass(frozen=True)
class Guess:
    """Where to begin."""

    unknown: Unknown
    skin_mm: Skin
    misfit: float
    iterations: int = 0


def weighing(seen: Observation, misfit: float) -> Weigh:
    """Noise and the calibration's error together, raised to what was left."""
    error = np.sqrt(seen.error**2 + np.float32(seen.noise**2)) * np.float32(misfit)
    return Weigh(seen.in_view / error, LEVEL)
