"""A tactile sensor in a MuJoCo scene: the bodies that touch its gel press the twin, which gives the image and the gel's wrench.

The sensor is a body of the scene whose frame is the sensor frame: origin in the middle of the undeformed skin, z outwards, x along
the longer side. MuJoCo is in metres, the twin in mm. MuJoCo decides where bodies are and how hard they press: the twin's object
has the shape, the position and the orientation of the bodies that touch, and sinks in until the gel resists with MuJoCo's load.

MuJoCo's skin does not yield sideways, a gel does. While a body sticks, the object is therefore moved on by as much as the gel
needs to resist with MuJoCo's friction. Where the friction of the scene is exhausted, the object slides as the body does.
"""

from collections.abc import Callable, Generator
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float64
from numpy import ndarray as Array

from ninedtact.capture.frame_source import FrameSource, SourceNotOpen
from ninedtact.errors import SimulationError
from ninedtact.interop.geom_undersides import CompoundIndenter, Solid, Vector
from ninedtact.interop.mujoco_contacts import BodyContact, MujocoScene
from ninedtact.mechanics.contact_result import Contact
from ninedtact.mechanics.pose import Pose
from ninedtact.quantities import BgrImage, Frame, HeightMap, Wrench
from ninedtact.required_libraries import require_libraries
from ninedtact.simulation.ground_truth import true_height_map
from ninedtact.simulation.press import Press
from ninedtact.simulation.twin import Twin

if TYPE_CHECKING:
    from ninedtact.calibration.sensor_folder import SensorFolder

MIN_LOAD_N = 0.01
"""Normal load below which nothing counts as touching; camera noise hides what it does to the gel."""
_FIRST_DEPTH_MM = 0.3
_MOVE_ORIGIN_MM = 1.0
"""Distance between the origin of the twin's object and the centre of MuJoCo's contacts at which the origin is moved there."""
_ORIGIN_WITHIN_MM = 3.0
"""Largest |x| and |y| of the origin when it is moved, so that the grid about it always holds what the camera sees."""
_RIM_MM = 0.5
"""Width of the gel's rim, and of the grid's, on which nothing presses: an object that is larger than the gel ends there."""
_FRICTION_TOLERANCE = 0.08
"""Error of the gel's friction, as a part of the load, that is left as it is."""
_SLIPS_FROM = 0.98
"""Part of the largest friction from which a body counts as sliding."""
_SOLVES_PER_STEP = 2
HEIGHT_PITCH_MM = 0.2


@dataclass(frozen=True)
class TactileReading:
    """Image, wrench and contact of the sensor at one moment of the scene."""

    render: Callable[[], BgrImage]
    """Renders the image when it is first asked for."""
    index: int
    """Number of the image since the sensor was opened."""
    wrench: Wrench
    """What the object applies to the gel of the twin, about the middle of the undeformed skin, in the sensor frame."""
    scene_wrench: Wrench
    """The same from MuJoCo's contact forces."""
    contact: Contact | None
    """The gel's contact with pressure, shear and heights; None while nothing touches."""
    area_mm: tuple[float, float]

    @cached_property
    def frame(self) -> Frame:
        """The raw image of the camera, stamped with the time of the scene."""
        return Frame(self.render(), self.scene_wrench.stamp_ns, self.index)

    @property
    def heights(self) -> HeightMap:
        """The true heights of the skin in mm over the sensing area, on a grid of 0.2 mm."""
        shape = round(self.area_mm[1] / HEIGHT_PITCH_MM), round(self.area_mm[0] / HEIGHT_PITCH_MM)
        if self.contact is None:
            flat = np.zeros(shape, np.float32), np.full(shape, 2, np.uint8)
            return HeightMap(*flat, HEIGHT_PITCH_MM, stamp_ns=self.scene_wrench.stamp_ns)
        return replace(true_height_map(self.contact, shape, HEIGHT_PITCH_MM), stamp_ns=self.scene_wrench.stamp_ns)


@dataclass(frozen=True)
class _PressStep:
    """The last press of the twin, and where the body that leads the motion was."""

    press: Press
    leader: BodyContact
    lag_mm: Vector
    """How far the twin's object is moved on from the body, x and y, because the gel yields."""
    stiffness_n_per_mm: float


