"""Dark spots of an image, at one size: where, and how much darker than what surrounds them."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32
from numpy import ndarray as Array
from scipy import ndimage

Points = Float[Array, "n 2"]

STRONGEST = 250
"""Spots kept: some four times the pins of the largest usual board."""


@dataclass(frozen=True)
class Blobs:
    """Dark spots, strongest first."""

    points_px: Points
    strength: Float[Array, " n"]
    """Scale-normalised Laplacian at the spot, in the image's own unit."""


def dark_blobs(image: Float32[Array, "rows cols"], size_px: float) -> Blobs:
    """Local maxima of the scale-normalised Laplacian of Gaussian (Lindeberg 1998) at standard deviation `size_px`."""
    response = ndimage.gaussian_laplace(image, size_px, mode="nearest") * size_px**2
    neighbourhood = 2 * round(1.5 * size_px) + 1
    peaks = (response == ndimage.maximum_filter(response, size=neighbourhood)) & (response > 0)
    points, strength = np.argwhere(peaks)[:, ::-1].astype(float), response[peaks].astype(float)
    order = np.argsort(-strength)[:STRONGEST]
    return Blobs(points[order], strength[order])
