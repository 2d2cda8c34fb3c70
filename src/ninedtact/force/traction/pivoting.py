"""The lowest point of a quadratic of which some unknowns must not be negative, solved outright.

Those unknowns are free, or held at zero. The free ones are solved for; all that come out negative are held, all held ones that
would rise are freed, and so on until none is on the wrong side; should exchanging all of them not lessen their number, they are
exchanged one by one, which always ends (block principal pivoting: Júdice and Pires 1994; docs/force_physics.md).
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float64
from numpy import ndarray as Array

WRONG = 0.05
"""Own standard deviations by which an unknown must be on the wrong side to count."""
CHANCES = 3
"""Exchanges of all that may fail to lessen the number of wrong ones in a row."""


@dataclass(frozen=True)
class Quadratic:
    """½ xᵀHx − bᵀx."""

    curvature: Float64[Array, "n n"]
    downhill_at_zero: Float64[Array, " n"]
    """b"""
    bounded: int
    """So many, the first, must not be negative."""

    def scale(self) -> Float64[Array, " n"]:
        """One over the standard deviation of each, the others known."""
        return np.sqrt(np.diag(self.curvature))

    def solved(self, free: Bool[Array, " n"], solves: int = 1) -> "Lowest":
        """The lowest point where the others are zero."""
        from scipy.linalg import cho_solve, cholesky

        at, index = np.zeros(len(free)), np.flatnonzero(free)
        part = self.curvature[np.ix_(index, index)].T
        factor = cholesky(part, lower=True, overwrite_a=True, check_finite=False)
        at[index] = cho_solve((factor, True), self.downhill_at_zero[index], check_finite=False)
        return Lowest(at, free, factor, solves)

    def inside(self, at: Float64[Array, " n"]) -> Float64[Array, " n"]:
        """Cut off at zero."""
        return np.concatenate([np.maximum(at[: self.bounded], 0), at[self.bounded :]])

    def wrong(self, now: "Lowest", scale: Float64[Array, " n"]) -> Bool[Array, " n"]:
        """Free ones that are negative, held ones that would rise."""
        held = ~now.free
        rising = held & (self.downhill_at_zero - self.curvature @ now.at > WRONG * scale)
        negative = now.free & (now.at * scale < -WRONG)
        negative[self.bounded :] = False
        return rising | negative


@dataclass(frozen=True)
class Lowest:
    """Where it is lowest."""

    at: Float64[Array, " n"]
    free: Bool[Array, " n"]
    factor: Float64[Array, "free free"]
    """Cholesky's, lower, of the free ones' curvature."""
    solves: int
    settled: bool = False

    def sizes(self, of: Float64[Array, "rows n"]) -> Float64[Array, "rows free"]:
        """L⁻¹ times each row; its square is the row's variance."""
        from scipy.linalg import solve_triangular

        return np.asarray(solve_triangular(self.factor, of[:, self.free].T, lower=True, check_finite=False).T)


def lowest(problem: Quadratic, free: Bool[Array, " n"], most: int) -> Lowest:
    """Solve, the first guess being which are free; after so many solutions the last one is cut off at zero."""
    scale = problem.scale()
    now = problem.solved(free)
    wrong, fewest, chances = problem.wrong(now, scale), len(free) + 1, CHANCES
    while now.solves < most and wrong.any():
        count = int(wrong.sum())
        fewest, chances = (count, CHANCES) if count < fewest else (fewest, chances - 1)
        now = problem.solved(now.free ^ (wrong if chances >= 0 else last_alone(wrong)), now.solves + 1)
        wrong = problem.wrong(now, scale)
    return replace(now, at=problem.inside(now.at), settled=not wrong.any())


def last_alone(wrong: Bool[Array, " n"]) -> Bool[Array, " n"]:
    """The last of these."""
    alone = np.zeros_like(wrong)
    alone[np.flatnonzero(wrong)[-1]] = True
    return alone
