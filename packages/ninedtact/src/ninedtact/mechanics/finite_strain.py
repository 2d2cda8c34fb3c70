"""Finite strain: what a neo-Hookean gel does differently from the linear layer when it is pressed deep.

Two corrections turn the contact of the linear gel into that of a neo-Hookean one: its tractions grow faster, and the skin around
the object is shaped differently. Their constants were fitted to axisymmetric finite elements of an incompressible gel under a
ball of two thicknesses to which the skin sticks, on a rigid base and on bases 3 to 40 times as stiff as the gel
(`benchmarks/finite_strain.py`; docs/mechanics.md has tables). The shape of the skin matters little for loads, but a calibration
that leaves it out attributes it to thinner gel and a deeper ball.
"""

from dataclasses import replace
from typing import Any

import numpy as np
from array_api_compat import device

from ninedtact.design import Gel
from ninedtact.mechanics.contact_result import Contact
from ninedtact.mechanics.numpy_or_torch_arrays import array_namespace_of, forward_transform, inverse_transform
from ninedtact.mechanics.skin import ScalarField

PRESSURE_STIFFENING = 1.7
"""With it, loads of balls of one and two thicknesses, down to the thickness on bases that yield, are right to 3 %."""
MODULUS_RATIOS = (0.0, 0.025, 0.05, 0.1, 0.2)
GROWTH = (0.254, 0.008, -0.047, 0.028, 0.03)
REDISTRIBUTION = (0.292, 0.288, 0.463, 1.008, 1.9)
TRANSPORT = (0.112, 0.108, 0.135, 0.235, 0.4)
"""Constants of `finite_strain_height_mm` for these moduli of the gel over that of the base; between them they are interpolated."""


def correct_for_finite_strain(contact: Contact) -> Contact:
    """Return the contact, or each of a batch, with the tractions and heights of its gel at finite strain (`Gel.finite_strain`)."""
    gel = contact.skin.gel
    if not gel.finite_strain:
        return contact
    stiffening = finite_strain_stiffening(contact.height_mm, contact.thickness_change_mm, gel)
    return replace(
        contact,
        pressure_mpa=contact.pressure_mpa * stiffening,
        shear_mpa=contact.shear_mpa * stiffening[..., None, :, :],
        height_mm=finite_strain_height_mm(contact),
    )


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


def finite_strain_height_mm(contact: Contact) -> ScalarField:
    """Return the height of the skin under and around an object; under the object it is the linear one.

    Around it the bulge b (the height where it is above zero) grows near the object and shrinks far from it, and is carried along
    by the skin that is pushed outwards: f [g s b − r s G(b) − t ∇·(b u)], where f is the share of finite strain, s the greatest
    thinning over the thickness, u the tangential displacement and G a Gaussian mean over one thickness. On a base that yields the
    bulge is wider and shrinks most of all.
    """
    gel, xp, height = contact.skin.gel, array_namespace_of(contact.height_mm), contact.height_mm
    change = sum(
        float(np.interp(gel.gel_to_base_modulus_ratio, MODULUS_RATIOS, constants)) * term
        for constants, term in zip(
            (GROWTH, REDISTRIBUTION, TRANSPORT), finite_strain_height_terms_mm(contact), strict=True
        )
    )
    return height + gel.finite_strain * xp.where(contact.pressure_mpa > 0, 0 * height, change)


def finite_strain_height_terms_mm(contact: Contact) -> tuple[ScalarField, ScalarField, ScalarField]:
    """Return the changes of height at finite strain for constants of one: the bulge grows, spreads and is carried along."""
    gel, grid, height = contact.skin.gel, contact.skin.grid, contact.height_mm
    xp = array_namespace_of(height)
    bulge = xp.where(height > 0, height, 0 * height)
    thinnest = xp.max(xp.max(-contact.thickness_change_mm, axis=-1, keepdims=True), axis=-2, keepdims=True)
    wave_x, wave_y = grid.wave_vectors
    mean = np.exp(-(wave_x**2 + wave_y**2) * gel.thickness_mm**2 / 2)
    spectrum = forward_transform(bulge, grid.shape) * xp.asarray(mean, dtype=height.dtype, device=device(height))
    smooth = inverse_transform(spectrum, grid.shape, grid.shape)
    carried = sum(
        _difference(xp, bulge * contact.tangential_mm[..., axis, :, :], -1 - axis, grid.pitch_mm) for axis in (0, 1)
    )
    strain = thinnest / gel.thickness_mm
    return strain * bulge, -strain * smooth, -carried


def _difference(xp: Any, field: ScalarField, axis: int, pitch_mm: float) -> ScalarField:
    """Return the central difference of a periodic field along one axis, per mm."""
    return (xp.roll(field, -1, axis=axis) - xp.roll(field, 1, axis=axis)) / (2 * pitch_mm)
