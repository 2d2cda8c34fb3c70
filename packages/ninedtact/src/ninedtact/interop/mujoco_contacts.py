"""What a MuJoCo scene says of a sensor: the bodies on its gel, with place, shape and force in the sensor frame."""

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from jaxtyping import Float64
from numpy import ndarray as Array

from ninedtact.errors import InputError
from ninedtact.interop.geom_undersides import ConvexSolid, MeshSolid, Rotation, Solid, Vector
from ninedtact.quantities import Wrench

MM_PER_M = 1e3


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
    geoms: frozenset[int]
    """The geoms of the body that touch."""

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
    geom: int
    """Number of the geom of that body that is the gel; what touches its other geoms does not press."""
    _meshes: dict[int, Array] = field(default_factory=dict, init=False, repr=False)
    """Triangles by mesh, because they do not change."""

    @classmethod
    def of_sensor(cls, model: Any, data: Any, body: str, geom: str | int | None) -> "MujocoScene":
        """Return the scene as seen from a body that is given by its name, and its geom that is the gel by name or number.

        The geom need not be given where only one of the body's geoms collides. Raises `InputError`.
        """
        import mujoco

        scene = cls(model, data, mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, body), -1)
        if scene.body <= 0:
            names = ", ".join(model.body(number).name for number in range(1, model.nbody))
            raise InputError(expected=f"a body of the scene, one of {names}", got=f"{body!r}", remedy="correct it")
        colliding = scene.geoms_of(scene.body)
        if not colliding:
            raise InputError(
                expected=f"body {body} to have a geom that collides",
                got="none",
                remedy="give it a box whose upper face is the skin",
            )
        by_name = {model.geom(number).name or number: number for number in colliding}
        listed = ", ".join(repr(name) for name in by_name)
        if geom is None and len(colliding) > 1:
            raise InputError(
                expected=f"one geom of body {body} that collides",
                got=f"{len(colliding)} ({listed})",
                remedy="pass that of the gel as geom",
            )
        scene.geom = colliding[0] if geom is None else by_name.get(geom, geom if geom in colliding else -1)
        if scene.geom < 0:
            raise InputError(
                expected=f"geom to be a geom of body {body} that collides, one of {listed}",
                got=f"{geom!r}",
                remedy="correct it",
            )
        return scene

    def body_contacts(self) -> list[BodyContact]:
        """Return every body on the gel with what MuJoCo's contacts say of it.

        Raises `InputError` where a soft body (flex) touches the gel.
        """
        import mujoco

        frame, origin = self.rotation_of(self.body), MM_PER_M * self.data.xpos[self.body]
        six, found = np.zeros(6), dict[int, list[tuple[Array, Array, float, float, int]]]()
        for number in range(self.data.ncon):
            contact = self.data.contact[number]
            if self.geom not in contact.geom or contact.efc_address < 0:
                continue
            on_second = contact.geom[1] == self.geom
            other = 0 if on_second else 1
            if contact.geom[other] < 0:  # a soft body, which is no geom and deforms
                flex = int(contact.flex[other])
                name = mujoco.mj_id2name(self.model, mujoco.mjtObj.mjOBJ_FLEX, flex) or f"number {flex}"
                raise InputError(
                    expected="rigid bodies on the gel",
                    got=f"the soft body (flex) {name}",
                    remedy="replace it by rigid ones, or keep it off the sensor",
                )
            mujoco.mj_contactForce(self.model, self.data, number, six)
            axes = contact.frame.reshape(3, 3)
            sign = 1.0 if on_second else -1.0
            force, twist = (sign * frame.T @ axes.T @ part for part in (six[:3], six[3:]))
            place = frame.T @ (MM_PER_M * contact.pos - origin)
            parts = np.concatenate([force, twist + np.cross(place, force) / MM_PER_M]), place
            found.setdefault(int(self.model.geom_bodyid[contact.geom[other]]), []).append(
                (*parts, float(contact.friction[0]), -MM_PER_M * float(contact.dist), int(contact.geom[other]))
            )
        return [self._contact_of(body, parts, frame, origin) for body, parts in found.items()]

    def _contact_of(
        self, body: int, parts: list[tuple[Array, Array, float, float, int]], frame: Any, origin: Any
    ) -> BodyContact:
        sixes, places, frictions, overlaps, geoms = (np.array(column) for column in zip(*parts, strict=True))
        six, loads = sixes.sum(axis=0), np.maximum(-sixes[:, 2], 0.0) + 1e-9
        return BodyContact(
            body,
            frame.T @ self.rotation_of(body),
            frame.T @ (MM_PER_M * self.data.xpos[body] - origin),
            np.average(places, axis=0, weights=loads),
            Wrench(six[:3], six[3:]),
            float(frictions.max()),
            float(overlaps.max()),
            frozenset(geoms.tolist()),
        )

    def rotation_of(self, body: int) -> Float64[Array, "3 3"]:
        """Return the matrix whose columns are a body's axes in the world."""
        return np.array(self.data.xmat[body]).reshape(3, 3)

    def geoms_of(self, body: int) -> list[int]:
        """Return the geoms of a body that collide, by contype and conaffinity or as one of a pair."""
        first, many = self.model.body_geomadr[body], self.model.body_geomnum[body]
        collides = self.model.geom_contype | self.model.geom_conaffinity
        paired = {*self.model.pair_geom1.tolist(), *self.model.pair_geom2.tolist()}
        return [geom for geom in range(first, first + many) if collides[geom] or geom in paired]

    def geoms_facing_gel(self, touching: BodyContact) -> list[int]:
        """Return the geoms of a touching body that touch the gel, or that would if they came near.

        Planes and height fields that do not touch are left out, because a body such as the world has them elsewhere.
        """
        import mujoco

        kinds, model, gel = mujoco.mjtGeom, self.model, self.geom
        shapeless = [int(kind) for kind in (kinds.mjGEOM_PLANE, kinds.mjGEOM_HFIELD, kinds.mjGEOM_SDF)]
        ends = zip(model.pair_geom1.tolist(), model.pair_geom2.tolist(), strict=True)
        paired = {other for pair in ends if gel in pair for other in pair}

        def faces(geom: int) -> bool:
            masks = model.geom_contype[geom] & model.geom_conaffinity[gel]
            masks |= model.geom_contype[gel] & model.geom_conaffinity[geom]
            return bool(masks or geom in paired) and int(model.geom_type[geom]) not in shapeless

        return [geom for geom in self.geoms_of(touching.body) if geom in touching.geoms or faces(geom)]

    def solid(self, geom: int, lag_mm: Vector) -> Solid:
        """Return one geom in the sensor frame; raises `InputError`."""
        import mujoco

        frame, kinds = self.rotation_of(self.body), mujoco.mjtGeom
        rotation = frame.T @ np.array(self.data.geom_xmat[geom]).reshape(3, 3)
        centre = frame.T @ (MM_PER_M * (self.data.geom_xpos[geom] - self.data.xpos[self.body])) + lag_mm
        size, kind = (MM_PER_M * self.model.geom_size[geom]).tolist(), kinds(self.model.geom_type[geom])
        if kind == kinds.mjGEOM_MESH:
            triangles_mm = self._triangles_mm(int(self.model.geom_dataid[geom]))
            return MeshSolid(triangles_mm @ rotation.T + centre)
        if kind in (kinds.mjGEOM_SPHERE, kinds.mjGEOM_ELLIPSOID):
            return ConvexSolid("ellipsoid", centre, rotation, size if kind == kinds.mjGEOM_ELLIPSOID else size[:1] * 3)
        if kind == kinds.mjGEOM_BOX:
            return ConvexSolid("box", centre, rotation, size)
        if kind in (kinds.mjGEOM_CYLINDER, kinds.mjGEOM_CAPSULE):
            shape: Literal["cylinder", "capsule"] = "cylinder" if kind == kinds.mjGEOM_CYLINDER else "capsule"
            return ConvexSolid(shape, centre, rotation, size[:2])
        name = self.model.body(self.model.geom_bodyid[geom]).name or "world"
        raise InputError(
            expected=f"body {name} to consist of spheres, ellipsoids, boxes, cylinders, capsules or meshes where "
            "it touches the gel",
            got=f"a {kind.name.removeprefix('mjGEOM_').lower()}",
            remedy="replace it, or keep it off the sensor",
        )

    def _triangles_mm(self, mesh: int) -> Float64[Array, "triangles 3 3"]:
        if mesh not in self._meshes:
            vertex, face = self.model.mesh_vertadr[mesh], self.model.mesh_faceadr[mesh]
            vertices = self.model.mesh_vert[vertex : vertex + self.model.mesh_vertnum[mesh]].astype(float) * MM_PER_M
            self._meshes[mesh] = vertices[self.model.mesh_face[face : face + self.model.mesh_facenum[mesh]]]
        return self._meshes[mesh]