@dataclass(frozen=True)
class ContactSolveRequest:
    """A contact to be solved: the object goes near a pose, and sinks in until the gel resists with a load."""

    last: Press | None
    solids: CompoundIndenter
    pose: Pose
    load_n: float
    friction: float


@dataclass
class TactileSensor(FrameSource):
    """A sensor on a body of a MuJoCo scene. It is also a source of frames, which `ninedtact.open` takes in place of a camera.

    Call `step` after as many `mj_step` as lie between two images. Bodies that touch at once press as one object, which moves as the
    one with the largest load. Raises `MissingLibraryError` and `InputError`.

    >>> skin = TactileSensor(model, data, "sensor", "my_sensor")
    >>> mujoco.mj_step(model, data, 8)
    >>> reading = skin.step()
    >>> reading.frame.image.shape, reading.wrench.force_n, reading.scene_wrench.force_n
    """

    model: Any
    """The `mujoco.MjModel`."""
    data: Any
    """The `mujoco.MjData`."""
    body: str
    """Name of the body that carries the gel."""
    sensor_folder: "SensorFolder | Twin | Path | str"
    """A calibrated sensor, or a twin, as `ninedtact.default_twin()`."""
    pitch_mm: float = 0.3
    """Pitch of the grid on which the contact is solved; the twin's own, 0.2 mm, shows finer texture in more time."""
    geom: str | int | None = None
    """Name or number of the body's geom that is the gel, needed where several collide; what touches the others does not press."""
    is_live = False
    is_simulated = True
    last: TactileReading | None = field(default=None, init=False, repr=False)
    """The newest reading, for programs that read frames."""
    is_open: bool = field(default=False, init=False)
    _press_before: _PressStep | None = field(default=None, init=False, repr=False)
    _frames: int = field(default=0, init=False)
    _twins: dict[float, Twin] = field(default_factory=dict, init=False, repr=False)
    """Twins by friction, because each prepares its skin once."""
    _scene_wrench: Wrench = field(default_factory=lambda: Wrench(np.zeros(3), np.zeros(3)), init=False, repr=False)

    def __post_init__(self) -> None:
        require_libraries("mujoco", "mujoco")
        self.name = f"twin on MuJoCo body {self.body}"
        self._scene = MujocoScene.of_sensor(self.model, self.data, self.body, self.geom)

    @cached_property
    def twin(self) -> Twin:
        """The twin that is pressed."""
        from ninedtact.calibration.sensor_folder import load_sensor

        given = self.sensor_folder
        if isinstance(given, Twin) and given.pitch_mm == self.pitch_mm:
            return given
        folder = load_sensor(given) if isinstance(given, Path | str) else given
        return replace(folder if isinstance(folder, Twin) else folder.twin(), pitch_mm=self.pitch_mm)

    def open(self) -> None:
        """Begin with undeformed skin."""
        self.is_open, self.last, self._press_before, self._frames = True, None, None, 0

    def close(self) -> None:
        """End the source; the scene is not changed."""
        self.is_open = False

    def read(self) -> Frame:
        """Return the image of the scene as it is now."""
        if not self.is_open:
            raise SourceNotOpen(self.name)
        return self.step().frame

    def step(self) -> TactileReading:
        """Press the twin as the scene is now, and return image, wrench and heights.

        Raises `SimulationError`, `InputError`, and what `Twin.press` raises.
        """
        pressing = self.press_steps()
        try:
            request = next(pressing)
            while True:
                twin = self._twin_with_friction(request.friction)
                request = pressing.send(twin.press(request.last, request.solids, request.pose, request.load_n))
        except StopIteration as ended:
            contact = None if ended.value is None else ended.value.corrected
        return self.show(contact, partial(self.twin.renderer, contact, self._frames + 1))

    def press_steps(self) -> Generator[ContactSolveRequest, Press, Press | None]:
        """Yield the presses to be solved for the scene as it is now, receive each, and return the one that is shown.

        `step` solves them one by one, `TactileSensorBatch` those of many scenes at once.
        """
        touching = [one for one in self._scene.body_contacts() if one.load_n > MIN_LOAD_N]
        six = np.sum([one.wrench.six for one in touching], axis=0) if touching else np.zeros(6)
        self._scene_wrench = Wrench(six[:3], six[3:], stamp_ns=round(self.data.time * 1e9))
        if not touching:
            self._press_before = None
            return None
        self._press_before = step = yield from self._press(touching)
        return step.press

    def show(self, contact: Contact | None, render: Callable[[], BgrImage]) -> TactileReading:
        """Keep and return the reading of a solved contact, whose image is rendered when it is asked for."""
        scene, self._frames = self._scene_wrench, self._frames + 1
        none = replace(scene, force_n=np.zeros(3), torque_nm=np.zeros(3))
        self.last = TactileReading(
            render,
            self._frames - 1,
            none if contact is None else replace(contact.wrench(), stamp_ns=scene.stamp_ns),
            scene,
            contact,
            self.twin.area_mm,
        )
        return self.last

    def _press(self, touching: list[BodyContact]) -> Generator[ContactSolveRequest, Press, _PressStep]:
        """Press the bodies that touch until the gel resists with their load and, where they stick, with their friction."""
        leader = max(touching, key=lambda one: one.load_n)
        self._require_depth_within_gel(touching)
        before = self._press_before
        last = before if before is not None and before.leader.body == leader.body else None
        wanted = np.sum([one.wrench.force_n for one in touching], axis=0)
        centre = np.clip(leader.centre_mm[:2], -_ORIGIN_WITHIN_MM, _ORIGIN_WITHIN_MM)
        start = None if last is None else _move_origin(last, centre)
        pose, lag = _pose_now(start, last, leader, centre), np.zeros(3) if last is None else last.lag_mm
        stiffness = 0.0 if last is None else last.stiffness_n_per_mm
        slides = np.hypot(*wanted[:2]) > _SLIPS_FROM * leader.friction * -wanted[2]
        if last is not None and not slides:
            lag = lag + _sideways(wanted - last.press.wrench.force_n) / stiffness
        tried: list[tuple[Vector, Vector]] = []
        for _ in range(_SOLVES_PER_STEP):
            about = (float(pose.x_mm + lag[0]), float(pose.y_mm + lag[1]))
            solids = self._solids(touching, lag, about)
            at = replace(pose, x_mm=about[0], y_mm=about[1])
            solved = yield ContactSolveRequest(start, solids, at, float(-wanted[2]), round(leader.friction, 3))
            tried.append((lag, solved.wrench.force_n))
            stiffness = _shear_stiffness(solved.solved, tried, stiffness)
            missing = wanted - tried[-1][1]
            if slides or np.hypot(*missing[:2]) < _FRICTION_TOLERANCE * -wanted[2]:
                break
            lag = lag + _sideways(missing) / stiffness
        return _PressStep(solved, leader, tried[-1][0], stiffness)

    def _twin_with_friction(self, friction: float) -> Twin:
        if friction not in self._twins:
            self._twins[friction] = replace(self.twin, friction=friction)
        return self._twins[friction]

    def _require_depth_within_gel(self, touching: list[BodyContact]) -> None:
        """Refuse bodies that overlap the gel by more than its thickness; raises `SimulationError`."""
        for one in touching:
            if one.deepest_mm >= self.twin.gel.max_depth_mm:
                raise SimulationError(
                    expected=f"body {self.model.body(one.body).name or one.body} less deep in the gel than it "
                    f"allows, {self.twin.gel.max_depth_mm:g} mm",
                    got=f"{one.deepest_mm:.2f} mm at {self.data.time:.3f} s",
                    remedy="place it above the skin, move it slower, or take smaller time steps",
                )

    def _solids(self, touching: list[BodyContact], lag_mm: Vector, about_mm: tuple[float, float]) -> CompoundIndenter:
        """Return the bodies as one indenter about a point, moved on by the lag of the gel.

        A geom that does not touch in the scene counts only over the skin, where it may come to touch as the object sinks in; lower
        ones are beside the gel or under it.
        """
        grid, (x, y) = self.twin.model.skin.grid, self.twin.model.skin.coordinates_mm
        sides = zip(self.twin.gel_mm, (grid.width_mm, grid.height_mm), about_mm, strict=True)
        reach = [(max(-gel / 2, at - side / 2), min(gel / 2, at + side / 2)) for gel, side, at in sides]
        within = [(low + _RIM_MM, high - _RIM_MM) for low, high in reach]

        def is_over_skin(solid: Solid) -> bool:
            return float(CompoundIndenter("", (solid,), about_mm, within).underside_mm(x, y).min()) >= 0

        solids = []
        for one in touching:
            for geom in self._scene.geoms_facing_gel(one):
                solid = self._scene.solid(geom, lag_mm)
                if geom in one.geoms or is_over_skin(solid):
                    solids.append(solid)
        names = "+".join(self.model.body(one.body).name or f"body {one.body}" for one in touching)
        whole = CompoundIndenter(names, tuple(solids), about_mm, within)
        return replace(whole, base_mm=float(whole.underside_mm(x, y).min()))


