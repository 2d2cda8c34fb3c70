"""The brightness of deformed gel, and the reference image of gel that nothing touches.

White light comes back from the translucent gel and is lost in the black one behind it, so thin gel is dark and thick gel
bright. The image of pressed gel is the reference image times

    (1 + c)·(1 + PSF ⊗ f(u))

u is the change of the gel's thickness, f the change of brightness with it, PSF a Gaussian (light scatters in the gel), and c the
dimming of the whole image, which loses light to its dark parts. Below zero, f follows the reflectance St/(1 + St) of a
scattering layer of thickness t in front of black (Kubelka and Munk 1931, docs/references.md). Above zero, f is a straight line,
whose slope is fitted for each sensor.

A twin that has no reference image gets a synthetic one: eight white LEDs around a rectangle, with faint clouds. Reflections of the
LEDs may lie over it (`GlarePatch`); their light does not come through the gel and stays the same under a contact.

`FITTED_PARAMETERS` are the distributions of the parameters that a calibration fits to real sensors.
"""

from dataclasses import dataclass, replace
from typing import Annotated, Any

import cv2
import numpy as np
from array_api_compat import array_namespace
from jaxtyping import Float, Float32
from msgspec import Meta
from numpy import ndarray as Array

from ninedtact.design import SensorDesign, require_positive
from ninedtact.errors import InputError
from ninedtact.simulation.pixel_to_skin_map import PixelToSkinMap


@dataclass(frozen=True)
class BrightnessModel:
    """How the brightness of one sensor's image follows the thickness of its gel. Defaults are those of an average sensor."""

    darkening_per_mm: Annotated[float, Meta(ge=0, le=5)] = 0.13
    """Slope of f where thinning begins."""
    saturation: Annotated[float, Meta(ge=0, le=100)] = 0.6
    """The product of S and the thickness: how much faster the last millimetre darkens than the first; zero gives a straight
    line."""
    brightening_per_mm: Annotated[float, Meta(ge=0, le=20)] = 0.4
    """Slope of f where the gel is thicker than untouched."""
    point_spread_mm: Annotated[float, Meta(ge=0, le=5)] = 0.45
    """Standard deviation of the point-spread."""
    global_dimming: Annotated[float, Meta(ge=0, le=10)] = 1.05
    """Light that the whole image loses, c, per mean darkening of the view."""
    inverse_distance_per_mm: Annotated[float, Meta(ge=0, le=1)] = 0.05
    """Inverse of the apparent viewing distance: pressed skin appears displaced outwards by its height times its distance from
    the axis times this. Light comes from within the gel and is refracted, so the camera's position alone does not give it."""
    thickness_mm: Annotated[float, Meta(ge=0.1, le=20)] = 2.5
    """Thickness of the gel that f assumes."""

    def __post_init__(self) -> None:
        require_positive("light.thickness_mm", self.thickness_mm)
        for name, value in vars(self).items():
            if not value >= 0:
                raise InputError(
                    expected=f"light.{name} of zero or more", got=f"{value}", remedy="fit the sensor again"
                )

    def brightness_change(self, thickness_change_mm: Float[Any, "*shape"]) -> Float[Any, "*shape"]:
        """Return f(u), the relative change of brightness at changes of thickness of any shape, before scattering; NumPy or
        torch."""
        xp = array_namespace(thickness_change_mm)
        pressed = xp.clip(thickness_change_mm, -self.thickness_mm, 0.0)
        dark = darkening_equivalent_height_mm(pressed, self.saturation, self.thickness_mm) * self.darkening_per_mm
        return dark + self.brightening_per_mm * xp.clip(thickness_change_mm, 0.0, None)

    def image_dimming(self, change: Float[Array, "*view"]) -> float:
        """Return c, the relative dimming of the whole image that these changes of brightness cause."""
        return -self.global_dimming * float(np.maximum(-change, 0).mean())


