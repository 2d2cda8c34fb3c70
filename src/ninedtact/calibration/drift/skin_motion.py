"""Where the untouched skin has moved in the raw image, from its fine structure: specks, bubbles, old imprints.

The structure is faint (a thousandth of the brightness) and yet tells a tenth of a pixel, because the whole image
votes. A change of scale is not sought: contours of the camera's own shading correction widen and narrow with the light
and would pass for one.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from ninedtact.calibration.brightness import DIMMEST, Image, grey_float
from ninedtact.calibration.drift.registration import Field, Motion, registered, tiles, undone

LONG_SIDE_PX = 320
"""Images are compared at this size, at which the structure is still well sampled."""
FINE_PX, COARSE_PX = 1.5, 6.0
"""Structure between these sizes: finer is camera noise and compression, coarser is light."""
BAND_NOISE = 0.171
"""What this band leaves of white noise: √(1/4πa² + 1/4πb² - 1/π(a² + b²)) for Gaussians a and b."""
RECOGNISED = 0.3
"""Likeness above which two images show one skin: at least 0.4 for one skin (compressed, noisy, or at half the light
too), at most 0.25 for different ones."""
FAINTEST_STRUCTURE = 7e-4
"""Contrast below which a skin is too even to be recognised: real ones have at least 1.0e-3, a rendered one 5e-4."""


@dataclass(frozen=True)
class SkinMotion:
    """How the skin lies in one image against another: pixels (x, y) of the raw image."""

    shift_px: tuple[float, float]
    """Of the middle of the image."""
    turn_deg: float
    """Clockwise on the screen."""
    shift_error_px: float
    """Standard error, of the worse axis."""
    turn_error_deg: float
    likeness: float
    """Correlation of the fine structure, once the motion is undone."""
    contrast: float
    """Standard deviation of the structure in the earlier image, part of the brightness, noise taken off."""

    @property
    def observable(self) -> bool:
        """Whether the skin has enough structure to be recognised by."""
        return self.contrast >= FAINTEST_STRUCTURE

    @property
    def recognised(self) -> bool:
        """Whether the two images show the same skin, so that the motion means something."""
        return self.observable and self.likeness >= RECOGNISED

    def undone(self, image: Image) -> Image:
        """The later image as it would be without the motion, borders repeated."""
        return undone(image, self.vector(image.shape))

    def kept(self, shape: tuple[int, ...]) -> Field:
        """Above zero where the image without the motion shows what the camera saw."""
        return undone(np.ones(shape[:2], np.float32), self.vector(shape), cv2.BORDER_CONSTANT)

    def vector(self, shape: tuple[int, ...]) -> Motion:
        """As `registration` has it; none where the skin was not recognised."""
        turn_px = np.deg2rad(self.turn_deg) * shape[1] / 2
        return np.array([*self.shift_px, turn_px]) * self.recognised


def skin_motion(before: Image, after: Image) -> SkinMotion:
    """The motion from one untouched image to another of the same size."""
    earlier, later = brightness(before), brightness(after)
    found = registered(structure(earlier), structure(later))
    scale, half_width = max(before.shape) / LONG_SIDE_PX, earlier.shape[1] / 2
    x, y, turn = found.motion.tolist()
    return SkinMotion(
        (x * scale, y * scale),
        float(np.rad2deg(turn / half_width)),
        float(found.error[:2].max() * scale),
        float(np.rad2deg(found.error[2] / half_width)),
        found.likeness,
        contrast(earlier, later),
    )


def brightness(image: Image) -> Field:
    """Logarithm of the brightness, at the size of comparison."""
    grey = np.log(np.maximum(grey_float(image), DIMMEST))
    factor = LONG_SIDE_PX / max(grey.shape)
    return (
        grey if factor == 1 else np.asarray(cv2.resize(grey, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA))
    )


def structure(image: Field) -> Field:
    """What lies between two sizes of detail."""
    return np.asarray(cv2.GaussianBlur(image, (0, 0), FINE_PX) - cv2.GaussianBlur(image, (0, 0), COARSE_PX))


def contrast(earlier: Field, later: Field) -> float:
    """Strength of the earlier image's structure in the middle one of its tiles, without what noise adds."""
    second = np.abs(np.diff(later - earlier, n=2, axis=1))
    # 0.6745 and √6 as in `brightness.noise_levels`; √2 because two images' noise is in their difference.
    noise = BAND_NOISE * float(np.median(second)) / 0.6745 / np.sqrt(6) / np.sqrt(2)
    strength = float(np.median([tile.std() for tile in tiles(structure(earlier))]))
    return float(np.sqrt(max(strength**2 - noise**2, 0.0)))
