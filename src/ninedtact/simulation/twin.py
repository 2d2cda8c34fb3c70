"""A sensor that is not there: gel, light, lens, image and noise of one that is, or of one that could be."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property, partial

import numpy as np

from ninedtact.design import Gel
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
from ninedtact.simulation.image import Renderer
from ninedtact.simulation.light import Light
from ninedtact.simulation.noise import Noise
from ninedtact.simulation.untouched import untouched_image
from ninedtact.simulation.view import WideLens

PITCH_MM = 0.2
MARGIN_MM = 4.0
"""Skin beyond the sensing area; see docs/mechanics.md for the error it leaves."""
LIVE = SolverSettings(tolerance=1e-2, must_converge=False)
"""A hundredth of the depth: less than the noise of an image shows."""


class PoseOutOfView(NinedtactError):
    """An object beside the skin that the camera sees."""


class ObjectTooLarge(NinedtactError):
    """An object that would touch more than the gel."""


def as_solved(contact: Contact) -> Contact:
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
    effort: SolverSettings = field(default_factory=lambda: LIVE)
    thickness_mm: float = np.inf
    """Of all that yields."""
    gel_mm: tuple[float, float] = (29.5, 22.5)
    """Width and height of the gel as the published mould makes it; the camera sees the middle."""
    felt: Callable[[Contact], Contact] = as_solved
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
    view = WideLens().view()
    renderer = Renderer(view, untouched_image(view, seed=seed), Light(), Noise(shape=view.raw_shape, seed=seed))
    return Twin("default", partial(bonded_layer_compliance, gel=gel), renderer, thickness_mm=gel.thickness_mm)
