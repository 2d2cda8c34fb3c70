"""Detection of out-of-distribution inputs: simple statistics of a network's input, compared with their ranges in training.

max_indentation       largest indentation, or largest darkening for image channels
pressed_fraction      fraction of the image that is pressed in or darker
mean_change           mean magnitude of the change from the state without contact
roughness             standard deviation of the difference from a mean over 3 × 3 pixels: noise, and sharp edges
reference_brightness  mean brightness of the reference image (image channels only)
sensor_feature_1 …    features of the sensor (for networks that have them as channels)

The ranges are stored in the model's card, and an input beyond them gets a warning.
"""

from typing import Annotated, Any

import numpy as np
from jaxtyping import Float32, Float64
from msgspec import Meta
from numpy import ndarray as Array

from ninedtact.force.network_input import InputChannels

Inputs = Float32[Array, "n channels rows cols"]
_Statistic = Annotated[float, Meta(ge=-1e6, le=1e6)]
StatisticRange = tuple[_Statistic, _Statistic]
_PRESSED_ABOVE = {True: 0.02, False: 5.0}
"""Threshold of `pressed_fraction`: in gel thicknesses for height channels (True), in grey levels for image channels (False)."""
SHARES = (0.1, 99.9)
"""Percentiles of the training's statistics that bound each range."""
MARGIN = 0.2
"""Fraction of a range by which a statistic may lie beyond it."""


def out_of_distribution_statistics(inputs: Inputs, channels: InputChannels) -> dict[str, Float64[Array, " n"]]:
    """Return the statistics of every input by which unlike inputs are recognised, by name."""
    pressed = inward_signal(inputs, channels)
    flat = pressed.reshape(len(inputs), -1)
    found: dict[str, Any] = {
        "max_indentation": flat.max(1),
        "pressed_fraction": (flat > _PRESSED_ABOVE[channels.of_heights]).mean(1),
        "mean_change": np.abs(flat).mean(1),
        "roughness": (pressed[:, 1:-1, 1:-1] - means_of_nine(pressed)).std((1, 2)),
    }
    if channels.of_heights:
        first = channels.number - channels.sensor_features
        found |= {f"sensor_feature_{at - first + 1}": inputs[:, at, 0, 0] for at in range(first, channels.number)}
    else:
        found["reference_brightness"] = inputs[:, 0 if channels is InputChannels.MIXED else 2].mean((1, 2))
    return {name: np.asarray(values, np.float64) for name, values in found.items()}


def inward_signal(inputs: Inputs, channels: InputChannels) -> Float32[Array, "n rows cols"]:
    """Return a field that is positive where the skin is pressed in or darker."""
    if channels.of_heights:
        return -inputs[:, 0]
    if channels is InputChannels.MIXED:
        return (inputs[:, 2] - inputs[:, 1]) / 3
    return inputs[:, 0] - inputs[:, 1]


def means_of_nine(fields: Float32[Array, "n rows cols"]) -> Float32[Array, "n fewer_rows fewer_cols"]:
    """Return means over 3 × 3 pixels, for every pixel that has eight neighbours."""
    across = fields[:, :, :-2] + fields[:, :, 1:-1] + fields[:, :, 2:]
    return (across[:, :-2] + across[:, 1:-1] + across[:, 2:]) / 9


def in_distribution_ranges(found: dict[str, Float64[Array, " n"]]) -> dict[str, StatisticRange]:
    """Return the range of each statistic without a few outliers, as it is stored in the model's card."""
    both = {name: np.percentile(values, SHARES).tolist() for name, values in found.items()}
    return {name: (low, high) for name, (low, high) in both.items()}


def is_out_of_distribution(
    inputs: Float32[Array, "channels rows cols"], channels: InputChannels, known: dict[str, StatisticRange]
) -> bool:
    """Return whether any statistic of one input lies outside its range in training and the margin of this range."""
    found = out_of_distribution_statistics(inputs[None], channels).items()
    return any(_is_beyond(float(values[0]), known[name]) for name, values in found if name in known)


def _is_beyond(value: float, known: StatisticRange) -> bool:
    """Return whether a statistic lies beyond a range and its margin; a narrow range counts as at least 5 % of its upper end."""
    low, high = known
    beyond = max(low - value, value - high)
    return beyond > 0 and beyond >= MARGIN * max(high - low, abs(high) * 0.05)
