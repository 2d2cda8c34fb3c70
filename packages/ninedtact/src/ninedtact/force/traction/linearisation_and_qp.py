"""One Gauss–Newton iteration: the brightness law linearised about a guess, which leaves a quadratic programme in the tractions.

The prior (`TractionPrior`) has the statistics of simulated presses, in units of the shear modulus (docs/force_physics.md has the
figures). Pressure has the correlation exp(−r/ℓ), ℓ = 1.9 mm, less of it below 0.5 mm, and a standard deviation in proportion to the
indentation over the gel's thickness. Shear has the mean that keeps the skin under the pressure from spreading sideways, as friction
does, and deviates from it by a power of the pressure times a smooth ratio. One part of this ratio is constant over the contact (the
tangential load: 0.2 on each axis); the other varies over about two millimetres (0.2).

The quadratic programme of one linearisation has unknowns that must not be negative. It is solved exactly, by block principal
pivoting: each bounded unknown is free, or held at zero. The free unknowns are solved for; then those that are negative are held,
and held ones that would rise are freed, until none is on the wrong side. Where exchanging all of them repeatedly fails to reduce
their number, they are exchanged one at a time, which always terminates (Júdice and Pires 1994; docs/force_physics.md).
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Float32, Float64, Int
from numpy import ndarray as Array

from ninedtact.force.traction.brightness_from_traction import (
    Indices,
    InfluenceKernels,
    SkinField,
    Tractions,
    View,
    influence_kernel,
    places_between_cells,
)
from ninedtact.force.traction.observation import CellGrid

WRONG_SIDE_STDS = 0.05
"""Distance beyond the bound, in an unknown's own standard deviations, from which it counts as on the wrong side."""
MAX_FAILED_EXCHANGES = 3
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

    def solve_free(
        self, free: Bool[Array, " n"], solve_count: int = 1, factor: Float64[Array, "free free"] | None = None
    ) -> "QPSolution":
        """Return the minimum over the free unknowns, the others being zero; `factor` is that of their curvature, where known."""
        from scipy.linalg import cho_solve, cholesky

        x, index = np.zeros(len(free)), np.flatnonzero(free)
        if factor is None:
            block = self.curvature[index][:, index]  # in two steps, which takes a quarter of the time
            factor = cholesky(block.T, lower=True, overwrite_a=True, check_finite=False)
        x[index] = cho_solve((factor, True), self.negative_gradient[index], check_finite=False)
        return QPSolution(x, free, factor, solve_count)

    def clip(self, x: Float64[Array, " n"]) -> Float64[Array, " n"]:
        """Return the unknowns with the bounded ones clipped at zero."""
        return np.concatenate([np.maximum(x[: self.bounded], 0), x[self.bounded :]])

    def wrong_side(self, solution: "QPSolution", precision_root: Float64[Array, " n"]) -> Bool[Array, " n"]:
        """Return a mask of the unknowns on the wrong side: free ones that are negative, and held ones that would rise."""
        held = ~solution.free
        rising = held & (self.negative_gradient - self.curvature @ solution.x > WRONG_SIDE_STDS * precision_root)
        negative = solution.free & (solution.x * precision_root < -WRONG_SIDE_STDS)
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


def solve_nonnegative_qp(
    problem: NonNegativeQP,
    free: Bool[Array, " n"],
    max_solves: int,
    factor: Float64[Array, "free free"] | None = None,
) -> QPSolution:
    """Return the minimum, starting from a guess of the free unknowns, or the last iterate after `max_solves`, clipped at zero.

    factor: that of the curvature of these unknowns, where it is known.
    """
    precision_root = problem.precision_root()
    solution = problem.solve_free(free, factor=factor)
    wrong, fewest, chances = problem.wrong_side(solution, precision_root), len(free) + 1, MAX_FAILED_EXCHANGES
    while solution.solve_count < max_solves and wrong.any():
        count = int(wrong.sum())
        fewest, chances = (count, MAX_FAILED_EXCHANGES) if count < fewest else (fewest, chances - 1)
        exchanged = wrong if chances >= 0 else _keep_last(wrong)
        solution = problem.solve_free(solution.free ^ exchanged, solution.solve_count + 1)
        wrong = problem.wrong_side(solution, precision_root)
    return replace(solution, x=problem.clip(solution.x), converged=not wrong.any())


def _keep_last(mask: Bool[Array, " n"]) -> Bool[Array, " n"]:
    """Return a mask of which only the last true entry is kept."""
    alone = np.zeros_like(mask)
    alone[np.flatnonzero(mask)[-1]] = True
    return alone


