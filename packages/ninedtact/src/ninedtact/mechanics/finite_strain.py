"""Finite strain: what a neo-Hookean gel does differently from the linear layer when it is pressed deep.

Three functions correct any contact of the linear layer: the load, the tractions and the heights. Their constants were fitted to
finite elements: a neo-Hookean, incompressible layer bonded to a rigid base, and a ball to which the skin sticks, pressed straight
in (`benchmarks/finite_strain.py`; docs/mechanics.md has tables and images). Other shapes, drags and twists were not fitted. For a
skin that slides, the linear load is within 4 % down to 1.7 mm in 2.5 mm of gel without a correction.

For a ball pressed straight in, `finite_strain_ball_change_mm` gives the change of height in the finite elements, from the table
`ball_at_finite_strain.npz`. The skin is lower at the edge of the contact, by up to 0.02 of the thickness, higher one thickness
beyond it, and lower again far out. The difference is small, but a calibration that leaves it out attributes it to thinner gel: it
finds the gel up to a sixth too thin and the ball up to 7 % too deep (`benchmarks/finite_strain_calibration.py`).
"""

from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import as_file, files
from typing import Any

import numpy as np
from array_api_compat import device
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact.mechanics.contact_arrays import array_namespace_of, forward_transform, inverse_transform
from ninedtact.mechanics.contact_result import Contact
from ninedtact.mechanics.indenter import BallUnderside, Indenter
from ninedtact.mechanics.skin import ScalarField

LOAD_STIFFENING = 0.81
PRESSURE_STIFFENING = 2.0
TRANSPORT, GROWTH, REDISTRIBUTION = 0.12, 0.24, 0.29
"""Constants of `finite_strain_height_mm`, fitted to balls of 1.2, 2 and 3.2 thicknesses, 0.1 to 0.8 thicknesses deep."""
MAX_FITTED_DEPTH_OVER_THICKNESS = 0.76
"""Depth over thickness up to which the constants of loads and tractions were fitted; beyond it they are extrapolated."""
TABLE_FILE = "ball_at_finite_strain.npz"
"""Finite elements less `ContactModel` with a friction coefficient of one; all lengths in units of the thickness."""


def finite_strain_load_factor(depth_over_thickness: Float[Any, "*any"]) -> Float[Any, "*any"]:
    """Return the ratio of the load of a ball to its linear load at a depth: exp(0.81 s²), s = depth / thickness.

    The error is within 1.3 % for the ball of the fit and 2 % for the two others; the factor grows from 1 to 1.59.
    """
    return array_namespace_of(depth_over_thickness).exp(LOAD_STIFFENING * depth_over_thickness**2)


def correct_for_finite_strain(
    contact: Contact, thickness_mm: float, indenter: Indenter | None = None, share: float = 1.0
) -> Contact:
    """Return the contact, or each of a batch, with the tractions and the heights of gel at finite strain.

    indenter: the object, where it is known; beside a ball the heights are those of the finite elements. share: part of the
    difference from the linear layer that is applied (`Gel.finite_strain`).
    """
    height = contact.height_mm
    on_both_axes = height[..., None, :, :] + 0 * contact.shear_mpa
    return replace(
        contact,
        pressure_mpa=finite_strain_traction_mpa(contact.pressure_mpa, height, thickness_mm, share),
        shear_mpa=finite_strain_traction_mpa(contact.shear_mpa, on_both_axes, thickness_mm, share),
        height_mm=height
        + _height_change_mm(contact, thickness_mm, (None,) if indenter is None else indenter.balls, share),
    )


def _height_change_mm(
    contact: Contact, thickness_mm: float, balls: tuple[BallUnderside | None, ...], share: float
) -> ScalarField:
    """Return this share of the change of height: beside a ball that of the finite elements, beside other shapes the fitted one."""
    xp, height = array_namespace_of(contact.height_mm), contact.height_mm
    if not any(balls):
        return share * (finite_strain_height_mm(contact, thickness_mm) - height)
    (x, y), depths_mm = (
        contact.skin.grid.positions_mm,
        np.broadcast_to(contact.pose.depth_mm, height.shape[:-2] or (1,)),
    )
    tabled = np.zeros((len(depths_mm), *x.shape))
    each = balls * len(depths_mm) if len(balls) == 1 else balls
    for index, (ball, depth_mm) in enumerate(zip(each, depths_mm.tolist(), strict=True)):
        if ball is not None:
            distance_mm = np.hypot(x - ball.x_mm, y - ball.y_mm)
            tabled[index] = finite_strain_ball_change_mm(distance_mm, ball.radius_mm, depth_mm, thickness_mm)
    change = share * xp.asarray(tabled.reshape(height.shape), dtype=height.dtype, device=device(height))
    if all(balls):
        return change
    is_ball = xp.asarray(np.array([ball is not None for ball in balls])[:, None, None], device=device(height))
    return xp.where(is_ball, change, share * (finite_strain_height_mm(contact, thickness_mm) - height))


