"""An axisymmetric neo-Hookean gel on a rigid base or on a layer that yields, cut into finite elements; it keeps its volume exactly.

The rigid floor is at z = 0, the untouched skin at the top; a point (r, z) moves to (r + u_r, z + u_z). Energy per volume is
G/2·(|F|² − 3) with G = 1 in the gel, so that forces are in shear moduli times mm². A pressure that is linear within each element
and knows nothing of its neighbours holds det F = 1 there: biquadratic displacement with it does not lock. (With Taylor and Hood's
continuous pressure the free skin beside deep presses wrinkled from element to element.)
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.sparse import coo_matrix, csc_matrix
from skfem import Basis, ElementQuad2, ElementVector, FacetBasis, MeshQuad
from skfem.helpers import grad

INTEGRATION_ORDER = 5
"""Three points along each side of an element."""
UNTOUCHED = np.array([1, 0, 0, 1, 1])
"""F where nothing is moved."""
WIDENING = 1.17
"""Of each element over its inner neighbour, where the ball does not reach."""
BULK = 1e4
"""Shear moduli by which the tangent holds det F = 1. The balance holds it exactly, so this sets only how fast it is reached."""


@dataclass(frozen=True)
class Layer:
    """What is pressed, and how finely it is divided."""

    thickness_mm: float = 2.5
    radius_mm: float = 20.0
    element_mm: float = 0.2
    """Width of the elements under the ball, and mean height of all."""
    fine_to_mm: float = 5.0
    """Where elements begin to widen outward."""
    base_thickness_mm: float = 0.0
    """Thickness of the layer under the gel; zero for gel on the rigid floor."""
    base_modulus: float = 1.0
    """Shear modulus of that layer over that of the gel."""

    @cached_property
    def mesh(self) -> MeshQuad:
        return MeshQuad.init_tensor(self.radii_mm, self.heights_mm)

    @property
    def heights_mm(self) -> Float[Array, " rows"]:
        rows = round(self.thickness_mm / self.element_mm)
        gel = np.linspace(0, self.thickness_mm, rows + 1)
        base_rows = round(self.base_thickness_mm / (2 * self.element_mm))
        return np.concatenate(
            [np.linspace(0, self.base_thickness_mm, base_rows + 1)[:-1], self.base_thickness_mm + gel]
        )

    @property
    def top_mm(self) -> float:
        """Height of the untouched skin over the rigid floor."""
        return self.base_thickness_mm + self.thickness_mm

    @property
    def radii_mm(self) -> Float[Array, " columns"]:
        near = np.linspace(0, self.fine_to_mm, round(self.fine_to_mm / self.element_mm) + 1)
        rest = self.radius_mm - self.fine_to_mm
        count = int(np.log(1 + rest / self.element_mm * (WIDENING - 1) / WIDENING) / np.log(WIDENING)) + 1
        far = np.cumsum(WIDENING ** np.arange(count))
        return np.concatenate([near, self.fine_to_mm + far * rest / far[-1]])


@dataclass(frozen=True)
class Parts:
    """What the unknowns of each element mean at its integration points: matrices, made once."""

    layer: Layer

    @cached_property
    def inside(self) -> Basis:
        return Basis(self.layer.mesh, ElementVector(ElementQuad2()), intorder=INTEGRATION_ORDER)

    @cached_property
    def skin(self) -> FacetBasis:
        mesh, height = self.layer.mesh, self.layer.top_mm
        top = mesh.facets_satisfying(lambda x: np.isclose(x[1], height))
        return FacetBasis(mesh, ElementVector(ElementQuad2()), facets=top, intorder=INTEGRATION_ORDER)

    @cached_property
    def unknowns_of(self) -> Array:
        """Of each element: indices of its displacements."""
        return self.inside.element_dofs.T

    @cached_property
    def modulus(self) -> Float[Array, "elements 1 1"]:
        """Shear modulus of each element, that of the gel being one."""
        middle_mm = self.layer.mesh.p[1, self.layer.mesh.t].mean(axis=0)
        in_base = middle_mm < self.layer.base_thickness_mm
        return np.where(in_base, self.layer.base_modulus, 1.0)[:, None, None]

    @cached_property
    def strain(self) -> Float[Array, "elements points 5 18"]:
        """From an element's displacements to F − 1 in the order rr, rz, zr, zz, θθ."""
        r = self.inside.global_coordinates().value[0]
        rows = [[*grad(shape).reshape(4, *r.shape), np.asarray(shape)[0] / r] for (shape,) in self.inside.basis]
        return np.moveaxis(np.asarray(rows), (0, 1), (3, 2))

    @cached_property
    def volume(self) -> Float[Array, "elements points"]:
        """All the way round."""
        return 2 * np.pi * self.inside.dx * self.inside.global_coordinates().value[0]

    @cached_property
    def pressing(self) -> Float[Array, "elements points 3"]:
        """From an element's three pressures to the pressure at its points."""
        place = self.inside.global_coordinates().value
        middle = self.layer.mesh.p[:, self.layer.mesh.t].mean(axis=1)[..., None]
        return np.stack([np.ones(place.shape[1:]), *((place - middle) / self.layer.element_mm)], axis=-1)

    @cached_property
    def yielding(self) -> Float[Array, "elements 3 3"]:
        """From volume missing, weighted by each pressure, to the pressures that bring it back."""
        mass = np.einsum("ep,epi,epj->eij", self.volume, self.pressing, self.pressing)
        return BULK * self.modulus * np.linalg.inv(mass)

    @cached_property
    def skin_place_mm(self) -> Float[Array, "facets points 2"]:
        """Integration points of the untouched skin."""
        return np.moveaxis(self.skin.global_coordinates().value, 0, -1)

    @cached_property
    def skin_area(self) -> Float[Array, "facets points"]:
        """All the way round."""
        return 2 * np.pi * self.skin.dx * self.skin_place_mm[..., 0]

    @cached_property
    def skin_motion(self) -> Float[Array, "facets points 2 18"]:
        """From an element's displacements to those of its skin points."""
        shape = (2, *self.skin_area.shape)
        rows = [np.broadcast_to(np.asarray(shape_of), shape) for (shape_of,) in self.skin.basis]
        return np.moveaxis(np.asarray(rows), (0, 1), (3, 2))

    @cached_property
    def free(self) -> Array:
        """Indices of the displacements that nothing holds."""
        basis = self.inside
        held = [
            basis.get_dofs(lambda x: np.isclose(x[1], 0)).all(),
            basis.get_dofs(lambda x: np.isclose(x[0], 0)).all(["u^1"]),
        ]
        return np.setdiff1d(np.arange(basis.N), np.concatenate(held))

    @cached_property
    def skin_nodes(self) -> tuple[Float[Array, " nodes"], Array, Array]:
        """Radii of the skin's nodes from the middle out, and the indices of their u_r and u_z."""
        return self.nodes_at(self.layer.top_mm)

    def nodes_at(self, height: float) -> tuple[Float[Array, " nodes"], Array, Array]:
        """Radii of the nodes at a height of the untouched layer from the middle out, and the indices of their u_r and u_z."""
        places = self.inside.doflocs
        nodes = self.inside.get_dofs(lambda x: np.isclose(x[1], height))
        across, up = (index[np.argsort(places[0, index])] for index in (nodes.all(["u^1"]), nodes.all(["u^2"])))
        return places[0, across], across, up


