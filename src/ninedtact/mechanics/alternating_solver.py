"""Pressure and shear in turns, until neither disturbs the other.

Both are coupled: shear raises and lowers the skin under the object, pressure spreads it, and friction holds only what
pressure allows.
"""

from dataclasses import dataclass
from typing import Any

from ninedtact.mechanics.batching import PerContact
from ninedtact.mechanics.friction import FrictionLimit, ShearSolution, solve_shear
from ninedtact.mechanics.normal_contact import ContactConstraint, PressureSolution, solve_pressure
from ninedtact.mechanics.skin import DisplacementOperators, ScalarField, VectorField


@dataclass(frozen=True)
class SolverSettings:
    """How exact an answer must be, and how long may be looked for it."""

    tolerance: float = 1e-3
    """Largest gap, overlap or missed stick, as a part of the depth."""
    least_tolerance_mm: float = 1e-5
    """That of an object which just touches."""
    rounds: int = 20
    """AlternatingSolver between normal contact and friction at most."""
    iterations: int = 200
    """Of each solver in one turn."""
    must_converge: bool = True
    """Whether an answer that misses its tolerance is refused; if not, its residual says how far off it is."""

    def tolerance_mm(self, depth_mm: Any) -> Any:
        """What counts as solved at this depth, a number or an array of them."""
        return ((self.tolerance * depth_mm) ** 2 + self.least_tolerance_mm**2) ** 0.5


@dataclass(frozen=True)
class AlternationState:
    """Where the turns have come to."""

    pressed: PressureSolution
    sheared: ShearSolution
    raised_mm: ScalarField
    """Outward displacement by the shear."""
    spread_mm: VectorField
    """Tangential displacement by the pressure."""

    @property
    def moved_mm(self) -> VectorField:
        """Tangential displacement by both."""
        return self.sheared.slid_mm + self.spread_mm

    @property
    def iterations(self) -> PerContact:
        """Of both solvers in this turn; none where pressure and shear fitted before."""
        return self.pressed.iterations + self.sheared.iterations


@dataclass(frozen=True)
class AlternationResult:
    """The end of the turns."""

    turn: AlternationState
    residual_mm: PerContact
    """The largest violation of the contact's conditions that the last turn found."""
    iterations: PerContact


@dataclass(frozen=True)
class AlternatingSolver:
    """One object on one window of skin, with nothing yet solved."""

    response: DisplacementOperators
    held: ContactConstraint
    overlap_mm: ScalarField
    """How far the object reaches into the untouched skin."""
    depth_mm: PerContact
    """Of the object, as its overlap has it."""
    carried_mm: VectorField
    """Where the skin's points come to if all that touch stick."""
    friction: float | PerContact
    effort: SolverSettings

    def begun(self, pressure_mpa: ScalarField, shear_mpa: VectorField) -> AlternationState:
        """First guesses with what they do to the skin."""
        pressure, response = self.held.loaded(pressure_mpa), self.response
        none = 0 * self.depth_mm
        pressed = PressureSolution(pressure, response.sunk_mm(pressure), none, none, none, none)
        sheared = ShearSolution(shear_mpa, response.slid_mm(shear_mpa), none, none, none)
        return AlternationState(pressed, sheared, response.raised_mm(shear_mpa), response.spread_mm(pressure))

    def settled(self, turn: AlternationState) -> AlternationResult:
        """AlternatingSolver until one has nothing to do."""
        iterations = 0 * self.depth_mm
        for _ in range(self.effort.rounds):
            turn = self.turned(turn)
            iterations = iterations + turn.iterations
            if not bool(self.response.xp.any(turn.iterations > 0)):
                break
        residual = self.response.xp.maximum(turn.pressed.disturbed_mm, turn.sheared.disturbed_mm)
        return AlternationResult(turn, residual, iterations)

    def turned(self, last: AlternationState) -> AlternationState:
        """Pressure, then shear; what was right already stays as it is."""
        response, most = self.response, self.effort.iterations
        tolerance = self.effort.tolerance_mm(self.depth_mm + last.pressed.deeper_mm)
        pressed = solve_pressure(response, self.held, self.overlap_mm + last.raised_mm, last.pressed, tolerance, most)
        same = pressed.pressure_mpa is last.pressed.pressure_mpa
        spread = last.spread_mm if same else response.spread_mm(pressed.pressure_mpa)
        grip = FrictionLimit(self.friction * pressed.pressure_mpa)
        sheared = solve_shear(response, self.carried_mm - spread, grip, last.sheared, tolerance, most)
        same = sheared.shear_mpa is last.sheared.shear_mpa
        return AlternationState(
            pressed, sheared, last.raised_mm if same else response.raised_mm(sheared.shear_mpa), spread
        )
