"""Press trajectories: one object on one sensor, pressed to a load, then dragged, twisted and tilted from target to target.

A press is controlled by force, like one by hand: every step sinks in under its load, and moves sideways by the missing shear
force over the stiffness of the contact, until the shear is reached or the object slips. The distributions of the targets were
tuned so that the wrenches have the percentiles of real ones (`dataset/statistics_and_card.py`); the wrenches themselves come
from contact mechanics.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float64
from numpy import ndarray as Array

from ninedtact.mechanics.contact_result import ContactLeavesGrid, NonPositiveLoad
from ninedtact.mechanics.indenter import Indenter
from ninedtact.mechanics.pose import InvalidPose, Pose
from ninedtact.simulation.twin import ContactLeavesGel, PoseOutOfView, Press
from ninedtact_train.batched.session_requests import RequestGenerator, SimulatedSetup, StepRequest
from ninedtact_train.dataset.generation.settings import PressSettings, PressTarget

_Pair = tuple[float, float]
_CONTACT_LOST = (PoseOutOfView, NonPositiveLoad, ContactLeavesGrid, ContactLeavesGel)
"""Errors of a step where no contact is possible; they end the press."""
_MAX_SIDEWAYS_STEP_MM = 0.5
_CONTACT_REACH_MM = 1.0
"""Parts of the underside that are lower than this are expected to touch."""
_EDGE_MARGIN_MM = 0.5
"""Smallest distance between a contact and the edge of the sensing area."""
_RESIDUAL_PART, _RESIDUAL_MM = 0.03, 0.002
"""Largest residual as a fraction of the maximum indentation, and in mm; a contact that is solved less accurately ends the press."""


@dataclass
class RandomPress:
    """One press of an object with sampled targets on a simulated sensor. Its steps are generators of simulation requests."""

    setup: SimulatedSetup
    indenter: Indenter
    settings: PressSettings
    rng: np.random.Generator
    pose: Pose = field(init=False)
    """Pose of the object."""
    contact: Press | None = field(init=False, default=None)
    """The contact that the next step starts from; None before the first."""
    initial_twist_rad: float = field(init=False)

    def __post_init__(self) -> None:
        self.initial_twist_rad = float(self.rng.uniform(-np.pi, np.pi))
        area_mm = self.setup.twin.area_mm
        max_offset_mm = _max_offset_mm(self.indenter, self.initial_twist_rad, area_mm)
        x, y = self.settings.sample_position(self.rng, max_offset_mm, area_mm)
        self.pose = Pose(x, y, 0.0, self.initial_twist_rad)

    def targets(self) -> Iterator[PressTarget]:
        """Yield the target of every step of the press; each is sampled when it is needed."""
        target = self._sample_without_shear(0.0)
        fewest, most = self.settings.targets
        for _ in range(self.rng.integers(fewest, most + 1)):
            before, target = target, self.settings.sample_target(self.rng)
            for step in range(1, self.settings.steps + 1):
                yield _interpolate_targets(before, target, step / self.settings.steps)

    def press_lightly(self, load_n: float) -> RequestGenerator[Press | None]:
        """Request the contact under this load alone; the result is None if there is none."""
        return self.step_towards(replace(self._sample_without_shear(load_n), twist_rad=0.0))

    def step_towards(self, target: PressTarget) -> RequestGenerator[Press | None]:
        """Request one step towards a target; the result is the contact, or None if the press cannot continue."""
        # A finite-strain gel yields a larger load than the linear model solves for, so the requested load is smaller.
        load_n = target.load_n / (self.contact.stiffening if self.contact else 1.0)
        try:
            contact = yield from self._sink_in(self._next_pose(target), load_n)
        except _CONTACT_LOST:
            return None
        self.contact, self.pose = contact, contact.pose
        is_accurate = contact.solved.residual_mm < _RESIDUAL_PART * contact.max_indentation_mm + _RESIDUAL_MM
        return contact if contact.touches and is_accurate else None

    def _sample_without_shear(self, load_n: float) -> PressTarget:
        return replace(self.settings.sample_target(self.rng), load_n=load_n, shear_n=np.zeros(2))

    def _sink_in(self, pose: Pose, load_n: float) -> RequestGenerator[Press]:
        """Request the contact under a load, but no deeper than a press goes."""
        try:
            contact: Press = yield self._request_step(pose, load_n)
        except InvalidPose:
            # The object would go through the gel under this load, as a needle would; half the load is tried next.
            return (yield from self._sink_in(pose, load_n / 2))
        too_deep_mm = contact.max_indentation_mm - self.settings.max_depth * self.setup.member.gel.thickness_mm
        if too_deep_mm <= 0:
            return contact
        return (yield self._request_step(replace(pose, depth_mm=contact.pose.depth_mm - too_deep_mm)))

    def _request_step(self, pose: Pose, load_n: float | None = None) -> StepRequest:
        return StepRequest(self.setup, self.contact, self.indenter, pose, load_n)

    def _next_pose(self, target: PressTarget) -> Pose:
        """Return the pose of the next step; its depth is an initial guess."""
        tilt_x, tilt_y = target.tilt_rad.tolist()
        twist = self.initial_twist_rad + target.twist_rad
        pose = replace(self.pose, twist_rad=twist, tilt_x_rad=tilt_x, tilt_y_rad=tilt_y)
        if self.contact is None or not self.contact.touches:
            return pose
        missing_n = target.shear_n - self.contact.wrench.force_n[:2]
        stiffness = self._shear_stiffness_n_per_mm(self.contact)
        dx, dy = np.clip(missing_n / stiffness, -_MAX_SIDEWAYS_STEP_MM, _MAX_SIDEWAYS_STEP_MM).tolist()
        return replace(pose, x_mm=pose.x_mm + dx, y_mm=pose.y_mm + dy)

    def _shear_stiffness_n_per_mm(self, contact: Press) -> float:
        """Estimate the stiffness of a contact: a disc of its area on a half-space, plus the layer below it in shear."""
        gel, area = self.setup.member.gel, contact.contact_area_mm2
        return gel.shear_modulus_mpa * (16 / 3 * np.sqrt(area / np.pi) + area / gel.thickness_mm)


def _interpolate_targets(before: PressTarget, after: PressTarget, part: float) -> PressTarget:
    """Return the target at this part of the way from one to the next."""
    values = {
        name: getattr(before, name) + part * (value - getattr(before, name)) for name, value in vars(after).items()
    }
    return PressTarget(**values)


def _max_offset_mm(indenter: Indenter, twist_rad: float, area_mm: _Pair) -> Float64[Array, "2"]:
    """Return how far the object may be from the sensor's middle along x and y with its contact inside the sensing area."""
    axis = np.linspace(-12, 12, 97)
    x, y = np.meshgrid(axis, axis)
    near = indenter.height_over_skin_mm(Pose(twist_rad=twist_rad), x, y) < _CONTACT_REACH_MM
    reach = np.array([np.abs(x[near]).max(initial=0), np.abs(y[near]).max(initial=0)])
    return np.maximum(np.array(area_mm) / 2 - _EDGE_MARGIN_MM - reach, 0)
