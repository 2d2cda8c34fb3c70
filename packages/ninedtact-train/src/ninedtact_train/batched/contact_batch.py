"""A batch of contact steps, of different objects on different sensors, that are solved and validated together.

Each contact is solved exactly as it would be alone: from its own first guess, in its own region, to its own last iteration.
Only rounding differs. A refused contact does not affect the others; its response is the refusal.
"""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from array_api_compat import device
from jaxtyping import Bool, Float64
from numpy import ndarray as Array

from ninedtact.errors import NinedtactError
from ninedtact.mechanics.active_region import (
    ActiveRectangles,
    GridRectangle,
    find_active_rectangles,
    points_inside_rectangles,
)
from ninedtact.mechanics.contact_model import (
    ContactModel,
    ContactProblem,
    SolverSettings,
    build_contact_problem_at_pose,
)
from ninedtact.mechanics.contact_result import (
    Contact,
    ContactLeavesGrid,
    least_gel_mm,
    positive_at_border,
    reach_mm,
    require_depth_within_gel,
    require_gel_left,
    require_inside_grid,
    require_positive_load,
)
from ninedtact.mechanics.height_grid_indenter import DeviceHeightGrids
from ninedtact.mechanics.normal_contact import ContactConstraint
from ninedtact.mechanics.numpy_or_torch_arrays import (
    array_namespace_of,
    drop_grid_axes,
    expand_over_grid,
    max_over_grid,
    to_numpy,
)
from ninedtact.mechanics.pose import Pose
from ninedtact.mechanics.skin import DisplacementOperators, PointMask, ScalarField, Skin
from ninedtact.simulation.press import Press
from ninedtact_train.batched.session_requests import (
    SimulatedSetup,
    StepRequest,
)

StepResponse = Press | StepRequest | NinedtactError
"""The response to a contact step: a press, a request to be computed in place of the first one, or a refusal."""
_Flags = Bool[Array, " batch"]


@dataclass(frozen=True)
class SkinStack:
    """The skins of several sensors, all on equal grids, stacked on one device."""

    setups: Sequence[SimulatedSetup]
    like: Any
    """An array whose library, precision and device all fields have."""
    max_compliances: dict[tuple[int, tuple[int, int]], tuple[float, float]] = field(default_factory=dict)
    """The largest compliance to pressure and to shear in a region, by sensor and shape of the region, as far as it was needed."""

    @cached_property
    def index(self) -> dict[SimulatedSetup, int]:
        """The position of each sensor in the stack."""
        return {setup: index for index, setup in enumerate(self.setups)}

    @cached_property
    def skins(self) -> list[Skin]:
        """The skin of each sensor on the device."""
        return [replace(setup.twin.model.skin, like=self.like) for setup in self.setups]

    @cached_property
    def initial_contact(self) -> Contact:
        """Undeformed skin, without any object near it, on the grid that all sensors share."""
        return ContactModel(self.skins[0]).initial_contact()

    def regions(
        self, sensors: Sequence[int], rectangles: Sequence[GridRectangle], like: ScalarField
    ) -> ActiveRectangles:
        """Return the region of each contact of a batch, given its sensor's position in the stack and its rectangle."""
        inside, xp, shape = (
            points_inside_rectangles(rectangles, like),
            array_namespace_of(self.like),
            self.skins[0].grid.shape,
        )
        indices = xp.asarray(np.array(sensors), device=device(self.like))
        normal, bulge, diagonal, crossed = (xp.take(symbol, indices, axis=0) for symbol in self._symbols)
        softest = np.array([self._max_compliances(*one) for one in zip(sensors, rectangles, strict=True)])
        operators = DisplacementOperators(
            *(normal, bulge, (diagonal, crossed), shape, shape),
            max_normal_compliance_mm_per_mpa=expand_over_grid(softest[:, 0], self.like),
            max_shear_compliance_mm_per_mpa=expand_over_grid(softest[:, 1], self.like)[..., None],
            inside=xp.astype(inside, self.like.dtype),
        )
        return ActiveRectangles(inside, operators)

    @cached_property
    def _symbols(self) -> tuple[Any, Any, Any, Any]:
        """The Fourier symbols of all sensors: N, the bulge, and the diagonal and the off-diagonal part of the tangential block."""
        operators = [setup.twin.model.skin.operators for setup in self.setups]
        stacks = (
            [one.normal for one in operators],
            [one.bulge for one in operators],
            [one.tangential[0] for one in operators],
            [one.tangential[1] for one in operators],
        )
        xp = array_namespace_of(self.like)
        normal, bulge, diagonal, crossed = (xp.asarray(np.stack(stack), device=device(self.like)) for stack in stacks)
        return normal, bulge, diagonal, crossed

    def _max_compliances(self, sensor: int, rectangle: GridRectangle) -> tuple[float, float]:
        """Return the largest compliances of a cropped region, which set the first steps of the solver."""
        key = sensor, rectangle.shape
        if key not in self.max_compliances:
            skin = self.setups[sensor].twin.model.skin
            whole = rectangle.shape == skin.grid.shape
            of = skin.operators if whole else skin.build_cropped_operators(*rectangle.shape)
            self.max_compliances[key] = of.max_normal_compliance_mm_per_mpa, of.max_shear_compliance_mm_per_mpa
        return self.max_compliances[key]


