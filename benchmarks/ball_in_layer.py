"""A rigid ball, or the flat end of a rod with a rounded edge, pressed step by step into a neo-Hookean layer whose skin sticks to it
where it touches.

Contact is a stiff penalty at the integration points of the skin. A point that touches keeps its place on the object; one that
has not touched yet would touch straight below the object's point above it, as in the linear model.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from neo_hookean import Inner, Parts, added, assembled, inner
from numpy import ndarray as Array
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu

STIFFNESS = 2e4
"""Traction per overlap, in shear moduli per mm: the deepest presses overlap by some micrometres."""
SOFT_MM = 1e-4
"""Overlap up to which the penalty's own stiffness rises from zero: points at the edge do not come and go for ever."""
TOLERANCE = 1e-9
"""Largest force left at any node, in shear moduli times mm², and largest volume gained by any element, mm³."""
NEWTON_STEPS = 25
HOPELESS = 1e9
HALVINGS = 6


class PressFailed(Exception):
    """Newton's method found no balance, however small the step."""


@dataclass(frozen=True)
class Touch:
    """What the object does to the points of the skin."""

    traction: Float[Array, "facets points 2"]
    """Per untouched area."""
    slope: Float[Array, "facets points 2 2"]
    """Its derivative by the point's place."""
    touches: Float[Array, "facets points"]
    rest_mm: Float[Array, "facets points"]
    """Place on the object, along it from its middle, at which each point bears no shear."""


@dataclass(frozen=True)
class Press:
    """The layer in balance with the object at one depth."""

    parts: Parts
    radius_mm: float
    """Radius of the ball, or of the edge of the flat end."""
    face_mm: float
    """Radius of the flat face inside that edge; zero for a ball."""
    depth_mm: float
    moved: Float[Array, " unknowns"]
    pressures: Float[Array, "elements 3"]
    touch: Touch | None = None

    @property
    def load(self) -> float:
        """Force over shear modulus, mm²."""
        return -float((self.touch.traction[..., 1] * self.parts.skin_area).sum())

    @property
    def profile_mm(self) -> tuple[Array, Array, Array]:
        """r, u_r and u_z of the skin's nodes."""
        r, across, up = self.parts.skin_nodes
        return r, self.moved[across], self.moved[up]

    def height_mm(self, radius_mm: Array) -> Array:
        """Height of the skin at distances from the axis."""
        r, across, up = self.profile_mm
        return np.interp(radius_mm, r + across, up)

    def thickness_change_mm(self, radius_mm: Array) -> Array:
        """Change of the thickness of the gel at distances from the axis."""
        if not self.parts.layer.base_thickness_mm:
            return self.height_mm(radius_mm)
        r, across, up = self.parts.nodes_at(self.parts.layer.base_thickness_mm)
        return self.height_mm(radius_mm) - np.interp(radius_mm, r + self.moved[across], self.moved[up])


def follow(parts: Parts, radius_mm: float, depths_mm: Iterable[float], face_mm: float = 0.0) -> Iterator[Press]:
    """Balance at each depth in turn; raises `PressFailed`."""
    last = Press(parts, radius_mm, face_mm, 0.0, np.zeros(parts.inside.N), np.zeros((len(parts.unknowns_of), 3)))
    for depth in depths_mm:
        last = pressed_on(last, depth)
        yield last


def pressed_on(last: Press, depth_mm: float) -> Press:
    """On to this depth, in halves where Newton's method fails."""
    for halving in range(HALVINGS):
        press = last
        for depth in np.linspace(last.depth_mm, depth_mm, 2**halving + 1)[1:]:
            press = press and balanced(press, depth)
        if press:
            return press
    raise PressFailed(f"no balance at {depth_mm:.3f} mm, from {last.depth_mm:.3f} mm in {2**halving} steps")


def balanced(last: Press, depth_mm: float) -> Press | None:
    """Newton's method from the last balance; None if it does not get there."""
    parts, press, rest = last.parts, replace(last, depth_mm=depth_mm), rest_mm(last)
    for _ in range(NEWTON_STEPS):
        touch = touched(press, rest)
        body = inner(parts, press.moved, press.pressures)
        forces = body.forces - skin_forces(parts, touch)
        residual = float(max(np.abs(forces[parts.free]).max(), np.abs(body.missing).max()))
        if residual < TOLERANCE:
            return replace(press, touch=touch)
        if not residual < HOPELESS:
            return None
        press = stepped(press, body, forces, touch)
    return None


