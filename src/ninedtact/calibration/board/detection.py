"""Detection of the pin board: the lattice of dark spots in the image that may be the board, with a first lens.

Lattices are grown from dark spots of every likely size. The one with most pins, best explained by a lens, is the candidate that
`board_fit` refines. Where no board is found, `BoardNotFound` says what was detected and what to do.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float, Float32
from numpy import ndarray as Array

from ninedtact.calibration.board.lattice import (
    CAMERA_ROTATIONS,
    PinLattice,
    detect_dark_spots,
    find_pin_lattices,
    lattice_size,
    pin_positions_mm,
)
from ninedtact.calibration.board.lens_fit import LensFit, fit_lens_with_terms
from ninedtact.calibration.brightness import estimate_pixel_noise, smooth_gaussian
from ninedtact.design import PinBoard
from ninedtact.errors import CalibrationError
from ninedtact.shape.lens import Points
from ninedtact.shape.rectification import CameraRotation

SIZES = (1 / 107, 1 / 80, 1 / 160, 1 / 58, 1 / 213)
"""Spot sizes that are tried, as fractions of the image's long side, likeliest first (6, 8, 4, 11, 3 of 640 pixels)."""
FEWEST = 0.5
"""Smallest fraction of the pins that a lattice must have to be a candidate."""
CLEAR = 0.08
"""Leave-one-out error of the first lens, in pitches, below which a complete board is accepted without trying other spot sizes."""
LARGEST = 0.10
"""Median leave-one-out error over the pins, in pitches, above which spots are no board: chance lattices lie near 0.2, real boards
near 0.04.
"""
FEWEST_FOR_LENS = 9


@dataclass(frozen=True)
class BoardCandidate:
    """A lattice that may be the board, with a first lens."""

    lattice: PinLattice
    mounting: CameraRotation
    fit: LensFit

    @property
    def miss_mm(self) -> float:
        """Median leave-one-out error: the deviation of this lattice from a lens."""
        return float(np.median(np.hypot(*self.fit.leave_one_out_errors_mm.T)))

    @property
    def agreeing_px(self) -> Points:
        """Return the spots that lie where the lens fitted to all of them predicts them."""
        pitch_mm = np.hypot(*(self.fit.points_mm[1] - self.fit.points_mm[0]))
        return self.lattice.points_px[np.hypot(*self.fit.leave_one_out_errors_mm.T) < LARGEST * pitch_mm]

    @property
    def rank(self) -> tuple[int, float]:
        """Sort key: more pins first, then the better lens."""
        return len(self.lattice), -self.miss_mm


def find_board_candidate(
    change: Float32[Array, "rows cols"], board: PinBoard, mounting: CameraRotation | Literal["auto"]
) -> BoardCandidate | None:
    """Return the most complete and best explained lattice over all spot sizes and orientations."""
    best: BoardCandidate | None = None
    for sighting in _generate_board_candidates(change, board, mounting):
        best = sighting if best is None or sighting.rank > best.rank else best
        if _is_unambiguous(best, board):
            break
    return best


def is_plausible_board(sighting: BoardCandidate, board: PinBoard) -> bool:
    """Return whether the candidate is worth refining."""
    return sighting.miss_mm < LARGEST * board.pitch_mm and len(sighting.lattice) >= FEWEST * board.count


def predict_missing_pins(
    sighting: BoardCandidate, board: PinBoard, seen_px: Float[Array, "seen 2"], shape: tuple[int, ...]
) -> Float[Array, "missing 2"]:
    """Return where a candidate's lens predicts pins within the image that were not seen.

    Where a whole side is missing, the lattice may continue on either side: the board whose middle is nearest to that of the image
    is taken, which is likely but not certain, so that this serves to advise and not to calibrate.
    """
    nodes, size = sighting.lattice.nodes, np.array(lattice_size(board, sighting.mounting))
    grid = np.array([(column, row) for row in range(size[1]) for column in range(size[0])])
    ranges = (range(low, high + 1) for low, high in zip(nodes.max(axis=0) - size + 1, nodes.min(axis=0), strict=True))
    boards_px = [
        sighting.fit.lens.to_px(pin_positions_mm(grid + corner, board, sighting.mounting))
        for corner in product(*ranges)
    ]
    extent = np.array(shape[1::-1])
    nearest = min(boards_px, key=lambda px: float(np.hypot(*(px.mean(axis=0) - extent / 2))))
    apart_px = np.hypot(*(nearest[:, None] - seen_px[None]).transpose(2, 0, 1)).min(axis=1, initial=np.inf)
    pitch_px = float(np.median(np.hypot(*np.diff(nearest.reshape(size[1], size[0], 2), axis=1).reshape(-1, 2).T)))
    return nearest[(apart_px > pitch_px / 2) & ((nearest >= 0) & (nearest < extent)).all(axis=1)]


