"""Solver of quadratic programmes some of whose unknowns must not be negative, exact, by block principal pivoting.

Each bounded unknown is free, or held at zero. The free unknowns are solved for; then those that are negative are held, and held
ones that would rise are freed, until none is on the wrong side. Where exchanging all of them repeatedly fails to reduce their
number, they are exchanged one at a time, which always terminates (Júdice and Pires 1994; docs/force_physics.md).
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float64
from numpy import ndarray as Array

_WRONG_SIDE_STDS = 0.05
"""Distance beyond the bound, in an unknown's own standard deviations, from which it counts as on the wrong side."""
_MAX_FAILED_EXCHANGES = 3
"""Number of consecutive block exchanges that may fail to reduce the number of unknowns on the wrong side."""


@dataclass(frozen=True)
class NonNegativeQP:
    """The problem of minimising ½ xᵀHx − bᵀx where the first `bounded` unknowns are not negative."""

    curvature: Float64[Array, "n n"]
    """H: symmetric and positive definite."""
    negative_gradient: Float64[Array, " n"]
    """b: the negative gradient of the objective at zero."""
    bounded: int

    def precision_root(self) -> Float64[Array, " n"]:
        """Return one over the standard deviation of each unknown, given the others."""
        return np.sqrt(np.diag(self.curvature))

    def solve_free(self, free: Bool[Array, " n"], solve_count: int = 1) -> "QPSolution":
        """Return the minimum over the free unknowns, the others being zero."""
        from scipy.linalg import cho_solve, cholesky

        x, index = np.zeros(len(free)), np.flatnonzero(free)
        block = self.curvature[np.ix_(index, index)].T
        factor = cholesky(block, lower=True, overwrite_a=True, check_finite=False)
        x[index] = cho_solve((factor, True), self.negative_gradient[index], check_finite=False)
        return QPSolution(x, free, factor, solve_count)

    def clip(self, x: Float64[Array, " n"]) -> Float64[Array, " n"]:
        """Return the unknowns with the bounded ones clipped at zero."""
        return np.concatenate([np.maximum(x[: self.bounded], 0), x[self.bounded :]])

    def wrong_side(self, solution: "QPSolution", precision_root: Float64[Array, " n"]) -> Bool[Array, " n"]:
        """Return a mask of the unknowns on the wrong side: free ones that are negative, and held ones that would rise."""
        held = ~solution.free
        rising = held & (self.negative_gradient - self.curvature @ solution.x > _WRONG_SIDE_STDS * precision_root)
        negative = solution.free & (solution.x * precision_root < -_WRONG_SIDE_STDS)
        negative[self.bounded :] = False
        return rising | negative


@dataclass(frozen=True)
class QPSolution:
    """The minimum, or the last iterate where `converged` is false."""

    x: Float64[Array, " n"]
    free: Bool[Array, " n"]
    factor: Float64[Array, "free free"]
    """L: the lower Cholesky factor of the free unknowns' curvature."""
    solve_count: int
    converged: bool = False

    def whiten_rows(self, rows: Float64[Array, "rows n"]) -> Float64[Array, "rows free"]:
        """Return L⁻¹ times each row; its squared norm is the row's variance."""
        from scipy.linalg import solve_triangular

        return np.asarray(solve_triangular(self.factor, rows[:, self.free].T, lower=True, check_finite=False).T)


def solve_nonnegative_qp(problem: NonNegativeQP, free: Bool[Array, " n"], max_solves: int) -> QPSolution:
    """Return the minimum, starting from a guess of the free unknowns, or the last iterate after `max_solves`, clipped at zero."""
    precision_root = problem.precision_root()
    solution = problem.solve_free(free)
    wrong, fewest, chances = problem.wrong_side(solution, precision_root), len(free) + 1, _MAX_FAILED_EXCHANGES
    while solution.solve_count < max_solves and wrong.any():
        count = int(wrong.sum())
        fewest, chances = (count, _MAX_FAILED_EXCHANGES) if count < fewest else (fewest, chances - 1)
        exchanged = wrong if chances >= 0 else _keep_last(wrong)
        solution = problem.solve_free(solution.free ^ exchanged, solution.solve_count + 1)
        wrong = problem.wrong_side(solution, precision_root)
    return replace(solution, x=problem.clip(solution.x), converged=not wrong.any())


def _keep_last(mask: Bool[Array, " n"]) -> Bool[Array, " n"]:
    """Return a mask of which only the last true entry is kept."""
    alone = np.zeros_like(mask)
    alone[np.flatnonzero(mask)[-1]] = True
    return alone
