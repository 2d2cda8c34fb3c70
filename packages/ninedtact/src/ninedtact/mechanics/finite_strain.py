"""Finite strain: what a neo-Hookean gel does differently from the linear layer when it is pressed deep.

Two corrections turn the contact of the linear gel into that of a neo-Hookean one: its tractions grow faster, which also presses a
base that yields down further, and the gel around the object thickens differently. Their constants were fitted to axisymmetric
finite elements of an incompressible gel under a ball of two thicknesses to which the skin sticks, on a rigid base and on bases 3
to 20 times as stiff as the gel (`benchmarks/finite_strain.py`; docs/mechanics.md has tables). In three-dimensional finite elements
of dragged balls, what shear thickens grows with the shear and does not spread, unlike what pressure thickens. The shape of the skin
matters little for loads, but a calibration that leaves it out attributes it to thinner gel and a deeper ball.
"""

from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from array_api_compat import device
from jaxtyping import Float32
from numpy import ndarray as Array

from ninedtact.design import Gel
from ninedtact.mechanics.contact_result import Contact
from ninedtact.mechanics.numpy_or_torch_arrays import array_namespace_of, forward_transform, inverse_transform
from ninedtact.mechanics.skin import PeriodicGrid, ScalarField, VectorField

PRESSURE_STIFFENING = 1.7
"""With it, loads of balls of one and two thicknesses, down to the thickness on bases that yield, are right to 3 %."""
MODULUS_RATIOS = (0.0, 0.05, 0.1, 0.2, 0.333)
GROWTH = (0.254, 0.146, 0.151, 0.112, 0.074)
REDISTRIBUTION = (0.292, 0.42, 0.576, 0.741, 0.932)
TRANSPORT = (0.112, 0.0, 0.0, 0.0, 0.0)
"""Constants of `finite_strain_thickening_mm` for these moduli of the gel over that of the base; between them they are
interpolated."""


def correct_for_finite_strain(contact: Contact) -> Contact:
    """Return the contact, or each of a batch, with the tractions and heights of its gel at finite strain (`Gel.finite_strain`).

    Under the object the skin stays where the object holds it. Around it, the skin lies on gel whose thickness is corrected, over a
    base that the larger tractions press down further. The gel thickens in proportion to the larger shear.
    """
    skin, gel = contact.skin, contact.skin.gel
    if not gel.finite_strain:
        return contact
    xp = array_namespace_of(contact.pressure_mpa)
    stiffening = finite_strain_stiffening(contact.height_mm, contact.thickness_change_mm, gel)
    pressure, shear = contact.pressure_mpa * stiffening, contact.shear_mpa * stiffening[..., None, :, :]
    change_by_pressure_mm = skin.thickness_change_by_pressure_mm(contact.pressure_mpa)
    greatest_thinning_mm = xp.max(xp.max(-contact.thickness_change_mm, axis=-1, keepdims=True), axis=-2, keepdims=True)
    thickening_mm = finite_strain_thickening_mm(
        change_by_pressure_mm, greatest_thinning_mm, gel, skin.grid, contact.tangential_mm
    )
    around_mm = contact.thickness_change_mm + gel.finite_strain * thickening_mm
    around_mm = around_mm + skin.operators.bulge_from_shear_mm(shear - contact.shear_mpa)
    around_mm = around_mm + skin.interface_height_mm(pressure, contact.shear_mpa)
    height_mm = xp.where(contact.pressure_mpa > 0, contact.height_mm, around_mm)
    return replace(contact, pressure_mpa=pressure, shear_mpa=shear, height_mm=height_mm)


def finite_strain_stiffening(height_mm: ScalarField, thickness_change_mm: ScalarField, gel: Gel) -> ScalarField:
    """Return the factor on pressure and shear of the linear gel: 1 + 1.7 f s², where the gel is thinner.

    f is the share of finite strain of the gel, and s = t²/(d h), with the thinning t, the depth d of the skin and the thickness
    h. On a rigid base t is d. On one that yields, the object has more room, and the gel is sheared less for the same thinning.
    """
    xp = array_namespace_of(height_mm)
    zero = 0 * height_mm
    thinning = xp.where(thickness_change_mm < 0, -thickness_change_mm, zero)
    if gel.has_rigid_base:
        strain = thinning / gel.thickness_mm
    else:
        depth = xp.where(height_mm < 0, -height_mm, zero)
        strain = (
            thinning
            / gel.thickness_mm
            * xp.where(depth > thinning, thinning / xp.where(depth > 0, depth, 1 + zero), 1 + zero)
        )
    return 1 + gel.finite_strain * PRESSURE_STIFFENING * strain**2


def finite_strain_thickening_mm(
    change_by_pressure_mm: ScalarField,
    greatest_thinning_mm: Any,
    gel: Gel,
    grid: PeriodicGrid,
    tangential_mm: VectorField | None = None,
) -> ScalarField:
    """Return by how much the gel around an object is thicker at full finite strain than that of the linear layer.

    What pressure thickens, b (`change_by_pressure_mm`, the change of thickness by pressure alone, where it is above zero), grows
    near the object and shrinks far from it, and on a rigid base is carried along by the skin that is pushed outwards:
    g s b − r s G(b) − t ∇·(b u). s is `greatest_thinning_mm` over the thickness, u the tangential displacement and G a Gaussian
    mean over one thickness. Without u the last term is left out.
    """
    terms = finite_strain_thickening_terms_mm(change_by_pressure_mm, greatest_thinning_mm, gel, grid, tangential_mm)
    constants = (
        float(np.interp(gel.gel_to_base_modulus_ratio, MODULUS_RATIOS, each))
        for each in (GROWTH, REDISTRIBUTION, TRANSPORT)
    )
    return sum(one * term for one, term in zip(constants, terms, strict=False))


def finite_strain_thickening_terms_mm(
    change_by_pressure_mm: ScalarField,
    greatest_thinning_mm: Any,
    gel: Gel,
    grid: PeriodicGrid,
    tangential_mm: VectorField | None = None,
) -> tuple[ScalarField, ...]:
    """Return the terms of `finite_strain_thickening_mm` for constants of one: what thickens grows, spreads, is carried along."""
    xp = array_namespace_of(change_by_pressure_mm)
    thicker = xp.where(change_by_pressure_mm > 0, change_by_pressure_mm, 0 * change_by_pressure_mm)
    mean = _gaussian_mean(grid, gel.thickness_mm)
    spectrum = forward_transform(thicker, grid.shape) * xp.asarray(mean, dtype=thicker.dtype, device=device(thicker))
    smooth = inverse_transform(spectrum, grid.shape, grid.shape)
    strain = greatest_thinning_mm / gel.thickness_mm
    if tangential_mm is None:
        return strain * thicker, -strain * smooth
    flows = ((thicker * tangential_mm[..., axis, :, :], -1 - axis) for axis in (0, 1))
    # Central differences of periodic fields.
    carried = sum((xp.roll(flow, -1, axis=by) - xp.roll(flow, 1, axis=by)) / (2 * grid.pitch_mm) for flow, by in flows)
    return strain * thicker, -strain * smooth, -carried


@lru_cache(maxsize=8)
def _gaussian_mean(grid: PeriodicGrid, sigma_mm: float) -> Float32[Array, "rows half"]:
    wave_x, wave_y = grid.wave_vectors
    return np.exp(-(wave_x**2 + wave_y**2) * sigma_mm**2 / 2).astype(np.float32)
