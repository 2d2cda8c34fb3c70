"""Any stack of elastic layers on a rigid base, answered wave by wave.

The same `Compliance` as `bonded_layer`, for skins whose gel lies on something that yields. In each layer a wave of plane
strain is u_x = i U(z) e^{ikx}, u_z = W(z) e^{ikx} with four unknowns, two on waves that fade upwards and two on waves that fade
downwards; z is counted from the layer's own bottom. State (U, W, σ_zz/k, σ_xz/ik) and unknowns are free of units of length,
and every exponential is at most one, so that nothing overflows.
"""

from collections.abc import Sequence
from functools import partial

import numpy as np
from jaxtyping import Float64
from numpy import ndarray as Array

from ninedtact.design import Gel
from ninedtact.mechanics.gel import Compliance, ComplianceOf, MeanCompliance, WaveNumber, mean_compliance, with_mean
from ninedtact.mechanics.library import library_of

Waves = Float64[Array, " waves"]
States = Float64[Array, "waves 4 4"]
"""Rows: state; columns: unknowns of a layer."""


def layered(layers: Sequence[Gel]) -> ComplianceOf:
    """Compliance of layers bonded to each other and to a rigid base; the skin is on the first, the last is on the base."""
    return partial(stack_compliance, layers=tuple(layers))


def stack_compliance(wave_number: WaveNumber, layers: tuple[Gel, ...]) -> Compliance:
    """Compliance of a stack, at wave numbers of any shape; zero means the mean of the field. Solved in NumPy."""
    xp, waves = library_of(wave_number), np.asarray(wave_number, np.float64).ravel()
    no_wave = waves == 0
    k = np.where(no_wave, 1.0, waves)
    skin = states(k, layers[0], layers[0].thickness_mm)[:, :2] @ amplitudes(k, layers)[:, :4]
    answer = Compliance(normal=skin[:, 1, 0], along=skin[:, 0, 1], across=across(k, layers), coupling=skin[:, 0, 0])
    answer = with_mean(no_wave, answer, mean_of(layers))
    return Compliance(*(xp.asarray(field.reshape(wave_number.shape)) for field in vars(answer).values()))


def mean_of(layers: tuple[Gel, ...]) -> MeanCompliance:
    """Uniform loads go through all layers alike."""
    means = [mean_compliance(layer) for layer in layers]
    return MeanCompliance(sum(mean.normal for mean in means), sum(mean.along for mean in means))


def across(k: Waves, layers: tuple[Gel, ...]) -> Waves:
    """Compliance to shear across the wave: each layer adds to what is below it as a line of transmission does."""
    below = np.zeros_like(k)
    for layer in reversed(layers):
        stiff, fade = layer.shear_modulus_mpa * k, np.tanh(k * layer.thickness_mm)
        below = (fade / stiff + below) / (1 + stiff * below * fade)
    return below


def amplitudes(k: Waves, layers: tuple[Gel, ...]) -> Float64[Array, "waves unknowns 2"]:
    """Unknowns of all layers under σ_zz = 1 and under σ_xz = i on the skin.

    4n equations for each wave: loads on the skin, no step between layers, no displacement of the base.
    """
    size = 4 * len(layers)
    equations, loads = np.zeros((len(k), size, size)), np.zeros((len(k), size, 2))
    tops = [states(k, layer, layer.thickness_mm) for layer in layers]
    bottoms = [states(k, layer, 0.0) for layer in layers]
    equations[:, :2, :4] = tops[0][:, 2:]
    loads[:, 0, 0] = loads[:, 1, 1] = 1 / k
    for first, (above, below) in zip(range(0, size, 4), zip(bottoms[:-1], tops[1:], strict=True), strict=False):
        equations[:, first + 2 : first + 6, first : first + 8] = np.concatenate([above, -below], axis=2)
    equations[:, -2:, -4:] = bottoms[-1][:, :2]
    return np.linalg.solve(equations, loads)


def states(k: Waves, layer: Gel, z_mm: float) -> States:
    """State at a height in a layer for each of its unknowns: amplitudes and slopes of what fades downwards, then upwards."""
    columns = []
    for sign, fade in ((1, np.exp(k * (z_mm - layer.thickness_mm))), (-1, np.exp(-k * z_mm))):
        amplitude, slope = amplitude_and_slope(k * z_mm, sign, layer)
        columns += [amplitude * fade, slope * fade]
    return np.moveaxis(np.array(columns), -1, 0).swapaxes(1, 2)


def amplitude_and_slope(x: Waves, sign: int, layer: Gel) -> tuple[Float64[Array, "4 waves"], Float64[Array, "4 waves"]]:
    """(U, W, σ_zz/k, σ_xz/ik) of W = e^{±x} and of W = x e^{±x}, the exponential left out; x = kz."""
    nu, stiff, one = layer.poisson_ratio, layer.shear_modulus_mpa, np.ones_like(x)
    amplitude = np.array([sign * one, one, 2 * stiff * sign * one, 2 * stiff * one])
    slope = [3 - 4 * nu + sign * x, x, stiff * (2 - 4 * nu + 2 * sign * x), stiff * (sign * (4 - 4 * nu) + 2 * x)]
    return amplitude, np.array(slope)
