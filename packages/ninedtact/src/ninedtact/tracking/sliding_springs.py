"""Springs with sliders that stand for a contact: each sticks until it bears its part of what friction holds, then slides (Iwan
1966, docs/references.md).

For a ball they are distributed so that the springs together follow Mindlin's law; reversal, repeated slip and a falling load need
no further rule. Friction, stiffness and the shape of the contact are unknown: the model runs for all values of a grid, each
weighted by how well it predicts the tangential load.
"""

from dataclasses import dataclass, field
from functools import cache

import numpy as np
from jaxtyping import Float, Float32
from numpy import ndarray as Array

_FRICTION = np.geomspace(0.05, 3.0, 48)
"""Friction coefficients that are tried."""
_FRICTION_PRIOR, _FRICTION_PRIOR_WIDTH = 0.5, 0.9
"""Median of the friction of things that nothing is known of, and the standard deviation of its logarithm."""
_STIFFNESS = np.geomspace(0.75, 4.0, 16)
"""Stiffnesses that are tried, over the ratio of load and displacement when both are first seen."""
_STIFFNESS_PRIOR, _STIFFNESS_PRIOR_WIDTH = 1.05, 0.2
"""Median of this ratio's factor, and the standard deviation of its logarithm: most contacts stick at first."""
_FIRST_SLIDE = np.array([0.0, 0.3, 0.6])
"""Displacement at which the rim begins to slide, over that at which everything does: of a ball, and of flatter faces."""
_SPRINGS = 12
_SEEN_STDS, _UNSEEN_STDS = 5.0, 2.0
"""Standard deviations of displacement and load from which both are seen, so that their ratio is known; and below which not."""
_SLID_STDS = 15.0
"""Standard deviations of displacement under an unchanged load from which the object slid from the beginning."""
_STEADY = 0.1
"""Relative change of the normal load within which the ratio is taken."""
_MODEL_ERROR = 0.025
"""Error of the predicted tangential load, over the normal load."""
_KNOWN_FRICTION_WIDTH, _DOUBT = 0.15, 4.0
"""Standard deviation of the logarithm of a known friction, and how unlikely (logarithm) another one is in the next contact."""
_CORRELATED_IMAGES = 3.0
"""Number of images whose errors are alike."""
_MEMORY_IMAGES = 180.0
"""Number of images with motion after which most of what the weights learnt is forgotten: friction changes from place to place."""
_RELAXATION_S, _RELAX_EVERY_S = 20.0, 0.2
"""Time in which the springs follow a load that the model does not explain, as creep of the gel; and how often they do. A gap in
time counts as the second."""
_PLAY_STDS = 1.5
"""Standard deviations by which displacement and load must change before the springs do, so that noise moves nothing."""
_AT_LIMIT = 0.97
"""Part of the limit of a slider from which it slides."""


@dataclass(frozen=True)
class SlipSample:
    """The numbers of one image of a contact; not numbers where nothing is known."""

    time_s: float
    displacement: Float[Array, "2"]
    """How far the object is displaced in the plane of the camera's image, from any origin, in mm or any one unit of length."""
    tangential: Float[Array, "2"]
    """Load that the object applies along the skin, in N or any one unit that is proportional to force."""
    normal: float
    """Load across the skin in the same unit, positive under pressure; zero where nothing touches."""
    displacement_std: float = float("nan")
    """Standard deviation of the error that changes from image to image; not a number where `slip_of_sequence` finds it."""
    load_std: float = float("nan")
    """The same of the loads: a factor common to all of them does not matter."""
    overread: float = 1.0
    """`normal` over what it is if the whole contact slides."""

    @property
    def is_known(self) -> bool:
        """Whether all numbers are known."""
        numbers = (self.time_s, *self.displacement, self.displacement_std, *self.tangential, self.normal, self.load_std)
        return bool(np.isfinite(numbers).all())


