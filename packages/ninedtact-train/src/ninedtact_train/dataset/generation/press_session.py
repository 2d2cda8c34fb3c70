"""One session of a generated data set: some fifty pairs with one simulated sensor, made by presses of one object after the other.

A session yields requests for contact steps and images and receives their answers (`ninedtact_train.batched`). A press is controlled
by force, like one by hand: every step sinks in under its load, and moves sideways by the missing shear force over the stiffness of
the contact, until the shear is reached or the object slips. The distributions of the targets were tuned so that the wrenches have
the percentiles of real ones (`dataset/dataset_card.py`); the wrenches themselves come from contact mechanics.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import lru_cache
from math import gcd

import numpy as np
from jaxtyping import Float64
from numpy import ndarray as Array

from ninedtact.capture.strict_image_reading import encode_png
from ninedtact.design import rectified_mm_per_px
from ninedtact.errors import InputError
from ninedtact.mechanics.contact_result import ContactLeavesGrid, NonPositiveLoad
from ninedtact.mechanics.indenter import Indenter
from ninedtact.mechanics.pose import InvalidPose, Pose
from ninedtact.quantities import NO_OBJECT
from ninedtact.simulation.objects.catalogue import indenter_from_name, mesh_file_of_name
from ninedtact.simulation.press import Press
from ninedtact.simulation.twin import ContactLeavesGel, PoseOutOfView
from ninedtact_train.batched.session_requests import RenderRequest, RequestGenerator, SimulatedSetup, StepRequest
from ninedtact_train.collecting.training_pair_rule import SamplingRule
from ninedtact_train.dataset.generation.settings import GenerationSettings, PressSettings, PressTarget
from ninedtact_train.dataset.schema import DatasetRow

_STEP_NS = 100_000_000
"""Time between two steps of a press: ten a second."""
_LIGHTEST_N = 0.02
_MAX_FRUITLESS_PRESSES = 30
"""Number of consecutive presses without a pair after which the session is abandoned."""
_OBJECT_SHIFT = 7
"""Shift of each session's first object in the shuffled list: about as many presses as a session makes."""
_Pair = tuple[float, float]
CONTACT_LOST = (PoseOutOfView, NonPositiveLoad, ContactLeavesGrid, ContactLeavesGel)
"""Errors of a step where no contact is possible; they end the press."""
_MAX_SIDEWAYS_STEP_MM = 0.5
_CONTACT_REACH_MM = 1.0
"""Parts of the underside that are lower than this are expected to touch."""
_EDGE_MARGIN_MM = 0.5
"""Smallest distance between a contact and the edge of the sensing area."""
_RESIDUAL_PART, _RESIDUAL_MM = 0.03, 0.002
"""Largest residual as a fraction of the maximum indentation, and in mm; a contact that is solved less accurately ends the press."""


@dataclass
class SimulatedPressSession:
    """One session of presses on one simulated sensor, until its share of the pairs is full.

    Its pairs depend neither on which other sessions are made nor on which executor computes its requests.
    """

    number: int
    settings: GenerationSettings
    setup: SimulatedSetup
    rows: list[DatasetRow] = field(default_factory=list, init=False)
    """The pairs so far."""
    _presses: int = field(default=0, init=False)
    _steps: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        self._rng = np.random.default_rng([self.settings.seed, 1, self.number])
        self._rule = SamplingRule(self.settings.rule, self._rng)
        self._missing = session_quotas(self.number, self.settings)

    def requests(self) -> RequestGenerator[list[DatasetRow]]:
        """Yield the session's requests; the result is its pairs. Raises `InputError` where presses give no pairs."""
        objects = session_objects(self.settings, self.number)
        fruitless = 0
        while any(self._missing.values()):
            before = len(self.rows)
            yield from self._press_once(next(objects))
            fruitless = fruitless + 1 if len(self.rows) == before else 0
            if fruitless > _MAX_FRUITLESS_PRESSES:
                raise InputError(
                    expected="pairs from presses",
                    got=f"none from {_MAX_FRUITLESS_PRESSES} of them",
                    remedy="press harder, or loosen the rule",
                )
        return self.rows

    def _press_once(self, object_name: str) -> RequestGenerator[None]:
        """Add a pair of every kind that is still missing: without contact, of a light touch, and of one press."""
        self._presses += 1
        if self._missing["no_contact"]:
            yield from self._add_row(None, NO_OBJECT, "no_contact")
        if self._missing["light_touch"]:
            press = self._start_press(object_name)
            load_n = float(self._rng.uniform(_LIGHTEST_N, self.settings.light_below_n))
            contact = yield from press.press_lightly(load_n)
            if contact and -self.settings.light_below_n < contact.wrench.force_n[2] < 0:
                yield from self._add_row(contact, object_name, "light_touch")
        if self._missing["rule"]:
            self._presses += 1
            yield from self._add_selected_rows(object_name)

    def _add_selected_rows(self, object_name: str) -> RequestGenerator[None]:
        self._rule.end_contact()
        press = self._start_press(object_name)
        for target in press.targets():
            contact = yield from press.step_towards(target)
            if contact is None:
                return
            self._steps += 1
            if self._rule.keeps(contact.wrench):
                yield from self._add_row(contact, object_name, "rule")
            if not self._missing["rule"]:
                return

    def _start_press(self, object_name: str) -> "RandomPress":
        indenter = load_object(object_name, self.settings.objects_seed)
        return RandomPress(self.setup, indenter, self.settings.press, self._rng)

    def _add_row(self, contact: Press | None, object_name: str, kind: str) -> RequestGenerator[None]:
        self._missing[kind] -= 1
        wrench = contact.wrench.six if contact else np.zeros(6)
        factor = yield RenderRequest(self.setup, contact.corrected if contact else None)
        image = self.setup.renderer.add_noise(factor, self._rng)
        self.rows.append(
            DatasetRow(
                id=self._row_id(len(self.rows)),
                image=encode_png(image),
                reference_id=self.setup.member.name,
                wrench=wrench.astype(np.float32),
                object=object_name,
                contact_id=f"{self.number:05d}-{self._presses:03d}",
                step=self._steps,
                time_ns=self._steps * _STEP_NS,
                sensor=self.setup.member.name,
                kind=kind,
                source=None,
                mm_per_px=rectified_mm_per_px(self.settings.size, self.settings.design),
            )
        )

    def _row_id(self, index: int) -> str:
        """Return the id of a row of this session: the numbers of its file and of its row there."""
        file, session_in_file = divmod(self.number, self.settings.sessions_per_file)
        return f"train-{file:05d}-{session_in_file * self.settings.pairs_per_session + index:05d}"