def _move_origin(last: _PressStep, centre_mm: Float64[Array, "2"]) -> Press:
    """Return the last press with its grid over the point of the object where the centre of the contacts is now.

    The grid moves by whole pitches, so that no field is interpolated. The object is without twist, because the solids stand turned
    as they are, and the twist of the next pose is that by which they have turned since.
    """
    press = last.press
    away = centre_mm + last.lag_mm[:2] - (press.pose.x_mm, press.pose.y_mm)
    if np.abs(away).max() < _MOVE_ORIGIN_MM:
        away = np.zeros(2)
    cols, rows = np.round(away / press.solved.skin.grid.pitch_mm).astype(int).tolist()
    return Press(_move_grid(press.solved, cols, rows), _move_grid(press.corrected, cols, rows), press.indenter)


def _move_grid(contact: Contact, cols: int, rows: int) -> Contact:
    """Return a contact with its grid moved by whole pitches, under an object without twist."""
    pitch, names = contact.skin.grid.pitch_mm, ("pressure_mpa", "shear_mpa", "height_mm", "tangential_mm")
    fields = {name: np.roll(getattr(contact, name), (-rows, -cols), axis=(-2, -1)) for name in names}
    x_mm, y_mm = contact.pose.x_mm + cols * pitch, contact.pose.y_mm + rows * pitch
    # Tilts stay: skin under a body that rolls on creeps, which skin of MuJoCo does not.
    return replace(contact, pose=replace(contact.pose, x_mm=x_mm, y_mm=y_mm, twist_rad=0.0), **fields)


