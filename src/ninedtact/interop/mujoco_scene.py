"""What a MuJoCo scene says of a sensor: the bodies on its gel, with place, shape and force in the sensor frame."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float64
from numpy import ndarray as Array

from ninedtact.errors import InputError
from ninedtact.interop.geom_undersides import (
    BoxSolid,
    CapsuleSolid,
    CylinderSolid,
    EllipsoidSolid,
    MeshSolid,
    Rotation,
    Solid,
    Vector,
)
from ninedtact.quantities import Wrench

MM_PER_M = 1e3


class MujocoBodyUnusable(InputError):
    """Raised for a body of the scene that cannot be a sensor, or that cannot press one."""


@dataclass(frozen=True)
class BodyContact:
    """One body of the scene on the gel: its place in the sensor frame, and what it applies to the gel."""

    body: int
    rotation: Rotation
    origin_mm: Vector
    centre_mm: Vector
    """Mean of the contact points, weighted by their load."""
    wrench: Wrench
    friction: float
    deepest_mm: float
    """How far MuJoCo lets the body overlap the gel."""

    @property
    def load_n(self) -> float:
        """The load towards the gel."""
        return -float(self.wrench.force_n[2])


@dataclass
class MujocoScene:
    """A scene as seen from the body that carries the gel."""

    model: Any
    """The `mujoco.MjModel`."""
    data: Any
    """The `mujoco.MjData`."""
    body: int
    """Number of the body that carries the gel."""
    _meshes: dict[int, Array] = field(default_factory=dict, init=False, repr=False)
    """Triangles by mesh, because they do not change."""

    def body_contacts(self) -> list[BodyContact]:
        """Return every body on the gel with what MuJoCo's contacts say of it."""
        import mujoco

        frame, origin = self.rotation_of(self.body), MM_PER_M * self.data.xpos[self.body]
        six, found = np.zeros(6), dict[int, list[tuple[Array, Array, float, float]]]()
        for number in range(self.data.ncon):
            contact = self.data.contact[number]
            bodies = self.model.geom_bodyid[contact.geom]
            if self.body not in bodies or bodies[0] == bodies[1] or contact.efc_address < 0:
                continue
            mujoco.mj_contactForce(self.model, self.data, number, six)
            axes, on_second = contact.frame.reshape(3, 3), bodies[1] == self.body
            sign = 1.0 if on_second else -1.0
            force, twist = (sign * frame.T @ axes.T @ part for part in (six[:3], six[3:]))
            place = frame.T @ (MM_PER_M * contact.pos - origin)
            parts = np.concatenate([force, twist + np.cross(place, force) / MM_PER_M]), place
            found.setdefault(int(bodies[0 if on_second else 1]), []).append(
                (*parts, float(contact.friction[0]), -MM_PER_M * float(contact.dist))
            )
        return [self._contact_of(body, parts, frame, origin) for body, parts in found.items()]

    def _contact_of(
        self, body: int, parts: list[tuple[Array, Array, float, float]], frame: Any, origin: Any
    ) -> BodyContact:
        """Return the sum of one body's contacts."""
        sixes, places, frictions, overlaps = (np.array(column) for column in zip(*parts, strict=True))
        six, loads = sixes.sum(axis=0), np.maximum(-sixes[:, 2], 0.0) + 1e-9
        return BodyContact(
            body,
            frame.T @ self.rotation_of(body),
            frame.T @ (MM_PER_M * self.data.xpos[body] - origin),
            np.average(places, axis=0, weights=loads),
            Wrench(six[:3], six[3:]),
            float(frictions.max()),
            float(overlaps.max()),
        )

    def rotation_of(self, body: int) -> Float64[Array, "3 3"]:
        """Return the matrix whose columns are a body's axes in the world."""
        return np.array(self.data.xmat[body]).reshape(3, 3)

    def geoms_of(self, body: int) -> list[int]:
        """Return the geoms of a body that collide."""
        first, many = self.model.body_geomadr[body], self.model.body_geomnum[body]
        collides = self.model.geom_contype | self.model.geom_conaffinity
        return [geom for geom in range(first, first + many) if collides[geom]]

    def solid(self, geom: int, lag_mm: Vector) -> Solid:
        """Return one geom in the sensor frame; raises `MujocoBodyUnusable`."""
        import mujoco

        frame, kinds = self.rotation_of(self.body), mujoco.mjtGeom
        rotation = frame.T @ np.array(self.data.geom_xmat[geom]).reshape(3, 3)
        centre = frame.T @ (MM_PER_M * (self.data.geom_xpos[geom] - self.data.xpos[self.body])) + lag_mm
        size, kind = (MM_PER_M * self.model.geom_size[geom]).tolist(), self.model.geom_type[geom]
        if kind == kinds.mjGEOM_SPHERE:
            return EllipsoidSolid(centre, rotation, (size[0],) * 3)
        if kind == kinds.mjGEOM_ELLIPSOID:
            return EllipsoidSolid(centre, rotation, tuple(size))
        if kind == kinds.mjGEOM_BOX:
            return BoxSolid(centre, rotation, tuple(size))
        if kind == kinds.mjGEOM_CYLINDER:
            return CylinderSolid(centre, rotation, tuple(size[:2]))
        if kind == kinds.mjGEOM_CAPSULE:
            return CapsuleSolid(centre, rotation, tuple(size[:2]))
        if kind == kinds.mjGEOM_MESH:
            return MeshSolid(centre, rotation, (), self._triangles_mm(int(self.model.geom_dataid[geom])))
        name = self.model.body(self.model.geom_bodyid[geom]).name or "world"
        raise MujocoBodyUnusable(
            f"expected body {name} to consist of spheres, ellipsoids, boxes, cylinders, capsules or meshes where it touches the "
            f"gel, got a {kinds(kind).name.removeprefix('mjGEOM_').lower()}; replace it, or keep it off the sensor"
        )

    def _triangles_mm(self, mesh: int) -> Float64[Array, "triangles 3 3"]:
        """Return the triangles of a mesh of the scene in the frame of its geom."""
        if mesh not in self._meshes:
            vertex, face = self.model.mesh_vertadr[mesh], self.model.mesh_faceadr[mesh]
            vertices = self.model.mesh_vert[vertex : vertex + self.model.mesh_vertnum[mesh]].astype(float) * MM_PER_M
            self._meshes[mesh] = vertices[self.model.mesh_face[face : face + self.model.mesh_facenum[mesh]]]
        return self._meshes[mesh]
