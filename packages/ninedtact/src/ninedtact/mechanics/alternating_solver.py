"""The alternating solver of a contact: solves pressure and shear in turn until neither changes the other.

The two are coupled. Shear raises and lowers the skin under the object, pressure displaces the skin sideways, and the friction
limit is proportional to the pressure.
"""

from dataclasses import dataclass
from typing import Any

from ninedtact.mechanics.friction import FrictionLimit, ShearSolution, solve_shear
from ninedtact.mechanics.normal_contact import ContactConstraint, PressureSolution, solve_pressure
from ninedtact.mechanics.shrinking_batch import PerContact
from ninedtact.mechanics.surface_displacement import DisplacementOperators, ScalarField, VectorField


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
    def tangential_mm(self) -> VectorField:
        """Tangential displacement by shear and pressure."""
        return self.shear.displacement_mm + self.spread_mm

    @property
    def iterations(self) -> PerContact:
        """Iterations of both solvers in this round; zero where pressure and shear were consistent already."""
        return self.pressure.iterations + self.shear.iterations


@dataclass(frozen=True)
class AlternationResult:
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
        none = 0 * self.depth_mm
        pressed = PressureSolution(pressure, operators.indentation_from_pressure_mm(pressure), none, none, none, none)
        sheared = ShearSolution(shear_mpa, operators.tangential_from_shear_mm(shear_mpa), none, none, none)
        bulge = operators.bulge_from_shear_mm(shear_mpa)
        return AlternationState(pressed, sheared, bulge, operators.tangential_from_pressure_mm(pressure))

    def solve(self, state: AlternationState) -> AlternationResult:
        """Run rounds until one changes neither pressure nor shear, or until there were as many as the settings allow."""
        iterations = 0 * self.depth_mm
        for _ in range(self.settings.max_rounds):
            state = self._next_state(state)
            iterations = iterations + state.iterations
            if not bool(self.operators.xp.any(state.iterations > 0)):
                break
        residual = self.operators.xp.maximum(state.pressure.initial_residual_mm, state.shear.initial_residual_mm)
        return AlternationResult(state, residual, iterations)

    def _next_state(self, last: AlternationState) -> AlternationState:
        """Return the state after one round: pressure, then shear. A field within the tolerance is kept unchanged."""
        operators, max_iterations = self.operators, self.settings.max_iterations
        tolerance = self.settings.tolerance_mm(self.depth_mm + last.pressure.depth_increase_mm)
        overlap = self.overlap_mm + last.bulge_mm
        pressure = solve_pressure(operators, self.constraint, overlap, last.pressure, tolerance, max_iterations)
        same = pressure.pressure_mpa is last.pressure.pressure_mpa
        spread = last.spread_mm if same else operators.tangential_from_pressure_mm(pressure.pressure_mpa)
        limit = FrictionLimit(self.friction * pressure.pressure_mpa)
        shear = solve_shear(operators, self.carried_mm - spread, limit, last.shear, tolerance, max_iterations)
        same = shear.shear_mpa is last.shear.shear_mpa
        bulge = last.bulge_mm if same else operators.bulge_from_shear_mm(shear.shear_mpa)
        return AlternationState(pressure, shear, bulge, spread)