def darkening_equivalent_height_mm(
    pressed_mm: Float[Any, "*shape"], saturation: float, thickness_mm: float
) -> Float[Any, "*shape"]:
    """Return the height to which darkening is proportional: u(1 + s)/(1 + s(1 + u/h)).

    Its slope is one at u = 0, and steeper where the gel is thin.
    """
    return pressed_mm * (1 + saturation) / (1 + saturation * (1 + pressed_mm / thickness_mm))


@dataclass(frozen=True)
class GlarePatch:
    """A reflection of an LED in the window or the lens: a Gaussian patch of light on the image."""

    centre: tuple[float, float]
    """x and y, from −1 to 1 across the image."""
    width: float
    """Standard deviation, relative to half of the image's width."""
    strength: float
    """Brightness in the middle, relative to the mean brightness of the image."""


LED_POSITIONS_MM = [(x, y) for x in (-11.0, 0.0, 11.0) for y in (-8.5, 8.5)] + [(-13.5, 0.0), (13.5, 0.0)]
LED_REACH_MM = 9.0
"""Distance over which the light of one LED falls off; the gel scatters it."""
MAX_REFERENCE_GREY = 250.0
"""Grey level to which a reference image is limited, so that nothing in it is overexposed."""
WAVE_PX = 200.0
"""Width in pixels of the clouds that gel and paint show."""


def synthetic_reference_image(
    pixel_map: PixelToSkinMap,
    mean_grey: float = 160.0,
    unevenness: float = 0.02,
    cast: tuple[float, float, float] = (1.0, 1.0, 1.0),
    seed: int = 0,
    vignetting: float = 0.0,
) -> Float32[Array, "raw_rows raw_cols 3"]:
    """Return a plausible BGR reference image (0 to 255) without noise.

    mean_grey: mean of the image. unevenness: relative standard deviation of its clouds. cast: gains of B, G and R. vignetting:
    relative loss of light in the corners of the image, which grows with the square of the distance from its centre.
    """
    rng = np.random.default_rng(seed)
    shape = pixel_map.raw_shape
    light = _led_illumination(pixel_map, rng) * (1 + _smooth_random_field(shape, unevenness, rng))
    if vignetting:
        light = light * (1 - vignetting * _squared_image_radius(shape))
    colours = [light * gain * (1 + _smooth_random_field(shape, unevenness / 3, rng)) for gain in cast]
    image = np.stack(colours, axis=-1)
    return np.clip(image * (mean_grey / image.mean()), 0, MAX_REFERENCE_GREY).astype(np.float32)


def add_glare(
    image: Float32[Array, "raw_rows raw_cols 3"], patches: tuple[GlarePatch, ...]
) -> tuple[Float32[Array, "raw_rows raw_cols 3"], Float32[Array, "raw_rows raw_cols"] | None]:
    """Return the reference image with its reflections, and their share of the light of every pixel; None without patches."""
    if not patches:
        return image, None
    rows, cols, _ = image.shape
    y, x = np.mgrid[-rows / cols : rows / cols : rows * 1j, -1 : 1 : cols * 1j]  # in halves of the image's width
    glare = np.zeros((rows, cols))
    for patch in patches:
        squared = (x - patch.centre[0]) ** 2 + (y - patch.centre[1] * rows / cols) ** 2
        glare += patch.strength * image.mean() * np.exp(-squared / (2 * patch.width**2))
    bright = np.clip(image + glare[..., None], 0, MAX_REFERENCE_GREY).astype(np.float32)
    return bright, (1 - image.mean(axis=-1) / bright.mean(axis=-1)).astype(np.float32)


def _led_illumination(pixel_map: PixelToSkinMap, rng: np.random.Generator) -> Float[Array, "rows cols"]:
    """Return the light of all LEDs on the skin, with mean one; the LEDs differ a little in strength."""
    x, y = pixel_map.plane_mm[..., 0].astype(float), pixel_map.plane_mm[..., 1].astype(float)
    strengths = rng.normal(1, 0.08, len(LED_POSITIONS_MM))
    fields = [
        strength / (1 + ((x - led[0]) ** 2 + (y - led[1]) ** 2) / LED_REACH_MM**2)
        for strength, led in zip(strengths, LED_POSITIONS_MM, strict=True)
    ]
    light = np.sum(fields, axis=0)
    return np.asarray(light / light.mean())


