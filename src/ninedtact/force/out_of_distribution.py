"""Simple numbers of a network's input, by which an image is known that is like none it was trained with.

deepest      how deep the skin is pressed in, or how much darker it is, at most
touched      part of the image that is
changed      mean size of what is not as untouched
rough        standard deviation of what a mean over 3 × 3 pixels takes away: noise, and sharp edges
reference    mean brightness of the untouched image (images only)
trait 1 …    what is known of the sensor (where the network is told it)
"""

from typing import Any

import numpy as np
from jaxtyping import Float32, Float64
from numpy import ndarray as Array

from ninedtact.force.network_input import InputChannels

Inputs = Float32[Array, "n channels rows cols"]
StatisticRange = tuple[float, float]
TOUCHED_AT = {True: 0.02, False: 5.0}
"""Of heights in gel thicknesses, of images in grey levels."""
SHARES = (0.1, 99.9)
"""Percentiles of the training's numbers between which an image is like it…"""
MARGIN = 0.2
"""… or beyond by this part of their distance."""


def input_statistics(inputs: Inputs, channels: InputChannels) -> dict[str, Float64[Array, " n"]]:
    """Of every image."""
    pressed = indentation_signal(inputs, channels)
    flat = pressed.reshape(len(inputs), -1)
    found: dict[str, Any] = {
        "deepest": flat.max(1),
        "touched": (flat > TOUCHED_AT[channels.of_heights]).mean(1),
        "changed": np.abs(flat).mean(1),
        "rough": (pressed[:, 1:-1, 1:-1] - means_of_nine(pressed)).std((1, 2)),
    }
    if channels.of_heights:
        found |= {f"trait {number}": inputs[:, number, 0, 0] for number in range(1, channels.number)}
    else:
        found["reference"] = inputs[:, 0 if channels is InputChannels.MIXED else 2].mean((1, 2))
    return {name: np.asarray(values, np.float64) for name, values in found.items()}


def indentation_signal(inputs: Inputs, channels: InputChannels) -> Float32[Array, "n rows cols"]:
    """Positive where the skin is pressed in or darker."""
    if channels.of_heights:
        return -inputs[:, 0]
    if channels is InputChannels.MIXED:
        return (inputs[:, 2] - inputs[:, 1]) / 3
    return inputs[:, 0] - inputs[:, 1]


def means_of_nine(fields: Float32[Array, "n rows cols"]) -> Float32[Array, "n fewer_rows fewer_cols"]:
    """Of every pixel that has eight neighbours."""
    across = fields[:, :, :-2] + fields[:, :, 1:-1] + fields[:, :, 2:]
    return (across[:, :-2] + across[:, 1:-1] + across[:, 2:]) / 9


def statistic_ranges(found: dict[str, Float64[Array, " n"]]) -> dict[str, StatisticRange]:
    """What training saw, a few outliers aside: kept with the model."""
    both = {name: np.percentile(values, SHARES).tolist() for name, values in found.items()}
    return {name: (low, high) for name, (low, high) in both.items()}


def is_out_of_distribution(
    inputs: Float32[Array, "channels rows cols"], channels: InputChannels, known: dict[str, StatisticRange]
) -> bool:
    """Whether any number of one image lies beyond those of training."""
    return any(
        not within(float(values[0]), known[name])
        for name, values in input_statistics(inputs[None], channels).items()
        if name in known
    )


def within(value: float, known: StatisticRange) -> bool:
    """Inside, or little beyond; a range of one value allows for as much of that."""
    low, high = known
    margin = MARGIN * max(high - low, abs(high) * 0.05)
    return low - margin <= value <= high + margin
