"""The gel: an elastic layer bonded to a rigid base, answered wave by wave.

A wave of pressure p̂ and shear traction q̂ on the skin, wave vector k = |k|·(e_x, e_y), displaces it by

    û_z = −N p̂ − i M (e·q̂)
    û_t = [L e eᵀ + S (1 − e eᵀ)] q̂ − i M e p̂

with N normal, L along, S across, M coupling, in mm/MPa. A Poisson ratio of 0.5, which rubber
comes close to, needs no special case. The closed form of N is Bentall and Johnson's (1968, docs/references.md); L, S and M
follow from the same four boundary conditions, and `mechanics.layers` solves those numerically for any stack of layers.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from jaxtyping import Float

from ninedtact.design import Gel
from ninedtact.mechanics.library import library_of

WaveNumber = Float[Any, "*waves"]

FLAT = 40.0
"""k·h from which the layer is a half-space to the last digit; cosh of more would overflow."""
LONG = 0.02
"""k·h below which N is taken from its series: the closed form subtracts nearly equal numbers."""


@dataclass(frozen=True)
class Compliance:
    """Answer of the skin to one wave number each, mm per MPa."""

    normal: WaveNumber
    along: WaveNumber
    across: WaveNumber
    coupling: WaveNumber


@dataclass(frozen=True)
class MeanCompliance:
    """Answer of the skin to a uniform load, mm per MPa; without coupling."""

    normal: float
    along: float


ComplianceOf = Callable[[WaveNumber], Compliance]
"""From wave numbers (1/mm, zero included) to what they meet."""


def bonded_layer(wave_number: WaveNumber, gel: Gel) -> Compliance:
    """Compliance of the gel on a rigid base.

    wave_number: |k| in 1/mm, any shape, float64 advised; zero means the mean of the field. There a mean pressure moves
    the skin only as far as the gel is compressible, (1 − 2ν)h / (2(1 − ν)G), and a mean shear moves it by h/G.
    """
    xp, no_wave = library_of(wave_number), wave_number == 0
    wave = xp.where(no_wave, 1.0, wave_number)
    x = wave * gel.thickness_mm
    shape = dimensionless(xp.where(x < FLAT, x, FLAT), gel.poisson_ratio)
    fields = (field / (gel.shear_modulus_mpa * wave) for field in shape)
    return with_mean(no_wave, Compliance(*fields), mean_compliance(gel))


def dimensionless(x: WaveNumber, poisson_ratio: float) -> tuple[WaveNumber, WaveNumber, WaveNumber, WaveNumber]:
    """N, L, S and M times G·k: functions of x = kh (above zero, at most `FLAT`) and of the Poisson ratio alone."""
    xp, nu, big_k = library_of(x), poisson_ratio, 3 - 4 * poisson_ratio
    cosh, sinh = xp.cosh(2 * x), xp.sinh(2 * x)
    below = 2 * big_k * cosh + 4 * x**2 + 1 + big_k**2
    # 2K sinh 2x − 4x in two parts, the first without its leading power, so that long waves keep all their digits.
    risen = xp.where(x < LONG, 4 / 3 * x**3 + 4 / 15 * x**5 + 8 / 315 * x**7, sinh - 2 * x)
    normal = (1 - nu) * (2 * big_k * risen + 4 * (big_k - 1) * x) / below
    along = (1 - nu) * (2 * big_k * sinh + 4 * x) / below
    coupling = (2 * x**2 - (1 - 2 * nu) * big_k * 2 * xp.sinh(x) ** 2) / below
    return normal, along, xp.tanh(x), coupling


def mean_compliance(gel: Gel) -> MeanCompliance:
    """The answer of a layer to a uniform load."""
    nu, h_over_g = gel.poisson_ratio, gel.thickness_mm / gel.shear_modulus_mpa
    return MeanCompliance((1 - 2 * nu) / (2 * (1 - nu)) * h_over_g, h_over_g)


def with_mean(no_wave: Any, waves: Compliance, mean: MeanCompliance) -> Compliance:
    """The answer to waves, and where there is none, to a uniform load."""
    xp, means = library_of(no_wave), (mean.normal, mean.along, mean.along, 0.0)
    return Compliance(*(xp.where(no_wave, *pair) for pair in zip(means, vars(waves).values(), strict=True)))


def half_space(wave_number: WaveNumber, gel: Gel) -> Compliance:
    """Compliance of gel without a bottom. Its mean displacement has no bound; it is taken as zero.

    Johnson, Contact Mechanics (1985), §3; docs/references.md.
    """
    xp, no_wave, nu = library_of(wave_number), wave_number == 0, gel.poisson_ratio
    unit = 1 / (gel.shear_modulus_mpa * xp.where(no_wave, 1.0, wave_number))
    waves = Compliance((1 - nu) * unit, (1 - nu) * unit, unit, -(1 - 2 * nu) / 2 * unit)
    return with_mean(no_wave, waves, MeanCompliance(0.0, 0.0))
