"""The board's image as numbers to fit: brightness relative to untouched skin at points among the pins."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Float32
from numpy import ndarray as Array

from ninedtact.calibration.board.fit import BoardFit
from ninedtact.calibration.brightness import smoothed
from ninedtact.calibration.twin.observed import DIMMEST, SMOOTHING_PX
from ninedtact.quantities import Rectified
from ninedtact.shape.lens import Points
from ninedtact.shape.rectification import skin_grid_mm

AROUND = 0.6
"""How far around a pin the image is fitted, in pitches: up to half-way to the next one, and a little over."""
EVERY_PX = 3
"""Of rows and columns."""
LEAST_SPREAD = 0.1
"""Of the middle's pixels per square millimetre: a lens fitted to pins may fold the image over beyond the outermost."""


@dataclass(frozen=True)
class ObservedBoard:
    """Two rectified images, before and under the board."""

    before: Rectified
    after: Rectified
    board: BoardFit

    @cached_property
    def chosen(self) -> Bool[Array, "rows cols"]:
        """The pixels that are fitted: among the pins, and away from those that were not seen."""
        x, y = skin_grid_mm(self.before.grey.shape, self.before.mm_per_px)
        design, away = self.board.board, AROUND * self.board.board.pitch_mm
        half_x, half_y = ((count - 1) / 2 * design.pitch_mm + away for count in (design.cols, design.rows))
        among = (np.abs(x) < half_x) & (np.abs(y) < half_y)
        for pin_x, pin_y in self.board.points_mm[~self.board.found].tolist():
            among &= np.hypot(x - pin_x, y - pin_y) > away
        every = np.zeros_like(among)
        every[::EVERY_PX, ::EVERY_PX] = True
        among &= every
        among[among] = self.spread(np.column_stack([x[among], y[among]])) > LEAST_SPREAD
        return np.asarray(among)

    def spread(self, points_mm: Points) -> Float[Array, " n"]:
        """Pixels of the raw image per square millimetre there, over that in the middle; below zero where it is folded over."""
        lens = self.board.lens
        here, middle = (np.linalg.det(lens.px_per_mm(points)) for points in (points_mm, np.zeros((1, 2))))
        return np.asarray(here / middle)

    @cached_property
    def points_mm(self) -> Points:
        """Of the chosen pixels, as the lens has them that the images were rectified with."""
        axes = skin_grid_mm(self.before.grey.shape, self.before.mm_per_px)
        return np.column_stack([axis[self.chosen] for axis in axes]).astype(float)

    @cached_property
    def seen(self) -> Float[Array, " n"]:
        """Relative brightness of the chosen pixels."""
        ratio: Float32[Array, "rows cols"] = smoothed(
            self.after.grey / np.maximum(self.before.grey, DIMMEST), SMOOTHING_PX
        )
        return ratio[self.chosen].astype(float)

    @property
    def mean_grey(self) -> float:
        """Of the untouched image: what turns relative brightness into grey levels."""
        return float(self.before.grey.mean())

    def image(self, values: Float[Array, " n"]) -> Float[Array, "few_rows few_cols"]:
        """Values of the chosen pixels as a coarse image, not-a-number elsewhere."""
        whole = np.full(self.chosen.shape, np.nan)
        whole[self.chosen] = values
        return whole[::EVERY_PX, ::EVERY_PX]
