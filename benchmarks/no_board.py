"""Pairs of images in which there is no pin board: what a person presses by mistake, and what only looks regular."""

from collections.abc import Iterator

import cv2
import numpy as np
from altered import FRAME_NOISE, Pair, both, quantised

SHAPE = 480, 640, 3
GREY = 160.0


def mistaken(untouched: np.ndarray, pressed: np.ndarray, ball_pair: Pair) -> Iterator[tuple[str, Pair]]:
    """From a sensor's own images."""
    yield "untouched twice", both(untouched, untouched, FRAME_NOISE)
    yield "a ball", ball_pair
    yield "images swapped", (quantised(pressed), quantised(untouched))


def invented(seed: int) -> Iterator[tuple[str, Pair]]:
    """From no sensor at all."""
    even = np.full(SHAPE, GREY)
    yield "noise", both(even + grains(1, seed), even + grains(1, seed + 100))
    yield "coarse noise", both(even, even + grains(6, seed))
    yield "random texture", both(even, even + texture(seed))
    yield "dots at random", both(even, even - 20 * dots(scattered(seed)), FRAME_NOISE)
    yield "dots in a honeycomb", both(even, even - 20 * dots(honeycomb(48)), FRAME_NOISE)


def grains(sigma_px: float, seed: int, levels: float = 10) -> np.ndarray:
    """Noise of one grain size, standard deviation in grey levels."""
    noise = cv2.GaussianBlur(np.random.default_rng(seed).normal(size=SHAPE[:2]), (0, 0), sigma_px)
    return (levels * noise / noise.std())[..., None]


def texture(seed: int) -> np.ndarray:
    """Noise of all grain sizes, as much of each, like a photograph."""
    return np.sum([grains(sigma, seed + number) for number, sigma in enumerate((1, 2, 4, 8, 16, 32, 64))], axis=0)


def dots(points_px: np.ndarray, radius_px: float = 8) -> np.ndarray:
    """One round soft dot at each place."""
    y, x = np.indices(SHAPE[:2])
    image = np.zeros(SHAPE[:2])
    for column, row in points_px:
        image = np.maximum(image, np.exp(-0.5 * ((x - column) ** 2 + (y - row) ** 2) / radius_px**2))
    return image[..., None]


def scattered(seed: int, count: int = 70) -> np.ndarray:
    return np.random.default_rng(seed).uniform((20, 20), (620, 460), (count, 2))


def honeycomb(step_px: float) -> np.ndarray:
    rows = np.arange(10)[:, None]
    x = 40 + step_px * (np.arange(12) + 0.5 * (rows % 2))
    y = 40 + step_px * np.sqrt(0.75) * rows + 0 * x
    return np.column_stack([x.ravel(), y.ravel()])
