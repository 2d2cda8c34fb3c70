"""Whether anything touches, and where.

Something touches where the image, smoothed over a millimetre, is darker than its noise could make it anywhere. The noise
is the image's own, so the rule needs no setting for a sensor that it has not seen.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32
from numpy import ndarray as Array

from ninedtact.force.traction.cells import BEYOND
from ninedtact.force.traction.observation import Observation

View = Float32[Array, "rows cols"]


@dataclass(frozen=True)
class Gate:
    """What counts as touched."""

    smoothing_cells: float = 1.5
    deviations: float = 9.0
    """Of the smoothed noise; the worst of 110 untouched images of 39 sensors came to 7.7."""
    least: float = 1e-3
    """Relative darkening (mm, where heights are observed) below which nothing counts: a reference is no better."""
    shallow_mm: float = 0.02
    shallow_part: float = 0.03
    """Of the deepest place: where the skin is less deep than this, and than `shallow_mm`, the gel is only drawn along."""
    deep_part: float = 0.1
    """Of the deepest place, that every part of a contact reaches somewhere."""
    deep_mm: float = 0.05
    dark_part: float = 0.5
    """Of the darkest place: what is darker than this is touched, however shallow the depth reader has it."""

    def touched(self, seen: Observation) -> View | None:
        """One where pressure may be, or nothing where nothing touches: what is pressed in, its parts deep enough to be more than
        noise, what is dark beyond doubt, and the rim of all that."""
        darker = self.darker(seen)
        if darker.max() <= self.noticed(seen):
            return None
        deepest_mm = max(-float(seen.z_mm[BEYOND:-BEYOND, BEYOND:-BEYOND].min()), 0.0)
        pressed = seen.z_mm < -max(self.shallow_mm, self.shallow_part * deepest_mm)
        deep = seen.z_mm < -max(self.deep_mm, self.deep_part * deepest_mm)
        dark = darker > max(self.noticed(seen), self.dark_part * float(darker.max()))
        return np.asarray(cv2.dilate((parts_with(pressed, deep) | dark).astype(np.float32), RIM))

    def darker(self, seen: Observation) -> View:
        """By how much every place is darker than the image's level, smoothed."""
        level = np.median(seen.change[seen.in_view > 0])
        return np.asarray(cv2.GaussianBlur((level - seen.change) * seen.in_view, (0, 0), self.smoothing_cells))

    def noticed(self, seen: Observation) -> float:
        """Smoothed darkening that is no noise."""
        return max(self.deviations * seen.noise / (2 * np.sqrt(np.pi) * self.smoothing_cells), self.least)


FAINT = 0.05
"""Of the largest pressure: less says nothing of what lies beyond."""
RIM = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
"""Skin at the rim of a contact may stand higher than the untouched plane."""


def parts_with(region: Bool[Array, "rows cols"], marks: Bool[Array, "rows cols"]) -> Bool[Array, "rows cols"]:
    """The connected parts of a region that hold a mark."""
    _, label = cv2.connectedComponents(region.astype(np.uint8), connectivity=4)
    return np.isin(label, np.unique(label[marks & region]))


def border_pressed(pressure: View, in_view: View) -> bool:
    """Whether pressure worth speaking of reaches a place that is not seen, or beside one."""
    unseen = cv2.dilate(1 - in_view, RIM)
    return bool(((pressure > FAINT * pressure.max()) & (unseen > 0)).any())
