"""Which of the pins are really seen, looked for where a lens expects them."""

import numpy as np
from jaxtyping import Bool, Float, Float32
from numpy import ndarray as Array

from ninedtact.calibration.board.imprints import centred_mm, patches
from ninedtact.calibration.board.lens_fit import LensFit
from ninedtact.design import PinBoard
from ninedtact.shape.lens import LensModel, Points, central_mm_per_px

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


def look(
    image: Float32[Array, "rows cols"], lens: LensModel, points_mm: Points, noise: float, board: PinBoard
) -> tuple[Points, Float[Array, " n"], Bool[Array, " n"]]:
    """Centre and contrast of the imprint at each pin's place, and whether it is one."""
    radius_mm = IMPRINT_RADIUS * board.pitch_mm
    seen_mm = centred_mm(image, lens, points_mm, radius_mm)
    points_px = lens.to_px(seen_mm)
    contrast = patches(image, lens, seen_mm, radius_mm).depth
    near = np.hypot(*(seen_mm - points_mm).T) < MOST_OFFSET * board.pitch_mm
    margin_px = board.pin_diameter_mm / 2 / central_mm_per_px(lens, board.pitch_mm)
    dark = contrast > max(FAINTEST * float(np.median(contrast)), FAINTEST_NOISE * noise)
    return points_px, contrast, dark & near & in_image(points_px, image.shape, margin_px)


def in_image(points_px: Points, shape: tuple[int, ...], margin_px: float) -> Bool[Array, " n"]:
    """Whether a pin's own width around these pixels is inside the image."""
    x, y = points_px.T
    rows, cols = shape
    return (x >= margin_px) & (y >= margin_px) & (x <= cols - 1 - margin_px) & (y <= rows - 1 - margin_px)


def is_stray(fit: LensFit, board: PinBoard) -> Bool[Array, " n"]:
    """Pins that all others contradict."""
    miss_mm = np.hypot(*fit.left_out_mm.T)
    return miss_mm > max(STRAY * board.pitch_mm, STRAY_TIMES * float(np.median(miss_mm)))
