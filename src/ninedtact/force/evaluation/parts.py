"""The same errors by load, by object and by sensor, and where nothing touches."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Bool
from numpy import ndarray as Array

from ninedtact.force.evaluation.predictions import FORCES, Predictions, Six

LOADS_N = (0.0, 1.0, 2.0, 4.0, 6.0, 8.0, 10.0, 12.0, np.inf)
"""Ends of the bins of |F_z|."""


@dataclass(frozen=True)
class Part:
    """Some of the pairs."""

    name: str
    pairs: int
    mae: Six
    bias: Six


@dataclass(frozen=True)
class Untouched:
    """Pairs whose true wrench is zero on all axes: every force found there is made up."""

    pairs: int
    mean_force_n: float
    """Of the length of the predicted force."""
    largest_force_n: float


def by_load(predictions: Predictions) -> Iterator[Part]:
    """Bins of the true |F_z| that hold any pairs; where nothing touches is none of them."""
    load_n, touched = np.abs(predictions.truth[:, 2]), predictions.truth.any(axis=1)
    for low, high in pairwise(LOADS_N):
        inside = (load_n >= low) & (load_n < high) & touched
        if inside.any():
            yield part(predictions, load_name(low, high), inside)


def load_name(low_n: float, high_n: float) -> str:
    """In words."""
    if low_n == 0:
        return f"below {high_n:g} N"
    return f"from {low_n:g} N" if np.isinf(high_n) else f"{low_n:g}–{high_n:g} N"


def by_name(predictions: Predictions, names: Sequence[str] | None) -> Iterator[Part]:
    """One part for each name; none where names are not known."""
    if names is None:
        return
    different, number = np.unique(np.asarray(names, dtype=str), return_inverse=True)
    order = np.argsort(number, kind="stable")
    for name, rows in zip(different, np.split(order, np.cumsum(np.bincount(number))[:-1]), strict=True):
        off = predictions.off[rows]
        yield Part(str(name), len(rows), np.abs(off).mean(0), off.mean(0))


def part(predictions: Predictions, name: str, inside: Bool[Array, " n"]) -> Part:
    """The errors of some pairs."""
    off = predictions.off[inside]
    return Part(name, len(off), np.abs(off).mean(0), off.mean(0))


def untouched(predictions: Predictions) -> Untouched | None:
    """What is predicted where nothing touches; None where there are no such pairs."""
    nothing = ~predictions.truth.any(axis=1)
    if not nothing.any():
        return None
    force_n = np.linalg.norm(predictions.predicted[nothing, FORCES], axis=1)
    return Untouched(int(nothing.sum()), float(force_n.mean()), float(force_n.max()))