def stepped(press: Press, body: Inner, forces: Array, touch: Touch) -> Press:
    """One step of Newton's, the pressures taken out element by element."""
    parts, free = press.parts, press.parts.free
    answer = np.einsum("eij,ej->ei", parts.yielding, body.missing)
    wanted = forces + added(np.einsum("eij,ej->ei", body.along, answer), parts, parts.unknowns_of)
    stiffness = (body.stiffness - skin_stiffness(parts, touch))[free][:, free]
    step = np.zeros_like(press.moved)
    # Symmetric, so the ordering of the symmetric pattern serves; it is seven times faster than the default.
    factors = splu(stiffness, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    step[free] = -factors.solve(wanted[free])
    gained = body.missing + np.einsum("eij,ei->ej", body.along, step[parts.unknowns_of])
    eased = np.einsum("eij,ej->ei", parts.yielding, gained)
    return replace(press, moved=press.moved + step, pressures=press.pressures + eased)


def skin_now(parts: Parts, moved: Array) -> Float[Array, "facets points 2"]:
    """Where the skin's points are."""
    return parts.skin_place_mm + np.einsum("fpij,fj->fpi", parts.skin_motion, moved[parts.skin.element_dofs.T])


def rest_mm(last: Press) -> Float[Array, "facets points"]:
    """Place on the object at which each point bears no shear."""
    across = skin_now(last.parts, last.moved)[..., 0]
    on_face = np.minimum(across, last.face_mm)
    below = on_face + last.radius_mm * np.arcsin(np.clip((across - on_face) / last.radius_mm, 0, 1))
    return below if last.touch is None else np.where(last.touch.touches, last.touch.rest_mm, below)


def touched(press: Press, rest: Float[Array, "facets points"]) -> Touch:
    """Pressure along the object's normal by overlap, and shear along its meridian by the way from rest."""
    radius = press.radius_mm
    place = skin_now(press.parts, press.moved)
    on_face = np.minimum(place[..., 0], press.face_mm)
    centre_z = press.parts.layer.top_mm - press.depth_mm + radius
    arm = np.stack([place[..., 0] - on_face, place[..., 1] - centre_z], axis=-1)
    distance = np.linalg.norm(arm, axis=-1)
    out = arm / distance[..., None]
    along = np.stack([-out[..., 1], out[..., 0]], axis=-1)
    is_curved = place[..., 0] > press.face_mm
    way = on_face + radius * np.arctan2(arm[..., 0], -arm[..., 1])
    touches = distance < radius
    overlap = np.where(touches, radius - distance, 0)
    stiffening = np.minimum(overlap / SOFT_MM, 1)
    pressure = STIFFNESS * stiffening * (overlap - stiffening * SOFT_MM / 2)
    shear = -STIFFNESS * np.where(touches, way - rest, 0)
    curvature, way_per_mm = is_curved / distance, np.where(is_curved, radius / distance, 1.0)
    slope = (
        scaled(-STIFFNESS * stiffening, out, out)
        + scaled(pressure * curvature - STIFFNESS * way_per_mm * touches, along, along)
        - scaled(shear * curvature, out, along)
    )
    return Touch(pressure[..., None] * out + shear[..., None] * along, slope, touches, rest)


def scaled(factor: Array, one: Array, other: Array) -> Array:
    """factor · one otherᵀ"""
    return factor[..., None, None] * one[..., :, None] * other[..., None, :]


def skin_forces(parts: Parts, touch: Touch) -> Float[Array, " unknowns"]:
    blocks = np.einsum("fpij,fpi->fj", parts.skin_motion, touch.traction * parts.skin_area[..., None])
    return added(blocks, parts, parts.skin.element_dofs.T)


def skin_stiffness(parts: Parts, touch: Touch) -> csc_matrix:
    motion, slope = parts.skin_motion, touch.slope * parts.skin_area[..., None, None]
    blocks = (np.swapaxes(motion, -1, -2) @ slope @ motion).sum(axis=1)
    return assembled(blocks, parts, parts.skin.element_dofs.T)
