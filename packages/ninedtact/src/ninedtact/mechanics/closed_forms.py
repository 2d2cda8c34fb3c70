"""Contact problems with a solution in closed form, to check the solver against. A rigid object presses with a load in N to a
depth in mm.

Half-spaces: Johnson, Contact Mechanics (1985), docs/references.md. Thin layers bonded to a rigid base: the leading term in
thickness / contact radius, from the limit of `bonded_layer_compliance` for long waves.
"""

from dataclasses import dataclass

import numpy as np

from ninedtact.design import Gel

SQUARE_LATTICE_SUM = 3.900264920
"""Minus the sum of 1/r over a square lattice of unit pitch without its origin and its mean: −4 ζ(½) β(½) (Borwein et
al. 2013, docs/references.md)."""


@dataclass(frozen=True)
class BallContactSolution:
    """Load, contact radius and peak pressure of a ball pressed into the skin."""

    load_n: float
    radius_mm: float
    """Radius of the contact."""
    peak_mpa: float
    """Pressure in the middle of the contact."""


def _contact_modulus_mpa(gel: Gel) -> float:
    """Return the contact modulus E* = E / (1 − ν²) of gel under a rigid object."""
    return 2 * gel.shear_modulus_mpa / (1 - gel.poisson_ratio)


def hertz_contact(gel: Gel, ball_radius_mm: float, depth_mm: float) -> BallContactSolution:
    """Return the contact of a ball with a half-space (Hertz; Johnson §4.2)."""
    radius = float(np.sqrt(ball_radius_mm * depth_mm))
    load = 4 / 3 * _contact_modulus_mpa(gel) * radius * depth_mm
    return BallContactSolution(load, radius, 3 * load / (2 * np.pi * radius**2))


def flat_punch_load_n(gel: Gel, punch_radius_mm: float, depth_mm: float) -> float:
    """Return the load of a round flat punch on a half-space (Boussinesq; Johnson §3)."""
    return 2 * _contact_modulus_mpa(gel) * punch_radius_mm * depth_mm


def periodic_half_space_shortfall_mm(gel: Gel, load_n: float, side_mm: float) -> float:
    """Return how much less deep a load sinks into a periodic square of half-space than it sinks alone.

    The periodic depth is measured from the mean height, the other from far away; each periodic image contributes 1/r.
    """
    return SQUARE_LATTICE_SUM * load_n / (np.pi * _contact_modulus_mpa(gel) * side_mm)


def mindlin_shear_force_n(gel: Gel, pressed: BallContactSolution, friction: float, drag_mm: float) -> float:
    """Return the shear force on a ball that is dragged along a half-space (Cattaneo, Mindlin; Johnson §7.2)."""
    nu, limit = gel.poisson_ratio, friction * pressed.load_n
    slip_at_mm = 3 * limit * (2 - nu) / (16 * gel.shear_modulus_mpa * pressed.radius_mm)
    return float(limit * (1 - max(1 - drag_mm / slip_at_mm, 0) ** 1.5))


def thin_layer_contact(gel: Gel, ball_radius_mm: float, depth_mm: float) -> BallContactSolution:
    """Return the contact of a ball with a layer that is much thinner than the contact is wide.

    Compressible gel yields where it is pressed, like independent springs. Incompressible gel must flow out from under the ball, and
    the pressure falls off like that of a squeezed film: −h³/(3G) ∇²p is the depth; p and its slope vanish at the edge.
    """
    stiff, h = gel.shear_modulus_mpa, gel.thickness_mm
    if gel.poisson_ratio < 0.5:
        spring = 2 * (1 - gel.poisson_ratio) / (1 - 2 * gel.poisson_ratio) * stiff / h
        radius = np.sqrt(2 * ball_radius_mm * depth_mm)
        return BallContactSolution(np.pi * spring * ball_radius_mm * depth_mm**2, float(radius), spring * depth_mm)
    radius = 2 * np.sqrt(ball_radius_mm * depth_mm)
    load = 2 * np.pi * stiff * ball_radius_mm**2 * (depth_mm / h) ** 3
    return BallContactSolution(load, float(radius), 3 * stiff * radius**4 / (32 * ball_radius_mm * h**3))
