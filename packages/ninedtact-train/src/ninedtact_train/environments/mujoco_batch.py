"""Tactile sensors in many MuJoCo scenes at once: their contacts are solved in batches, with NumPy or with torch on any device.

Every scene presses a gel of its own. The contacts that the scenes need are collected, those with equal friction are solved in one
batch, and one image is rendered for each. A scene gets the same contact as alone, but for rounding.
"""

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from array_api_compat import to_device

from ninedtact.errors import InputError, NinedtactError
from ninedtact.interop.geom_undersides import CompoundIndenter
from ninedtact.interop.mujoco import ContactSolveRequest, TactileReading, TactileSensor
from ninedtact.mechanics.contact_result import Contact
from ninedtact.mechanics.indenter import Heights, Indenter, PosedHeights
from ninedtact.mechanics.pose import Pose
from ninedtact.mechanics.skin import Skin
from ninedtact.quantities import BgrImage
from ninedtact.simulation.press import Press
from ninedtact.simulation.renderer import BatchRenderer
from ninedtact.simulation.twin import Twin

if TYPE_CHECKING:
    from ninedtact.calibration.sensor_folder import SensorFolder


@dataclass(frozen=True, eq=False)
class _SolidsOfScenes(Indenter):
    """The bodies of each scene as one indenter: the k-th contact of a batch meets those of the k-th scene."""

    each: Sequence[CompoundIndenter]
    skin: Skin

    @property
    def name(self) -> str:  # type: ignore[override]
        """The names of the bodies of all scenes, joined by commas."""
        return ", ".join(one.name for one in self.each)

    def underside_mm(self, x_mm: Heights, y_mm: Heights) -> PosedHeights:
        """Return the undersides of all scenes, computed on the processor, on the device of the skin."""
        x, y = (np.asarray(to_device(axis, "cpu"), float) for axis in (x_mm, y_mm))
        return self.skin.asarray(np.stack([one.underside_mm(x, y) for one in self.each]))

    def height_over_skin_mm(self, pose: Pose, x_mm: Heights, y_mm: Heights) -> PosedHeights:
        """Return the heights of the undersides over the undeformed skin; the solids are turned already."""
        depths = self.skin.asarray(np.asarray(pose.depth_mm, float)[:, None, None])
        return self.underside_mm(x_mm, y_mm) - depths