def finite_strain_traction_mpa(
    pressure_mpa: ScalarField, height_mm: Float[Any, "... rows cols"], thickness_mm: float, share: float = 1.0
) -> ScalarField:
    """Return the linear pressure (or shear) times 1 + 2 f (height / thickness)² where the skin is pressed in.

    share: f, the part of the difference from the linear layer that is applied.

    The correction applies to any shape of object. For balls the sum of the corrected pressure is the load within 1.5 % (fit) and
    3.4 % (validation).
    """
    sunk = array_namespace_of(height_mm).where(height_mm < 0, height_mm, 0.0) / thickness_mm
    return pressure_mpa * (1 + share * PRESSURE_STIFFENING * sunk**2)


def finite_strain_height_mm(contact: Contact, thickness_mm: float) -> ScalarField:
    """Return the height of the skin under and around an object of any shape; under the object it is the linear one.

    Around it the bulge b (the height where it is above zero) grows near the object and shrinks far from it, and is carried along by
    the skin that is pushed outwards: 0.24 s b − 0.29 s G(b) − 0.12 ∇·(b u), where s is the greatest indentation over the thickness,
    u the tangential displacement and G a Gaussian mean over one thickness.
    """
    grown, redistributed, carried = finite_strain_height_terms_mm(contact, thickness_mm)
    change = GROWTH * grown + REDISTRIBUTION * redistributed + TRANSPORT * carried
    xp, height = array_namespace_of(contact.height_mm), contact.height_mm
    return height + xp.where(contact.pressure_mpa > 0, 0 * height, change)


def finite_strain_height_terms_mm(
    contact: Contact, thickness_mm: float
) -> tuple[ScalarField, ScalarField, ScalarField]:
    """Return the changes of height at finite strain, with constants of one: the bulge grows, spreads and is carried along."""
    xp, height, grid = array_namespace_of(contact.height_mm), contact.height_mm, contact.skin.grid
    bulge = xp.where(height > 0, height, 0 * height)
    deepest = xp.max(xp.max(-height, axis=-1, keepdims=True), axis=-2, keepdims=True) / thickness_mm
    wave_x, wave_y = grid.wave_vectors
    mean = np.exp(-(wave_x**2 + wave_y**2) * thickness_mm**2 / 2)
    spectrum = forward_transform(bulge, grid.shape) * xp.asarray(mean, dtype=height.dtype, device=device(height))
    smooth = inverse_transform(spectrum, grid.shape, grid.shape)
    carried = sum(
        _difference(xp, bulge * contact.tangential_mm[..., axis, :, :], -1 - axis, grid.pitch_mm) for axis in (0, 1)
    )
    return deepest * bulge, -deepest * smooth, -carried


def _difference(xp: Any, field: ScalarField, axis: int, pitch_mm: float) -> ScalarField:
    """Return the central difference of a periodic field along one axis, per mm."""
    return (xp.roll(field, -1, axis=axis) - xp.roll(field, 1, axis=axis)) / (2 * pitch_mm)


@dataclass(frozen=True)
class _BallTable:
    """Difference of height by radius of the ball, depth and distance from the ball's axis, all over the thickness."""

    ball_radius: Float[Array, " radii"]
    depth: Float[Array, " depths"]
    distance: Float[Array, " distances"]
    height: Float[Array, "radii depths distances"]

    def profile(self, ball_radius: float, depth: float) -> Float[Array, " distances"]:
        """Return the difference by distance: interpolated between radii and depths, the last slope continued beyond the depths."""
        (first, second), along = _interval(self.ball_radius, np.clip(ball_radius, *self.ball_radius[[0, -1]]))
        (upper, lower), down = _interval(self.depth, depth)
        between = (1 - along) * self.height[first] + along * self.height[second]
        return np.asarray((1 - down) * between[upper] + down * between[lower])


def finite_strain_ball_change_mm(
    distance_mm: Float[Array, "*any"], ball_radius_mm: float, depth_mm: float, thickness_mm: float
) -> Float[Array, "*any"]:
    """Return what is added to the linear height of the skin at these distances from the axis of a ball pressed straight in.

    The table reaches from 1.2 to 3.2 thicknesses of ball radius, beyond which the nearest is taken, and to a depth of 0.85
    thicknesses, beyond which the difference grows on as it grew last. It is zero for a ball above the skin.
    """
    table = _ball_table()
    profile = table.profile(ball_radius_mm / thickness_mm, max(depth_mm, 0.0) / thickness_mm)
    return np.asarray(thickness_mm * np.interp(distance_mm / thickness_mm, table.distance, profile, right=0.0))


def _interval(nodes: Float[Array, " n"], value: float) -> tuple[tuple[int, int], float]:
    """Return the nodes on both sides of a value and how far between them it is; more than one beyond the last."""
    upper = int(np.clip(np.searchsorted(nodes, value), 1, len(nodes) - 1))
    return (upper - 1, upper), float((value - nodes[upper - 1]) / (nodes[upper] - nodes[upper - 1]))


@cache
def _ball_table() -> _BallTable:
    with as_file(files("ninedtact.mechanics") / TABLE_FILE) as path, np.load(path) as stored:
        return _BallTable(**{name: stored[name].astype(float) for name in stored.files})
