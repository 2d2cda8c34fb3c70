"""The digital twin of a sensor: its gel, brightness model, lens, reference image and camera noise.

`build_twin_from_folder` of `ninedtact.calibration` makes the twin of a calibrated sensor, `twin_from_design` that of a sensor which
is designed but not built, `default_twin` that of the published design.

A design differs from the published one in three ways. The gel's thickness t changes the reflectance St/(1 + St) of its layer
(Kubelka and Munk 1931, docs/references.md), and with it the slope and the saturation of the brightness model; the point-spread
stays the same part of the thickness. The camera's distance and the refraction into acrylic and silicone change the scale of the
image. The exposure is assumed to be set so that the reference image keeps its brightness.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Protocol, runtime_checkable
from zlib import crc32

import numpy as np

from ninedtact.design import ACRYLIC_REFRACTIVE_INDEX, SILICONE_REFRACTIVE_INDEX, Gel, SensorDesign
from ninedtact.errors import SimulationError
from ninedtact.mechanics.alternating_solver import SolverSettings
from ninedtact.mechanics.array_namespace import to_numpy
from ninedtact.mechanics.contact_model import ContactModel
from ninedtact.mechanics.contact_result import Contact, ContactLeavesGrid
from ninedtact.mechanics.indenter import Indenter
from ninedtact.mechanics.layer_compliance import ComplianceFunction, bonded_layer_compliance
from ninedtact.mechanics.periodic_grid import padded_grid
from ninedtact.mechanics.pose import Pose
from ninedtact.mechanics.surface_displacement import Skin
from ninedtact.simulation.gel_brightness import BrightnessModel, synthetic_reference_image
from ninedtact.simulation.pixel_to_skin_map import PixelToSkinMap, WideAngleLens
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


@runtime_checkable
class ContactCorrection(Protocol):
    """A function from a contact of the linear solver to the one that is rendered and measured."""

    def __call__(self, contact: Contact, indenter: Indenter | None = None) -> Contact:
        """Return the corrected contact; the object is given where it is known."""


def _uncorrected(contact: Contact, indenter: Indenter | None = None) -> Contact:
    """Return the contact of the linear layer unchanged."""
    return contact


LOAD_TOLERANCE = 0.005
"""Relative difference from the wanted load at which a contact that is corrected counts as found."""
LOAD_ROUNDS = 4
"""Largest number of contacts that are solved to find a load."""


@dataclass(frozen=True)
class Twin:
    """Everything needed to press a simulated sensor and to render its images."""

    name: str
    compliance_of: ComplianceFunction
    """Surface compliance of the gel at a wave number."""
    renderer: Renderer
    friction: float = 1.0
    pitch_mm: float = PITCH_MM
    area_mm: tuple[float, float] = (24.0, 18.0)
    solver_settings: SolverSettings = field(default_factory=lambda: LIVE_SOLVER_SETTINGS)
    thickness_mm: float = np.inf
    """Thickness of all compliant layers."""
    gel_mm: tuple[float, float] = (29.5, 22.5)
    """Width and height of the gel that the published mould makes; the camera sees the middle."""
    correct_contact: ContactCorrection = _uncorrected
    """Gels that are not linear need it."""

    @cached_property
    def model(self) -> ContactModel:
        """The contact model of the skin."""
        patch = padded_grid(*self.area_mm, self.pitch_mm, MARGIN_MM)
        skin = Skin(patch, self.compliance_of, np.zeros((), np.float32), self.thickness_mm)
        return ContactModel(skin, self.friction, self.solver_settings)

    def with_noise_of(self, name: str) -> "Twin":
        """Return the twin with the camera noise that belongs to a name, so that sensors seen together have noise of their own.

        The noise of the empty name is that of a sensor by itself (seed 0).
        """
        noise = replace(self.renderer.noise, seed=crc32(name.encode()))
        return replace(self, renderer=replace(self.renderer, noise=noise))

    def step(self, last: Contact, indenter: Indenter, pose: Pose, load_n: float | None = None) -> Contact:
        """Return the contact after the object has moved to a pose, or to a load near that pose, before `correct_contact`.

        The load is that of the corrected contact, to `LOAD_TOLERANCE`.
        Raises `PoseOutOfView`, `ContactLeavesGel`, and what `ContactModel` raises.
        """
        if load_n is None:
            return self.step_linear_layer(last, indenter, pose)
        contact = last
        for _ in range(LOAD_ROUNDS):
            contact = self.step_linear_layer(last, indenter, pose, self.linear_load_n(contact, load_n))
            if self.bears(contact, load_n):
                break
        return contact

    def bears(self, contact: Contact, load_n: float) -> bool:
        """Return whether a contact of the solver has a load after `correct_contact`, to `LOAD_TOLERANCE`."""
        return self.correct_contact is _uncorrected or abs(self.load_n(contact) - load_n) <= LOAD_TOLERANCE * load_n

    def load_n(self, contact: Contact) -> float:
        """Return the load of a contact after `correct_contact`."""
        return -float(self.correct_contact(contact).wrench().force_n[2])

    def linear_load_n(self, known: Contact, load_n: float) -> float:
        """Return the load of the linear layer whose corrected contact has a load, as a contact of the same object tells.

        The correction adds a share of the load that grows with the load. Without contact it is the load itself.
        """
        solved_n = -float(known.wrench().force_n[2]) if known.touches else 0.0
        if self.correct_contact is _uncorrected or solved_n <= 0:
            return load_n
        growth_per_n = (self.load_n(known) / solved_n - 1) / solved_n
        return 2 * load_n / (1 + np.sqrt(max(1 + 4 * growth_per_n * load_n, 0.0)))

    def step_linear_layer(self, last: Contact, indenter: Indenter, pose: Pose, load_n: float | None = None) -> Contact:
        """Return the contact as `step` does, where a load is that of the linear layer, before `correct_contact`."""
        self.require_in_view(pose)
        try:
            if load_n is None:
                contact = self.model.step(last, indenter, pose)
            else:
                contact = self.model.step_to_load(last, indenter, pose, load_n)
        except ContactLeavesGrid as beyond:
            raise self.contact_leaves_gel(indenter, "more than that") from beyond
        self.require_on_gel(indenter, contact)
        return contact

    def require_in_view(self, pose: Pose) -> None:
        """Refuse a pose whose centre the camera does not see; raises `PoseOutOfView`."""
        reach = self.renderer.pixel_map.reach_mm
        if abs(pose.x_mm) > reach[0] or abs(pose.y_mm) > reach[1]:
            raise PoseOutOfView(
                f"expected the object over the skin that the camera sees, x within ±{reach[0]:.1f} mm and y within "
                f"±{reach[1]:.1f} mm, got ({pose.x_mm:g}, {pose.y_mm:g}) mm; press nearer to the centre"
            )

    def require_on_gel(self, indenter: Indenter, contact: Contact) -> None:
        """Refuse a contact that reaches beyond the edge of the gel; raises `ContactLeavesGel`."""
        pressed = to_numpy(contact.pressure_mpa) > 0
        if not pressed.any():
            return
        reach = [float(np.abs(place[pressed]).max()) for place in contact.surface_points_mm[:2]]
        if reach[0] > self.gel_mm[0] / 2 or reach[1] > self.gel_mm[1] / 2:
            raise self.contact_leaves_gel(indenter, f"contact up to x = ±{reach[0]:.1f} mm and y = ±{reach[1]:.1f} mm")

    def contact_leaves_gel(self, indenter: Indenter, got: str) -> ContactLeavesGel:
        """Return the error for an object that does not fit on the gel."""
        width, height = self.gel_mm
        return ContactLeavesGel(
            f"expected {indenter.name} to touch no more than the gel of {width:g} x {height:g} mm, got {got}; take a "
            "smaller object, press less deep, or press nearer to the centre"
        )


def default_twin(seed: int = 0, gel: Gel = Gel()) -> Twin:
    """Return the twin of the published design with an average brightness model and lens; the seed picks its reference image.

    >>> twin = ninedtact.default_twin()
    >>> contact = ninedtact.ScriptedPress(depth_mm=0.5).simulate(twin, ninedtact.indenter_from_name("ball:4"))
    >>> bool(contact.wrench().force_n[2] < -0.5), twin.renderer(contact).shape
    (True, (480, 640, 3))
    """
    pixel_map = WideAngleLens().pixel_map()
    reference, noise = (
        synthetic_reference_image(pixel_map, seed=seed),
        CameraNoise(shape=pixel_map.raw_shape, seed=seed),
    )
    renderer = Renderer(pixel_map, reference, BrightnessModel(), noise)
    return Twin("default", partial(bonded_layer_compliance, gel=gel), renderer, thickness_mm=gel.thickness_mm)


PUBLISHED_DESIGN = SensorDesign()
"""The design of the sensors from which the default brightness model and lens were fitted."""
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
        partial(bonded_layer_compliance, gel=design.gel),
        renderer,
        area_mm=area.size_mm,
        thickness_mm=design.gel.thickness_mm,
        gel_mm=area.gel_mm,
    )


def brightness_model_for_design(design: SensorDesign) -> BrightnessModel:
    """Return the average brightness model, scaled to a design."""
    return scale_brightness_to_design(BrightnessModel(), design)


def scale_brightness_to_design(
    model: BrightnessModel, design: SensorDesign, measured_on: SensorDesign = PUBLISHED_DESIGN
) -> BrightnessModel:
    """Scale the brightness model of a sensor of one design to the gel and the camera distance of another."""
    thickness_mm, measured_mm = design.gel.thickness_mm, measured_on.gel.thickness_mm
    thicker = thickness_mm / measured_mm
    steeper = _reflectance_slope_per_mm(thickness_mm, model) / _reflectance_slope_per_mm(measured_mm, model)
    nearer = measured_on.camera.distance_mm / design.camera.distance_mm
    return replace(
        model,
        darkening_per_mm=model.darkening_per_mm * steeper,
        brightening_per_mm=model.brightening_per_mm * steeper,
        saturation=model.saturation * thicker,
        point_spread_mm=model.point_spread_mm * thicker,
        inverse_distance_per_mm=model.inverse_distance_per_mm * nearer,
        thickness_mm=model.thickness_mm * thicker,
    )


def _reflectance_slope_per_mm(thickness_mm: float, model: BrightnessModel) -> float:
    """Return the relative change per mm of the reflectance St/(1 + St) with the thickness t."""
    scattered = model.saturation / model.thickness_mm * thickness_mm
    return 1 / (thickness_mm * (1 + scattered))


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