@dataclass
class TactileSensorBatch:
    """One sensor in each of many scenes of MuJoCo. Every scene has a body of this name that carries the gel.

    >>> batch = TactileSensorBatch([(model, mujoco.MjData(model)) for _ in range(16)], "sensor", "my_sensor")
    >>> readings = batch.step()
    """

    scenes: Sequence[tuple[Any, Any]]
    """A `mujoco.MjModel` and a `mujoco.MjData` for each scene; scenes may share a model."""
    body: str
    """Name of the body that carries the gel."""
    sensor_folder: "SensorFolder | Twin | Path | str"
    """A calibrated sensor, or a twin; the same for all scenes."""
    like: Any = field(default_factory=lambda: np.zeros((), np.float32))
    """An array whose library, precision and device the solver uses, such as `torch.zeros((), device="cuda")`."""
    pitch_mm: float = 0.3
    """Pitch of the grid on which the contacts are solved."""
    geom: str | int | None = None
    """Name or number of the body's geom that is the gel, needed where several collide; the same for all scenes."""
    sensors: list[TactileSensor] = field(init=False)
    """The sensor of each scene."""

    def __post_init__(self) -> None:
        if not self.scenes:
            raise InputError(expected="at least one scene, a pair of MjModel and MjData", got="none", remedy="give one")
        first = TactileSensor(*self.scenes[0], self.body, self.sensor_folder, self.pitch_mm, self.geom)
        rest = (TactileSensor(*scene, self.body, first.twin, self.pitch_mm, self.geom) for scene in self.scenes[1:])
        self.sensors = [first, *rest]
        self.reset(range(len(self.sensors)))

    @property
    def twin(self) -> Twin:
        """The twin that is pressed in every scene."""
        return self.sensors[0].twin

    def reset(self, scenes: Sequence[int]) -> None:
        """Begin these scenes with undeformed skin, as after `mj_resetData`."""
        for number in scenes:
            self.sensors[number].open()

    def step(self) -> list[TactileReading]:
        """Press the twin as every scene is now, and return the reading of each, after `mj_step` of all.

        Raises what `TactileSensor.step` raises, with the number of the scene; then no scene has stepped on.
        """
        before = [sensor._press_before for sensor in self.sensors]
        contacts = self._solve_all(range(len(self.sensors)))
        refusals = [one for one in contacts.values() if isinstance(one, NinedtactError)]
        if refusals:
            for sensor, press in zip(self.sensors, before, strict=True):
                sensor._press_before = press
            raise refusals[0]
        return [reading for reading in self._to_readings(contacts).values() if isinstance(reading, TactileReading)]

    def step_each(self, scenes: Sequence[int]) -> dict[int, TactileReading | NinedtactError]:
        """Press the twin in these scenes; return their readings, and the refusals of scenes that must be reset."""
        return self._to_readings(self._solve_all(scenes))

    def _to_readings(
        self, contacts: dict[int, Contact | NinedtactError | None]
    ) -> dict[int, TactileReading | NinedtactError]:
        solved = {number: one for number, one in contacts.items() if not isinstance(one, NinedtactError)}
        images = self._renderers(list(solved), list(solved.values()))
        shown = {
            number: self.sensors[number].show(contact, image)
            for (number, contact), image in zip(solved.items(), images, strict=True)
        }
        return {number: shown.get(number, one) for number, one in contacts.items()}  # type: ignore[arg-type,misc]

    def _solve_all(self, scenes: Sequence[int]) -> dict[int, Contact | NinedtactError | None]:
        """Return the contact of each scene, None where nothing touches, or why it is refused."""
        contacts: dict[int, Contact | NinedtactError | None] = dict.fromkeys(scenes)
        running = {number: self.sensors[number].press_steps() for number in scenes}
        responses: dict[int, Press | NinedtactError | None] = dict.fromkeys(running)
        while responses:
            requests: dict[int, ContactSolveRequest] = {}
            for number, response in responses.items():
                if isinstance(response, NinedtactError):
                    contacts[number] = response
                    continue
                try:
                    requests[number] = running[number].send(response)  # type: ignore[arg-type]  # None starts it
                except StopIteration as ended:
                    contacts[number] = None if ended.value is None else ended.value.corrected
                except NinedtactError as refusal:
                    contacts[number] = _name_scene(refusal, number)
            responses = self._solve(requests) if requests else {}
        return contacts

    def _solve(self, requests: dict[int, ContactSolveRequest]) -> dict[int, Press | NinedtactError | None]:
        groups: dict[float, list[int]] = defaultdict(list)
        for number, request in requests.items():
            groups[request.friction].append(number)
        solved: dict[int, Press | NinedtactError | None] = {}
        for friction, numbers in groups.items():
            try:
                presses = self._solve_group(self._twin(friction), [requests[number] for number in numbers])
                solved |= dict(zip(numbers, presses, strict=True))
            except NinedtactError:  # which does not name the scene
                solved |= {number: self._solve_alone(requests[number], number) for number in numbers}
        return solved

    def _solve_group(self, twin: Twin, batch: Sequence[ContactSolveRequest]) -> list[Press]:
        """Return the presses of requests with equal friction, copied to the processor."""
        skin, solids = twin.model.skin, [request.solids for request in batch]
        indenter = _SolidsOfScenes(solids, skin)
        before = [request.last or self.twin.hover(request.solids, Pose()) for request in batch]
        poses, loads = Pose.stack([request.pose for request in batch]), np.array([request.load_n for request in batch])
        presses = twin.press(Press.stack(before, indenter).on_skin(skin), indenter, poses, loads)
        return presses.on_skin(self.twin.model.skin).unstack(solids)

    def _solve_alone(self, request: ContactSolveRequest, number: int) -> Press | NinedtactError:
        try:
            return self._solve_group(self._twin(request.friction), [request])[0]
        except NinedtactError as refusal:
            return _name_scene(refusal, number)

    def _twin(self, friction: float) -> Twin:
        """Return the twin with a friction on the device, kept because it prepares its skin once."""
        if friction not in self._twins:
            self._twins[friction] = replace(self.twin, friction=friction, like=self.like)
        return self._twins[friction]

    @cached_property
    def _twins(self) -> dict[float, Twin]:
        return {}

    def _renderers(self, scenes: Sequence[int], contacts: Sequence[Contact | None]) -> list[Callable[[], BgrImage]]:
        """Return functions that render the camera image of each scene when they are called.

        On the processor each renders its own image with OpenCV, which is faster there; on a device the first renders all.
        """
        renderer, numbers = self.twin.renderer, [self.sensors[scene]._frames + 1 for scene in scenes]
        if isinstance(self.like, np.ndarray):
            return [partial(renderer, *one) for one in zip(contacts, numbers, strict=True)]
        render_all = cache(partial(self._images, numbers, contacts))
        return [lambda index=index: render_all()[index] for index in range(len(numbers))]  # type: ignore[misc]

    def _images(self, numbers: Sequence[int], contacts: Sequence[Contact | None]) -> list[BgrImage]:
        """Return the camera images with these numbers, rendered in one batch."""
        renderer = self.twin.renderer
        touched = [number for number, contact in enumerate(contacts) if contact is not None and contact.touches]
        clean: list[Any] = [renderer.reference] * len(contacts)
        if touched:
            batch = Contact.stack([contact for number in touched if (contact := contacts[number]) is not None])
            images = self._batch_renderer.images(batch.on_skin(self._twin(self.twin.friction).model.skin))
            for number, image in zip(touched, np.asarray(to_device(images, "cpu"), np.float32), strict=True):
                clean[number] = image
        return [renderer.noise.add_to(image, number) for image, number in zip(clean, numbers, strict=True)]

    @cached_property
    def _batch_renderer(self) -> BatchRenderer:
        return BatchRenderer(self.twin.renderer, self.like)


def _name_scene(refusal: NinedtactError, number: int) -> NinedtactError:
    """Return a refusal whose sentence begins with the scene that it is about."""
    refusal.args = (f"scene {number}: {refusal}",)
    return refusal
