"""Quadratic programmes of which some unknowns must not be negative, solved exactly by block principal pivoting.

Those unknowns are free, or held at zero. The free ones are solved for; all that come out negative are held, all held ones that
would rise are freed, and so on until none is on the wrong side. Should exchanging all of them fail to lessen their number, they are
exchanged one by one, which always ends (Júdice and Pires 1994; docs/force_physics.md).
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float64
from numpy import ndarray as Array

_WRONG_SIDE_STDS = 0.05
"""Own standard deviations by which an unknown must be on the wrong side to count."""
_MAX_FAILED_EXCHANGES = 3
"""Exchanges of all in a row that may fail to lessen the number of wrong ones."""


@dataclass(frozen=True)
class NonNegativeQP:
    """½ xᵀHx − bᵀx, the first `bounded` unknowns not negative."""

    curvature: Float64[Array, "n n"]
    """H"""
    negative_gradient: Float64[Array, " n"]
    """b: of the objective at zero."""
    bounded: int

    def precision_root(self) -> Float64[Array, " n"]:
        """Return one over the standard deviation of each unknown, the others known."""
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
        """Return unknowns of which the bounded ones are cut off at zero."""
        return np.concatenate([np.maximum(x[: self.bounded], 0), x[self.bounded :]])

    def wrong_side(self, solution: "QPSolution", precision_root: Float64[Array, " n"]) -> Bool[Array, " n"]:
        """Return which free unknowns are negative, and which held ones would rise."""
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
    """Return the minimum, with a first guess of the free unknowns; after `max_solves` the last iterate is cut off at zero."""
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