@cache
def _spring_shares() -> tuple[Float32[Array, "shapes springs"], Float32[Array, "shapes springs"]]:
    """Return the share of the area and of the limit of every spring; all have the same stiffness.

    Where the part c² of the area of a ball sticks, the part c of its stiffness is left, and it has moved by the part 1 − c² of what
    it moves before everything slides (Johnson, Contact Mechanics, 1985, §7.2).
    """
    edges = np.linspace(1, 0, _SPRINGS + 1) ** 2
    area = edges[:-1] - edges[1:]
    slides_at = 1 - (edges[:-1] + edges[1:]) / 2
    slides_at = _FIRST_SLIDE[:, None] + (1 - _FIRST_SLIDE[:, None]) * slides_at
    limit = slides_at / slides_at.sum(axis=1, keepdims=True)
    return np.broadcast_to(area, limit.shape).astype(np.float32), limit.astype(np.float32)


def later_start(start: SlipSample, now: SlipSample) -> SlipSample:
    """Return from which sample to count: from now while the contact grows, or moves without a load that holds it."""
    grows = abs(now.normal - start.normal) > _STEADY * now.normal
    change, load = (float(np.linalg.norm(one)) for one in (now.tangential - start.tangential, now.tangential))
    is_free = load < max(_SEEN_STDS * now.load_std, _FRICTION[0] * now.normal)
    return now if grows or (is_free and change < _UNSEEN_STDS * now.load_std) else start


def springs_if_seen(start: SlipSample, now: SlipSample, friction: float) -> "SlidingSprings | None":
    """Return the springs once displacement and load have both changed, so that their ratio is known; None before.

    friction: coefficient that is known of the object; not a number where none is.
    """
    moved, change = now.displacement - start.displacement, now.tangential - start.tangential
    distance, load = float(np.linalg.norm(moved)), float(np.linalg.norm(change))
    if distance > _SLID_STDS * now.displacement_std and load < _UNSEEN_STDS * now.load_std:
        load = float(np.linalg.norm(now.tangential))  # it slid from the beginning
    if distance < _SEEN_STDS * now.displacement_std or load < _SEEN_STDS * now.load_std:
        return None
    stiffness_log_prior = -0.5 * (np.log(_STIFFNESS / _STIFFNESS_PRIOR) / _STIFFNESS_PRIOR_WIDTH) ** 2
    log_prior = friction_log_prior(_FRICTION, friction)
    if np.isfinite(friction):
        log_prior = np.logaddexp(log_prior, -_DOUBT)
    springs = SlidingSprings(load / distance * _STIFFNESS, start, stiffness_log_prior[:, None] + log_prior)
    springs.load(now, 0.0)
    return springs


def friction_log_prior(coefficients: Float[Array, " frictions"], friction: float) -> Float[Array, " frictions"]:
    """Return the logarithm of how likely coefficients are.

    friction: coefficient that is known of the object; not a number where none is.
    """
    known = np.isfinite(friction)
    median, width = (friction, _KNOWN_FRICTION_WIDTH) if known else (_FRICTION_PRIOR, _FRICTION_PRIOR_WIDTH)
    return -0.5 * np.asarray(np.log(coefficients / median) / width) ** 2


def load_variance(normal: float, load_std: float = 0.0) -> float:
    """Return the variance of a tangential load about what a model predicts."""
    return _CORRELATED_IMAGES * (load_std**2 + (_MODEL_ERROR * normal) ** 2)


