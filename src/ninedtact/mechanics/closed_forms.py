"""Contacts with an answer in closed form, to check the solver against. A rigid object presses with a load, N, to a depth, mm.

Half-spaces: Johnson, Contact Mechanics (1985), docs/references.md. Thin layers bonded to a rigid base: the leading term in
thickness / contact radius, from what `bonded_layer` is to long waves.
"""

from dataclasses import dataclass

import numpy as np

from ninedtact.design import Gel

SQUARE_LATTICE_SUM = 3.900264920
"""Minus the sum of 1/r over a square lattice of unit pitch, the middle and the mean left out: −4 ζ(½) β(½) (Borwein et
al. 2013, docs/references.md)."""


@dataclass(frozen=True)
class BallContactSolution:
    """A ball pressed in."""

    load_n: float
    radius_mm: float
    """Of the contact."""
    peak_mpa: float
    """Pressure in its middle."""


def _contact_modulus_mpa(gel: Gel) -> float:
    """E* = E / (1 − ν²) of gel under something rigid."""
    return 2 * gel.shear_modulus_mpa / (1 - gel.poisson_ratio)


def hertz_contact(gel: Gel, ball_radius_mm: float, depth_mm: float) -> BallContactSolution:
    """A ball on a half-space (Hertz; Johnson §4.2)."""
    radius = float(np.sqrt(ball_radius_mm * depth_mm))
    load = 4 / 3 * _contact_modulus_mpa(gel) * radius * depth_mm
    return BallContactSolution(load, radius, 3 * load / (2 * np.pi * radius**2))


def flat_punch_load_n(gel: Gel, punch_radius_mm: float, depth_mm: float) -> float:
    """Load of a round flat punch on a half-space (Boussinesq; Johnson §3)."""
    return 2 * _contact_modulus_mpa(gel) * punch_radius_mm * depth_mm


def periodic_half_space_shortfall_mm(gel: Gel, load_n: float, side_mm: float) -> float:
    """By how much less a contact sinks in a periodic square of half-space, measured from its mean height, than it sinks
    alone, measured from far away: all its images stand 1/r apart."""
    return SQUARE_LATTICE_SUM * load_n / (np.pi * _contact_modulus_mpa(gel) * side_mm)


def mindlin_shear_force_n(gel: Gel, pressed: BallContactSolution, friction: float, drag_mm: float) -> float:
    """Shear force on a ball dragged along a half-space until it slips all over (Cattaneo, Mindlin; Johnson §7.2)."""
    nu, limit = gel.poisson_ratio, friction * pressed.load_n
    slip_at_mm = 3 * limit * (2 - nu) / (16 * gel.shear_modulus_mpa * pressed.radius_mm)
    return float(limit * (1 - max(1 - drag_mm / slip_at_mm, 0) ** 1.5))


def thin_layer_contact(gel: Gel, ball_radius_mm: float, depth_mm: float) -> BallContactSolution:
    """A ball on a layer much thinner than the contact is wide.

    If the gel is compressible it yields where it is pressed, like a mattress. If not, it must flow out from under the ball,
    and the pressure falls off like that of a squeezed film: −h³/(3G) ∇²p is the depth, p and its slope vanish at the edge.
    """
    stiff, h = gel.shear_modulus_mpa, gel.thickness_mm
    if gel.poisson_ratio < 0.5:
        spring = 2 * (1 - gel.poisson_ratio) / (1 - 2 * gel.poisson_ratio) * stiff / h
        radius = np.sqrt(2 * ball_radius_mm * depth_mm)
        return BallContactSolution(np.pi * spring * ball_radius_mm * depth_mm**2, float(radius), spring * depth_mm)
    radius = 2 * np.sqrt(ball_radius_mm * depth_mm)
    load = 2 * np.pi * stiff * ball_radius_mm**2 * (depth_mm / h) ** 3
    return BallContactSolution(load, float(radius), 3 * stiff * radius**4 / (32 * ball_radius_mm * h**3))
