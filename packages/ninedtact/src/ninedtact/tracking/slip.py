"""Slip of a contact from a few numbers of each image: how far the object has moved, and the loads along and across the skin.

While an object sticks it moves with the skin, and the tangential load grows with its displacement by the contact's tangential
stiffness. At the rim, where pressure is least, the object slides first, and the load grows less (Cattaneo 1938, Mindlin 1949;
docs/references.md). When everything slides, the displacement goes on and the load does not follow.

The contact is modelled as springs with sliders (`sliding_springs`). The state is the weighted mean over their grid.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact.errors import InputError
from ninedtact.tracking.sliding_springs import SlidingSprings, SlipSample, later_start, springs_if_seen

INCIPIENT_SHARE = 0.7
"""Share of the contact that sticks below which slip is incipient."""
_STUCK_SHARE = 0.02
"""Share below which nothing sticks."""
_LONGEST_WINDOW_S = 0.12
"""Time over which slip is measured at most."""
_MOVING_STDS, _STOPPED_STDS = 4.0, 1.6
"""Standard deviations by which slip must change to be a motion; and by which half of a slip that went on would be missed."""
_JUMP_STEPS = 3
"""Steps from which slip must be seen in more than the largest: in changing light, the outline of a contact jumps from one image
to the next."""
_LEAST_SLID_STDS = 5.0
"""Standard deviations of displacement that must have slid before friction is stated."""
_RATIOS = np.geomspace(0.01, 10.0, 700)
"""Ratios of tangential and normal load that are told apart, 1 % from each other."""
_COEFFICIENT_QUANTILE, _UPPER_QUANTILE = 0.75, 0.95
"""Quantiles of the ratio while it slides: the coefficient, and what is a standard deviation above it for a normal distribution."""
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

    >>> from ninedtact.tracking import SlipEstimator, SlipSample
    >>> slip = SlipEstimator()
    >>> for step in range(1, 60):  # a ball at 2 N is dragged at 6 mm/s
    ...     drag_mm = np.array([0.1 * step, 0.0])
    ...     load_n = np.array([min(1.5 * drag_mm[0], 1.0), 0.0])
    ...     found = slip.update(SlipSample(step / 60, drag_mm, load_n, 2.0, displacement_std=0.01, load_std=0.02))
    >>> found.state, round(found.speed), round(found.friction, 1)
    (<SlipState.GROSS: 'gross'>, 6, 0.5)
    """

    least_friction: float = 0.0
    """Ratio of tangential to normal load below which an object cannot slide; a contact that moves then belongs to one that rolls.
    Zero where this ratio is not known."""
    _last: SlipEstimate = field(default_factory=SlipEstimate, init=False, repr=False)
    _history: deque[SlipSample] = field(default_factory=deque, init=False, repr=False)
    """Samples of the last moments."""
    _slid_at_s: float = field(default=-np.inf, init=False, repr=False)
    """Time of the last image with gross slip."""
    _friction: "_SlidingFriction" = field(default_factory=lambda: _SlidingFriction(), init=False, repr=False)
    _springs: SlidingSprings | None = field(default=None, init=False, repr=False)
    """None until the stiffness of the contact is seen."""
    _start: SlipSample | None = field(default=None, init=False, repr=False)
    """The sample from which displacement and load are counted until then; None without contact."""

    @property
    def time_s(self) -> float | None:
        """Time of the last estimate of the contact; None where nothing touches."""
        return self._history[-1].time_s if self._history else None

    @property
    def friction(self) -> float:
        """Friction coefficient so far; not a number until something slid."""
        return self._last.friction

    def release(self) -> SlipEstimate:
        """Forget the contact, because nothing touches; what is known of friction stays."""
        self._springs, self._start, self._history = None, None, deque()
        self._last = SlipEstimate(friction=self._last.friction, friction_std=self._last.friction_std)
        return self._last

    def update(self, sample: SlipSample) -> SlipEstimate:
        """Return the slip at the next image.

        Where a number is not known, or there is no normal load, the estimate is unknown. Raises `InputError` for a time that is not
        later than the last one.
        """
        if not sample.is_known:
            return SlipEstimate(friction=self._last.friction, friction_std=self._last.friction_std)
        if sample.normal <= 0:
            return self.release()
        if self.time_s is not None and sample.time_s <= self.time_s:
            raise InputError(
                expected=f"a time later than the last one, {self.time_s:g} s",
                got=f"{sample.time_s:g} s",
                remedy="give the images in their order, each once",
            )
        if self._start is None:
            self._start = sample
        if self._springs is None:
            self._start = later_start(self._start, sample)
            self._springs = springs_if_seen(self._start, sample, self._friction.ratio)
        elif self._history:
            self._springs.load(sample, sample.time_s - self._history[-1].time_s)
        self._remember(sample)
        self._last = self._estimate(sample)
        return self._last

    def _remember(self, sample: SlipSample) -> None:
        """Keep the samples of the last moments, two at least."""
        self._history.append(sample)
        while len(self._history) > 2 and self._history[1].time_s < sample.time_s - _LONGEST_WINDOW_S:
            self._history.popleft()

    def _estimate(self, sample: SlipSample) -> SlipEstimate:
        """Return the weighted mean over what the springs say."""
        if self._springs is None:
            known = self._last
            return SlipEstimate(
                SlipState.STATIC, 0.0, 0.0, 1.0, speed=0.0, friction=known.friction, friction_std=known.friction_std
            )
        springs, share = self._springs, self._springs.share
        velocity = _slip_velocity(self._history, springs.stiffness)
        is_held = float(np.linalg.norm(sample.tangential)) < self.least_friction * sample.normal
        p_gross = float((springs.weight * (share < _STUCK_SHARE)).sum()) if velocity.any() and not is_held else 0.0
        p_incipient = 0.0 if is_held else float((springs.weight * (share < INCIPIENT_SHARE)).sum()) - p_gross
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
            self._friction.coefficient,
            self._friction.std,
            sample.time_s if began else self._last.onset_s,
        )