MIN_MODE_POWER = 0.01
"""Fraction of the strongest shear mode's power below which a mode is left out."""
MODE_DAMPING = 1e-3
"""Damping of the projection on shear modes, relative to the strongest of them: neighbouring modes overlap."""
GROWTH_STEPS = 4
"""Number of levels of the pressure over which a contact is taken to have grown."""
_CELLS_PER_BATCH = 64
"""Number of cells whose fields are computed together, small enough for the processor's cache."""


@dataclass(frozen=True)
class TractionPrior:
    """Statistics of the tractions in presses that were simulated separately, with other objects on other sensors."""

    pressure_per_strain: float = 120.0
    """Standard deviation of the pressure over the root mean square of the indentation, which is relative to the gel's thickness.
    Several times the value found: pressure has sharp edges, unlike a Gaussian field, and a tighter prior shrinks forces."""
    correlation_mm: float = 1.9
    pull: float = 0.2
    """Standard deviation of the part of shear over pressure that is constant over the contact."""
    spread: float = 0.2
    """Standard deviation of the part of shear over pressure that varies over the contact. A third more than the value found, for
    what the modes cannot represent: with less, wide contacts are read too weak."""
    spread_mm: float = 2.0
    smooth_mm: float = 0.5
    """Length below which pressure varies less than exp(−r/ℓ) does, and standard deviation of the Gaussian that smooths it before it
    carries shear. Light that scatters hides a pressure that alternates from cell to cell, which would be found in deep presses."""


@dataclass(frozen=True)
class DiscretePrior:
    """The prior on a grid of cells."""

    cells: CellGrid
    prior: TractionPrior

    @cached_property
    def shear_modes(self) -> Float32[Array, "cells modes"]:
        """Ratios of shear to pressure on one axis, cells row after row: one constant mode, and Gaussian bumps on a lattice."""
        down, across = (_gaussian_bumps(side, self.cells.pitch_mm, self.prior.spread_mm) for side in self.cells.shape)
        power = np.sqrt((down**2).sum(1).mean() * (across**2).sum(1).mean())
        down, across = (down * self.prior.spread / power).astype(np.float32), across.astype(np.float32)
        lattice = np.einsum("ia,jb->ijab", down, across).reshape(len(down) * len(across), -1)
        common = np.full((len(lattice), 1), self.prior.pull, np.float32)
        return np.concatenate([common, lattice], axis=1)

    def pressure_precision(self, row: Indices, col: Indices) -> Float32[Array, "n n"]:
        """Return the precision of pressure between each of these cells and each of them, for a strain of one."""
        return self._precision_kernel.take(places_between_cells(self.cells, row, col))

    @cached_property
    def _precision_kernel(self) -> Float32[Array, "tall wide"]:
        return influence_kernel(self.cells, self.precision_spectrum, (0, 0))

    @property
    def precision_spectrum(self) -> Float32[Array, "skin_rows half"]:
        """The precision of pressure for a strain of one, per wave vector."""
        wave = np.hypot(*self.cells.patch.wave_vectors)
        return pressure_precision_spectrum(wave, self.prior, self.cells.pitch_mm)


@dataclass(frozen=True)
class Whitener:
    """The inverse covariance of the residual: independent errors of the cells, and one of the brightness level that they share."""

    per_error: View
    """One over the standard deviation of every cell; zero where nothing is seen."""
    level_std: float
    """Standard deviation of the common level."""

    def __call__(self, residual: View) -> View:
        """Return the inverse covariance times a residual."""
        return self.whiten(residual) * self.per_error

    def whiten(self, residual: View) -> View:
        """Return a residual over its errors; what is common to all cells is subtracted as far as the level's error allows."""
        weighted = residual * self.per_error
        common = self.level_std * self.per_error
        weighted -= common * (float(np.vdot(common, weighted)) * self._level_gain)
        return weighted

    def gram(self, columns: Float32[Array, "n cells"]) -> Float32[Array, "n n"]:
        """Return the products of fields that are divided by their errors already."""
        common = columns @ (self.level_std * self.per_error.ravel())
        gram = columns @ columns.T
        gram -= np.outer(common, common) * np.float32(self._level_gain)
        return gram

    @cached_property
    def _level_gain(self) -> float:
        """One over one plus the precision of the level over that of its prior."""
        return 1 / (1 + self.level_std**2 * float(np.vdot(self.per_error, self.per_error)))


