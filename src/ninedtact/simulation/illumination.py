"""What the camera sees of a skin that is not flat: one factor of brightness per point.

White light comes back from the translucent gel and is lost in the black one behind it, so thin gel is dark and thick gel
bright. The pressed image is the untouched one times

    (1 + c)·(1 + PSF ⊗ f(u))

u is the height of the skin, f its brightness law, PSF a Gaussian (light scatters in the gel), and c the light that the
whole image loses to what is dark. Below zero, f follows the reflectance St/(1 + St) of a scattering layer of thickness t
before black (Kubelka and Munk 1931, docs/references.md); above zero it is a line, whose slope is a fact of each sensor.

A plausible untouched skin, for twins that have no image of one: eight white LEDs round a rectangle.
"""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from array_api_compat import array_namespace
from jaxtyping import Float, Float32
from numpy import ndarray as Array

from ninedtact.design import require_positive
from ninedtact.errors import NinedtactError
from ninedtact.simulation.pixel_map import PixelMap


class InvalidBrightnessModel(NinedtactError):
    """A light that no sensor can have."""


@dataclass(frozen=True)
class BrightnessModel:
    """The light of one sensor. Defaults are those of an average one."""

    darkening_per_mm: float = 0.13
    """Slope of the law where indentation begins."""
    saturation: float = 0.6
    """S times the thickness: how much faster the last millimetre darkens than the first; zero is a line."""
    brightening_per_mm: float = 0.4
    """Slope of the law where the gel bulges."""
    point_spread_mm: float = 0.45
    """Standard deviation of the point-spread."""
    global_dimming: float = 0.2
    """BrightnessModel lost everywhere, c, per mean darkening of the view."""
    inverse_distance_per_mm: float = 0.05
    """Inverse distance from which the skin seems to be looked at: pressed skin appears displaced outwards by height times
    place times this. Light comes from within the gel and is bent on its way, so it is not that of the camera alone."""
    thickness_mm: float = 2.5
    """Of the gel, as far as darkness is concerned."""

    def __post_init__(self) -> None:
        require_positive("light.thickness_mm", self.thickness_mm)
        for name in (
            "darkening_per_mm",
            "saturation",
            "brightening_per_mm",
            "point_spread_mm",
            "global_dimming",
            "inverse_distance_per_mm",
        ):
            if not getattr(self, name) >= 0:
                raise InvalidBrightnessModel(
                    f"expected light.{name} of zero or more, got {getattr(self, name)}; fit the sensor again"
                )

    def change(self, height_mm: Float[Any, "*shape"]) -> Float[Any, "*shape"]:
        """f(u): relative change of brightness where the skin is this high, before any scattering; NumPy or torch."""
        xp = array_namespace(height_mm)
        pressed = xp.clip(height_mm, -self.thickness_mm, 0.0)
        dark = saturating_response_mm(pressed, self.saturation, self.thickness_mm) * self.darkening_per_mm
        return dark + self.brightening_per_mm * xp.clip(height_mm, 0.0, None)

    def loss(self, change: Float[Array, "*view"]) -> float:
        """c: what the whole image loses when this much of the view is darker."""
        return -self.global_dimming * float(np.maximum(-change, 0).mean())


def saturating_response_mm(
    pressed_mm: Float[Any, "*shape"], saturation: float, thickness_mm: float
) -> Float[Any, "*shape"]:
    """u(1 + s)/(1 + s(1 + u/h)): slope one at zero, steeper where the gel is thin."""
    return pressed_mm * (1 + saturation) / (1 + saturation * (1 + pressed_mm / thickness_mm))


LED_POSITIONS_MM = [(x, y) for x in (-11.0, 0.0, 11.0) for y in (-8.5, 8.5)] + [(-13.5, 0.0), (13.5, 0.0)]
LED_REACH_MM = 9.0
"""Over which the light of one falls off; the gel scatters it."""
WAVE_PX = 200.0
"""Width of the clouds in gel and paint."""


def synthetic_reference_image(
    view: PixelMap,
    mean_grey: float = 160.0,
    unevenness: float = 0.02,
    cast: tuple[float, float, float] = (1.0, 1.0, 1.0),
    seed: int = 0,
) -> Float32[Array, "raw_rows raw_cols 3"]:
    """BGR image without noise.

    mean_grey: mean of the image. unevenness: standard deviation of its clouds, relative. cast: gain of B, G and R.
    """
    rng = np.random.default_rng(seed)
    light = _led_illumination(view, rng) * (1 + _smooth_random_field(view.raw_shape, unevenness, rng))
    colours = [light * gain * (1 + _smooth_random_field(view.raw_shape, unevenness / 3, rng)) for gain in cast]
    image = np.stack(colours, axis=-1)
    return np.clip(image * (mean_grey / image.mean()), 0, 250).astype(np.float32)


def _led_illumination(view: PixelMap, rng: np.random.Generator) -> Float[Array, "rows cols"]:
    """Light of all LEDs on the skin, each a little brighter or dimmer than the next."""
    x, y = view.plane_mm[..., 0].astype(float), view.plane_mm[..., 1].astype(float)
    strengths = rng.normal(1, 0.08, len(LED_POSITIONS_MM))
    fields = [
        strength / (1 + ((x - led[0]) ** 2 + (y - led[1]) ** 2) / LED_REACH_MM**2)
        for strength, led in zip(strengths, LED_POSITIONS_MM, strict=True)
    ]
    light = np.sum(fields, axis=0)
    return np.asarray(light / light.mean())


def _smooth_random_field(
    shape: tuple[int, int], strength: float, rng: np.random.Generator
) -> Float[Array, "rows cols"]:
    """Smooth random field with this standard deviation."""
    coarse = rng.normal(size=tuple(int(side / WAVE_PX) + 3 for side in shape))
    field = cv2.resize(coarse, shape[::-1], interpolation=cv2.INTER_CUBIC)
    return np.asarray(field * (strength / field.std()))