@dataclass
class SlidingSprings:
    """Springs with sliders for every shape of contact, stiffness and friction of the grid."""

    stiffnesses: Float[Array, " stiffnesses"]
    start: SlipSample
    log_prior: Float[Array, "stiffnesses frictions"]
    at: Float[Array, "2"] = field(init=False)
    """Displacement up to which the springs have been loaded."""
    normal: float = field(init=False)
    """Normal load for which their limits hold."""
    slack: float = field(default=0.0, init=False)
    """By how much it may be too large, as a part of it."""
    weight: Float[Array, "shapes stiffnesses frictions"] = field(init=False)
    share: Float[Array, "shapes stiffnesses frictions"] = field(init=False)
    """Share of the area whose springs are below the limits of their sliders."""
    force: Float32[Array, "2 shapes stiffnesses frictions springs"] = field(init=False)
    _log_weight: Float[Array, "shapes stiffnesses frictions"] = field(init=False)
    _unrelaxed_s: float = field(default=0.0, init=False)

    def __post_init__(self) -> None:
        shape = len(_FIRST_SLIDE), len(_STIFFNESS), len(_FRICTION)
        self.at, self.normal = self.start.displacement, self.start.normal
        force = (self.start.tangential / _SPRINGS).astype(np.float32)
        self.force = np.broadcast_to(force[:, None, None, None, None], (2, *shape, _SPRINGS)).copy()
        self._prior = np.broadcast_to(self.log_prior, shape)
        self._log_weight = self._prior.copy()
        self._slide()
        self._set_weight()

    @property
    def stiffness(self) -> float:
        """Weighted mean of the stiffness."""
        return float(self.weight.sum(axis=(0, 2)) @ self.stiffnesses)

    def load(self, sample: SlipSample, after_s: float) -> None:
        """Stretch the springs to a displacement, let them slide, and compare their sum with the tangential load."""
        step, normal = self._step_with_play(sample), self._normal_with_play(sample)
        self.slack = min(_PLAY_STDS * sample.load_std / sample.normal, 1.0)
        has_changed, self.normal = bool(step.any()) or normal != self.normal, normal
        self._unrelaxed_s += after_s
        if not has_changed and self._unrelaxed_s < _RELAX_EVERY_S:
            return
        rate = (self.stiffnesses / _SPRINGS).astype(np.float32)[:, None, None]
        for force, along in zip(self.force, step, strict=True):
            force += rate * np.float32(along)
        self._slide()
        error = sample.tangential[:, None, None, None] - self.force.sum(axis=-1)
        if has_changed:
            variance = load_variance(sample.normal, sample.load_std)
            kept = np.exp(-1 / _MEMORY_IMAGES)
            likelihood = -0.5 * (error**2).sum(axis=0) / variance
            self._log_weight = kept * self._log_weight + (1 - kept) * self._prior + likelihood
            self._set_weight()
        followed = 1 - np.exp(-min(self._unrelaxed_s, _RELAX_EVERY_S) / _RELAXATION_S)
        self._unrelaxed_s = 0.0
        self.force += (followed * error / _SPRINGS).astype(np.float32)[..., None]
        self._slide()

    def _step_with_play(self, sample: SlipSample) -> Float[Array, "2"]:
        """Return the step of displacement beyond its noise."""
        behind = sample.displacement - self.at
        distance, play = float(np.linalg.norm(behind)), _PLAY_STDS * sample.displacement_std
        step = behind * max(1 - play / distance, 0.0) if distance > 0 else np.zeros(2)
        self.at = self.at + step
        return step

    def _normal_with_play(self, sample: SlipSample) -> float:
        """Return the normal load, changed only beyond its noise."""
        play = _PLAY_STDS * sample.load_std
        return float(np.clip(self.normal, sample.normal - play, sample.normal + play))

    def _slide(self) -> None:
        """Shorten every spring to the limit of its slider, and find out which sticks."""
        area, limit = _spring_shares()
        limit = limit[:, None, None] * (_FRICTION * self.normal).astype(np.float32)[:, None]
        length = np.hypot(*self.force)
        self.force *= np.minimum(1, limit / np.maximum(length, np.float32(1e-12)))
        self.share = ((length < (_AT_LIMIT - self.slack) * limit) * area[:, None, None]).sum(axis=-1)

    def _set_weight(self) -> None:
        weight = np.exp(self._log_weight - self._log_weight.max())
        self.weight = weight / weight.sum()
