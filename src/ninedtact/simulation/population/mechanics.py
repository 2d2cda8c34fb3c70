"""What lies below the skin.

Two of the three kinds are not what shape and force are estimated with, so that no figure rests on the same model being on
both sides.
"""

from dataclasses import replace
from functools import partial
from typing import Literal

import numpy as np

from ninedtact.design import Gel
from ninedtact.mechanics.contact import Contact
from ninedtact.mechanics.finite_strain import finite_strain_height_mm, finite_strain_traction_mpa
from ninedtact.mechanics.layer_compliance import ComplianceFunction, bonded_layer_compliance, layered_compliance

Kind = Literal["bonded", "compliant_base", "finite_strain"]
BASE_STIFFNESS = 10.0
"""Modulus of the transparent layer over that of the gel; Shore A 45 over Shore A 5 is about that."""


def drawn_base(rng: np.random.Generator, gel: Gel) -> Gel:
    """The transparent layer of one sensor, on a rigid window."""
    modulus = gel.shear_modulus_mpa * BASE_STIFFNESS * rng.uniform(0.8, 1.25)
    return Gel(float(rng.uniform(4.0, 8.0)), float(modulus), gel.poisson_ratio)


def compliance_below(gel: Gel, base: Gel | None) -> ComplianceFunction:
    """Of gel on a base, or on a rigid one where none is given."""
    return partial(bonded_layer_compliance, gel=gel) if base is None else layered_compliance((gel, base))


def felt(contact: Contact, kind: Kind, gel: Gel) -> Contact:
    """From the contact that the linear model solved to the one that is seen and weighed."""
    return finite_strain(contact, gel.thickness_mm) if kind == "finite_strain" else contact


def finite_strain(contact: Contact, thickness_mm: float) -> Contact:
    """Tractions of gel that stiffens where it is thin, heights that pile up (`mechanics.finite_strain`)."""
    height = contact.height_mm
    on_both_axes = height[..., None, :, :] + 0 * contact.shear_mpa
    return replace(
        contact,
        pressure_mpa=finite_strain_traction_mpa(contact.pressure_mpa, height, thickness_mm),
        shear_mpa=finite_strain_traction_mpa(contact.shear_mpa, on_both_axes, thickness_mm),
        height_mm=finite_strain_height_mm(height, thickness_mm),
    )
