"""Images of a video or folder in a light that is the same in all of them.

A lamp that flickers multiplies whole images. The skin that changes least over the sequence, once what is common to the view is
taken out, lies beside all contacts: its brightness over that in the reference images is the light of each image.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact.capture.frame_source import FrameSource
from ninedtact.quantities import Frame
from ninedtact.reference_frames import ReferenceFrames, brightness_on_cells
from ninedtact.robust_noise import noise_by_second_differences
from ninedtact.shape.calibrated_shape import MIN_LIT_GREY_LEVEL

_QUIET_SHARE = 0.25
"""Share of the lit cells that are taken to lie beside all contacts."""
_ROUNDS = 2
_LEAST_FLICKER = 0.002
"""Standard deviation of the light from image to image up to which all images are left as they are: half of it is measured
in steady light."""
_MOST_CHANGE = 0.2
"""Change of the light from which an image is left as it is, because it may show something else."""


class SteadyLight(FrameSource):
    """The images of a file, each over its light (`measure_light`)."""

    is_live = False

    def __init__(self, source: FrameSource, light: Float[Array, " n"]) -> None:
        self._source, self._light, self._next = source, light, 0
        self.name = source.name

    def open(self) -> None:
        """Open the file; raises what it raises."""
        self._source.open()
        self.recorded_hz, self._next = self._source.recorded_hz, 0

    def read(self) -> Frame:
        """Return the next image in steady light; raises what the file raises."""
        frame = self._source.read()
        light = self._light[self._next] if self._next < len(self._light) else 1.0
        self._next += 1
        if light == 1 or abs(light - 1) > _MOST_CHANGE:
            return frame
        return replace(frame, image=np.clip(np.rint(frame.image / light), 0, 255).astype(np.uint8))

    def close(self) -> None:
        """Close the file."""
        self._source.close()


def measure_light(references: ReferenceFrames) -> Float[Array, " n"]:
    """Return the light of every image of a sequence relative to its reference images; ones where it does not flicker."""
    images, reference = references.brightness, brightness_on_cells(references.frames)
    is_lit = reference > MIN_LIT_GREY_LEVEL
    if not is_lit.any():
        return np.ones(len(images))
    light = common_factor(images[:, is_lit] / reference[is_lit])
    return light if noise_by_second_differences(light, axis=0) > _LEAST_FLICKER else np.ones(len(images))


def common_factor(ratio: Float[Array, "n cells"]) -> Float[Array, " n"]:
    """Return the factor of every image that is common to the cells that change least besides.

    ratio: brightness of every image over the reference.
    """
    quiet, factor = ratio, np.median(ratio, axis=1)
    for _ in range(_ROUNDS):
        change = np.sqrt(np.mean((ratio / np.maximum(factor, 1e-3)[:, None] - 1) ** 2, axis=0))
        quiet = ratio[:, change <= np.quantile(change, _QUIET_SHARE)]
        factor = np.median(quiet, axis=1)
    return np.asarray(factor)
