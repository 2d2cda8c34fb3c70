"""What one height map says in a few numbers: how deep, how large, how much, where."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32
from numpy import ndarray as Array

from ninedtact.quantities import HeightMap, HeightSource
from ninedtact.shape.surface import pixel_footprint_mm2, sightline_scale


@dataclass(frozen=True)
class ContactRule:
    """Which pixels count as touched: those beyond a threshold, in a region that somewhere goes deep."""

    at_least_mm: float = 0.05
    """Above what slow drift of the light and of the gel looks like, and one fiftieth of the gel's thickness."""
    noise_factor: float = 5.0
    """In standard deviations of a pixel: at 5, not one pixel in three million untouched ones passes by chance."""
    share_of_deepest: float = 0.25
    """Part of the greatest depth that a region must reach. What presses deep takes light away from everywhere, which
    looks like a shallow press far from it: up to 0.3 mm in the corners of a real image whose ball is 2 mm deep."""

    def threshold_mm(self, noise_mm: float) -> float:
        """The larger of the two."""
        return max(self.at_least_mm, self.noise_factor * noise_mm)


@dataclass(frozen=True)
class ShapeSummary:
    """The measures of one height map."""

    max_indentation_mm: float
    max_bulge_mm: float
    contact_area_mm2: float
    """On the untouched plane."""
    displaced_volume_mm3: float
    """Between the contact and the untouched plane."""
    contact_centre_mm: tuple[float, float] | None
    """x and y of the centre of the displaced volume; None where nothing touches."""
    contact_threshold_mm: float
    extrapolated_share: float
    """Part of the contact area that lies beyond what the calibration covered, 0 to 1."""


def summarise_shape(height: HeightMap, rule: ContactRule = ContactRule()) -> ShapeSummary:
    """Measure one height map; what is out of view does not count."""
    touched = contact_mask(height, rule)
    # Only inside the contact: rectified noise over the whole image adds up to cubic millimetres.
    area_mm2 = np.where(touched, pixel_footprint_mm2(height), np.float32(0))
    volume_mm3 = area_mm2 * np.where(touched, -height.z_mm, np.float32(0))
    return ShapeSummary(
        max_indentation_mm=max_indentation_mm(height),
        max_bulge_mm=max_bulge_mm(height),
        contact_area_mm2=float(area_mm2.sum(dtype=np.float64)),
        displaced_volume_mm3=float(volume_mm3.sum(dtype=np.float64)),
        contact_centre_mm=contact_centre_mm(height, volume_mm3),
        contact_threshold_mm=rule.threshold_mm(height.noise_mm),
        extrapolated_share=share(height.source == HeightSource.EXTRAPOLATED, touched),
    )


def contact_mask(height: HeightMap, rule: ContactRule = ContactRule()) -> Bool[Array, "rows cols"]:
    """Where the skin is pressed in by more than drift, noise and loss of light explain."""
    beyond = height.in_view & (height.z_mm < -rule.threshold_mm(height.noise_mm))
    deep = beyond & (height.z_mm <= -rule.share_of_deepest * max_indentation_mm(height))
    regions, number = cv2.connectedComponents(beyond.astype(np.uint8), connectivity=8)
    touched = np.zeros(regions, bool)
    touched[number[deep]] = True
    return np.asarray(touched[number])


def max_indentation_mm(height: HeightMap) -> float:
    """The deepest point in view, 0 where nothing is pressed in."""
    return max(0.0, -float(np.min(height.z_mm, where=height.in_view, initial=0)))


def max_bulge_mm(height: HeightMap) -> float:
    """The highest point in view, 0 where nothing bulges."""
    return float(np.max(height.z_mm, where=height.in_view, initial=0))


def contact_centre_mm(height: HeightMap, weight: Float32[Array, "rows cols"]) -> tuple[float, float] | None:
    """Weighted mean position of the skin, None without any weight."""
    total = weight.sum(dtype=np.float64)
    if total == 0:
        return None
    u, v = height.axes_mm
    moment = np.where(weight > 0, weight * sightline_scale(height), np.float32(0))
    along_x, along_y = moment.sum(axis=0, dtype=np.float64), moment.sum(axis=1, dtype=np.float64)
    return float(along_x @ u / total), float(along_y @ v / total)


def share(part: Bool[Array, "rows cols"], whole: Bool[Array, "rows cols"]) -> float:
    """How much of `whole` is `part`; 0 of nothing."""
    return float((part & whole).sum()) / max(float(whole.sum()), 1.0)
