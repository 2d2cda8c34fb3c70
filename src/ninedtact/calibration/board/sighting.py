"""Is there a lattice in the image that may be the board, and where?

Lattices are grown from dark spots of every likely size; the one that holds most pins, best explained by a lens, is the
sighting that a closer look starts from.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float32
from numpy import ndarray as Array

from ninedtact.calibration.board.blobs import dark_blobs
from ninedtact.calibration.board.lattice import Lattice, find_lattices
from ninedtact.calibration.board.lens_fit import LensFit, fit_terms
from ninedtact.calibration.board.mounting import MOUNTINGS, Mounting, lattice_size, skin_points_mm
from ninedtact.design import PinBoard
from ninedtact.shape.lens import Points

SIZES = (1 / 107, 1 / 80, 1 / 160, 1 / 58, 1 / 213)
"""Spot sizes tried, as parts of the image's long side, likeliest first (6, 8, 4, 11, 3 of 640 pixels)."""
FEWEST = 0.5
"""Part of the pins that a lattice must have to be looked at as the board."""
CLEAR = 0.08
"""Left-out error of the first lens, in pitches, under which a complete board needs no second opinion."""
LARGEST = 0.10
"""Its median over the pins, above which spots are no board: chance lattices lie near 0.2, real boards near 0.04."""
FEWEST_FOR_LENS = 9


@dataclass(frozen=True)
class Sighting:
    """A lattice that may be the board, with a first lens."""

    lattice: Lattice
    mounting: Mounting
    fit: LensFit

    @property
    def miss_mm(self) -> float:
        """Median left-out error: how far from a lens this lattice is."""
        return float(np.median(np.hypot(*self.fit.left_out_mm.T)))

    @property
    def agreeing_px(self) -> Points:
        """Spots that lie where the lens through all of them puts them."""
        pitch_mm = np.hypot(*(self.fit.points_mm[1] - self.fit.points_mm[0]))
        return self.lattice.points_px[np.hypot(*self.fit.left_out_mm.T) < LARGEST * pitch_mm]

    @property
    def rank(self) -> tuple[int, float]:
        """More pins first, then the better lens."""
        return len(self.lattice), -self.miss_mm


def best_sighting(
    change: Float32[Array, "rows cols"], board: PinBoard, mounting: Mounting | Literal["auto"]
) -> Sighting | None:
    """The most complete, best explained lattice over all spot sizes and ways to lie."""
    best: Sighting | None = None
    for sighting in sightings(change, board, mounting):
        best = sighting if best is None or sighting.rank > best.rank else best
        if is_clear(best, board):
            break
    return best


def could_be_board(sighting: Sighting, board: PinBoard) -> bool:
    """Whether it is worth a closer look."""
    return sighting.miss_mm < LARGEST * board.pitch_mm and len(sighting.lattice) >= FEWEST * board.count


def is_clear(sighting: Sighting, board: PinBoard) -> bool:
    """Whether no other sighting could be better."""
    return len(sighting.lattice) == board.count and sighting.fit.left_out_rms_mm < CLEAR * board.pitch_mm


def sightings(
    change: Float32[Array, "rows cols"], board: PinBoard, mounting: Mounting | Literal["auto"]
) -> Iterator[Sighting]:
    """At each spot size, of all lattices and ways to lie, the board-sized part that gathers most contrast."""
    middle = np.array(change.shape[::-1]) / 2
    for size in SIZES:
        lattices = find_lattices(dark_blobs(change, size * max(change.shape)), middle)
        parts = [(one.window(*lattice_size(board, way)), way) for one in lattices for way in MOUNTINGS[mounting]]
        if parts:
            part, way = max(parts, key=lambda one: one[0].score)
            if len(part) >= FEWEST_FOR_LENS:
                points_mm = skin_points_mm(part.nodes, board, way)
                yield Sighting(part, way, fit_terms(points_mm, part.points_px, change.shape, 1))
