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

from ninedtact.calibration.board.blobs import dark_blobs
from ninedtact.calibration.board.imprints import centred_mm, patches
from ninedtact.calibration.board.lattice import Lattice, find_lattices
from ninedtact.calibration.board.lens_fit import LensFit, fit_lens, fit_terms
from ninedtact.calibration.board.mounting import MOUNTINGS, Mounting, lattice_size, skin_points_mm
from ninedtact.calibration.brightness import (
    Image,
    noise_levels,
    relative_change,
    require_same_size,
    require_usable,
    smoothed,
)
from ninedtact.design import PinBoard
from ninedtact.errors import NinedtactError
from ninedtact.shape.lens import LensModel, Points, central_mm_per_px

SIZES = (1 / 107, 1 / 80, 1 / 160, 1 / 58, 1 / 213)
"""Spot sizes tried, as parts of the picture's long side, likeliest first (6, 8, 4, 11, 3 of 640 pixels)."""
FEWEST = 0.5
"""Part of the pins that a lattice must have to be looked at as the board."""
CLEAR = 0.08
"""Left-out error of the first lens, in pitches, under which a complete board needs no second opinion."""
LARGEST = 0.10
"""Its median over the pins, above which spots are no board: chance lattices lie near 0.2, real boards near 0.04."""
MOST_MISSING = 0.10
"""Part of the pins that may be predicted instead of seen."""
IMPRINT_RADIUS = 0.52
"""Disc in which a centre is sought, in pitches: as much as fits without the neighbours."""
FAINTEST = 0.12
"""Contrast of a pin, relative to the median pin, below which it is not seen."""
FAINTEST_NOISE = 1.5
"""The same, in standard deviations of a lightly smoothed pixel."""
MOST_OFFSET = 0.25
"""A centre farther than this from where the lens expects it, in pitches, is another thing."""
STRAY, STRAY_TIMES = 0.10, 5.0
"""A pin that the others miss by this many pitches and by this many times the median is not trusted (glare, dirt)."""
FEWEST_FOR_LENS = 9
UNTOUCHED = 4.0
"""Range of a smoothed change, in standard deviations of a pixel, below which nothing happened."""
REFINEMENTS = 4
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
    sighting = best_sighting(change, board, mounting)
    if sighting is None or not could_be_board(sighting, board):
        raise not_found(change, board, sighting.agreeing_px if sighting else np.empty((0, 2)), sighting)
    return refined(change, board, sighting)


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


def refined(change: Float32[Array, "rows cols"], board: PinBoard, sighting: Sighting) -> BoardFit:
    """Find imprint centres and lens in turn, and look again for pins not yet seen where the lens expects them."""
    cols, rows = lattice_size(board, sighting.mounting)
    nodes = np.array([(column, row) for row in range(rows) for column in range(cols)])
    points_mm = skin_points_mm(nodes, board, sighting.mounting)
    picture, noise, fit = smoothed(change, SMOOTHING_PX), noise_levels(change), sighting.fit
    strays = np.zeros(len(nodes), bool)
    for _ in range(REFINEMENTS):
        points_px, contrast, found = look(picture, fit.lens, points_mm, noise, board)
        found &= ~strays
        require_enough(change, board, nodes, found, points_px, sighting)
        fit = fit_lens(points_mm[found], points_px[found], fit.lens)
        strays[np.flatnonzero(found)[is_stray(fit, board)]] = True
    where = np.where(found[:, None], points_px, fit.lens.to_px(points_mm))
    return BoardFit(board, sighting.mounting, fit, nodes, points_mm, where, found, contrast, noise, change)


def look(
    picture: Float32[Array, "rows cols"], lens: LensModel, points_mm: Points, noise: float, board: PinBoard
) -> tuple[Points, Float[Array, " n"], Bool[Array, " n"]]:
    """Centre and contrast of the imprint at each pin's place, and whether it is one."""
    radius_mm = IMPRINT_RADIUS * board.pitch_mm
    seen_mm = centred_mm(picture, lens, points_mm, radius_mm)
    points_px = lens.to_px(seen_mm)
    contrast = patches(picture, lens, seen_mm, radius_mm).depth
    near = np.hypot(*(seen_mm - points_mm).T) < MOST_OFFSET * board.pitch_mm
    margin_px = board.pin_diameter_mm / 2 / central_mm_per_px(lens, board.pitch_mm)
    dark = contrast > max(FAINTEST * float(np.median(contrast)), FAINTEST_NOISE * noise)
    return points_px, contrast, dark & near & in_picture(points_px, picture.shape, margin_px)


def in_picture(points_px: Points, shape: tuple[int, ...], margin_px: float) -> Bool[Array, " n"]:
    """Whether a pin's own width around these pixels is inside the picture."""
    x, y = points_px.T
    rows, cols = shape
    return (x >= margin_px) & (y >= margin_px) & (x <= cols - 1 - margin_px) & (y <= rows - 1 - margin_px)


def is_stray(fit: LensFit, board: PinBoard) -> Bool[Array, " n"]:
    """Pins that all others contradict."""
    miss_mm = np.hypot(*fit.left_out_mm.T)
    return miss_mm > max(STRAY * board.pitch_mm, STRAY_TIMES * float(np.median(miss_mm)))


def require_enough(
    change: Float32[Array, "rows cols"],
    board: PinBoard,
    nodes: Int[Array, "n 2"],
    found: Bool[Array, " n"],
    points_px: Points,
    sighting: Sighting,
) -> None:
    """Refuse a board with too many pins missing, or with a whole side missing, which could then be any row."""
    last = nodes.max(axis=0)
    sides = [found[nodes[:, axis] == end].any() for axis in (0, 1) for end in (0, last[axis])]
    if (~found).sum() > MOST_MISSING * board.count or not all(sides):
        raise not_found(change, board, max(points_px[found], sighting.agreeing_px, key=len), sighting)


def not_found(
    change: Float32[Array, "rows cols"], board: PinBoard, seen_px: Points, sighting: Sighting | None = None
) -> BoardNotFound:
    """The refusal, in words that help: swapped pictures and no contact at all are told apart."""
    if np.ptp(smoothed(change, 2.0)) < UNTOUCHED * noise_levels(change):
        seen_px, advice = seen_px[:0], "nothing touched the skin: press the board while the second picture is taken"
    elif looks_swapped(change, board, sighting):
        advice = "the pictures look swapped: give the untouched one as the reference"
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