@dataclass(frozen=True)
class LinearisedBrightnessProblem:
    """The quadratic programme ½ xᵀHx − bᵀx that results from linearising about guessed heights of the skin.

    The unknowns x are the pressure on each cell of the contact region, then the weights of the shear modes along x and along y. The
    prior expects the weights that the pressure brings with it.
    """

    kernels: InfluenceKernels
    prior: DiscretePrior
    region: View
    """Contact region: one on cells where pressure may act, zero elsewhere."""
    about: Tractions
    """The tractions of the guess."""
    carries: View
    """Power of the smoothed pressure, to which shear is proportional."""
    slope: SkinField
    """Derivative of the brightness law at the guess."""
    whitener: Whitener
    strain: float
    """Root mean square of the indentation over the gel's thickness, which scales the prior of pressure."""
    sticking_part: float = 1.0
    """Part of the shear that keeps the skin in place which friction bears; a contact that slides has none left."""
    growth_steps: int = GROWTH_STEPS

    @cached_property
    def contact_cells(self) -> tuple[Int[Array, " n"], Int[Array, " n"]]:
        """Row and column of the cells of the contact region."""
        row, col = np.nonzero(self.region)
        return row, col

    @cached_property
    def carried_shear(self) -> Float32[Array, "n modes"]:
        """Shear on each of these cells by each mode that is not negligible on them."""
        row, col = self.contact_cells
        carried = self.prior.shear_modes[row * self.region.shape[1] + col] * self.carries[row, col][:, None]
        power = (carried**2).sum(axis=0)
        return np.ascontiguousarray(carried[:, power >= MIN_MODE_POWER * power.max()])

    @cached_property
    def sticking_weights(self) -> Float32[Array, "n weights"]:
        """Weights of the shear modes along x and along y that unit pressure on each of these cells brings with it.

        They are those of the shear that keeps the skin in place, as far as it does. Skin that an object reaches late has moved
        before: the contact is taken to have grown over the levels of the pressure, and what each step adds to have found the skin
        of that step in place (docs/force_physics.md).
        """
        row, col = self.contact_cells
        # The cells that are in contact at a level are then the first ones.
        order = np.argsort(-self.carries[row, col])
        carried, modes = self.carries[row, col][order], self.carried_shear[order].T
        between = self.kernels.tangential_between_cells(row[order], col[order])
        step = max(float(carried[0]) / self.growth_steps, 1e-9)
        weights, moved, held = np.zeros((2, *modes.shape)), np.zeros((5, *modes.shape), np.float32), 0
        for level in reversed(range(self.growth_steps)):
            above = carried[carried > level * step] - level * step
            added, held = slice(held, len(above)), len(above)
            moved += modes[:, added] @ between[:, added]
            part = np.minimum(above, step) / carried[:held]
            weights[..., :held] += _shear_that_holds(modes[:, :held], moved[..., :held]) * part
        sticking = np.empty((len(row), 2 * len(modes)), np.float32)
        sticking[order] = np.linalg.solve(_damped(modes @ modes.T), weights).reshape(-1, len(row)).T
        return sticking * np.float32(self.sticking_part)

    @cached_property
    def jacobian(self) -> Float32[Array, "unknowns cells"]:
        """J: the derivative of the observed signal by each unknown, over the signal's standard deviation."""
        count, modes = self.carried_shear.shape
        row, col = self.contact_cells
        jacobian = np.empty((count + 2 * modes, self.whitener.per_error.size), np.float32)
        for first in range(0, count, _CELLS_PER_BATCH):
            batch = slice(first, min(first + _CELLS_PER_BATCH, count))
            jacobian[batch] = self._signal_of_heights(self.kernels.heights_of_cells(row[batch], col[batch]))
        carried = np.zeros((modes, *self.region.shape), np.float32)
        carried[:, row, col] = self.carried_shear.T
        jacobian[count:] = self._signal_of_heights(self.kernels.heights_of_shear(carried))
        return jacobian

    @cached_property
    def curvature(self) -> Float64[Array, "unknowns unknowns"]:
        """H: the curvature of the misfit plus that of the prior."""
        row, col = self.contact_cells
        count, brought, curvature = len(row), self.sticking_weights, self.whitener.gram(self.jacobian)
        curvature[:count, :count] += self.prior.pressure_precision(row, col) * np.float32(1 / self.strain**2)
        curvature[:count, :count] += brought @ brought.T
        curvature[:count, count:] -= brought
        curvature[count:, :count] -= brought.T
        np.einsum("ii->i", curvature)[count:] += 1
        return curvature.astype(float)

    def negative_gradient(self, residual: View) -> Float64[Array, " unknowns"]:
        """Return b for a residual (r): Jᵀ times the whitened residual."""
        return (self.jacobian @ self.whitener.whiten(residual).ravel()).astype(float)

    def quadratic_programme(self, target: View) -> NonNegativeQP:
        """Return the programme whose solution explains this change of the signal in the linearised law."""
        return NonNegativeQP(self.curvature, self.negative_gradient(target), len(self.contact_cells[0]))

    def initially_free(self, pressure: View) -> Bool[Array, " unknowns"]:
        """Return which unknowns are free at first: pressure where there was some before, and all shear."""
        return np.concatenate([pressure[self.contact_cells] > 0, np.ones(2 * self.carried_shear.shape[1], bool)])

    def tractions(self, unknowns: Float[Array, " unknowns"]) -> Tractions:
        """Return pressure and shear on the view."""
        row, col = self.contact_cells
        modes = self.carried_shear.shape[1]
        tractions = np.zeros((3, *self.region.shape), np.float32)
        tractions[0, row, col] = unknowns[: len(row)]
        tractions[1:, row, col] = unknowns[len(row) :].reshape(2, modes) @ self.carried_shear.T
        return tractions

    def newton_decrement(self, solution: QPSolution, residual: View) -> float:
        """Return how far the solution would move to explain this residual as well.

        By the Cauchy–Schwarz inequality no linear combination of the unknowns moves by more of its own standard deviations.
        """
        return float(np.linalg.norm(solution.whiten_rows(self.negative_gradient(residual)[None])))

    def _signal_of_heights(self, heights: Float32[Array, "n skin_rows skin_cols"]) -> Float32[Array, "n cells"]:
        """Return the change of the observed signal over its standard deviation; overwrites the heights."""
        down, across = self.kernels.point_spread
        heights *= self._slope_on_skin
        rows, cols = heights.shape[1:]
        signal = down @ (heights.reshape(-1, cols) @ across).reshape(-1, rows, across.shape[1])
        signal *= self.whitener.per_error
        return signal.reshape(len(signal), self.whitener.per_error.size)

    @cached_property
    def _slope_on_skin(self) -> Float32[Array, "skin_rows skin_cols"]:
        return self.kernels.crop_to_skin(self.slope)


