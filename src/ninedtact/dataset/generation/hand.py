"""How a person presses: aims drawn anew for each station of a touch.

The numbers were tuned so that the wrenches have the percentiles of the real ones (`percentiles.py`); the wrenches themselves
are what the contact mechanics says.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from numpy import ndarray as Array

from ninedtact.design import SensingArea

Pair = tuple[float, float]
Random = np.random.Generator
PUBLISHED_MM = SensingArea().size_mm


@dataclass(frozen=True)
class Aim:
    """Where one station of a touch goes."""

    load_n: float
    shear_n: Float64[Array, "2"]
    twist_rad: float
    """From the turn that the object came down with."""
    tilt_rad: Float64[Array, "2"]


@dataclass(frozen=True)
class Hand:
    """What is aimed at: means and standard deviations."""

    load_n: Pair = (6.7, 2.8)
    load_within_n: Pair = (0.5, 11.5)
    shear_mean: Pair = (0.03, -0.085)
    """Of shear over load, along x and y: hands lean."""
    shear_spread: Pair = (0.125, 0.145)
    twist_deg: float = 3.0
    most_twist_deg: float = 20.0
    tilt_deg: float = 3.0
    most_tilt_deg: float = 10.0
    place_mm: Pair = (4.5, 3.2)
    """Of the object's middle from the sensor's, on the published sensing area; as much wider on a wider one."""
    stations: tuple[int, int] = (4, 8)
    """Fewest and most in one touch."""
    steps: int = 2
    """From one station to the next."""
    deepest: float = 0.75
    """Part of the gel's thickness at which a hand feels the base and stops."""

    def aim(self, rng: Random) -> Aim:
        """The next one."""
        load = float(np.clip(rng.normal(*self.load_n), *self.load_within_n))
        shear = load * rng.normal(self.shear_mean, self.shear_spread)
        most = np.array([self.most_twist_deg, self.most_tilt_deg, self.most_tilt_deg])
        angles = np.clip(rng.normal(0, (self.twist_deg, self.tilt_deg, self.tilt_deg)), -most, most)
        return Aim(load, shear, float(np.radians(angles[0])), np.radians(angles[1:]))

    def place(self, rng: Random, room_mm: Float64[Array, "2"], area_mm: Pair = PUBLISHED_MM) -> tuple[float, float]:
        """Where the object comes down on an area of this size, at most so far from the middle as there is room."""
        wider = np.divide(area_mm, PUBLISHED_MM)
        x, y = np.clip(rng.normal(0, self.place_mm * wider), -room_mm, room_mm).tolist()
        return x, y
