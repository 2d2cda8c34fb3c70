"""How light, gel, lens and mounting spread over sensors.

Light: ball presses on eight real sensors of five labs (docs/datasets.md; a ninth image was too poor), as logarithms, with
their correlations. There are few of them, so draws end at `REACH` standard deviations. Lens: three real sensors, fitted by
`WideLens` to 0.05 mm. Untouched images: the mean grey of nine sensors. The rest is what moulds, silicone and hands allow.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact.design import Gel, SensorDesign
from ninedtact.simulation.designed import AVERAGE, carried_light, designed_lens
from ninedtact.simulation.light import Light, saturating
from ninedtact.simulation.view import WideLens

FITTED = np.array(
    [
        (0.164, 0.33, 0.49, 0.012),
        (0.223, 0.53, 0.65, 0.008),
        (0.176, 0.42, 0.52, 0.014),
        (0.129, 0.25, 0.47, 0.009),
        (0.182, 0.44, 0.52, 0.018),
        (0.175, 0.32, 0.60, 0.010),
        (0.177, 0.35, 0.46, 0.008),
        (0.142, 0.41, 0.72, 0.006),
    ]
)
"""a_dark and a_bright per mm, scattering in mm, and the light lost everywhere; one row per real sensor."""
FITTED_AT_MM = 2.0
"""Depth of those presses: a_dark is the slope of the straight line to there."""
MEAN_DARKENING = 0.014
"""Of the whole view, in those presses: turns the lost light into `Light.global_dimming`."""
REACH = 2.0

Random = np.random.Generator


def fitted_light(rng: Random) -> Float[Array, "4"]:
    """One more row of `FITTED`."""
    logs = np.log(FITTED)
    root = np.linalg.cholesky(np.cov(logs.T))
    return np.asarray(np.exp(logs.mean(axis=0) + root @ within_reach(rng, 4)))


def within_reach(rng: Random, count: int) -> Float[Array, " count"]:
    """Standard normal numbers without the far tails."""
    return np.clip(rng.standard_normal(count), -REACH, REACH)


def drawn_light(rng: Random, thickness_mm: float, design: SensorDesign = AVERAGE) -> Light:
    """The light of one sensor with this gel, as of a published one with as much too thick a gel, carried to the design."""
    usual_mm = thickness_mm * (AVERAGE.gel.thickness_mm / design.gel.thickness_mm)
    return carried_light(usual_light(rng, usual_mm), design)


def usual_light(rng: Random, thickness_mm: float) -> Light:
    """The light of one published sensor."""
    secant, bright, scattering, lost = fitted_light(rng).tolist()
    saturation = float(np.exp(rng.uniform(np.log(0.2), np.log(3.5))))
    depth = np.array([-min(FITTED_AT_MM, 0.9 * thickness_mm)])
    bend = float(saturating(depth, saturation, thickness_mm)[0] / depth[0])
    nearness = float(np.clip(0.03 + 0.015 * within_reach(rng, 1)[0], 0, None))
    return Light(secant / bend, saturation, bright, scattering, lost / MEAN_DARKENING, nearness, thickness_mm)


def drawn_gel(rng: Random, meant: Gel = AVERAGE.gel) -> Gel:
    """Moulded to 2.5 ± 0.2 mm, or as exactly for its thickness; within a quarter of its modulus; keeping its volume or nearly."""
    thickness = meant.thickness_mm + 0.2 * (meant.thickness_mm / AVERAGE.gel.thickness_mm) * within_reach(rng, 1)[0]
    modulus = meant.shear_modulus_mpa * rng.uniform(0.75, 1.25)
    return Gel(float(thickness), float(modulus), meant.poisson_ratio - min(0.02, float(rng.exponential(0.004))))


def drawn_lens(rng: Random, design: SensorDesign = AVERAGE) -> WideLens:
    """A lens of the same make, and a skin mounted a little off its axis, turned and tilted."""
    bent, mean = 1 + 0.06 * within_reach(rng, 1)[0], designed_lens(design)
    pairs = iter((within_reach(rng, 6).reshape(3, 2) * np.array([[0.015], [0.008], [0.2]])).tolist())
    centre, tilt, offset = ((float(x), float(y)) for x, y in pairs)
    return replace(
        mean,
        mm_per_unit=mean.mm_per_unit * (1 + 0.01 * float(within_reach(rng, 1)[0])),
        radial=(mean.radial[0] * bent, mean.radial[1] * bent),
        centre=centre,
        tilt=tilt,
        turn_rad=0.012 * float(within_reach(rng, 1)[0]),
        offset_mm=offset,
    )
