"""Compliance of elastic layers on a rigid base, wave by wave: one bonded layer in closed form, any stack of layers numerically.

A wave of pressure p̂ and shear traction q̂ on the skin, wave vector k = |k|·(e_x, e_y), displaces it by

    û_z = −N p̂ − i M (e·q̂)
    û_t = [L e eᵀ + S (1 − e eᵀ)] q̂ − i M e p̂

with N normal, L along, S across, M coupling, in mm/MPa. A Poisson ratio of 0.5, which rubber
comes close to, needs no special case. The closed form of N is Bentall and Johnson's (1968, docs/references.md); L, S and M
follow from the same four boundary conditions, and the numerical solution of a stack checks them.

In each layer of a stack a wave of plane strain is u_x = i U(z) e^{ikx}, u_z = W(z) e^{ikx} with four unknowns: two of waves
that fade upwards and two of waves that fade downwards; z is counted from the layer's own bottom. State (U, W, σ_zz/k, σ_xz/ik)
and unknowns are free of units of length, and every exponential is at most one, so that nothing overflows.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Float, Float64
from numpy import ndarray as Array

from ninedtact.design import Gel
from ninedtact.mechanics.contact_arrays import array_namespace_of

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


ComplianceFunction = Callable[[WaveNumbers], Compliance]
"""A function from wave numbers (1/mm, zero included) to the compliance there."""


def bonded_layer_compliance(wave_number: WaveNumbers, gel: Gel) -> Compliance:
    """Return the compliance of a layer of gel bonded to a rigid base (Bentall and Johnson 1968).

    wave_number: |k| in 1/mm, any shape, float64 advised; zero means the mean of the field. There a mean pressure moves
    the skin only as far as the gel is compressible, (1 − 2ν)h / (2(1 − ν)G), and a mean shear moves it by h/G.
    """
    xp, no_wave = array_namespace_of(wave_number), wave_number == 0
    wave = xp.where(no_wave, 1.0, wave_number)
    x = wave * gel.thickness_mm
    shape = _normalised_compliance(xp.where(x < _HALF_SPACE_FROM, x, _HALF_SPACE_FROM), gel.poisson_ratio)
    fields = (field / (gel.shear_modulus_mpa * wave) for field in shape)
    return _insert_mean(no_wave, Compliance(*fields), _mean_compliance_of_layer(gel))


def half_space_compliance(wave_number: WaveNumbers, gel: Gel) -> Compliance:
    """Return the compliance of gel of infinite thickness. Its mean displacement has no bound and is set to zero.

    Johnson, Contact Mechanics (1985), §3; docs/references.md.
    """
    xp, no_wave, nu = array_namespace_of(wave_number), wave_number == 0, gel.poisson_ratio
    unit = 1 / (gel.shear_modulus_mpa * xp.where(no_wave, 1.0, wave_number))
    waves = Compliance((1 - nu) * unit, (1 - nu) * unit, unit, -(1 - 2 * nu) / 2 * unit)
    return _insert_mean(no_wave, waves, _MeanCompliance(0.0, 0.0))


def layered_compliance(layers: Sequence[Gel]) -> ComplianceFunction:
    """Return the compliance function of layers bonded to each other and to a rigid base.

    layers: from the one that carries the skin to the one on the base.
    """
    return partial(_stack_compliance, layers=tuple(layers))


@dataclass(frozen=True)
class _MeanCompliance:
    """The displacement of the skin by a uniform load, in mm per MPa; a uniform load has no coupling."""

    normal: float
    along: float


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
    """Return the compliance of one layer to a uniform load."""
    nu, h_over_g = gel.poisson_ratio, gel.thickness_mm / gel.shear_modulus_mpa
    return _MeanCompliance((1 - 2 * nu) / (2 * (1 - nu)) * h_over_g, h_over_g)


def _mean_compliance_of_stack(layers: tuple[Gel, ...]) -> _MeanCompliance:
    """Return the compliance of a stack to a uniform load, which passes unchanged through all layers."""
    means = [_mean_compliance_of_layer(layer) for layer in layers]
    return _MeanCompliance(sum(mean.normal for mean in means), sum(mean.along for mean in means))


def _insert_mean(no_wave: Any, waves: Compliance, mean: _MeanCompliance) -> Compliance:
    """Return the compliance to waves, replaced by that to a uniform load where the wave number is zero."""
    xp, means = array_namespace_of(no_wave), (mean.normal, mean.along, mean.along, 0.0)
    return Compliance(*(xp.where(no_wave, *pair) for pair in zip(means, vars(waves).values(), strict=True)))


def _stack_compliance(wave_number: WaveNumbers, layers: tuple[Gel, ...]) -> Compliance:
    """Return the compliance of a stack at wave numbers of any shape; zero means the mean of the field. Solved in NumPy."""
    xp, waves = array_namespace_of(wave_number), np.asarray(wave_number, np.float64).ravel()
    no_wave = waves == 0
    k = np.where(no_wave, 1.0, waves)
    skin = _layer_states(k, layers[0], layers[0].thickness_mm)[:, :2] @ _layer_amplitudes(k, layers)[:, :4]
    compliance = Compliance(
        normal=skin[:, 1, 0], along=skin[:, 0, 1], across=_compliance_across_wave(k, layers), coupling=skin[:, 0, 0]
    )
    compliance = _insert_mean(no_wave, compliance, _mean_compliance_of_stack(layers))
    return Compliance(*(xp.asarray(field.reshape(wave_number.shape)) for field in vars(compliance).values()))


def _compliance_across_wave(k: _Waves, layers: tuple[Gel, ...]) -> _Waves:
    """Return S of a stack: each layer adds to the layers below it as a transmission line does."""
    below = np.zeros_like(k)
    for layer in reversed(layers):
        stiffness, fade = layer.shear_modulus_mpa * k, np.tanh(k * layer.thickness_mm)
        below = (fade / stiffness + below) / (1 + stiffness * below * fade)
    return below


def _layer_amplitudes(k: _Waves, layers: tuple[Gel, ...]) -> Float64[Array, "waves unknowns 2"]:
    """Return the unknowns of all layers under σ_zz = 1 and under σ_xz = i on the skin.

    4n equations for each wave: the loads on the skin, continuity between layers, and no displacement of the base.
    """
    size = 4 * len(layers)
    equations, loads = np.zeros((len(k), size, size)), np.zeros((len(k), size, 2))
    tops = [_layer_states(k, layer, layer.thickness_mm) for layer in layers]
    bottoms = [_layer_states(k, layer, 0.0) for layer in layers]
    equations[:, :2, :4] = tops[0][:, 2:]
    loads[:, 0, 0] = loads[:, 1, 1] = 1 / k
    for first, (above, below) in zip(range(0, size, 4), zip(bottoms[:-1], tops[1:], strict=True), strict=False):
        equations[:, first + 2 : first + 6, first : first + 8] = np.concatenate([above, -below], axis=2)
    equations[:, -2:, -4:] = bottoms[-1][:, :2]
    return np.linalg.solve(equations, loads)


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
