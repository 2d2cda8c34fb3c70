"""The contact model: a rigid object moves pose by pose over the skin (press, drag, twist, tilt, lift), and each contact is solved.

Each step starts from the last contact, because friction has memory: a point that sticks is carried with the object. Fields move
with the object, so a point that sticks keeps its place on the grid. The object goes to a given depth, or sinks in under a given
load. A pose with arrays in it is a batch: all its contacts are solved at once, each as it would be alone. A single contact is
solved by the same code without a batch axis.

Pressure and shear are solved in turn until neither changes the other (`AlternatingSolver`). Shear raises and lowers the skin under
the object, pressure displaces the skin sideways, and the friction limit is proportional to the pressure.

The layer is linear; `finite_strain` corrects its loads and heights for deep presses.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from ninedtact.mechanics.active_region import (
    ActiveRegion,
    SharedActiveRectangle,
    find_touchable_region,
)
from ninedtact.mechanics.contact_result import (
    Contact,
    require_converged,
    require_depth_within_gel,
    require_inside_grid,
    require_positive_load,
)
from ninedtact.mechanics.cuda_graphs import repeated
from ninedtact.mechanics.friction import FrictionLimit, ShearSolution, solve_shear
from ninedtact.mechanics.indenter import Indenter
from ninedtact.mechanics.normal_contact import ContactConstraint, PressureSolution, solve_pressure
from ninedtact.mechanics.numpy_or_torch_arrays import (
    ITERATIONS_UNSEEN,
    ContactIndices,
    PerContact,
    ScalarPerContact,
    array_namespace_of,
    drop_grid_axes,
    expand_over_grid,
    forward_transform,
    half_with_all_unconverged,
    inverse_transform,
    map_arrays,
    max_over_grid,
    put_contacts,
    take_contacts,
    to_numpy,
    to_numpy_together,
)
from ninedtact.mechanics.pose import Pose, rigid_displacement_mm
from ninedtact.mechanics.skin import DisplacementOperators, PointMask, ScalarField, Skin, VectorField


@dataclass(frozen=True)
class SolverSettings:
    """Accuracy and settings of the contact solver."""

    tolerance: float = 1e-3
    """Largest gap, overlap or missed stick, as a part of the depth."""
    min_tolerance_mm: float = 1e-5
    """The tolerance for an object that just touches."""
    max_rounds: int = 20
    """Largest number of rounds, each of which solves pressure and then shear."""
    max_iterations: int = 200
    """Largest number of iterations of each of the two solvers in one round."""
    must_converge: bool = True
    """Whether a result that misses its tolerance is refused; if not, its residual says how far off it is."""

    def tolerance_mm(self, depth_mm: Any) -> Any:
        """Return the residual in mm at which a contact of this depth (a number or an array) counts as solved."""
        return ((self.tolerance * depth_mm) ** 2 + self.min_tolerance_mm**2) ** 0.5


@dataclass(frozen=True)
class AlternationState:
    """Pressure and shear after a round, with the displacements that each of them causes."""

    pressure: PressureSolution
    shear: ShearSolution
    bulge_mm: ScalarField
    """Outward displacement by the shear."""
    spread_mm: VectorField
    """Tangential displacement by the pressure."""

    @property
    def iterations(self) -> PerContact:
        """Iterations of both solvers in this round; zero where pressure and shear were consistent already."""
        return self.pressure.iterations + self.shear.iterations


@dataclass(frozen=True)
class AlternatingSolverResult:
    """The state after the last round."""

    state: AlternationState
    residual_mm: PerContact
    """The largest violation of the contact's conditions that the last round found."""
    iterations: PerContact


