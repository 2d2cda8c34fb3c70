"""What the camera sees of a skin that is not flat: one factor of brightness per point.

White light comes back from the translucent gel and is lost in the black one behind it, so thin gel is dark and thick gel
bright. The pressed image is the untouched one times

    (1 + c)·(1 + PSF ⊗ f(u))

u is the height of the skin, f its brightness law, PSF a Gaussian (light scatters in the gel), and c the light that the
whole image loses to what is dark. Below zero, f follows the reflectance St/(1 + St) of a scattering layer of thickness t
before black (Kubelka and Munk 1931, docs/references.md); above zero it is a line, whose slope is a fact of each sensor.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from array_api_compat import array_namespace
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact.design import require_positive
from ninedtact.errors import NinedtactError


class LightImpossible(NinedtactError):
    """A light that no sensor can have."""


@dataclass(frozen=True)
class Light:
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
    """Light lost everywhere, c, per mean darkening of the view."""
    nearness_per_mm: float = 0.05
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
            "nearness_per_mm",
        ):
            if not getattr(self, name) >= 0:
                raise LightImpossible(
                    f"expected light.{name} of zero or more, got {getattr(self, name)}; fit the sensor again"
                )

    def change(self, height_mm: Float[Any, "*shape"]) -> Float[Any, "*shape"]:
        """f(u): relative change of brightness where the skin is this high, before any scattering; NumPy or torch."""
        xp = array_namespace(height_mm)
        pressed = xp.clip(height_mm, -self.thickness_mm, 0.0)
        dark = saturating(pressed, self.saturation, self.thickness_mm) * self.darkening_per_mm
        return dark + self.brightening_per_mm * xp.clip(height_mm, 0.0, None)

    def loss(self, change: Float[Array, "*view"]) -> float:
        """c: what the whole image loses when this much of the view is darker."""
        return -self.global_dimming * float(np.maximum(-change, 0).mean())


def saturating(pressed_mm: Float[Any, "*shape"], saturation: float, thickness_mm: float) -> Float[Any, "*shape"]:
    """u(1 + s)/(1 + s(1 + u/h)): slope one at zero, steeper where the gel is thin."""
    return pressed_mm * (1 + saturation) / (1 + saturation * (1 + pressed_mm / thickness_mm))
