"""The light that the whole image loses when a part of the skin is dark, told from the image itself."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32
from numpy import ndarray as Array

EVERY_PX = 5
"""Rows and columns looked at: darkness is smooth."""
NOTICED = 0.02
"""Darkening that counts, relative: three standard deviations of a pixel's noise and a little drift stay below it."""
ROUNDS = 4
"""Of taking the loss off before darkness is counted; each gains a factor of five or more."""


@dataclass(frozen=True)
class Loss:
    """c, relative, for an image of which some is dark."""

    global_dimming: float = 0.0
    """c per mean darkening of the view; zero where the calibration knows of none."""

    def __call__(self, grey: Float32[Array, "rows cols"], reference: Float32[Array, "rows cols"]) -> float:
        """c of this image, zero or below; exactly zero where nothing is noticeably dark."""
        if self.global_dimming == 0:
            return 0.0
        loss = 0.0
        for _ in range(ROUNDS):
            loss = -self.global_dimming * mean_darkening(grey, reference, loss)
        return loss


def mean_darkening(grey: Float32[Array, "rows cols"], reference: Float32[Array, "rows cols"], loss: float) -> float:
    """Of the view, relative to untouched skin, the loss taken off."""
    few = np.s_[::EVERY_PX, ::EVERY_PX]
    darkening = 1 - grey[few] / (np.maximum(reference[few], 1) * np.float32(1 + loss))
    return float(np.where(darkening > NOTICED, darkening, 0).mean())