@dataclass(frozen=True)
class AlternatingSolver:
    """The problem of one object on one region of skin, or of each of a batch."""

    operators: DisplacementOperators
    constraint: ContactConstraint
    overlap_mm: ScalarField
    """How far the object reaches into the undeformed skin."""
    depth_mm: PerContact
    """The depth of the object for which the overlap was computed."""
    carried_mm: VectorField
    """Tangential displacement of the skin's points if all that touch stick."""
    friction: float | PerContact
    settings: SolverSettings

    def initial_state(self, pressure_mpa: ScalarField, shear_mpa: VectorField) -> AlternationState:
        """Return the state of first guesses of pressure and shear."""
        pressure, operators = self.constraint.scale_to_load(pressure_mpa), self.operators
        none, indentation = 0 * self.depth_mm, operators.indentation_from_pressure_mm(pressure)
        first_steps = operators.first_step_lengths(none)
        pressed = PressureSolution(pressure, indentation, none, none, none, none, first_steps[0])
        tangential = operators.tangential_from_shear_mm(shear_mpa)
        sheared = ShearSolution(shear_mpa, tangential, none, none, none, first_steps[1])
        bulge = operators.bulge_from_shear_mm(shear_mpa)
        return AlternationState(pressed, sheared, bulge, operators.tangential_from_pressure_mm(pressure))

    def solve(self, state: AlternationState) -> AlternatingSolverResult:
        """Run rounds until one changes neither pressure nor shear, or until there were as many as the settings allow."""
        return self._run_rounds(state, 0 * self.depth_mm, self.settings.max_rounds)

    def _run_rounds(self, state: AlternationState, iterations: PerContact, left: int) -> AlternatingSolverResult:
        """Run the rounds that are left. As soon as half of a batch has converged, the other half is solved alone."""
        rounds = repeated(AlternatingSolver._next_state, self, state, self.settings.max_iterations <= ITERATIONS_UNSEEN)
        for count in range(left):
            state = rounds.next(state)
            iterations = iterations + state.iterations
            unconverged = np.atleast_1d(to_numpy(state.iterations)[..., 0, 0]) > 0
            if not unconverged.any():
                break
            half = half_with_all_unconverged(unconverged)
            if half is not None and count + 1 < left:
                whole = self._result(rounds.take(state), iterations)
                state, iterations = map_arrays(partial(take_contacts, indices=half), (whole.state, iterations))
                part = self._select(half)._run_rounds(state, iterations, left - count - 1)
                return map_arrays(partial(put_contacts, half), whole, part)
        return self._result(rounds.take(state), iterations)

    def _select(self, indices: ContactIndices) -> "AlternatingSolver":
        given = self.constraint, self.overlap_mm, self.depth_mm, self.carried_mm, self.friction
        constraint, overlap, depth, carried, friction = map_arrays(partial(take_contacts, indices=indices), given)
        operators = self.operators.select(indices)
        return AlternatingSolver(operators, constraint, overlap, depth, carried, friction, self.settings)

    def _result(self, state: AlternationState, iterations: PerContact) -> AlternatingSolverResult:
        residual = self.operators.xp.maximum(state.pressure.initial_residual_mm, state.shear.initial_residual_mm)
        return AlternatingSolverResult(state, residual, iterations)

    def _tolerance_mm(self, depth_increase_mm: PerContact) -> PerContact:
        return self.settings.tolerance_mm(self.depth_mm + depth_increase_mm)

    def _next_state(self, last: AlternationState) -> AlternationState:
        """Return the state after one round: pressure, then shear. A field within the tolerance is kept unchanged."""
        operators, max_iterations = self.operators, self.settings.max_iterations
        overlap = self.overlap_mm + last.bulge_mm
        pressure = solve_pressure(
            operators, self.constraint, overlap, last.pressure, self._tolerance_mm, max_iterations
        )
        same = pressure.pressure_mpa is last.pressure.pressure_mpa
        spread = last.spread_mm if same else operators.tangential_from_pressure_mm(pressure.pressure_mpa)
        limit = FrictionLimit(self.friction * pressure.pressure_mpa)
        tolerance = self._tolerance_mm(pressure.depth_increase_mm)
        shear = solve_shear(operators, self.carried_mm - spread, limit, last.shear, tolerance, max_iterations)
        same = shear.shear_mpa is last.shear.shear_mpa
        bulge = last.bulge_mm if same else operators.bulge_from_shear_mm(shear.shear_mpa)
        return AlternationState(pressure, shear, bulge, spread)


