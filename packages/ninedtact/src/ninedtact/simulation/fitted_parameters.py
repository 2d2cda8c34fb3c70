"""Distributions of the parameters that a calibration fits to real sensors, and how far a fitted sensor is from their middle."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact.design import Gel, SensorDesign
from ninedtact.simulation.gel_brightness import BrightnessModel
from ninedtact.simulation.twin import PUBLISHED_DESIGN, scale_brightness_to_design

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
    "global_dimming": LogNormal(1.05, 0.5),
    "relative_thickness": LogNormal(0.92, 0.22),
}
"""Distributions of the parameters that `ninedtact calibrate` fits to sensors of the published design; the last is the thickness
with which the gel acts over the designed one."""


def sample_clipped_normal(rng: np.random.Generator, count: int) -> Float[Array, " count"]:
    """Sample standard normal numbers, clipped at `REACH`."""
    return np.clip(rng.standard_normal(count), -REACH, REACH)


def deviation_from_population(light: BrightnessModel, gel: Gel, design: SensorDesign = PUBLISHED_DESIGN) -> float:
    """Return how far a fitted sensor is from the middle of the population: the root of the summed squares of the deviations of its
    parameters, each in standard deviations.

    Half of the sensors of the population are within 2.1, and 98 of 100 within 3.2.
    """
    published = scale_brightness_to_design(light, PUBLISHED_DESIGN, measured_on=design)
    found = {**vars(published), "relative_thickness": gel.thickness_mm / design.gel.thickness_mm}
    return float(np.linalg.norm([one.deviation(found[name]) for name, one in FITTED_PARAMETERS.items()]))