def _squared_image_radius(shape: tuple[int, int]) -> Float[Array, "rows cols"]:
    """Return the square of the distance from the image's centre, one in the corners."""
    rows, cols = (np.linspace(-1, 1, side) ** 2 / 2 for side in shape)
    return np.asarray(rows[:, None] + cols)


def _smooth_random_field(
    shape: tuple[int, int], strength: float, rng: np.random.Generator
) -> Float[Array, "rows cols"]:
    coarse = rng.normal(size=tuple(int(side / WAVE_PX) + 3 for side in shape))
    field = cv2.resize(coarse, shape[::-1], interpolation=cv2.INTER_CUBIC)
    return np.asarray(field * (strength / field.std()))


PUBLISHED_DESIGN = SensorDesign()
"""The design of the sensors from which the default brightness model and lens were fitted."""


def brightness_model_for_design(design: SensorDesign) -> BrightnessModel:
    """Return the average brightness model, scaled to a design."""
    return transfer_brightness_model(BrightnessModel(), design)


def transfer_brightness_model(
    model: BrightnessModel, design: SensorDesign, measured_on: SensorDesign = PUBLISHED_DESIGN
) -> BrightnessModel:
    """Scale the brightness model of a sensor of one design to the gel and the camera distance of another."""
    thickness_mm, measured_mm = design.gel.thickness_mm, measured_on.gel.thickness_mm
    thicker = thickness_mm / measured_mm
    steeper = _reflectance_slope_per_mm(thickness_mm, model) / _reflectance_slope_per_mm(measured_mm, model)
    nearer = measured_on.camera.distance_mm / design.camera.distance_mm
    return replace(
        model,
        darkening_per_mm=model.darkening_per_mm * steeper,
        brightening_per_mm=model.brightening_per_mm * steeper,
        saturation=model.saturation * thicker,
        point_spread_mm=model.point_spread_mm * thicker,
        inverse_distance_per_mm=model.inverse_distance_per_mm * nearer,
        thickness_mm=model.thickness_mm * thicker,
    )


def _reflectance_slope_per_mm(thickness_mm: float, model: BrightnessModel) -> float:
    """Return the relative change per mm of the reflectance St/(1 + St) with the thickness t."""
    scattered = model.saturation / model.thickness_mm * thickness_mm
    return 1 / (thickness_mm * (1 + scattered))


REACH = 2.0
"""Standard deviations at which normal distributions are cut off, because the real sensors behind them are few."""


@dataclass(frozen=True)
class LogNormal:
    """A log-normal distribution of a positive parameter."""

    median: float
    spread: float
    """Standard deviation of the natural logarithm."""

    def deviation(self, value: float) -> float:
        """Return how many standard deviations a value is from the median."""
        return float(np.log(max(value, 1e-9) / self.median)) / self.spread

    def sample(self, rng: np.random.Generator) -> float:
        """Sample a value, at most `REACH` standard deviations from the median."""
        return float(self.median * np.exp(self.spread * sample_clipped_normal(rng, 1)[0]))


FITTED_PARAMETERS = {
    "darkening_per_mm": LogNormal(0.118, 0.30),
    "brightening_per_mm": LogNormal(0.39, 0.26),
    "point_spread_mm": LogNormal(0.48, 0.17),
    "global_dimming": LogNormal(0.6, 0.9),
    "relative_thickness": LogNormal(0.92, 0.22),
}
"""Distributions of the parameters that `ninedtact calibrate` fits to sensors of the published design; the last is the thickness
with which the gel acts over the designed one."""


def sample_clipped_normal(rng: np.random.Generator, count: int) -> Float[Array, " count"]:
    """Sample standard normal numbers, clipped at `REACH`."""
    return np.clip(rng.standard_normal(count), -REACH, REACH)