def _slip_velocity(history: Sequence[SlipSample], stiffness: float) -> Float[Array, "2"]:
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
    is_beyond = np.linalg.norm(slid, axis=1) > _MOVING_STDS * std
    steps = np.diff(places, axis=0)
    if len(steps) >= _JUMP_STEPS:
        largest = int(np.argmax(np.linalg.norm(steps, axis=1)))
        without = slid - np.where(np.arange(len(slid)) <= largest, 1, 0)[:, None] * steps[largest]
        is_beyond &= np.linalg.norm(without, axis=1) > _MOVING_STDS * std
    return np.asarray(slid[0] / ago_s[0]) if is_beyond.any() else np.zeros(2)


@dataclass
class _SlidingFriction:
    """The ratios of loads, each weighted by the distance that slid and the load under which it did.

    Before everything slides, and under light loads, the ratio is read too low, and never much too high: its upper quartile is the
    coefficient.
    """

    distance: float = 0.0
    weight: Float[Array, " ratios"] = field(default_factory=lambda: np.zeros(len(_RATIOS)))
    overread: float = 0.0
    """Sum of `SlipSample.overread`, weighted so."""
    is_known: bool = False

    def add(self, before: SlipSample, now: SlipSample, speed: float) -> None:
        """Add another image in which everything slides."""
        ratio, step = float(np.linalg.norm(now.tangential)) / now.normal, speed * (now.time_s - before.time_s)
        self.distance += step
        self.weight[min(int(np.searchsorted(_RATIOS, ratio)), len(_RATIOS) - 1)] += step * now.normal
        self.overread += step * now.normal * now.overread
        self.is_known = self.is_known or self.distance > _LEAST_SLID_STDS * now.displacement_std

    def _quantile(self, part: float) -> float:
        below = np.cumsum(self.weight)
        return float(_RATIOS[np.searchsorted(below, part * below[-1])])

    @property
    def ratio(self) -> float:
        """Ratio of the loads as they are read while everything slides; not a number until something slid."""
        return self._quantile(_COEFFICIENT_QUANTILE) if self.is_known else float("nan")

    @property
    def coefficient(self) -> float:
        """Friction coefficient; not a number until something slid."""
        return self.ratio * self.overread / float(self.weight.sum()) if self.is_known else float("nan")

    @property
    def std(self) -> float:
        """Standard deviation of the coefficient's error."""
        if not self.is_known:
            return float("nan")
        spread = self._quantile(_UPPER_QUANTILE) - self.ratio
        return float(np.hypot(spread, _FRICTION_ERROR * self.coefficient))
