"""No board: said with what was seen, and with what to do about it."""

import numpy as np
from jaxtyping import Float32
from numpy import ndarray as Array

from ninedtact.calibration.board.sighting import Sighting, best_sighting, is_clear
from ninedtact.calibration.brightness import noise_levels, smoothed
from ninedtact.design import PinBoard
from ninedtact.errors import NinedtactError
from ninedtact.shape.lens import Points

UNTOUCHED = 4.0
"""Range of a smoothed change, in standard deviations of a pixel, below which nothing happened."""


class BoardNotFound(NinedtactError):
    """The pin board is not in the image, or not enough of it."""

    def __init__(self, sentence: str, found: int, expected: int, seen_px: Points, change: Float32[Array, "rows cols"]):
        super().__init__(sentence)
        self.found, self.expected = found, expected
        self.seen_px, self.change = seen_px, change


def not_found(
    change: Float32[Array, "rows cols"], board: PinBoard, seen_px: Points, sighting: Sighting | None = None
) -> BoardNotFound:
    """The refusal, in words that help: swapped images and no contact at all are told apart."""
    if np.ptp(smoothed(change, 2.0)) < UNTOUCHED * noise_levels(change):
        seen_px, advice = seen_px[:0], "nothing touched the skin: press the board while the second image is taken"
    elif looks_swapped(change, board, sighting):
        advice = "the images look swapped: give the untouched one as the reference"
    else:
        advice = "press harder, hold the board flatter so that all pins touch, and check that it is the design's board"
    words = f"expected {board.count} pins ({board.cols} x {board.rows}), found {len(seen_px)}; {advice}"
    return BoardNotFound(words, len(seen_px), board.count, seen_px, change)


def looks_swapped(change: Float32[Array, "rows cols"], board: PinBoard, sighting: Sighting | None) -> bool:
    """Whether a whole board stands out brighter than the reference, more than what there is of a darker one."""
    inverted = best_sighting(-change, board, "auto")
    if inverted is None or not is_clear(inverted, board):
        return False
    return sighting is None or bool(np.median(inverted.lattice.strength) > np.median(sighting.lattice.strength))