@dataclass(frozen=True)
class Inner:
    """Elastic forces of the layer, and how they change with its displacements."""

    forces: Float[Array, " unknowns"]
    stiffness: csc_matrix
    """With the pressures' answer in it."""
    missing: Float[Array, "elements 3"]
    """Volume gained, weighted by each pressure; zero in balance."""
    along: Float[Array, "elements 18 3"]
    """Derivative of that by the element's displacements."""


def gradient(parts: Parts, moved: Array) -> Float[Array, "elements points 5"]:
    """F at the integration points."""
    return np.einsum("epij,ej->epi", parts.strain, moved[parts.unknowns_of]) + UNTOUCHED


def determinant(f: Float[Array, "*any 5"]) -> tuple[Array, Array, Array]:
    """det F with its first and second derivatives by the entries of F."""
    rr, rz, zr, zz, around = np.moveaxis(f, -1, 0)
    plane = rr * zz - rz * zr
    first = np.stack([zz * around, -zr * around, -rz * around, rr * around, plane], axis=-1)
    second = np.zeros((*f.shape, 5))
    second[..., 0, 3], second[..., 1, 2] = around, -around
    second[..., 0, 4], second[..., 1, 4], second[..., 2, 4], second[..., 3, 4] = zz, -zr, -rz, rr
    return plane * around, first, second + np.swapaxes(second, -1, -2)


def inner(parts: Parts, moved: Array, pressures: Float[Array, "elements 3"]) -> Inner:
    """Elastic forces at these displacements and pressures; a pressure of zero belongs to the untouched layer."""
    f, volume, strain = gradient(parts, moved), parts.volume[..., None], parts.strain
    grown, first, second = determinant(f)
    held = np.einsum("epi,ei->ep", parts.pressing, pressures)[..., None] - parts.modulus
    forces = np.einsum("epij,epi->ej", strain, (parts.modulus * f + held * first) * volume)
    tangent = (parts.modulus[..., None] * np.eye(5) + held[..., None] * second) * volume[..., None]
    flat = strain.reshape(len(strain), -1, strain.shape[-1])
    own = np.swapaxes(flat, 1, 2) @ (tangent @ strain).reshape(flat.shape)
    along = np.swapaxes(np.einsum("epij,epi->epj", strain, first * volume), 1, 2) @ parts.pressing
    missing = np.einsum("epi,ep->ei", parts.pressing, (grown - 1) * parts.volume)
    stiffness = own + along @ parts.yielding @ np.swapaxes(along, 1, 2)
    return Inner(
        added(forces, parts, parts.unknowns_of), assembled(stiffness, parts, parts.unknowns_of), missing, along
    )


def added(values: Float[Array, "elements 18"], parts: Parts, unknowns_of: Array) -> Float[Array, " unknowns"]:
    """What the elements contribute, summed at each unknown."""
    return np.bincount(unknowns_of.ravel(), values.ravel(), parts.inside.N)


def assembled(blocks: Float[Array, "elements 18 18"], parts: Parts, unknowns_of: Array) -> csc_matrix:
    """The elements' matrices as one."""
    row, col = np.broadcast_arrays(unknowns_of[:, :, None], unknowns_of[:, None, :])
    return coo_matrix((blocks.ravel(), (row.ravel(), col.ravel())), shape=(parts.inside.N,) * 2).tocsc()