def _is_unambiguous(sighting: BoardCandidate, board: PinBoard) -> bool:
    """Return whether no other candidate could be better."""
    return len(sighting.lattice) == board.count and sighting.fit.leave_one_out_rms_mm < CLEAR * board.pitch_mm


def _generate_board_candidates(
    change: Float32[Array, "rows cols"], board: PinBoard, mounting: CameraRotation | Literal["auto"]
) -> Iterator[BoardCandidate]:
    """Yield, at each spot size, the board-sized part of all lattices and orientations that has most contrast."""
    middle = np.array(change.shape[::-1]) / 2
    for size in SIZES:
        lattices = find_pin_lattices(detect_dark_spots(change, size * max(change.shape)), middle)
        parts = [(one.window(*lattice_size(board, way)), way) for one in lattices for way in CAMERA_ROTATIONS[mounting]]
        if parts:
            part, way = max(parts, key=lambda one: one[0].score)
            if len(part) >= FEWEST_FOR_LENS:
                points_mm = pin_positions_mm(part.nodes, board, way)
                yield BoardCandidate(part, way, fit_lens_with_terms(points_mm, part.points_px, change.shape, 1))


UNTOUCHED = 4.0
"""Range of a smoothed change, in standard deviations of a pixel, below which there is no contact."""


class BoardNotFound(CalibrationError):
    """The pin board is not in the image, or too little of it. Holds what was detected, for a drawing."""

    def __init__(
        self,
        sentence: str,
        found: int,
        expected: int,
        detected_px: Points,
        change: Float32[Array, "rows cols"],
        missing_px: Float[Array, "missing 2"] | None = None,
    ) -> None:
        super().__init__(sentence)
        self.found, self.expected = found, expected
        self.detected_px, self.change = detected_px, change
        self.missing_px = np.empty((0, 2)) if missing_px is None else missing_px
        """Where the other pins are likely; empty where too little of the board was detected."""

    def with_drawing(self, path: Path) -> "BoardNotFound":
        """Return the same error, its message with the path of a drawing of what was detected."""
        sentence = f"{self}; what was detected is drawn in {path}"
        return BoardNotFound(sentence, self.found, self.expected, self.detected_px, self.change, self.missing_px)


def make_board_not_found_error(
    change: Float32[Array, "rows cols"], board: PinBoard, seen_px: Points, sighting: BoardCandidate | None = None
) -> BoardNotFound:
    """Return the error with advice; swapped images are distinguished from an image without contact."""
    if np.ptp(smooth_gaussian(change, 2.0)) < UNTOUCHED * estimate_pixel_noise(change):
        seen_px, advice = seen_px[:0], "nothing touched the skin: press the board while the second image is taken"
    elif _images_look_swapped(change, board, sighting):
        advice = "the images look swapped: give the image without contact as the reference"
    else:
        advice = "press harder, hold the board flatter so that all pins touch, and check that it is the design's board"
    words = f"expected {board.count} pins ({board.cols} x {board.rows}), found {len(seen_px)}; {advice}"
    missing_px = None
    if sighting is not None and len(seen_px) and is_plausible_board(sighting, board):
        missing_px = predict_missing_pins(sighting, board, seen_px, change.shape)
    return BoardNotFound(words, len(seen_px), board.count, seen_px, change, missing_px)


def _images_look_swapped(change: Float32[Array, "rows cols"], board: PinBoard, sighting: BoardCandidate | None) -> bool:
    """Return whether a whole board stands out brighter than the reference, more than any darker one."""
    inverted = find_board_candidate(-change, board, "auto")
    if inverted is None or not _is_unambiguous(inverted, board):
        return False
    return sighting is None or bool(np.median(inverted.lattice.strength) > np.median(sighting.lattice.strength))
