"""Slip in a sequence of images that is read as a whole, of a sensor of which no error is known.

The noise of displacement and loads shows in their second differences from image to image. Both are then smoothed over as many
images as the motion allows: as long as smoothing takes no more off than the noise.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from ninedtact.robust_noise import noise_by_second_differences
from ninedtact.tracking.sliding_springs import SlipSample
from ninedtact.tracking.slip import SlipEstimate, SlipEstimator

_SMOOTHING_IMAGES = 4.0, 3.0, 2.0, 1.4, 1.0, 0.6
"""Standard deviations of the smoothing that are tried, the longest first."""
_MOST_TAKEN_OFF = 1.6
"""What smoothing may take off, over what it takes off noise."""
_LEAST_IMAGES = 5
"""Images of a contact below which nothing is smoothed."""
_FIRM = 0.3
"""Part of the greatest normal load from which images count for the noise; light contacts have more."""
_NOISE_PART = 0.5
"""Part of the measured noise that is passed to `SlipEstimator`, whose thresholds are made for errors alike in several images."""
_PASSES = 2
"""What the first pass learnt of friction is known from the beginning of the second."""
_LEAST_DISPLACEMENT_STD, _LEAST_RELATIVE_LOAD_STD = 0.004, 0.003
"""Errors that are assumed at least: mm, and over the median normal load."""


def slip_of_sequence(samples: Sequence[SlipSample]) -> list[SlipEstimate]:
    """Return the slip at every sample, unknown without contact; standard deviations of the samples are not read.

    Raises `InputError` for times that do not rise.
    """
    values = np.array([[*one.displacement, *one.tangential, one.normal] for one in samples], float).reshape(-1, 5)
    is_touching = np.isfinite(values).all(axis=1) & (values[:, 4] > 0)
    if not is_touching.any():
        return [SlipEstimate() for _ in samples]
    estimator, smoothed = SlipEstimator(), _smooth_samples(samples, values, is_touching)
    for _ in range(_PASSES):
        found = [estimator.release() if one.normal <= 0 else estimator.update(one) for one in smoothed]
        estimator.release()
    return found


def _smooth_samples(
    samples: Sequence[SlipSample], values: Float[Array, "n 5"], is_touching: Bool[Array, " n"]
) -> list[SlipSample]:
    """Return the samples smoothed within each contact, with the errors that are left.

    values: displacement, tangential and normal load of each sample.
    """
    firm = is_touching & (values[:, 4] > _FIRM * values[is_touching, 4].max())
    displacement_noise, load_noise = (
        noise_by_second_differences(values[firm, at], 0) for at in (slice(2), slice(2, 4))
    )
    scale = np.maximum([displacement_noise] * 2 + [load_noise] * 2, 1e-9)
    runs, smooth = list(_contact_runs(is_touching)), values.copy()
    images, left = _choose_smoothing(values[:, :4] / scale, runs)
    for run in runs:
        smooth[run] = _smooth(values[run], images)
    least_load_std = _LEAST_RELATIVE_LOAD_STD * float(np.median(values[firm, 4]))
    displacement_std = max(_NOISE_PART * left * displacement_noise, _LEAST_DISPLACEMENT_STD)
    load_std = max(_NOISE_PART * left * load_noise, least_load_std)
    return [
        replace(
            sample,
            displacement=row[:2],
            tangential=row[2:4],
            normal=float(row[4]) if touches else sample.normal,
            displacement_std=displacement_std,
            load_std=load_std,
        )
        for sample, row, touches in zip(samples, smooth, is_touching, strict=True)
    ]


def _contact_runs(is_touching: Bool[Array, " n"]) -> Iterator[Int[Array, " run"]]:
    """Yield the indices of every contact."""
    at = np.flatnonzero(is_touching)
    yield from np.split(at, np.flatnonzero(np.diff(at) > 1) + 1)


def _choose_smoothing(scaled: Float[Array, "n k"], runs: list[Int[Array, " run"]]) -> tuple[float, float]:
    """Return the longest smoothing, in images, that takes off little but noise, and the part of the noise that it leaves.

    scaled: values over their noise.
    """
    long = [scaled[run] for run in runs if len(run) >= _LEAST_IMAGES]
    for images in _SMOOTHING_IMAGES if long else ():
        weight = _gaussian(images)
        off_noise = np.sqrt(1 - 2 * weight.max() + (weight**2).sum())
        taken_off = np.concatenate([one - _smooth(one, images) for one in long])
        if np.sqrt(np.mean(taken_off**2)) <= _MOST_TAKEN_OFF * off_noise:
            return images, float(np.sqrt((weight**2).sum()))
    return 0.0, 1.0


def _gaussian(images: float) -> Float[Array, " taps"]:
    reach = int(np.ceil(3 * images))
    weight = np.exp(-((np.arange(-reach, reach + 1) / images) ** 2) / 2)
    return np.asarray(weight / weight.sum())


def _smooth(values: Float[Array, "n k"], images: float) -> Float[Array, "n k"]:
    """Return values smoothed along the first axis; beyond the ends they go on as they came, mirrored about a point."""
    if images == 0 or len(values) < _LEAST_IMAGES:
        return values
    weight = _gaussian(images)
    reach = len(weight) // 2
    padded = np.pad(values, ((reach, reach), (0, 0)), mode="reflect", reflect_type="odd")
    return np.stack([np.convolve(column, weight, mode="valid") for column in padded.T], axis=1)