def load_object(name: str, seed: int) -> Indenter:
    """Return the object of this name, made once, and again where its mesh file was written again; raises `InputError`."""
    file = mesh_file_of_name(name)
    entry = file.stat() if file is not None and file.is_file() else None
    return _cached_object(name, seed, entry and (entry.st_size, entry.st_mtime_ns))


@lru_cache(maxsize=64)
def _cached_object(name: str, seed: int, stamp: tuple[int, int] | None) -> Indenter:
    """Return the object of this name; stamp: size and time of its mesh file."""
    return indenter_from_name(name, seed)


def session_objects(settings: GenerationSettings, session: int) -> Iterator[str]:
    """Yield names of objects for one session without end; over all sessions all objects come equally often."""
    names = settings.selected_objects
    order = np.random.default_rng([settings.seed, 2]).permutation(len(names))
    # After this many turns a sensor would begin with the same object again, and is shifted once more.
    turns = len(names) // gcd(len(names), _OBJECT_SHIFT * settings.sensors)
    at = (session + session // (turns * settings.sensors)) * _OBJECT_SHIFT
    while True:
        yield names[order[at % len(names)]]
        at += 1


def session_quotas(number: int, settings: GenerationSettings) -> dict[str, int]:
    """Return how many pairs of each kind a session makes, such that the shares hold over all sessions.

    Where both small kinds are due in a session without room for both, light touches wait for the next one with room.
    """
    ends = np.minimum(settings.pairs_per_session * np.arange(number + 2), settings.pairs)
    no_contact, light_due = (
        np.rint(share * ends).astype(int) for share in (settings.shares.no_contact, settings.shares.light_touch)
    )
    room = ends - no_contact
    light_touch = room + np.minimum.accumulate(light_due - room)
    pairs, untouched, light = (int(total[-1] - total[-2]) for total in (ends, no_contact, light_touch))
    return {"no_contact": untouched, "light_touch": light, "rule": pairs - untouched - light}


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
        reach_mm = max_offset_mm(self.indenter, self.initial_twist_rad, area_mm)
        x, y = self.settings.sample_position(self.rng, reach_mm, area_mm)
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
        except CONTACT_LOST:
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
    values = {
        name: getattr(before, name) + part * (value - getattr(before, name)) for name, value in vars(after).items()
    }
    return PressTarget(**values)


def max_offset_mm(indenter: Indenter, twist_rad: float, area_mm: _Pair) -> Float64[Array, "2"]:
    """Return how far the object may be from the sensor's middle along x and y with its contact inside the sensing area."""
    axis = np.linspace(-12, 12, 97)
    x, y = np.meshgrid(axis, axis)
    near = indenter.height_over_skin_mm(Pose(twist_rad=twist_rad), x, y) < _CONTACT_REACH_MM
    reach = np.array([np.abs(x[near]).max(initial=0), np.abs(y[near]).max(initial=0)])
    return np.maximum(np.array(area_mm) / 2 - _EDGE_MARGIN_MM - reach, 0)
