"""One press of the pin board → where every point of the skin appears in the picture.

    pictures → relative change → dark spots → lattice → lens → imprint centres on the skin → lens

Nothing here is a threshold that a person tunes: spots compete as lattices, and a lattice counts by how well a lens
explains it.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Float32, Int
from numpy import ndarray as Array

from ninedtact.calibration.blobs import dark_blobs
from ninedtact.calibration.brightness import (
    Image,
    noise_levels,
    relative_change,
    require_same_size,
    require_usable,
    smoothed,
)
from ninedtact.calibration.imprints import centred_px, patches
from ninedtact.calibration.lattice import Lattice, find_lattice
from ninedtact.calibration.lens_fit import LensFit, fit_lens, fit_terms
from ninedtact.calibration.mounting import MOUNTINGS, Mounting, lattice_size, skin_points_mm
from ninedtact.design import PinBoard
from ninedtact.errors import NinedtactError
from ninedtact.shape.lens import LensModel, Points

SIZES = (1 / 107, 1 / 80, 1 / 160, 1 / 58, 1 / 213)
"""Spot sizes tried, as parts of the picture's long side, likeliest first (6, 8, 4, 11, 3 of 640 pixels)."""
CLEAR_RMS = 0.04
"""Left-out error, in pitches, under which a complete board needs no second opinion."""
LARGEST_RMS = 0.10
"""Left-out error, in pitches, above which spots are no board: chance lattices lie near 0.2, real boards near 0.02."""
MOST_MISSING = 0.10
"""Part of the pins that may be predicted instead of seen."""
IMPRINT_RADIUS = 0.48
"""Disc in which a centre is sought, in pitches: as much as fits without the neighbours."""
FAINTEST = 0.12
"""Contrast of a pin, relative to the median pin, below which it is not seen."""
FAINTEST_NOISE = 1.5
"""The same, in standard deviations of a lightly smoothed pixel."""
REFINEMENTS = 3
SMOOTHING_PX = 1.0


class BoardNotFound(NinedtactError):
    """The pin board is not in the picture, or not enough of it."""

    def __init__(self, sentence: str, found: int, expected: int, seen_px: Points, change: Float32[Array, "rows cols"]):
        super().__init__(sentence)
        self.found, self.expected = found, expected
        self.seen_px, self.change = seen_px, change


@dataclass(frozen=True)
class BoardFit:
    """All pins of the board, and the lens that explains them."""

    board: PinBoard
    mounting: Mounting
    lens_fit: LensFit
    nodes: Int[Array, "n 2"]
    """Lattice node of every pin, (column, row) along the picture's axes."""
    points_mm: Points
    points_px: Points
    """Seen where `found`, predicted by the lens elsewhere."""
    found: Bool[Array, " n"]
    contrast: Float[Array, " n"]
    """Depth of each imprint in grey levels."""
    noise: float
    change: Float32[Array, "rows cols"]

    @property
    def lens(self) -> LensModel:
        """The fitted lens."""
        return self.lens_fit.lens

    @property
    def missing(self) -> list[str]:
        """Names of the pins that were predicted."""
        return [f"column {column + 1}, row {row + 1}" for column, row in self.nodes[~self.found].tolist()]


@dataclass(frozen=True)
class Sighting:
    """A lattice that may be the board, with a first lens."""

    lattice: Lattice
    mounting: Mounting
    fit: LensFit

    @property
    def rank(self) -> tuple[int, float]:
        """More pins first, then the better lens."""
        return len(self.lattice), -self.fit.left_out_rms_mm


def fit_board(
    reference: Image, press: Image, board: PinBoard, mounting: Mounting | Literal["auto"] = "auto"
) -> BoardFit:
    """Find the pins at sub-pixel accuracy and fit the lens; raises `BoardNotFound`, `PictureUnusable`.

    reference, press: raw pictures (rows, cols, 3) of the untouched and of the pressed skin, of one size.
    """
    require_same_size("board picture", reference, press)
    require_usable("board reference", reference)
    require_usable("board picture", press)
    change = relative_change(reference, press)
    return refined(change, board, best_sighting(change, board, mounting))


def best_sighting(
    change: Float32[Array, "rows cols"], board: PinBoard, mounting: Mounting | Literal["auto"]
) -> Sighting:
    """The most complete, best explained lattice over all spot sizes and ways to lie."""
    best: Sighting | None = None
    for sighting in sightings(change, board, mounting):
        best = sighting if best is None or sighting.rank > best.rank else best
        if len(best.lattice) == board.count and best.fit.left_out_rms_mm < CLEAR_RMS * board.pitch_mm:
            break
    return require_board(change, board, best)