@dataclass(frozen=True)
class ContactBatch:
    """The contact steps of one batch and their contacts. In the contacts of the whole batch `skin` is that of the first sensor;
    `contacts_of_sensor` returns those of one sensor with its own."""

    requests: Sequence[StepRequest]
    stack: SkinStack
    store: DeviceHeightGrids

    @cached_property
    def sensors(self) -> list[int]:
        """The position of each request's sensor in the stack."""
        return [self.stack.index[request.setup] for request in self.requests]

    @property
    def settings(self) -> SolverSettings:
        """The solver settings, which are the same for all twins."""
        return self.requests[0].setup.twin.solver_settings

    @cached_property
    def problem(self) -> ContactProblem:
        """The contact steps before they are solved. The depth of those that are pressed to a load is a first guess."""
        last = Contact.stack([self._last(request) for request in self.requests])
        indenter = self.store.batch([request.indenter for request in self.requests])
        pose = Pose.stack([request.pose for request in self.requests])
        friction = expand_over_grid(
            np.array([request.setup.twin.friction for request in self.requests]), self.stack.like
        )
        guess = Contact.stack([request.guess or self._last(request) for request in self.requests])
        return build_contact_problem_at_pose(last, indenter, pose, ContactConstraint(), friction, guess)

    def _last(self, request: StepRequest) -> Contact:
        """Return the contact from which a step continues."""
        return request.last.solved if request.last else replace(self.stack.initial_contact, pose=request.pose)

    @cached_property
    def _rectangles(self) -> list[GridRectangle]:
        found = find_active_rectangles(self.problem.overlap_mm)
        return [request.rectangle or one for request, one in zip(self.requests, found, strict=True)]

    @cached_property
    def regions(self) -> ActiveRectangles:
        """The region of each contact."""
        return self.stack.regions(self.sensors, self._rectangles, self.problem.overlap_mm)

    @property
    def constraint(self) -> ContactConstraint:
        """The load or the depth of each contact, whichever its request gives."""
        overlap, loads = self.problem.overlap_mm, [request.load_n for request in self.requests]
        cell_area = self.stack.skins[0].grid.cell_area_mm2
        pressure_sums = expand_over_grid(np.array([load or 0.0 for load in loads]) / cell_area, overlap)
        by_load = np.array([load is not None for load in loads])[:, None, None]
        by_load = array_namespace_of(overlap).asarray(by_load, device=device(overlap))
        return ContactConstraint(pressure_sums, by_load, self.regions.operators.inside)

    @cached_property
    def solution(self) -> tuple[Contact, PointMask]:
        """All contacts, each solved until it stops, and the points where the skin is inside the object beyond the tolerance."""
        return replace(self.problem, constraint=self.constraint).solve(self.regions, self.settings)

    @property
    def contacts(self) -> Contact:
        """All contacts as one batch."""
        return self.solution[0]

    def contacts_of_sensor(self, indices: Sequence[int]) -> Contact:
        """Return the contacts at these positions, all of one sensor, as a batch with its skin and friction."""
        first = indices[0]
        return self.contacts.select(
            indices, self.stack.skins[self.sensors[first]], self.requests[first].setup.twin.friction
        )

    def responses(self) -> list[StepResponse]:
        """Return the response to every request: the contact, its refusal, or the same request in a larger region."""
        responses: dict[int, StepResponse] = {}
        for index, request in enumerate(self.requests):
            if response := self._refusal(index, request):
                responses[index] = response
        responses |= self._presses([index for index in range(len(self.requests)) if index not in responses])
        return [responses[index] for index in range(len(self.requests))]

    def _presses(self, indices: Iterable[int]) -> dict[int, Press | NinedtactError]:
        """Return the presses of these contacts, finished sensor by sensor, or the refusal of one that leaves no gel."""
        of_sensor: dict[int, list[int]] = defaultdict(list)
        for index in indices:
            of_sensor[self.sensors[index]].append(index)
        presses: dict[int, Press | NinedtactError] = {}
        for chosen in of_sensor.values():
            indenters, twin = [self.requests[index].indenter for index in chosen], self.requests[chosen[0]].setup.twin
            press = twin.finish_press(self.contacts_of_sensor(chosen), self.store.batch(indenters))
            left_mm = np.asarray(least_gel_mm(press.corrected))
            for index, one, left in zip(chosen, press.unstack(indenters), left_mm, strict=True):
                try:
                    require_gel_left(twin.gel, float(left))
                    presses[index] = one
                except NinedtactError as refusal:
                    presses[index] = refusal
        return presses

    def _refusal(self, index: int, request: StepRequest) -> NinedtactError | StepRequest | None:
        """Return why a contact is refused, in the order of `Twin.press`; or the request to solve it in a larger region.

        The flags of the whole batch show which contacts may be refused; only those are checked one by one, as single contacts are.
        """
        twin = request.setup.twin
        try:
            if request.load_n is None:
                require_depth_within_gel(float(self._max_overlap_mm[index]), twin.gel)
                if self._overlap_at_border[index]:
                    require_inside_grid(self.stack.skins[0].grid, self.problem.overlap_mm[index])
            if self._leaves_region[index]:
                rectangle = self._rectangles[index].enlarged(self.solution[1][index])
                return replace(request, rectangle=rectangle, guess=self.contacts_of_sensor([index]).unstack()[0])
            if self._may_be_refused[index]:
                contact = self.contacts_of_sensor([index]).unstack()[0]
                twin.model.require_valid(contact, float(self._deepest_mm[index]))
                twin.require_on_gel(request.indenter, contact)
        except ContactLeavesGrid:
            return twin.contact_leaves_gel(request.indenter, "more than that")
        except NinedtactError as refusal:
            return refusal
        return None

    @cached_property
    def _max_overlap_mm(self) -> Float64[Array, " batch"]:
        """The largest overlap of each object."""
        return np.asarray(drop_grid_axes(max_over_grid(self.problem.overlap_mm)))

    @cached_property
    def _deepest_mm(self) -> Float64[Array, " batch"]:
        """How far each object reaches into the skin, at the depth that was found."""
        return np.asarray(self.problem.deepest_mm(self.contacts))

    @cached_property
    def _overlap_at_border(self) -> _Flags:
        """Whether each object reaches into the skin at the grid's border."""
        return to_numpy(positive_at_border(self.problem.overlap_mm)) > 0

    @cached_property
    def _leaves_region(self) -> _Flags:
        """Whether each contact is larger than its region."""
        return to_numpy(self.regions.any_outside(self.solution[1])) > 0

    @cached_property
    def _may_be_refused(self) -> _Flags:
        """Whether each contact is at the border, through the base, over the gel's rim, or perhaps not converged."""
        contacts, twins = self.contacts, [request.setup.twin for request in self.requests]
        through_base = ~(self._deepest_mm < np.array([twin.gel.max_depth_mm for twin in twins]))
        beyond_gel = (reach_mm(contacts) > np.array([twin.gel_mm for twin in twins]) / 2).any(axis=1)
        at_border = to_numpy(positive_at_border(contacts.pressure_mpa)) > 0
        return np.asarray(at_border | through_base | beyond_gel | self.settings.must_converge)


def refusal_before_solving(request: StepRequest) -> NinedtactError | None:
    """Return why a step is refused without any computation: its pose is out of view, or its load does not press."""
    try:
        request.setup.twin.require_in_view(request.pose)
        if request.load_n is not None:
            require_positive_load(request.load_n)
    except NinedtactError as refusal:
        return refusal
    return None