def _shear_that_holds(
    modes: Float32[Array, "modes held"], moved: Float32[Array, "5 modes held"]
) -> Float64[Array, "2 modes held"]:
    """Return the projections on the modes of the shear, along x and along y, that holds the skin of some cells under unit pressure
    on each: that of the least elastic energy, as Galerkin's method finds it.

    moved: the modes times the displacements of `tangential_between_cells`.
    """
    xx, xy, yy = moved[2:] @ modes.T
    stiff = np.concatenate([np.concatenate(row, axis=1) for row in ((xx, xy), (xy.T, yy))])
    weights = np.linalg.solve(_damped(stiff), np.concatenate(list(moved[:2])))
    return -(modes @ modes.T) @ weights.reshape(moved[:2].shape)


def _damped(gram: Float32[Array, "n n"]) -> Float64[Array, "n n"]:
    """Return the products of modes with a little damping: neighbouring modes overlap."""
    return gram.astype(float) + max(MODE_DAMPING * float(gram.max()), 1e-12) * np.eye(len(gram))


def pressure_precision_spectrum(
    wave: Float[Array, "rows half"], prior: TractionPrior, pitch_mm: float
) -> Float32[Array, "rows half"]:
    """Return the inverse power spectrum of pressure at every wave number (1/mm), for a strain of one.

    The spectrum is that of the correlation exp(−r/ℓ) in two dimensions, which waves shorter than `smooth_mm` have less of.
    """
    length = prior.correlation_mm
    power = 2 * np.pi * (prior.pressure_per_strain * length / pitch_mm) ** 2
    return ((1 + (wave * length) ** 2) ** 1.5 * (1 + (wave * prior.smooth_mm) ** 2) / power).astype(np.float32)


def _gaussian_bumps(cells: int, pitch_mm: float, step_mm: float) -> Float[Array, "cells n"]:
    """Return Gaussians one step apart along one axis."""
    count = int(np.ceil(cells * pitch_mm / step_mm)) + 1
    middle = (np.arange(count) - (count - 1) / 2) * step_mm
    place = (np.arange(cells) - (cells - 1) / 2) * pitch_mm
    return np.exp(-((place[:, None] - middle) ** 2) / (2 * (0.8 * step_mm) ** 2))