def sightings(
    change: Float32[Array, "rows cols"], board: PinBoard, mounting: Mounting | Literal["auto"]
) -> Iterator[Sighting]:
    """Lattices large enough to be the board, at each spot size and in each orientation that the mounting allows."""
    middle = np.array(change.shape[::-1]) / 2
    for size in SIZES:
        lattice = find_lattice(dark_blobs(change, size * max(change.shape)), middle)
        for way in MOUNTINGS[mounting] if lattice else ():
            part = lattice.window(*lattice_size(board, way))
            if len(part) >= board.count / 2:
                points_mm = skin_points_mm(part.nodes, board, way)
                yield Sighting(part, way, fit_terms(points_mm, part.points_px, change.shape, 1))


def require_board(change: Float32[Array, "rows cols"], board: PinBoard, sighting: Sighting | None) -> Sighting:
    """Refuse what is not a board."""
    if sighting is None:
        raise not_found(change, board, 0, np.empty((0, 2)))
    if sighting.fit.left_out_rms_mm > LARGEST_RMS * board.pitch_mm:
        raise not_found(change, board, 0, sighting.lattice.points_px)
    return sighting


def refined(change: Float32[Array, "rows cols"], board: PinBoard, sighting: Sighting) -> BoardFit:
    """Find imprint centres and lens in turn, and look again for pins not yet seen where the lens expects them."""
    cols, rows = lattice_size(board, sighting.mounting)
    nodes = np.array([(column, row) for row in range(rows) for column in range(cols)])
    points_mm = skin_points_mm(nodes, board, sighting.mounting)
    picture, radius_mm = smoothed(change, SMOOTHING_PX), IMPRINT_RADIUS * board.pitch_mm
    fit = sighting.fit
    for _ in range(REFINEMENTS):
        points_px = centred_px(picture, fit.lens, fit.lens.to_px(points_mm), radius_mm)
        seen_mm = fit.lens.to_mm(points_px)
        contrast = patches(picture, fit.lens, seen_mm, radius_mm).depth
        found = is_pin(contrast, seen_mm - points_mm, noise_levels(change), board)
        require_enough(change, board, nodes, found, points_px)
        fit = fit_lens(points_mm[found], points_px[found], change.shape)
    where = np.where(found[:, None], points_px, fit.lens.to_px(points_mm))
    return BoardFit(
        board, sighting.mounting, fit, nodes, points_mm, where, found, contrast, noise_levels(change), change
    )


def is_pin(contrast: Float[Array, " n"], offset_mm: Points, noise: float, board: PinBoard) -> Bool[Array, " n"]:
    """Dark enough against noise and against the other pins, and near where the lens expects it."""
    enough = max(FAINTEST * float(np.median(contrast)), FAINTEST_NOISE * noise)
    return (contrast > enough) & (np.hypot(*offset_mm.T) < 0.25 * board.pitch_mm)


def require_enough(
    change: Float32[Array, "rows cols"],
    board: PinBoard,
    nodes: Int[Array, "n 2"],
    found: Bool[Array, " n"],
    points_px: Points,
) -> None:
    """Refuse a board with too many pins missing, or with a whole side missing, which could then be any row."""
    last = nodes.max(axis=0)
    sides = [found[nodes[:, axis] == end].any() for axis in (0, 1) for end in (0, last[axis])]
    if (~found).sum() > MOST_MISSING * board.count or not all(sides):
        raise not_found(change, board, int(found.sum()), points_px[found])


def not_found(change: Float32[Array, "rows cols"], board: PinBoard, found: int, seen_px: Points) -> BoardNotFound:
    """The refusal, in words that help: swapped pictures and no contact at all are told apart."""
    return BoardNotFound(
        f"expected {board.count} pins ({board.cols} x {board.rows}), found {found}; {advice(change, board)}",
        found,
        board.count,
        seen_px,
        change,
    )


def advice(change: Float32[Array, "rows cols"], board: PinBoard) -> str:
    """What to do about a board that was not found."""
    calm = smoothed(change, 2.0)
    if np.ptp(calm) < 4 * noise_levels(change):
        return "the two pictures show the same untouched skin: press the board on the gel while the second one is taken"
    if next(sightings(-change, board, "auto"), None) is not None:
        return "the pictures look swapped: give the untouched one as the reference"
    return (
        "press harder, hold the board flatter so that all pins touch, and check that the board's size is the design's"
    )