def _pose_now(
    before: Press | None, last: _PressStep | None, leader: BodyContact, centre_mm: Float64[Array, "2"]
) -> Pose:
    """Return where the point of the object at the origin of the last contact is now, without lag, and how it has turned."""
    if before is None or last is None:
        return Pose(float(centre_mm[0]), float(centre_mm[1]), _FIRST_DEPTH_MM)
    turned = leader.rotation @ last.leader.rotation.T
    origin = before.pose.origin_mm - last.lag_mm
    pose = Pose.from_frame(turned @ (origin - last.leader.origin_mm) + leader.origin_mm, turned)
    return replace(pose, depth_mm=float(before.pose.depth_mm))


def _sideways(vector: Vector) -> Vector:
    return np.array([*vector[:2], 0.0])


def _shear_stiffness(contact: Contact, tried: list[tuple[Vector, Vector]], known: float) -> float:
    """Return how much friction in N the gel resists per mm that its object is moved on.

    Two attempts tell; before, it is the stiffness of the touched skin as a layer in shear, which small contacts exceed about twice.
    """
    skin = contact.skin
    area = float(np.count_nonzero(contact.pressure_mpa > 0)) * skin.grid.cell_area_mm2
    layer = max(area, skin.grid.cell_area_mm2) / float(skin.operators.max_shear_compliance_mm_per_mpa)
    if len(tried) > 1:
        (lag, force), (next_lag, next_force) = tried[-2:]
        moved = np.hypot(*(next_lag - lag)[:2])
        if moved > 0:
            known = float((next_force - force)[:2] @ (next_lag - lag)[:2] / moved**2)
    return float(np.clip(known or 2 * layer, layer, 6 * layer))
