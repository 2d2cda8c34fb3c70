"""Scalar measures of one height map: maximum indentation and bulge, contact area, displaced volume, and the centre of the contact.
`contact_mask` decides by a `ContactRule` which pixels are in contact.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Int
from numpy import ndarray as Array

from ninedtact.quantities import HeightMap, HeightSource
from ninedtact.shape.surface import pixel_footprint_mm2


@dataclass(frozen=True)
class ContactRule:
    """The rule of which pixels are in contact: those beyond a threshold, in a connected region that somewhere is deep enough."""

    at_least_mm: float = 0.05
    """Smallest threshold. It exceeds the apparent height of slow drift of the light and of the gel, and is one fiftieth of the
    gel's thickness.
    """
    noise_factor: float = 5.0
    """Threshold in standard deviations of a pixel: at 5, not one pixel in three million without contact exceeds it by chance."""
    share_of_deepest: float = 0.25
    """Fraction of the maximum indentation that a region must reach. A deep press takes light away from the whole image, which looks
    like a shallow press far from it: up to 0.3 mm in the corners of a real image whose ball is 2 mm deep.
    """

    def threshold_mm(self, noise_mm: float) -> float:
        """Return the larger of the two thresholds."""
        return max(self.at_least_mm, self.noise_factor * noise_mm)


_NOTABLE_SHARE = 0.01
"""Share of the contact beyond the calibrated range from which it is worth a warning."""


@dataclass(frozen=True)
class ShapeSummary:
    """The measures of one height map."""

    max_indentation_mm: float
    max_bulge_mm: float
    contact_area_mm2: float
    """Area of the contact, projected on the undeformed plane."""
    displaced_volume_mm3: float
    """Volume between the contact and the undeformed plane."""
    contact_centre_mm: tuple[float, float] | None
    """x and y of the centre of the displaced volume; None where there is no contact."""
    contact_threshold_mm: float
    extrapolated_share: float
    """Fraction of the contact area that lies beyond the calibrated range, 0 to 1."""
    is_deepest_clipped: bool
    """Whether the skin is deeper somewhere than the depth curve goes, so that the maximum indentation is a lower limit."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """A sentence where depths, or a notable part of the contact, lie beyond the calibrated range."""
        clipped = ("the deepest place lies beyond the calibrated range, its depth is a lower limit",)
        share = (f"{self.extrapolated_share:.0%} of the contact lies beyond the calibrated range",)
        return (clipped if self.is_deepest_clipped else ()) + (
            share if self.extrapolated_share > _NOTABLE_SHARE else ()
        )


def summarise_shape(
    height: HeightMap, rule: ContactRule = ContactRule(), touched: Bool[Array, "rows cols"] | None = None
) -> ShapeSummary:
    """Return the measures of one height map; pixels out of view do not count. touched: its `contact_mask`, where it is known."""
    touched = contact_mask(height, rule) if touched is None else touched
    # The volume is summed inside the contact only, because rectified noise over the whole image adds up to cubic millimetres.
    at = np.flatnonzero(touched)
    area_mm2 = pixel_footprint_mm2(height).ravel()[at] if at.size else np.zeros(0, np.float32)
    volume_mm3 = area_mm2 * -height.z_mm.ravel()[at]
    return ShapeSummary(
        max_indentation_mm=max_indentation_mm(height),
        max_bulge_mm=max_bulge_mm(height),
        contact_area_mm2=float(area_mm2.sum(dtype=np.float64)),
        displaced_volume_mm3=float(volume_mm3.sum(dtype=np.float64)),
        contact_centre_mm=_weighted_centre_mm(height, at, volume_mm3),
        contact_threshold_mm=rule.threshold_mm(height.noise_mm),
        extrapolated_share=np.count_nonzero(height.source.ravel()[at] == HeightSource.EXTRAPOLATED) / max(at.size, 1),
        is_deepest_clipped=height.is_clipped,
    )


def contact_mask(height: HeightMap, rule: ContactRule = ContactRule()) -> Bool[Array, "rows cols"]:
    """Return the pixels at which the skin is indented by more than drift, noise and loss of light explain."""
    beyond = height.in_view & (height.z_mm < -rule.threshold_mm(height.noise_mm))
    deep = beyond & (height.z_mm <= -rule.share_of_deepest * max_indentation_mm(height))
    regions, number = cv2.connectedComponents(beyond.astype(np.uint8), connectivity=8)
    touched = np.zeros(regions, bool)
    touched[number[deep]] = True
    return np.asarray(touched[number])


def max_indentation_mm(height: HeightMap) -> float:
    """Return the deepest indentation of a height map, 0 where nothing is indented."""
    return max(0.0, -_extremes_mm(height)[0])


def max_bulge_mm(height: HeightMap) -> float:
    """Return the maximum height of bulges in view, 0 where nothing bulges."""
    return max(0.0, _extremes_mm(height)[1])


def _extremes_mm(height: HeightMap) -> tuple[float, float]:
    """Return the lowest and the highest height in view, which OpenCV finds ten times faster than numpy; zeros without a view."""
    return cv2.minMaxLoc(height.z_mm, height.in_view.view(np.uint8))[:2]


def _weighted_centre_mm(
    height: HeightMap, at: Int[Array, " n"], weight: Float32[Array, " n"]
) -> tuple[float, float] | None:
    """Return the weighted mean position of the skin at pixels, numbered row by row; None where all weights are zero."""
    total = weight.sum(dtype=np.float64)
    if total == 0:
        return None
    (u, v), cols = height.axes_mm, height.z_mm.shape[1]
    moment = weight.astype(np.float64) * (1 + height.z_mm.ravel()[at] / height.camera_distance_mm)
    return float(moment @ u[at % cols] / total), float(moment @ v[at // cols] / total)
