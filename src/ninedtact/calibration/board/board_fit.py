"""One press of the pin board → where every point of the skin appears in the image.

    images → relative change → dark spots → lattice → lens → imprint centres on the skin → lens

Nothing here is a threshold that a person tunes: spots compete as lattices, and a lattice counts by how well a lens
explains it.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Float32, Int
from numpy import ndarray as Array

from ninedtact.calibration.board.detection import Sighting, best_sighting, could_be_board, not_found
from ninedtact.calibration.board.lattice import Mounting, lattice_size, skin_points_mm
from ninedtact.calibration.board.lens_fit import LensFit, fit_lens
from ninedtact.calibration.board.pin_imprints import is_stray, look
from ninedtact.calibration.brightness import (
    Image,
    noise_levels,
    relative_change,
    require_same_size,
    require_usable,
    smoothed,
)
from ninedtact.design import PinBoard
from ninedtact.shape.lens import LensModel, Points

MOST_MISSING = 0.10
"""Part of the pins that may be predicted instead of seen."""
REFINEMENTS = 4
SMOOTHING_PX = 1.0


@dataclass(frozen=True)
class BoardFit:
    """All pins of the board, and the lens that explains them."""

    board: PinBoard
    mounting: Mounting
    lens_fit: LensFit
    nodes: Int[Array, "n 2"]
    """Lattice node of every pin, (column, row) along the image's axes."""
    points_mm: Points
    points_px: Points
    """Seen where `found`, predicted by the lens elsewhere."""
    found: Bool[Array, " n"]
    contrast: Float[Array, " n"]
    """Depth of each imprint in grey levels."""
    noise: float
    change: Float32[Array, "rows cols"]
    refined: LensModel | None = None
    """A lens that the whole image told, not the imprints' centres alone (`calibration.board_press`)."""

    @property
    def lens(self) -> LensModel:
        """The fitted lens."""
        return self.lens_fit.lens if self.refined is None else self.refined

    @property
    def missing(self) -> list[str]:
        """Names of the pins that were predicted."""
        return [f"column {column + 1}, row {row + 1}" for column, row in self.nodes[~self.found].tolist()]


def fit_board(
    reference: Image, press: Image, board: PinBoard, mounting: Mounting | Literal["auto"] = "auto"
) -> BoardFit:
    """Find the pins at sub-pixel accuracy and fit the lens; raises `BoardNotFound`, `ImageUnusable`.

    reference, press: raw images (rows, cols, 3) of the untouched and of the pressed skin, of one size.
    """
    require_same_size("board image", reference, press)
    require_usable("board reference", reference)
    require_usable("board image", press)
    change = relative_change(reference, press)
    sighting = best_sighting(change, board, mounting)
    if sighting is None or not could_be_board(sighting, board):
        raise not_found(change, board, sighting.agreeing_px if sighting else np.empty((0, 2)), sighting)
    return refined(change, board, sighting)


def refined(change: Float32[Array, "rows cols"], board: PinBoard, sighting: Sighting) -> BoardFit:
    """Find imprint centres and lens in turn, and look again for pins not yet seen where the lens expects them."""
    cols, rows = lattice_size(board, sighting.mounting)
    nodes = np.array([(column, row) for row in range(rows) for column in range(cols)])
    points_mm = skin_points_mm(nodes, board, sighting.mounting)
    image, noise, fit = smoothed(change, SMOOTHING_PX), noise_levels(change), sighting.fit
    strays = np.zeros(len(nodes), bool)
    for _ in range(REFINEMENTS):
        points_px, contrast, found = look(image, fit.lens, points_mm, noise, board)
        found &= ~strays
        require_enough(change, board, nodes, found, points_px, sighting)
        fit = fit_lens(points_mm[found], points_px[found], fit.lens)
        strays[np.flatnonzero(found)[is_stray(fit, board)]] = True
    where = np.where(found[:, None], points_px, fit.lens.to_px(points_mm))
    return BoardFit(board, sighting.mounting, fit, nodes, points_mm, where, found, contrast, noise, change)


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
