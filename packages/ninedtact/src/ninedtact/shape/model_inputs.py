"""Images as the inputs of published tactile models, prepared as their own code prepares them (docs/references.md).

`sparsh` (Higuera et al. 2024): difference to the image without contact plus one half, 8 bits, turned to portrait, 320 x 240 pixels,
0 to 1; the present image before that of five images earlier at 60 Hz, along the channels.
`htt` (Bi et al. 2026): difference to the image without contact over the standard deviation of each channel in its pretraining,
stretched to 224 x 224 pixels, as its code does with images of other sensors (its own are stored in this size); along a first axis
the image before and the present one, as in its pretraining, or the present one twice, as for its force and slip. The rate of its
images is not published.
`anytouch` (Feng et al. 2025): the image itself, stretched to 224 x 224 pixels, normalised as ImageNet; one image.

Channels are red, green, blue. The image is that on the skin's grid, and its grey levels are all three, because the light of these
sensors is white.
"""

from typing import Literal

import cv2
import numpy as np
from jaxtyping import Float32, UInt8
from numpy import ndarray as Array

from ninedtact.errors import InputError
from ninedtact.quantities import Rectified

TactileModel = Literal["sparsh", "htt", "anytouch"]
SPARSH_INTERVAL_MS, _SPARSH_TOLERANCE_MS = 5e3 / 60, 25.0
_SPARSH_SHAPE, _SIDE = (320, 240), 224
_HTT_STD = np.array([0.011171176143077726, 0.010200349792517646, 0.009436507924359806], np.float32)
_HTT_LEAST_STD = np.float32(1e-6)
_IMAGENET_MEAN = np.array([0.485, 0.456, 0.406], np.float32)
_IMAGENET_STD = np.array([0.229, 0.224, 0.225], np.float32)


def prepare_model_input(
    model: TactileModel, image: Rectified, reference: Rectified, earlier: Rectified | None
) -> Float32[Array, "..."]:
    """Return the input of a model, float32: `sparsh` (6, 320, 240), `htt` (2, 3, 224, 224), `anytouch` (3, 224, 224).

    reference: without contact. earlier: the other image of a pair; None takes the present one twice. Raises `InputError` for
    an earlier image that does not fit.
    """
    if model == "anytouch":
        _require(earlier is None, "no earlier image for anytouch", "one", "leave it out")
        grey = cv2.resize(_to_8_bits(image), (_SIDE, _SIDE), interpolation=cv2.INTER_AREA).astype(np.float32) / 255
        return np.stack([(grey - mean) / std for mean, std in zip(_IMAGENET_MEAN, _IMAGENET_STD, strict=True)])
    other = image if earlier is None else earlier
    if earlier is not None:
        _require_interval(model, (image.stamp_ns - earlier.stamp_ns) / 1e6)
    if model == "sparsh":
        planes = [_sparsh_plane(one, reference) for one in (image, other)]
        return np.repeat(np.stack(planes), 3, axis=0)
    differences = (_difference(one, reference) for one in (other, image))
    square = np.stack([cv2.resize(one, (_SIDE, _SIDE), interpolation=cv2.INTER_LINEAR) for one in differences])
    return np.asarray(square[:, None] / (_HTT_STD[:, None, None] + _HTT_LEAST_STD), np.float32)


def _sparsh_plane(image: Rectified, reference: Rectified) -> Float32[Array, "320 240"]:
    shifted = (np.clip(_difference(image, reference) + 0.5, 0, 1) * 255).astype(np.uint8)
    rows, cols = shifted.shape
    upright = cv2.rotate(shifted, cv2.ROTATE_90_CLOCKWISE) if rows < cols else shifted
    size = _SPARSH_SHAPE[::-1]
    return np.asarray(cv2.resize(upright, size, interpolation=cv2.INTER_AREA), np.float32) / np.float32(255)


def _difference(image: Rectified, reference: Rectified) -> Float32[Array, "rows cols"]:
    """Return the change of brightness, −1 to 1."""
    return (_to_8_bits(image).astype(np.float32) - _to_8_bits(reference)) / np.float32(255)


def _to_8_bits(image: Rectified) -> UInt8[Array, "rows cols"]:
    return np.clip(np.rint(image.grey), 0, 255).astype(np.uint8)


def _require_interval(model: TactileModel, interval_ms: float) -> None:
    if model == "htt":
        _require(interval_ms > 0, "the image before for htt", f"one {-interval_ms:.0f} ms later", "exchange them")
        return
    _require(
        abs(interval_ms - SPARSH_INTERVAL_MS) <= _SPARSH_TOLERANCE_MS,
        f"an image {SPARSH_INTERVAL_MS:.0f} ± {_SPARSH_TOLERANCE_MS:.0f} ms earlier for sparsh",
        f"one {interval_ms:.0f} ms earlier",
        "keep readings for as long",
    )


def _require(is_met: bool, expected: str, got: str, remedy: str) -> None:
    if not is_met:
        raise InputError(expected=expected, got=got, remedy=remedy)
