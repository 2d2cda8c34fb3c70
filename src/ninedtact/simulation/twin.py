"""A sensor that is not there: gel, light, lens, image and noise of one that is, or of one that could be.

The twin of a sensor that is designed but not built: what changes from the average sensor when the design does.

The gel's thickness t changes the light as the reflectance St/(1 + St) of its layer does (Kubelka and Munk 1931,
docs/references.md): slope and saturation of the brightness law; scattering spreads light over a part of the thickness that
stays the same. The camera's distance and the way light is bent into acrylic and silicone change the scale of the image.
The exposure is taken to be set so that untouched skin is as bright as ever.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np

from ninedtact.design import ACRYLIC_REFRACTIVE_INDEX, SILICONE_REFRACTIVE_INDEX, Gel, SensorDesign
from ninedtact.errors import NinedtactError
from ninedtact.mechanics.alternating_solver import SolverSettings
from ninedtact.mechanics.array_namespace import to_numpy
from ninedtact.mechanics.contact import Contact, ContactLeavesGrid
from ninedtact.mechanics.contact_model import ContactModel
from ninedtact.mechanics.indenter import Indenter
from ninedtact.mechanics.layer_compliance import ComplianceFunction, bonded_layer_compliance
from ninedtact.mechanics.periodic_grid import padded_grid
from ninedtact.mechanics.pose import Pose
from ninedtact.mechanics.skin import Skin
from ninedtact.simulation.illumination import BrightnessModel, synthetic_reference_image
from ninedtact.simulation.pixel_map import PixelMap, WideAngleLens
from ninedtact.simulation.renderer import CameraNoise, Renderer

PITCH_MM = 0.2
MARGIN_MM = 4.0
"""Skin beyond the sensing area; see docs/mechanics.md for the error it leaves."""
LIVE_SOLVER_SETTINGS = SolverSettings(tolerance=1e-2, must_converge=False)
"""A hundredth of the depth: less than the noise of an image shows."""


class PoseOutOfView(NinedtactError):
    """An object beside the skin that the camera sees."""


class ObjectTooLarge(NinedtactError):
    """An object that would touch more than the gel."""


def _uncorrected(contact: Contact) -> Contact:
    """No correction: what the linear layer says."""
    return contact


@dataclass(frozen=True)
class Twin:
    """Everything needed to press it and to look at it."""

    name: str
    compliance_of: ComplianceFunction
    renderer: Renderer
    friction: float = 1.0
    pitch_mm: float = PITCH_MM
    area_mm: tuple[float, float] = (24.0, 18.0)
    effort: SolverSettings = field(default_factory=lambda: LIVE_SOLVER_SETTINGS)
    thickness_mm: float = np.inf
    """Of all that yields."""
    gel_mm: tuple[float, float] = (29.5, 22.5)
    """Width and height of the gel as the published mould makes it; the camera sees the middle."""
    felt: Callable[[Contact], Contact] = _uncorrected
    """From a contact as it is solved, and gone on from, to what is seen and weighed: for gels that are not linear."""

    @cached_property
    def model(self) -> ContactModel:
        """The skin, ready to be pressed."""
        patch = padded_grid(*self.area_mm, self.pitch_mm, MARGIN_MM)
        skin = Skin(patch, self.compliance_of, np.zeros((), np.float32), self.thickness_mm)
        return ContactModel(skin, self.friction, self.effort)

    def step(self, last: Contact, indenter: Indenter, pose: Pose, load_n: float | None = None) -> Contact:
        """The contact after the object moved on to this pose, or to this load near it.

        Raises `PoseOutOfView`, `ObjectTooLarge`, and what `ContactModel` raises.
        """
        self.require_in_view(pose)
        try:
            if load_n is None:
                contact = self.model.step(last, indenter, pose)
            else:
                contact = self.model.step_to_load(last, indenter, pose, load_n)
        except ContactLeavesGrid as beyond:
            raise self.too_large(indenter, "more than that") from beyond
        self.require_on_gel(indenter, contact)
        return contact

    def require_in_view(self, pose: Pose) -> None:
        """Refuse an object whose middle the camera does not see; raises `PoseOutOfView`."""
        reach = self.renderer.view.reach_mm
        if abs(pose.x_mm) > reach[0] or abs(pose.y_mm) > reach[1]:
            raise PoseOutOfView(
                f"expected the object over the skin that the camera sees, x within ±{reach[0]:.1f} mm and y within "
                f"±{reach[1]:.1f} mm, got ({pose.x_mm:g}, {pose.y_mm:g}) mm; press nearer to the middle"
            )

    def require_on_gel(self, indenter: Indenter, contact: Contact) -> None:
        """Refuse a contact that reaches over the gel's rim; raises `ObjectTooLarge`."""
        pressed = to_numpy(contact.pressure_mpa) > 0
        if not pressed.any():
            return
        reach = [float(np.abs(place[pressed]).max()) for place in contact.surface_mm[:2]]
        if reach[0] > self.gel_mm[0] / 2 or reach[1] > self.gel_mm[1] / 2:
            raise self.too_large(indenter, f"contact up to x = ±{reach[0]:.1f} mm and y = ±{reach[1]:.1f} mm")

    def too_large(self, indenter: Indenter, got: str) -> ObjectTooLarge:
        """The refusal of an object that does not fit on the gel."""
        width, height = self.gel_mm
        return ObjectTooLarge(
            f"expected {indenter.name} to touch no more than the gel of {width:g} x {height:g} mm, got {got}; take a "
            "smaller object, press less deep, or nearer to the middle"
        )