@dataclass(frozen=True)
class ContactProblem:
    """One step before it is solved: an object at its next pose over the skin as the last step left it, or a batch of them."""

    last: Contact
    guess: Contact
    """A contact whose tractions are the first guess."""
    pose: Pose
    constraint: ContactConstraint
    overlap_mm: ScalarField
    """How far the object reaches into the undeformed skin."""
    carried_mm: VectorField
    """Tangential displacement of the skin's points if all that touched stick."""
    friction: float | PerContact

    @property
    def depth_mm(self) -> PerContact:
        """The depth of the object for which the overlap was computed."""
        return 0 * self.overlap_mm[..., :1, :1] + expand_over_grid(self.pose.depth_mm, self.overlap_mm)

    @property
    def max_overlap_mm(self) -> float:
        """The largest overlap; for a batch, the largest of all objects."""
        return float(array_namespace_of(self.overlap_mm).max(self.overlap_mm))

    def deepest_mm(self, solved: Contact) -> ScalarPerContact:
        """Return how far each object reaches into the skin at the depth that was found: its origin, or under a tilt its lowest
        point."""
        return deepest_of_solved_mm(solved, self.pose, drop_grid_axes(max_over_grid(self.overlap_mm)))

    def solve(self, region: ActiveRegion, settings: SolverSettings) -> tuple[Contact, PointMask]:
        """Return the contact solved in a region, and where on the grid its skin is inside the object beyond the tolerance.

        Such points outside the region mean that the region was too small.
        """
        solver = AlternatingSolver(
            region.operators,
            self.constraint,
            region.crop_overlap(self.overlap_mm),
            self.depth_mm,
            region.crop(self.carried_mm),
            self.friction,
            settings,
        )
        start = (self._over_batch(self.guess.pressure_mpa, 2), self._over_batch(self.guess.shear_mpa, 3))
        result = solver.solve(solver.initial_state(*(region.crop(guess) for guess in start)))
        pressure, shear = result.state.pressure, result.state.shear
        tractions = region.embed(pressure.pressure_mpa), region.embed(shear.shear_mpa)
        numbers = to_numpy_together(pressure.depth_increase_mm, result.residual_mm, result.iterations)
        deeper_mm, residual_mm, iterations = map(drop_grid_axes, numbers)
        contact = Contact(
            self.last.skin,
            replace(self.pose, depth_mm=self.pose.depth_mm + deeper_mm),
            *tractions,
            *region.whole_grid_operators.displacement_mm(*tractions),
            self.friction,
            residual_mm,
            int(iterations) if isinstance(iterations, float) else np.asarray(iterations).astype(int),
        )
        deeper = pressure.depth_increase_mm
        level = settings.tolerance_mm(self.depth_mm + deeper) - deeper
        return contact, contact.height_mm + self.overlap_mm > level

    def _over_batch(self, field: Any, axes: int) -> Any:
        """Return one field for every pose of the batch, including fields that are the same for all poses."""
        return _broadcast_to_batch(self.pose, field, axes)


def deepest_of_solved_mm(solved: Contact, pose: Pose, max_overlap_mm: ScalarPerContact) -> ScalarPerContact:
    """Return `ContactProblem.deepest_mm`, given the pose before it was solved and the overlap with the undeformed skin there."""
    return np.maximum(solved.pose.depth_mm, max_overlap_mm + (solved.pose.depth_mm - pose.depth_mm))


def build_contact_problem_at_pose(
    last: Contact,
    indenter: Indenter,
    pose: Pose,
    constraint: ContactConstraint,
    friction: float | PerContact,
    guess: Contact | None = None,
) -> ContactProblem:
    """Return the problem of an object that moves to this pose over skin that was last in this contact.

    The skin's points are carried along as if all that touched stuck. guess: a contact whose tractions are the first guess; the last
    one unless another is closer.
    """
    overlap = -indenter.height_over_skin_mm(replace(pose, x_mm=0.0, y_mm=0.0), *last.skin.coordinates_mm)
    overlap, carried = _broadcast_to_batch(pose, overlap, 2), _broadcast_to_batch(pose, _carried_mm(last, pose), 3)
    return ContactProblem(last, guess or last, pose, constraint, overlap, carried, friction)


