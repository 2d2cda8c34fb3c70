"""Dirt on lens, window or skin: spots that gel cannot make, replaced by their surroundings.

Dirt is darker or brighter than its surroundings with an edge that is steeper than scattered light allows.
"""

import cv2
import numpy as np
from jaxtyping import Float32, UInt8
from numpy import ndarray as Array

from ninedtact.shape.deblurring import block_means

MIN_DIRT_CONTRAST = 0.06
"""Smallest difference of brightness over a millimetre at which an edge is judged."""
_DIRT_CELL_PX = 2
_DIRT_BLUR, _DIRT_WINDOW = 0.8, np.ones((13, 13), np.uint8)
"""Smoothing and window of edges, in cells of dirt: the window is 1.3 mm wide."""
_STEEPEST = 0.25
"""Slope per cell over the contrast above which an edge is dirt. Pins pressed on real sensors reach 0.22, and presses on twins of
real sensors 0.14; specks of 10 to 40 % with an edge of up to 3 raw pixels reach 0.25 to 0.49."""
_LEAST_STEEP = 0.15
"""Slope per cell over the contrast of edges that go on from dirt."""
_CONTRAST_PER_NOISE = 40.0
"""Contrast, in medians of the slope, below which an edge may be noise or compression."""
_MAX_DIRT_SHARE = 0.15
"""Largest share of the view that is replaced: a hair across the view, with its rim, covers a tenth of it."""
_DIRT_RIM = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (7, 7))
_CLOSING = np.ones((3, 3), np.uint8)
_FILLING_SIGMAS, _MIN_FILLING_WEIGHT = (1.5, 3.0, 6.0, 12.0, 24.0), 0.1
_FILLING_BLURS, _FILLING_BLUR = 8, 2.0

Cells = Float32[Array, "few_rows few_cols"]
Grey = Float32[Array, "rows cols"]


def replace_dirt(grey: Grey, reference: Grey) -> tuple[Grey, int, int]:
    """Return the image with dirt replaced by its surroundings, the number of spots and their area in pixels."""
    ratio = block_means(grey, _DIRT_CELL_PX) / np.maximum(block_means(reference, _DIRT_CELL_PX), np.float32(1))
    mask, spots = _find_dirt(ratio)
    if not spots:
        return grey, 0, 0
    filled = _fill_from_surroundings(ratio, mask)
    rows, cols = grey.shape
    dirty, light = (
        cv2.resize(part, None, fx=_DIRT_CELL_PX, fy=_DIRT_CELL_PX, interpolation=how)[:rows, :cols]
        for part, how in ((mask, cv2.INTER_NEAREST), (filled, cv2.INTER_LINEAR))
    )
    return np.where(dirty > 0, light * reference, grey).astype(np.float32), spots, int((dirty > 0).sum())


def _find_dirt(ratio: Cells) -> tuple[UInt8[Array, "few_rows few_cols"], int]:
    """Return a mask that is not zero on dirt and its rim, and the number of spots."""
    smooth = cv2.GaussianBlur(ratio, (0, 0), _DIRT_BLUR)
    slope = cv2.magnitude(
        cv2.Sobel(smooth, cv2.CV_32F, 1, 0, ksize=1, scale=0.5), cv2.Sobel(smooth, cv2.CV_32F, 0, 1, ksize=1, scale=0.5)
    )
    nothing = np.zeros(ratio.shape, np.uint8)
    contrast = max(MIN_DIRT_CONTRAST, _CONTRAST_PER_NOISE * float(np.median(slope[::8, ::2])))
    if cv2.minMaxLoc(slope)[1] <= _STEEPEST * contrast:
        return nothing, 0
    # The morphological gradient is the difference of the largest and the smallest value in the window.
    local = cv2.morphologyEx(smooth, cv2.MORPH_GRADIENT, _DIRT_WINDOW)
    steepness = cv2.divide(slope, np.maximum(local, np.float32(contrast)))
    if cv2.minMaxLoc(steepness)[1] <= _STEEPEST:
        return nothing, 0
    edges = cv2.morphologyEx((steepness > _LEAST_STEEP).astype(np.uint8), cv2.MORPH_CLOSE, _CLOSING)
    _, label = cv2.connectedComponents(edges)
    steep = np.unique(label[(steepness > _STEEPEST) & (edges > 0)])
    outlines, _ = cv2.findContours(np.isin(label, steep).astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    mask = cv2.dilate(cv2.drawContours(nothing.copy(), outlines, -1, (255,), cv2.FILLED), _DIRT_RIM)
    if np.count_nonzero(mask) > _MAX_DIRT_SHARE * mask.size:
        return nothing, 0
    return np.asarray(mask, np.uint8), cv2.connectedComponents(mask)[0] - 1


def _fill_from_surroundings(ratio: Cells, mask: UInt8[Array, "few_rows few_cols"]) -> Cells:
    """Return the field with masked cells replaced by weighted means of their surroundings, which widen until they reach all.

    Blurring the filled cells a few times more takes the steps between the widths out and goes on with slopes from side to side.
    """
    filled, known = ratio.copy(), (mask == 0).astype(np.float32)
    missing = mask > 0
    for sigma in _FILLING_SIGMAS:
        weight = cv2.GaussianBlur(known, (0, 0), sigma)
        mean = cv2.GaussianBlur(ratio * known, (0, 0), sigma) / np.maximum(weight, np.float32(1e-6))
        reached = missing & (weight > _MIN_FILLING_WEIGHT)
        filled[reached] = mean[reached]
        missing &= ~reached
        if not missing.any():
            break
    filled[missing] = 1
    for _ in range(_FILLING_BLURS):
        filled[mask > 0] = cv2.GaussianBlur(filled, (0, 0), _FILLING_BLUR)[mask > 0]
    return filled