def default_twin(seed: int = 0, gel: Gel = Gel()) -> Twin:
    """The twin of no sensor in particular: the published gel, an average light and lens; the seed is that of its skin."""
    view = WideAngleLens().view()
    renderer = Renderer(
        view,
        synthetic_reference_image(view, seed=seed),
        BrightnessModel(),
        CameraNoise(shape=view.raw_shape, seed=seed),
    )
    return Twin("default", partial(bonded_layer_compliance, gel=gel), renderer, thickness_mm=gel.thickness_mm)


PUBLISHED_DESIGN = SensorDesign()
"""The design of the sensors that the defaults of light and lens come from."""
AIR_MM, ACRYLIC_MM = 0.35, 2.0
"""Between lens front and gel in the published sensor; the rest is silicone."""


def twin_from_design(design: SensorDesign, seed: int = 0) -> Twin:
    """The twin that a sensor of this design would have; that of the published design is `default_twin`."""
    view = lens_for_design(design).view()
    noise = CameraNoise(shape=view.raw_shape, seed=seed)
    renderer = Renderer(
        view,
        synthetic_reference_image(illumination_pixel_map(view, design), seed=seed),
        brightness_model_for_design(design),
        noise,
    )
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
    """The average light, carried to this design."""
    return scale_brightness_to_design(BrightnessModel(), design)


def scale_brightness_to_design(light: BrightnessModel, design: SensorDesign) -> BrightnessModel:
    """The light of a sensor of the published design → that through the gel of another, seen from its distance."""
    thicker = design.gel.thickness_mm / PUBLISHED_DESIGN.gel.thickness_mm
    steeper = _reflectance_slope_per_mm(design.gel.thickness_mm, light) / _reflectance_slope_per_mm(
        PUBLISHED_DESIGN.gel.thickness_mm, light
    )
    return replace(
        light,
        darkening_per_mm=light.darkening_per_mm * steeper,
        brightening_per_mm=light.brightening_per_mm * steeper,
        saturation=light.saturation * thicker,
        point_spread_mm=light.point_spread_mm * thicker,
        inverse_distance_per_mm=light.inverse_distance_per_mm
        * (PUBLISHED_DESIGN.camera.distance_mm / design.camera.distance_mm),
        thickness_mm=light.thickness_mm * thicker,
    )


def _reflectance_slope_per_mm(thickness_mm: float, light: BrightnessModel) -> float:
    """Relative change of the reflectance St/(1 + St) with t."""
    scattered = light.saturation / light.thickness_mm * thickness_mm
    return 1 / (thickness_mm * (1 + scattered))


def lens_for_design(design: SensorDesign) -> WideAngleLens:
    """The average lens, looking from this distance; a narrower lens spreads its image over less skin."""
    lens = WideAngleLens()
    nearer = radius_mm_per_rad(design) / radius_mm_per_rad(PUBLISHED_DESIGN)
    narrower = design.camera.lens_angle_deg / PUBLISHED_DESIGN.camera.lens_angle_deg
    return replace(lens, mm_per_unit=lens.mm_per_unit * nearer * narrower)


def radius_mm_per_rad(design: SensorDesign) -> float:
    """Radius gained per radian near the axis, on the way through air, acrylic and silicone."""
    silicone = max(design.camera.distance_mm - AIR_MM - ACRYLIC_MM, 0.0)
    return AIR_MM + ACRYLIC_MM / ACRYLIC_REFRACTIVE_INDEX + silicone / SILICONE_REFRACTIVE_INDEX


def illumination_pixel_map(view: PixelMap, design: SensorDesign) -> PixelMap:
    """The view on the average sensor that shows the light of this one: LEDs stand round the area, however large it is."""
    area, average = design.sensing_area, PUBLISHED_DESIGN.sensing_area
    if area == average:
        return view
    smaller = np.array([average.width_mm / area.width_mm, average.height_mm / area.height_mm], np.float32)
    return PixelMap(view.plane_mm * smaller)
