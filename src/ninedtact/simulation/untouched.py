"""A plausible untouched skin, for twins that have no image of one: eight white LEDs round a rectangle."""

import cv2
import numpy as np
from jaxtyping import Float, Float32
from numpy import ndarray as Array

from ninedtact.simulation.view import View

LED_PLACES_MM = [(x, y) for x in (-11.0, 0.0, 11.0) for y in (-8.5, 8.5)] + [(-13.5, 0.0), (13.5, 0.0)]
LED_REACH_MM = 9.0
"""Over which the light of one falls off; the gel scatters it."""
WAVE_PX = 200.0
"""Width of the clouds in gel and paint."""


def untouched_image(
    view: View,
    mean_grey: float = 160.0,
    unevenness: float = 0.02,
    cast: tuple[float, float, float] = (1.0, 1.0, 1.0),
    seed: int = 0,
) -> Float32[Array, "raw_rows raw_cols 3"]:
    """BGR image without noise.

    mean_grey: mean of the image. unevenness: standard deviation of its clouds, relative. cast: gain of B, G and R.
    """
    rng = np.random.default_rng(seed)
    light = led_light(view, rng) * (1 + clouds(view.raw_shape, unevenness, rng))
    colours = [light * gain * (1 + clouds(view.raw_shape, unevenness / 3, rng)) for gain in cast]
    image = np.stack(colours, axis=-1)
    return np.clip(image * (mean_grey / image.mean()), 0, 250).astype(np.float32)


def led_light(view: View, rng: np.random.Generator) -> Float[Array, "rows cols"]:
    """Light of all LEDs on the skin, each a little brighter or dimmer than the next."""
    x, y = view.plane_mm[..., 0].astype(float), view.plane_mm[..., 1].astype(float)
    strengths = rng.normal(1, 0.08, len(LED_PLACES_MM))
    fields = [
        strength / (1 + ((x - led[0]) ** 2 + (y - led[1]) ** 2) / LED_REACH_MM**2)
        for strength, led in zip(strengths, LED_PLACES_MM, strict=True)
    ]
    light = np.sum(fields, axis=0)
    return np.asarray(light / light.mean())


def clouds(shape: tuple[int, int], strength: float, rng: np.random.Generator) -> Float[Array, "rows cols"]:
    """Smooth random field with this standard deviation."""
    coarse = rng.normal(size=tuple(int(side / WAVE_PX) + 3 for side in shape))
    field = cv2.resize(coarse, shape[::-1], interpolation=cv2.INTER_CUBIC)
    return np.asarray(field * (strength / field.std()))
