"""Compliance of a gel, wave by wave: bonded to a rigid base in closed form, or to a layer that yields.

A wave of pressure p̂ and shear traction q̂ on the skin, wave vector k = |k|·(e_x, e_y), displaces it by

    û_z = −N p̂ − i M (e·q̂)
    û_t = [L e eᵀ + S (1 − e eᵀ)] q̂ − i M e p̂

with N normal, L along, S across, M coupling, in mm/MPa. The interface between gel and base rises by −Nᵢ p̂ − i Mᵢ (e·q̂), so that the
gel's thickness changes by −(N − Nᵢ) p̂ − i (M − Mᵢ)(e·q̂). A Poisson ratio of 0.5, which rubber comes close to, needs no special
case. The closed form of N on a rigid base is Bentall and Johnson's (1968, docs/references.md); L, S and M follow from the same four
boundary conditions.

On a base that yields, a wave of plane strain in the gel is u_x = i U(z) e^{ikx}, u_z = W(z) e^{ikx} with four unknowns: two of
waves that fade upwards and two of waves that fade downwards; z is counted from the gel's bottom. There the gel moves as the base
does, which is a bonded layer itself. State (U, W, σ_zz/k, σ_xz/ik) and unknowns are free of units of length, and every
exponential is at most one, so that nothing overflows.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Float64
from numpy import ndarray as Array

from ninedtact.design import Gel
from ninedtact.mechanics.numpy_or_torch_arrays import array_namespace_of

WaveNumbers = Float[Any, "*waves"]

_HALF_SPACE_FROM = 40.0
"""The value of k·h from which the layer equals a half-space in all digits; cosh of larger values would overflow."""
_SERIES_BELOW = 0.02
"""The value of k·h below which N is computed from its series: the closed form subtracts nearly equal numbers."""

_Waves = Float64[Array, " waves"]
_States = Float64[Array, "waves 4 4"]
"""A matrix whose rows are the components of the state and whose columns are the unknowns of a layer."""


@dataclass(frozen=True)
class Compliance:
    """The compliance of the skin at some wave numbers, in mm per MPa."""

    normal: WaveNumbers
    """N: inward displacement by pressure, in mm/MPa."""
    along: WaveNumbers
    """L: displacement by shear along the wave vector."""
    across: WaveNumbers
    """S: displacement by shear across the wave vector."""
    coupling: WaveNumbers
    """M: between normal and tangential directions."""
    interface_normal: WaveNumbers
    """Nᵢ: inward displacement of the interface by pressure on the skin; zero on a rigid base."""
    interface_coupling: WaveNumbers
    """Mᵢ: inward displacement of the interface by shear on the skin; zero on a rigid base."""


ComplianceFunction = Callable[[WaveNumbers, Gel], Compliance]
"""A function from wave numbers (1/mm, zero included) and a gel to the compliance there."""


def gel_compliance(wave_number: WaveNumbers, gel: Gel) -> Compliance:
    """Return the compliance of a gel on its base, rigid or not.

    wave_number: |k| in 1/mm, any shape, float64 advised; zero means the mean of the field. There a mean pressure moves the skin
    only as far as gel and base are compressible, and a mean shear moves it by h/G of each.
    """
    return bonded_layer_compliance(wave_number, gel) if gel.has_rigid_base else _two_layer_compliance(wave_number, gel)


def bonded_layer_compliance(wave_number: WaveNumbers, gel: Gel) -> Compliance:
    """Return the compliance of a layer of gel bonded to a rigid base (Bentall and Johnson 1968).

    wave_number: |k| in 1/mm, any shape, float64 advised; zero means the mean of the field. There a mean pressure moves
    the skin only as far as the gel is compressible, (1 − 2ν)h / (2(1 − ν)G), and a mean shear moves it by h/G.
    """
    xp, no_wave = array_namespace_of(wave_number), wave_number == 0
    wave = xp.where(no_wave, 1.0, wave_number)
    x = wave * gel.thickness_mm
    shape = _normalised_compliance(xp.where(x < _HALF_SPACE_FROM, x, _HALF_SPACE_FROM), gel.poisson_ratio)
    fields = [field / (gel.shear_modulus_mpa * wave) for field in shape]
    fields += [0 * fields[0]] * 2  # the interface does not move
    return _insert_mean(no_wave, Compliance(*fields), _mean_compliance_of_layer(gel), _RIGID)


def half_space_compliance(wave_number: WaveNumbers, gel: Gel) -> Compliance:
    """Return the compliance of gel of infinite thickness. Its mean displacement has no bound and is set to zero.

    Johnson, Contact Mechanics (1985), §3; docs/references.md.
    """
    xp, no_wave, nu = array_namespace_of(wave_number), wave_number == 0, gel.poisson_ratio
    unit = 1 / (gel.shear_modulus_mpa * xp.where(no_wave, 1.0, wave_number))
    waves = Compliance((1 - nu) * unit, (1 - nu) * unit, unit, -(1 - 2 * nu) / 2 * unit, 0 * unit, 0 * unit)
    return _insert_mean(no_wave, waves, _RIGID, _RIGID)


@dataclass(frozen=True)
class _MeanCompliance:
    """The displacement of the skin by a uniform load, in mm per MPa; a uniform load has no coupling."""

    normal: float
    along: float


_RIGID = _MeanCompliance(0.0, 0.0)


def _normalised_compliance(
    x: WaveNumbers, poisson_ratio: float
) -> tuple[WaveNumbers, WaveNumbers, WaveNumbers, WaveNumbers]:
    """Return N, L, S and M times G·k: functions of x = kh (above zero, at most 40) and of the Poisson ratio alone."""
    xp, nu, big_k = array_namespace_of(x), poisson_ratio, 3 - 4 * poisson_ratio
    cosh, sinh = xp.cosh(2 * x), xp.sinh(2 * x)
    below = 2 * big_k * cosh + 4 * x**2 + 1 + big_k**2
    # 2K sinh 2x − 4x is computed in two parts, the first without its leading power, so that long waves keep all digits.
    risen = xp.where(x < _SERIES_BELOW, 4 / 3 * x**3 + 4 / 15 * x**5 + 8 / 315 * x**7, sinh - 2 * x)
    normal = (1 - nu) * (2 * big_k * risen + 4 * (big_k - 1) * x) / below
    along = (1 - nu) * (2 * big_k * sinh + 4 * x) / below
    coupling = (2 * x**2 - (1 - 2 * nu) * big_k * 2 * xp.sinh(x) ** 2) / below
    return normal, along, xp.tanh(x), coupling


def _mean_compliance_of_layer(gel: Gel) -> _MeanCompliance:
    nu, h_over_g = gel.poisson_ratio, gel.thickness_mm / gel.shear_modulus_mpa
    return _MeanCompliance((1 - 2 * nu) / (2 * (1 - nu)) * h_over_g, h_over_g)


def _insert_mean(no_wave: Any, waves: Compliance, mean: _MeanCompliance, base_mean: _MeanCompliance) -> Compliance:
    """Return the compliance to waves, replaced by that to a uniform load where the wave number is zero."""
    xp = array_namespace_of(no_wave)
    means = (mean.normal + base_mean.normal, *2 * (mean.along + base_mean.along,), 0.0, base_mean.normal, 0.0)
    return Compliance(*(xp.where(no_wave, *pair) for pair in zip(means, vars(waves).values(), strict=True)))


def _two_layer_compliance(wave_number: WaveNumbers, gel: Gel) -> Compliance:
    """Return the compliance of gel on a base that yields, at wave numbers of any shape. Solved in NumPy."""
    xp, base = array_namespace_of(wave_number), gel.base
    waves, places = np.unique(np.asarray(wave_number, np.float64), return_inverse=True)  # a grid has each many times
    no_wave = waves == 0
    k = np.where(no_wave, 1.0, waves)
    below = bonded_layer_compliance(k, base)
    top, bottom = (_layer_states(k, gel, z_mm) for z_mm in (gel.thickness_mm, 0.0))
    of_base = np.stack([below.coupling, below.along, below.normal, below.coupling], axis=-1).reshape(-1, 2, 2)
    joint = bottom[:, :2] - k[:, None, None] * of_base @ bottom[:, 2:]
    loads = np.broadcast_to(np.eye(4)[:, :2], (len(k), 4, 2)) / k[:, None, None]
    unknowns = np.linalg.solve(np.concatenate([top[:, 2:], joint], axis=1), loads)
    skin, interface = top[:, :2] @ unknowns, bottom[:, :2] @ unknowns
    stiffness, fade = gel.shear_modulus_mpa * k, np.tanh(k * gel.thickness_mm)
    compliance = Compliance(
        normal=skin[:, 1, 0],
        along=skin[:, 0, 1],
        across=(fade / stiffness + below.across) / (1 + stiffness * below.across * fade),  # a transmission line
        coupling=skin[:, 0, 0],
        interface_normal=interface[:, 1, 0],
        interface_coupling=interface[:, 1, 1],
    )
    compliance = _insert_mean(no_wave, compliance, *map(_mean_compliance_of_layer, (gel, base)))
    return Compliance(*(xp.asarray(field[places].reshape(wave_number.shape)) for field in vars(compliance).values()))


def _layer_states(k: _Waves, layer: Gel, z_mm: float) -> _States:
    """Return the state at a height in a layer for each unknown.

    The unknowns are amplitude and slope of the wave that fades downwards, then of the one that fades upwards.
    """
    columns = []
    for sign, fade in ((1, np.exp(k * (z_mm - layer.thickness_mm))), (-1, np.exp(-k * z_mm))):
        amplitude, slope = _wave_states(k * z_mm, sign, layer)
        columns += [amplitude * fade, slope * fade]
    return np.moveaxis(np.array(columns), -1, 0).swapaxes(1, 2)


def _wave_states(x: _Waves, sign: int, layer: Gel) -> tuple[Float64[Array, "4 waves"], Float64[Array, "4 waves"]]:
    """Return (U, W, σ_zz/k, σ_xz/ik) of W = e^{±x} and of W = x e^{±x} without the exponential; x = kz."""
    nu, stiffness, one = layer.poisson_ratio, layer.shear_modulus_mpa, np.ones_like(x)
    amplitude = np.array([sign * one, one, 2 * stiffness * sign * one, 2 * stiffness * one])
    slope = [
        3 - 4 * nu + sign * x,
        x,
        stiffness * (2 - 4 * nu + 2 * sign * x),
        stiffness * (sign * (4 - 4 * nu) + 2 * x),
    ]
    return amplitude, np.array(slope)
