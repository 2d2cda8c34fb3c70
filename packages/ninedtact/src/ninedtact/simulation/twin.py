"""The digital twin of a sensor: its gel, brightness model, lens, reference image and camera noise.

`SensorFolder.twin` of `ninedtact.calibration` makes the twin of a calibrated sensor, `twin_from_design` that of a sensor which
is designed but not built, `default_twin` that of the published design.

A design differs from the published one in three ways. The gel's thickness t changes the reflectance St/(1 + St) of its layer
(Kubelka and Munk 1931, docs/references.md), and with it the slope and the saturation of the brightness model; the point-spread
stays the same part of the thickness. The camera's distance and the refraction into acrylic and silicone change the scale of the
image. The exposure is assumed to be set so that the reference image keeps its brightness.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, Any
from zlib import crc32

import numpy as np
from msgspec import Meta

from ninedtact.bounds import checks_arguments
from ninedtact.design import ACRYLIC_REFRACTIVE_INDEX, SILICONE_REFRACTIVE_INDEX, Gel, SensorDesign
from ninedtact.errors import SimulationError
from ninedtact.mechanics.contact_model import ContactModel, SolverSettings
from ninedtact.mechanics.contact_result import Contact, ContactLeavesGrid, least_gel_mm, require_gel_left
from ninedtact.mechanics.finite_strain import correct_for_finite_strain
from ninedtact.mechanics.indenter import Indenter
from ninedtact.mechanics.numpy_or_torch_arrays import ScalarPerContact, to_numpy
from ninedtact.mechanics.pose import Pose
from ninedtact.mechanics.relaxation import GelMemory
from ninedtact.mechanics.skin import Skin, padded_grid
from ninedtact.simulation.gel_brightness import (
    PUBLISHED_DESIGN,
    brightness_model_for_design,
    synthetic_reference_image,
)
from ninedtact.simulation.pixel_to_skin_map import PixelToSkinMap, WideAngleLens
from ninedtact.simulation.press import Press, number_of_single
from ninedtact.simulation.renderer import CameraNoise, Renderer

PITCH_MM = 0.2
MARGIN_MM = 4.0
"""Width of the simulated skin beyond the sensing area; docs/mechanics.md states the error that remains."""
LIVE_SOLVER_SETTINGS = SolverSettings(tolerance=1e-2, must_converge=False)
"""A tolerance of one hundredth of the depth, which is less than image noise shows."""


class PoseOutOfView(SimulationError):
    """Raised for an object beside the part of the skin that the camera sees."""


class ContactLeavesGel(SimulationError):
    """Raised for a contact that reaches beyond the edge of the gel."""


LOAD_TOLERANCE = 0.005
"""Relative difference from the wanted load at which a press counts as found."""
LOAD_ROUNDS = 4
"""Largest number of contacts that are solved to find a load."""


@checks_arguments
@dataclass(frozen=True)
class Twin:
    """Everything needed to press a simulated sensor and to render its images."""

    name: str
    gel: Gel
    renderer: Renderer
    friction: Annotated[float, Meta(ge=0)] = 1.0
    pitch_mm: Annotated[float, Meta(gt=0)] = PITCH_MM
    area_mm: tuple[float, float] = (24.0, 18.0)
    solver_settings: SolverSettings = field(default_factory=lambda: LIVE_SOLVER_SETTINGS)
    gel_mm: tuple[float, float] = (29.5, 22.5)
    """Width and height of the gel that the published mould makes; the camera sees the middle."""
    like: Any = field(default_factory=lambda: np.zeros((), np.float32), compare=False, repr=False)
    """Presses are solved in the array library, precision and device of this array."""

    @cached_property
    def model(self) -> ContactModel:
        """The contact model of the skin."""
        patch = padded_grid(*self.area_mm, self.pitch_mm, MARGIN_MM)
        skin = Skin(patch, self.gel, self.like)
        return ContactModel(skin, self.friction, self.solver_settings)

    @checks_arguments
    def with_noise_of(self, name: str) -> "Twin":
        """Return the twin with the camera noise that belongs to a name, so that sensors seen together have noise of their own.

        The noise of the empty name is that of a sensor by itself (seed 0).
        """
        noise = replace(self.renderer.noise, seed=crc32(name.encode()))
        return replace(self, renderer=replace(self.renderer, noise=noise))

    @checks_arguments
    def hover(self, indenter: Indenter, pose: Pose) -> Press:
        """Return undeformed skin under an object at a pose that is above it."""
        contact = replace(self.model.initial_contact(), pose=pose)
        return Press(contact, contact, indenter)

    @checks_arguments
    def press(
        self,
        last: Press | None,
        indenter: Indenter,
        pose: Pose,
        load_n: ScalarPerContact | None = None,
        *,
        is_linear_load: bool = False,
        after_s: Annotated[float, Meta(ge=0)] = 0.0,
    ) -> Press:
        """Return the press after the object has moved to a pose, or to a load near that pose; this is the only way to press a twin.

        last: the press before, None for undeformed skin. load_n: the load of the gel as it acts, to `LOAD_TOLERANCE`; with
        `is_linear_load` that of the linear layer, which is solved once. A pose with arrays in it is a batch. after_s: time since
        the press before, in which the gel relaxes (`mechanics.relaxation`); for single presses.

        Raises `PoseOutOfView`, `ContactLeavesGel`, and what `ContactModel` raises.
        """
        self.require_in_view(pose)
        before = self.model.initial_contact() if last is None else last.solved
        memory = self._memory_of(last, after_s)
        if load_n is None or is_linear_load:
            press = self.finish_press(self._solve(before, indenter, pose, load_n), indenter)
        else:
            elastic_n = load_n if memory is None else memory.elastic_load_n(float(load_n), after_s)
            press = self._press_to_load(last, before, indenter, pose, elastic_n)
        require_gel_left(self.gel, least_gel_mm(press.corrected))
        return press if memory is None else press.relax(memory, after_s)

    def _memory_of(self, last: Press | None, after_s: float) -> GelMemory | None:
        """Return what the gel remembers at the last press; None where it does not relax."""
        memory = None if last is None or not last.touches else last.memory
        if memory is not None or after_s == 0 or not self.gel.relaxing_shares:
            return memory
        return GelMemory.of_new_contact(self.gel)

    def _press_to_load(
        self, last: Press | None, before: Contact, indenter: Indenter, pose: Pose, load_n: ScalarPerContact
    ) -> Press:
        """Return the press with this load of the gel as it acts, found by presses with loads of the linear layer."""
        wanted_n = self._linear_load_n(last, load_n)
        for round_number in range(LOAD_ROUNDS):
            press = self.finish_press(self._solve(before, indenter, pose, wanted_n), indenter)
            found = np.abs(press.load_n - load_n) <= LOAD_TOLERANCE * np.asarray(load_n)
            if not self.gel.finite_strain or found.all() or round_number == LOAD_ROUNDS - 1:
                break
            # A press of a batch whose load is found is solved again as it was, so that it is the one that it would be alone.
            wanted_n = np.where(found, wanted_n, self._linear_load_n(press, load_n)) + 0.0
        return press

    def finish_press(self, solved: Contact, indenter: Indenter) -> Press:
        """Return the press of a contact that the linear solver found, here or in a batch of several sensors."""
        return Press(solved, correct_for_finite_strain(solved), indenter)

    def _linear_load_n(self, known: Press | None, load_n: ScalarPerContact) -> ScalarPerContact:
        """Return the load of the linear layer at which the gel has a load, as a press of the same object tells.

        The correction adds a share of the load that grows with the load. Without contact it is the load itself.
        """
        if not self.gel.finite_strain or known is None or not known.touches:
            return load_n
        linear_n = np.maximum(known.linear_load_n, 1e-12)
        growth_per_n = (known.stiffening - 1) / linear_n
        found = 2 * np.asarray(load_n) / (1 + np.sqrt(np.maximum(1 + 4 * growth_per_n * load_n, 0.0)))
        return number_of_single(np.where(np.asarray(known.linear_load_n) > 0, found, load_n))

    def _solve(self, before: Contact, indenter: Indenter, pose: Pose, load_n: ScalarPerContact | None) -> Contact:
        """Return the contact of the linear layer at a pose or under a load."""
        try:
            if load_n is None:
                contact = self.model.step(before, indenter, pose)
            else:
                contact = self.model.step_to_load(before, indenter, pose, load_n)
        except ContactLeavesGrid as beyond:
            raise self.contact_leaves_gel(indenter, "more than that") from beyond
        self.require_on_gel(indenter, contact)
        return contact

    def require_in_view(self, pose: Pose) -> None:
        """Refuse a pose whose centre the camera does not see; raises `PoseOutOfView`."""
        reach = self.renderer.pixel_map.reach_mm
        x_mm, y_mm = np.broadcast_arrays(np.atleast_1d(pose.x_mm), pose.y_mm)
        outside = (np.abs(x_mm) > reach[0]) | (np.abs(y_mm) > reach[1])
        if outside.any():
            raise PoseOutOfView(
                expected=f"the object over the skin that the camera sees, x within ±{reach[0]:.1f} mm and y "
                f"within ±{reach[1]:.1f} mm",
                got=f"({x_mm[outside][0]:g}, {y_mm[outside][0]:g}) mm",
                remedy="press nearer to the centre",
            )

    def require_on_gel(self, indenter: Indenter, contact: Contact) -> None:
        """Refuse a contact that reaches beyond the edge of the gel; raises `ContactLeavesGel`."""
        pressed = to_numpy(contact.pressure_mpa) > 0
        places = np.abs(contact.surface_points_mm[..., :2, :, :]) * pressed[..., None, :, :]
        x_mm, y_mm = (float(places[..., axis, :, :].max()) for axis in (0, 1))
        if x_mm > self.gel_mm[0] / 2 or y_mm > self.gel_mm[1] / 2:
            raise self.contact_leaves_gel(indenter, f"contact up to x = ±{x_mm:.1f} mm and y = ±{y_mm:.1f} mm")

    def contact_leaves_gel(self, indenter: Indenter, got: str) -> ContactLeavesGel:
        """Return the error for an object that does not fit on the gel."""
        width, height = self.gel_mm
        return ContactLeavesGel(
            expected=f"{indenter.name} to touch no more than the gel of {width:g} x {height:g} mm",
            got=f"{got}",
            remedy="take a smaller object, press less deep, or press nearer to the centre",
        )


@checks_arguments
def default_twin(seed: Annotated[int, Meta(ge=0)] = 0, gel: Gel = Gel()) -> Twin:
    """Return the twin of the published design with an average brightness model and lens; the seed picks its reference image.

    >>> twin = ninedtact.default_twin()
    >>> contact = ninedtact.ScriptedPress(depth_mm=0.5).simulate(twin, ninedtact.indenter_from_name("ball:4"))
    >>> bool(contact.wrench().force_n[2] < -0.5), twin.renderer(contact).shape
    (True, (480, 640, 3))
    """
    return replace(twin_from_design(PUBLISHED_DESIGN, seed), gel=gel)


AIR_MM, ACRYLIC_MM = 0.35, 2.0
"""Lengths of the optical path in air and acrylic in the published sensor; the rest is silicone."""


def twin_from_design(design: SensorDesign, seed: int = 0) -> Twin:
    """Return the twin of a sensor of this design; the published design gives `default_twin`."""
    pixel_map = lens_for_design(design).pixel_map()
    reference = synthetic_reference_image(scale_pixel_map_to_published(pixel_map, design), seed=seed)
    noise = CameraNoise(shape=pixel_map.raw_shape, seed=seed)
    renderer = Renderer(pixel_map, reference, brightness_model_for_design(design), noise)
    area = design.sensing_area
    return Twin(
        "default" if design == PUBLISHED_DESIGN else "designed",
        design.gel,
        renderer,
        area_mm=area.size_mm,
        gel_mm=area.gel_mm,
    )


def lens_for_design(design: SensorDesign) -> WideAngleLens:
    """Return the average lens at the design's camera distance; a lens of smaller angle sees less skin."""
    lens = WideAngleLens()
    nearer = paraxial_skin_mm_per_rad(design) / paraxial_skin_mm_per_rad(PUBLISHED_DESIGN)
    narrower = design.camera.lens_angle_deg / PUBLISHED_DESIGN.camera.lens_angle_deg
    return replace(lens, mm_per_unit=lens.mm_per_unit * nearer * narrower)


def paraxial_skin_mm_per_rad(design: SensorDesign) -> float:
    """Return the mm on the skin per radian of ray angle near the optical axis, through air, acrylic and silicone."""
    silicone = max(design.camera.distance_mm - AIR_MM - ACRYLIC_MM, 0.0)
    return AIR_MM + ACRYLIC_MM / ACRYLIC_REFRACTIVE_INDEX + silicone / SILICONE_REFRACTIVE_INDEX


def scale_pixel_map_to_published(pixel_map: PixelToSkinMap, design: SensorDesign) -> PixelToSkinMap:
    """Scale the positions of a pixel map to the sensing area of the published design, so that its illumination applies.

    LEDs stand around the sensing area whatever its size, so positions scale with the area.
    """
    area, average = design.sensing_area, PUBLISHED_DESIGN.sensing_area
    if area == average:
        return pixel_map
    smaller = np.array([average.width_mm / area.width_mm, average.height_mm / area.height_mm], np.float32)
    return PixelToSkinMap(pixel_map.plane_mm * smaller)