@dataclass(frozen=True)
class ContactModel:
    """A skin with friction, on which objects are pressed."""

    skin: Skin
    friction: float = 1.0
    settings: SolverSettings = field(default_factory=SolverSettings)

    def initial_contact(self) -> Contact:
        """Return the undeformed skin, without any object near it."""
        return self._no_contact(Pose(), self.skin.asarray(np.zeros(self.skin.grid.shape)))

    def follow(self, indenter: Indenter, poses: Iterable[Pose]) -> Iterator[Contact]:
        """Yield the contact at each pose in turn, from undeformed skin on."""
        contact = self.initial_contact()
        for pose in poses:
            contact = self.step(contact, indenter, pose)
            yield contact

    def step(self, last: Contact, indenter: Indenter, pose: Pose, guess: Contact | None = None) -> Contact:
        """Return the contact after the object moved from the last pose to this one.

        guess: a contact like the wanted one, from whose tractions it is found sooner than from the last ones.
        Raises `InvalidPose` where the object would reach the base, `ContactLeavesGrid` where the contact would meet
        its own periodic image, `SimulationError`.
        """
        problem = build_contact_problem_at_pose(last, indenter, pose, ContactConstraint(), self.friction, guess)
        require_depth_within_gel(problem.max_overlap_mm, self.skin.gel)
        if problem.max_overlap_mm <= 0:
            return self._no_contact(pose, problem.overlap_mm)
        require_inside_grid(self.skin.grid, problem.overlap_mm)
        return self._solve(problem)

    def step_to_load(self, last: Contact, indenter: Indenter, pose: Pose, load_n: ScalarPerContact) -> Contact:
        """Return the contact after the object moved and was pressed with this load; its pose has the depth that was found.

        The depth of `pose` is a first guess. Raises `NonPositiveLoad`, and what `step` raises.
        """
        require_positive_load(load_n)
        pressure_sum = self.skin.asarray(np.asarray(load_n, float)[..., None, None] / self.skin.grid.cell_area_mm2)
        each = replace(pose, depth_mm=pose.depth_mm + 0 * np.asarray(load_n))
        return self._solve(
            build_contact_problem_at_pose(last, indenter, each, ContactConstraint(pressure_sum), self.friction)
        )

    def require_valid(self, contact: Contact, deepest_mm: float) -> None:
        """Refuse a contact at the grid's border, through the base or not converged; raises what `step` raises.

        deepest_mm: how far the object reaches into the skin; under a tilt that is farther than its origin does.
        """
        require_inside_grid(self.skin.grid, contact.pressure_mpa)
        require_depth_within_gel(deepest_mm, self.skin.gel)
        if self.settings.must_converge:
            tolerance = self.settings.tolerance_mm(contact.pose.depth_mm)
            require_converged(contact.residual_mm, tolerance, contact.iterations)

    def solve(self, problem: ContactProblem, region: SharedActiveRectangle) -> Contact:
        """Return the contact in the region that it should fit in, or in a larger one where skin outside rises into the object.

        Nothing is refused; see `require_valid`.
        """
        contact, inside_object = problem.solve(region, self.settings)
        while region.any_outside(inside_object):
            region = region.enlarged(inside_object)
            contact, inside_object = replace(problem, guess=contact).solve(region, self.settings)
        return contact

    def _solve(self, problem: ContactProblem) -> Contact:
        """Return the contact, or refuse it; raises what `require_valid` raises."""
        contact = self.solve(problem, find_touchable_region(self.skin, problem.overlap_mm))
        self.require_valid(contact, float(np.max(problem.deepest_mm(contact))))
        return contact

    def _no_contact(self, pose: Pose, like: ScalarField) -> Contact:
        """Return undeformed skin at this pose, with fields of this shape and kind."""
        zero = 0 * like
        pair = array_namespace_of(zero).stack((zero, zero), axis=-3)
        return Contact(self.skin, pose, zero, pair, zero, pair, self.friction)


def _broadcast_to_batch(pose: Pose, field: Any, axes: int) -> Any:
    """Return one field, with this many axes of its own, for every pose of a batch, including a field that is the same for all."""
    return array_namespace_of(field).broadcast_to(field, (*pose.batch_shape, *field.shape[-axes:]))


def _carried_mm(last: Contact, pose: Pose) -> VectorField:
    """Return the tangential displacement of the skin at every point of the new grid, if all that touched stuck.

    A point that touched keeps its grid point and has moved with the object. A point that did not keeps its place on the
    sensor, so it is another point of the grid now. Fields are not rotated by twists, since one step twists by little.
    """
    if last.pressure_mpa.ndim == 2 and not last.touches:  # the test on a batch would wait for its device
        return last.tangential_mm
    by = pose.x_mm - last.pose.x_mm, pose.y_mm - last.pose.y_mm
    free = _shift_periodic_field(last.skin, last.tangential_mm, by) if any(map(np.any, by)) else last.tangential_mm
    before, after = replace(last.pose, x_mm=0.0, y_mm=0.0), replace(pose, x_mm=by[0], y_mm=by[1])
    stuck = last.tangential_mm + rigid_displacement_mm(before, after, last.skin.positions_mm)
    return array_namespace_of(free).where((last.pressure_mpa > 0)[..., None, :, :], stuck, free)


def _shift_periodic_field(skin: Skin, field: Any, by_mm: tuple[Any, Any]) -> Any:
    """Return a periodic field shifted by this much along x and y, by the phase of its waves."""
    (k_x, k_y), shape, xp = skin.shift_wave_numbers, skin.grid.shape, array_namespace_of(field)
    phase = xp.exp(1j * k_x * expand_over_grid(by_mm[0], k_x)) * xp.exp(1j * k_y * expand_over_grid(by_mm[1], k_y))
    return inverse_transform(forward_transform(field, shape) * phase[..., None, :, :], shape, shape)
