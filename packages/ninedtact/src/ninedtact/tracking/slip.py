"""Slip of a contact from a few numbers of each image: how far the object has moved, and the loads along and across the skin.

While an object sticks it moves with the skin, and the tangential load grows with its displacement by the contact's tangential
stiffness. At the rim, where pressure is least, the object slides first, and the load grows less (Cattaneo 1938, Mindlin 1949;
docs/references.md). When everything slides, the displacement goes on and the load does not follow.

The contact is modelled as springs side by side, each with a slider (Iwan 1966), whose limits add up to friction times the normal
load. For a ball they are distributed so that the springs together follow Mindlin's law; reversal, repeated slip and a falling load
need no further rule. Friction, stiffness and the shape of the contact are unknown: the model runs for all values of a grid, each
weighted by how well it predicts the tangential load. The state is the weighted mean over the grid.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cache

import numpy as np
from jaxtyping import Float, Float32
from numpy import ndarray as Array

from ninedtact.errors import InputError

INCIPIENT_SHARE = 0.7
"""Share of the contact that sticks below which slip is incipient."""
_STUCK_SHARE = 0.02
"""Share below which nothing sticks."""
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
_LONGEST_WINDOW_S = 0.12
"""Time over which slip is measured at most."""
_MOVING_STDS, _STOPPED_STDS = 4.0, 1.6
"""Standard deviations by which slip must change to be a motion; and by which half of a slip that went on would be missed."""
_AT_LIMIT = 0.97
"""Part of the limit of a slider from which it slides."""
_LEAST_SLID_STDS = 5.0
"""Standard deviations of displacement that must have slid before friction is stated."""
_FRICTION_ERROR = 0.1
"""Relative error of friction that does not fall with the length of the slide."""


class SlipState(StrEnum):
    """How much of the contact slides."""

    UNKNOWN = "unknown"
    """Nothing touches, or a number is missing."""
    STATIC = "static"
    """Most of the contact sticks; also until displacement and load have changed by more than their errors."""
    INCIPIENT = "incipient"
    """Less than `INCIPIENT_SHARE` of the contact sticks."""
    GROSS = "gross"
    """The whole contact slides."""


@dataclass(frozen=True)
class SlipEstimate:
    """Slip of one contact at one time."""

    state: SlipState = SlipState.UNKNOWN
    p_incipient: float = float("nan")
    """Probability that less than `INCIPIENT_SHARE` of the contact sticks, and some does or nothing moves."""
    p_gross: float = float("nan")
    """Probability that the whole contact slides."""
    sticking_share: float = float("nan")
    """Share of the area of contact that sticks, 0 to 1."""
    direction: Float[Array, "2"] = field(default_factory=lambda: np.full(2, np.nan))
    """Unit vector along which the object slides over the skin; not a number unless slip is gross."""
    speed: float = float("nan")
    """Speed at which the object slides, in units of displacement (mm) per second; zero unless slip is gross."""
    friction: float = float("nan")
    """Friction coefficient; not a number until something slid."""
    friction_std: float = float("nan")
    onset_s: float = float("nan")
    """Time at which the last gross slip began; not a number before."""


@dataclass
class SlipEstimator:
    """Estimates the slip of one contact; give it every image of the stream in turn.

    Displacements may be in any one unit of length, and loads in any one unit that is proportional to force.

    >>> from ninedtact.tracking import SlipEstimator
    >>> slip = SlipEstimator()
    >>> for step in range(1, 60):  # a ball at 2 N is dragged at 6 mm/s
    ...     drag_mm = np.array([0.1 * step, 0.0])
    ...     load_n = np.array([min(1.5 * drag_mm[0], 1.0), 0.0])
    ...     found = slip.update(step / 60, drag_mm, 0.01, load_n, 2.0, 0.02)
    >>> found.state, round(found.speed), round(found.friction, 1)
    (<SlipState.GROSS: 'gross'>, 6, 0.5)
    """

    _last: SlipEstimate = field(default_factory=SlipEstimate, init=False, repr=False)
    _history: "deque[_Sample]" = field(default_factory=deque, init=False, repr=False)
    """Samples of the last moments."""
    _slid_at_s: float = field(default=-np.inf, init=False, repr=False)
    """Time of the last image with gross slip."""
    _friction: "_SlidingFriction" = field(default_factory=lambda: _SlidingFriction(), init=False, repr=False)
    _springs: "_Springs | None" = field(default=None, init=False, repr=False)
    """None until the stiffness of the contact is seen."""
    _start: "_Sample | None" = field(default=None, init=False, repr=False)
    """The sample from which displacement and load are counted until then; None without contact."""

    @property
    def time_s(self) -> float | None:
        """Time of the last estimate of the contact; None where nothing touches."""
        return self._history[-1].time_s if self._history else None

    def release(self) -> SlipEstimate:
        """Forget the contact, because nothing touches; what is known of friction stays."""
        self._springs, self._start, self._history = None, None, deque()
        self._last = SlipEstimate(friction=self._last.friction, friction_std=self._last.friction_std)
        return self._last

    def update(
        self,
        time_s: float,
        displacement: Float[Array, "2"],
        displacement_std: float,
        tangential: Float[Array, "2"],
        normal: float,
        load_std: float,
    ) -> SlipEstimate:
        """Return the slip at the next image.

        displacement: of the object, in the plane of the camera's image, in mm or px, from any origin. tangential, normal: load that
        the object applies to the skin, in N or any one unit; normal is positive under pressure. The standard deviations are those
        of the errors that change from image to image: a factor common to all loads does not matter. Where a number is not finite,
        or there is no normal load, the estimate is unknown. Raises `InputError` for a time that is not later than the last one.
        """
        numbers = (time_s, *displacement, displacement_std, *tangential, normal, load_std)
        if not np.isfinite(numbers).all():
            return SlipEstimate(friction=self._last.friction, friction_std=self._last.friction_std)
        if normal <= 0:
            return self.release()
        if self.time_s is not None and time_s <= self.time_s:
            raise InputError(
                expected=f"a time later than the last one, {self.time_s:g} s",
                got=f"{time_s:g} s",
                remedy="give the images in their order, each once",
            )
        displacement, tangential = np.asarray(displacement, float), np.asarray(tangential, float)
        sample = _Sample(time_s, displacement, displacement_std, tangential, normal, load_std)
        if self._start is None:
            self._start = sample
        if self._springs is None:
            self._start = _later_start(self._start, sample)
            self._springs = _springs_if_seen(self._start, sample, self._friction.mean)
        elif self._history:
            self._springs.load(sample, time_s - self._history[-1].time_s)
        self._remember(sample)
        self._last = self._estimate(sample)
        return self._last

    def _remember(self, sample: "_Sample") -> None:
        """Keep the samples of the last moments, two at least."""
        self._history.append(sample)
        while len(self._history) > 2 and self._history[1].time_s < sample.time_s - _LONGEST_WINDOW_S:
            self._history.popleft()

    def _estimate(self, sample: "_Sample") -> SlipEstimate:
        """Return the weighted mean over what the springs say."""
        if self._springs is None:
            known = self._last
            return SlipEstimate(
                SlipState.STATIC, 0.0, 0.0, 1.0, speed=0.0, friction=known.friction, friction_std=known.friction_std
            )
        springs, share = self._springs, self._springs.share
        velocity = _slip_velocity(self._history, springs.stiffness)
        p_gross = float((springs.weight * (share < _STUCK_SHARE)).sum()) if velocity.any() else 0.0
        p_incipient = float((springs.weight * (share < INCIPIENT_SHARE)).sum()) - p_gross
        state = SlipState.STATIC
        if p_gross > 0.5:
            state = SlipState.GROSS
        elif p_gross + p_incipient > 0.5:
            state = SlipState.INCIPIENT
        is_gross, speed = state == SlipState.GROSS, float(np.linalg.norm(velocity))
        if is_gross:
            self._friction.add(self._history[-2], sample, speed)
        began = is_gross and sample.time_s - self._slid_at_s > _LONGEST_WINDOW_S  # noise interrupts a slip for less
        self._slid_at_s = sample.time_s if is_gross else self._slid_at_s
        return SlipEstimate(
            state,
            max(p_incipient, 0.0),
            p_gross,
            float((springs.weight * share).sum()),
            velocity / speed if is_gross else np.full(2, np.nan),
            speed if is_gross else 0.0,
            self._friction.mean,
            self._friction.std,
            sample.time_s if began else self._last.onset_s,
        )


@dataclass(frozen=True)
class _Sample:
    """The numbers of one image."""

    time_s: float
    displacement: Float[Array, "2"]
    displacement_std: float
    tangential: Float[Array, "2"]
    normal: float
    load_std: float


def _slip_velocity(history: Sequence[_Sample], stiffness: float) -> Float[Array, "2"]:
    """Return how fast the object slides if all of it does; zero where that is within errors, or has just ended.

    The distance that slid is displacement − load/stiffness. It slides if the distance is beyond errors over any time up to
    `_LONGEST_WINDOW_S`; the velocity is that over all of it, which noise changes least.
    """
    now = history[-1]
    ago_s = now.time_s - np.array([one.time_s for one in history])
    places = np.array([one.displacement - one.tangential / stiffness for one in history])
    slid = places[-1] - places
    std = np.sqrt(2) * float(np.hypot(now.displacement_std, now.load_std / stiffness))
    for last in range(len(history) - 2, 0, -1):
        longer = ago_s[last] / (ago_s[0] - ago_s[last])
        went_on = longer * float(np.linalg.norm(slid[0] - slid[last]))
        if went_on / 2 > max(float(np.linalg.norm(slid[last])), _STOPPED_STDS * (1 + longer) * std):
            return np.zeros(2)
    is_sliding = bool((np.linalg.norm(slid, axis=1) > _MOVING_STDS * std).any())
    return np.asarray(slid[0] / ago_s[0]) if is_sliding else np.zeros(2)


@dataclass
class _SlidingFriction:
    """The ratio of loads, averaged over the distance that slid and the load under which it did."""

    distance: float = 0.0
    weight: float = 0.0
    ratio: float = 0.0
    squared_ratio: float = 0.0
    is_known: bool = False

    def add(self, before: _Sample, now: _Sample, speed: float) -> None:
        """Average over another image in which everything slides."""
        ratio, step = float(np.linalg.norm(now.tangential)) / now.normal, speed * (now.time_s - before.time_s)
        weight = step * now.normal
        self.distance += step
        self.weight += weight
        self.ratio += weight * ratio
        self.squared_ratio += weight * ratio**2
        self.is_known = self.is_known or self.distance > _LEAST_SLID_STDS * now.displacement_std

    @property
    def mean(self) -> float:
        """Friction coefficient; not a number until something slid."""
        return self.ratio / self.weight if self.is_known else float("nan")

    @property
    def std(self) -> float:
        """Standard deviation of the error of the mean."""
        if not self.is_known:
            return float("nan")
        variance = max(self.squared_ratio / self.weight - self.mean**2, 0.0)
        return float(np.sqrt(variance + (_FRICTION_ERROR * self.mean) ** 2))


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


def _later_start(start: _Sample, now: _Sample) -> _Sample:
    """Return from which sample to count: from now while the contact grows, or moves without a load that holds it."""
    grows = abs(now.normal - start.normal) > _STEADY * now.normal
    change, load = (float(np.linalg.norm(one)) for one in (now.tangential - start.tangential, now.tangential))
    is_free = load < max(_SEEN_STDS * now.load_std, _FRICTION[0] * now.normal)
    return now if grows or (is_free and change < _UNSEEN_STDS * now.load_std) else start


def _springs_if_seen(start: _Sample, now: _Sample, friction: float) -> "_Springs | None":
    """Return the springs once displacement and load have both changed, so that their ratio is known; None before.

    friction: coefficient that is known of the object; not a number where none is.
    """
    moved, change = now.displacement - start.displacement, now.tangential - start.tangential
    distance, load = float(np.linalg.norm(moved)), float(np.linalg.norm(change))
    if distance > _SLID_STDS * now.displacement_std and load < _UNSEEN_STDS * now.load_std:
        load = float(np.linalg.norm(now.tangential))  # it slid from the beginning
    if distance < _SEEN_STDS * now.displacement_std or load < _SEEN_STDS * now.load_std:
        return None
    known = np.isfinite(friction)
    median, width = (friction, _KNOWN_FRICTION_WIDTH) if known else (_FRICTION_PRIOR, _FRICTION_PRIOR_WIDTH)
    log_prior = -0.5 * (np.log(_FRICTION / median) / width) ** 2
    stiffness_log_prior = -0.5 * (np.log(_STIFFNESS / _STIFFNESS_PRIOR) / _STIFFNESS_PRIOR_WIDTH) ** 2
    if known:
        log_prior = np.logaddexp(log_prior, -_DOUBT)
    springs = _Springs(load / distance * _STIFFNESS, start, stiffness_log_prior[:, None] + log_prior)
    springs.load(now, 0.0)
    return springs


@dataclass
class _Springs:
    """Springs with sliders for every shape of contact, stiffness and friction of the grid."""

    stiffnesses: Float[Array, " stiffnesses"]
    start: _Sample
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

    def load(self, sample: _Sample, after_s: float) -> None:
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
            variance = (sample.load_std**2 + (_MODEL_ERROR * sample.normal) ** 2) * _CORRELATED_IMAGES
            kept = np.exp(-1 / _MEMORY_IMAGES)
            likelihood = -0.5 * (error**2).sum(axis=0) / variance
            self._log_weight = kept * self._log_weight + (1 - kept) * self._prior + likelihood
            self._set_weight()
        followed = 1 - np.exp(-min(self._unrelaxed_s, _RELAX_EVERY_S) / _RELAXATION_S)
        self._unrelaxed_s = 0.0
        self.force += (followed * error / _SPRINGS).astype(np.float32)[..., None]
        self._slide()

    def _step_with_play(self, sample: _Sample) -> Float[Array, "2"]:
        """Return the step of displacement beyond its noise."""
        behind = sample.displacement - self.at
        distance, play = float(np.linalg.norm(behind)), _PLAY_STDS * sample.displacement_std
        step = behind * max(1 - play / distance, 0.0) if distance > 0 else np.zeros(2)
        self.at = self.at + step
        return step

    def _normal_with_play(self, sample: _Sample) -> float:
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
