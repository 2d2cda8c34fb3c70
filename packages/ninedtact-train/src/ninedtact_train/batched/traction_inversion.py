"""The traction inversion of many observations at once, as torch tensors.

Each result is that of `TractionInversion` without a previous image (docs/force_physics.md). Contacts have different numbers of
cells and of shear modes. Each is padded to the size of its batch with unknowns that have no effect and are zero in the solution.
Unknowns that are held at zero are treated in the same way. The schedule on a GPU is fixed: every iteration exchanges bounded
unknowns a fixed number of times, and the processor waits for the device once per iteration, to find which contacts have converged.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import torch
from jaxtyping import Bool, Float32, Float64, Int
from numpy import ndarray as Array

from ninedtact.force.traction import linearisation_and_qp as qp
from ninedtact.force.traction import traction_from_brightness as single
from ninedtact.force.traction.brightness_from_traction import DeformedSkin, ForwardModel, influence_kernel
from ninedtact.force.traction.observation import BrightnessLaw
from ninedtact_train.batched.contact_cells import BatchedObservation, Numbers, Views, smoothed
from ninedtact_train.batched.linearised_problem import (
    BatchedProblem,
    BatchedWhitener,
    SkinFields,
    Tractions,
    solve_nonnegative_qps,
)

_MODES_STEP, _CELLS_STEP = 8, 32
"""Numbers of modes and of cells are rounded up to multiples of these, so that few sizes occur."""
_LARGEST_BATCH, _LARGEST_GPU_BATCH = 1 << 20, 1 << 26
"""Largest number of values in the influences of the cells of a batch: what fits into the processor's cache, and what fills a
GPU."""


@dataclass(frozen=True)
class BatchedInversionResult:
    """`InversionResult` of each observation, and the covariance of the wrench over the squared shear modulus."""

    tractions: Tractions
    height_mm: Views
    thickness_change_mm: Views
    stiffening: Views
    covariance: Float64[torch.Tensor, "batch 6 6"]
    newton_decrement: Numbers
    pressure_change: Numbers

    @classmethod
    def zeros(cls, change: Views) -> "BatchedInversionResult":
        """Return the results of observations without contact, on the device of their changes."""
        count, zeros = len(change), change.new_zeros
        return cls(
            zeros(count, 3, *change.shape[1:]),
            *(torch.zeros_like(change), torch.zeros_like(change), torch.zeros_like(change)),
            zeros(count, 6, 6, dtype=torch.float64),
            *(zeros(count), zeros(count)),
        )

    def replace_where(
        self, indices: torch.Tensor, others: "BatchedInversionResult", better: Bool[torch.Tensor, " some"]
    ) -> None:
        """Replace the results at these indices by others, in place, where the others are better."""
        for name, other in vars(others).items():
            kept = getattr(self, name)
            flags = better.view(-1, *[1] * (other.ndim - 1))
            kept[indices] = torch.where(flags, other, kept[indices])


@dataclass(frozen=True)
class _Guess:
    """`InitialGuess` of each observation, and the step of its last result (`InversionResult.step`)."""

    tractions: Tractions
    skin: DeformedSkin
    misfit: Numbers
    step: Numbers

    def select(self, indices: torch.Tensor) -> "_Guess":
        skin = DeformedSkin(*(field[indices] for field in vars(self.skin).values()))
        return _Guess(self.tractions[indices], skin, self.misfit[indices], self.step[indices])


@dataclass(frozen=True)
class BatchedTractionInversion:
    """The inversion for one sensor and size of image on a device."""

    inversion: single.TractionInversion
    calibration_error: float
    """Standard deviation of the change due to the calibration (`ObservationOnCells.error`)."""
    device: str
    gpu_schedule: bool
    """Whether to use large batches, for which the processor waits once per iteration. Otherwise it also checks after every
    exchange of unknowns whether another one is needed."""

    def invert(self, observation: BatchedObservation) -> BatchedInversionResult:
        """Return the tractions that explain each observation, from itself alone; zero where nothing touches."""
        results = BatchedInversionResult.zeros(observation.change)
        for indices, cells, modes in self._batches(observation):
            part = self._converge(observation.select(indices), cells, modes)
            results.replace_where(indices, part, torch.ones_like(indices, dtype=torch.bool))
        return results

    def _batches(self, observation: BatchedObservation) -> Iterator[tuple[Int[torch.Tensor, " some"], int, int]]:
        """Yield the touching observations in batches of similar size, and the numbers of cells and modes of each batch."""
        region = observation.region.flatten(1)
        power = region @ self._modes.square()
        modes = (power >= qp.MIN_MODE_POWER * power.amax(1, keepdim=True)).sum(1)
        cell_counts, mode_counts = torch.stack([region.sum(1).long(), modes]).cpu()
        order = cell_counts.argsort(descending=True)[: int((cell_counts > 0).sum())]
        largest = _LARGEST_GPU_BATCH if self.gpu_schedule else _LARGEST_BATCH
        values_per_cell = self._height_windows[0].shape[2:].numel()
        while len(order):
            cells = _round_up(int(cell_counts[order[0]]), _CELLS_STEP, region.shape[1])
            part = order[: max(largest // (cells * values_per_cell), 1)]
            # At most about half of the unknowns of a contact are padding.
            part = part[cell_counts[part] * 2 + _CELLS_STEP >= cells]
            yield (
                part.to(region.device),
                cells,
                _round_up(int(mode_counts[part].max()), _MODES_STEP, self._modes.shape[1]),
            )
            order = order[len(part) :]

    def _converge(self, observation: BatchedObservation, cells: int, modes: int) -> BatchedInversionResult:
        """Iterate from the observed heights; return the result nearest to convergence of each observation."""
        guess = self._guess_from_heights(observation)
        best: BatchedInversionResult | None = None
        active = torch.arange(len(observation.change), device=self.device)
        for _ in range(self.inversion.solver.max_iterations):
            result, misfit = self._iterate(observation, guess, cells, modes)
            distance = self._distance(result)
            if best is None:
                best, better = result, torch.ones_like(distance, dtype=torch.bool)
            else:
                better = distance < self._distance(best)[active]
                best.replace_where(active, result, better)
            guess = self._guess_after(guess, result, misfit, better)
            unconverged = (distance > 1).nonzero()[:, 0]
            if not len(unconverged):
                break
            active, guess = active[unconverged], guess.select(unconverged)
            observation = observation.select(unconverged)
        assert best is not None
        return best

    def _guess_after(
        self, guess: _Guess, result: BatchedInversionResult, misfit: Numbers, better: Bool[torch.Tensor, " batch"]
    ) -> _Guess:
        """Return the guesses a step of the way to the results, a shorter one where a result is not better."""
        step = torch.where(better, guess.step, (guess.step / 2).clamp(min=single.SMALLEST_STEP))
        tractions = guess.tractions + step[:, None, None, None] * (result.tractions - guess.tractions)
        return _Guess(tractions, self._forward.deform(tractions), misfit, step)

    def _distance(self, result: BatchedInversionResult) -> Numbers:
        """Return how far each result is from convergence; at one and below, another iteration would hardly change it."""
        solver = self.inversion.solver
        decrement = result.newton_decrement / solver.target_decrement
        return decrement.maximum(result.pressure_change / solver.target_change)

    def _iterate(
        self, observation: BatchedObservation, guess: _Guess, cells: int, modes: int
    ) -> tuple[BatchedInversionResult, Numbers]:
        """Compute one Gauss–Newton iteration; return the result and its misfit."""
        forward, problem = self._forward, self._linearise(observation, guess, cells, modes)
        constant = forward.observed_change(self._law, guess.skin, observation.sight)
        constant = constant - forward.scatter(problem.slope * guess.skin.linear_mm)
        target = problem.negative_gradient(observation.change - constant)
        free = guess.tractions[:, 0].flatten(1).gather(1, problem.index) > 0
        weights = free.new_ones(len(free), problem.curvature.shape[1] - cells)
        solution = solve_nonnegative_qps(
            problem.curvature, target, torch.cat([free, weights], 1), cells, not self.gpu_schedule
        )
        tractions = problem.tractions(solution.x, self.inversion.forward.cells.shape)
        skin = forward.deform(tractions)
        predicted = forward.observed_change(self._law, skin, observation.sight)
        nonlinear = predicted - constant - forward.scatter(problem.slope * skin.linear_mm)
        whitened = solution.whiten_rows(
            torch.cat([problem.negative_gradient(nonlinear)[:, None], self._wrench_operator(problem)], 1)
        )
        result = BatchedInversionResult(
            tractions,
            *self._fields_on_view(skin),
            whitened[:, 1:] @ whitened[:, 1:].mT,
            whitened[:, 0].norm(dim=1).float().masked_fill(~solution.converged, torch.inf),
            _change(tractions, guess.tractions, problem.sticking_part),
        )
        return result, self._misfit(observation, predicted)

    def _fields_on_view(self, skin: DeformedSkin) -> tuple[Views, Views, Views]:
        """Return copies of height, change of thickness and stiffening on the view."""
        rows, cols = self.inversion.forward.cells.shape
        height_mm, change_mm, stiffening = (
            field[:, :rows, :cols].clone() for field in (skin.height_mm, skin.thickness_change_mm, skin.stiffening)
        )
        return height_mm, change_mm, stiffening

    def _linearise(self, observation: BatchedObservation, guess: _Guess, cells: int, modes: int) -> BatchedProblem:
        """Return the problem of each observation, linearised about its guess, with these numbers of cells and modes."""
        region = observation.region.flatten(1)
        index = region.argsort(dim=1, descending=True, stable=True)[:, :cells]
        used = region.gather(1, index)
        pressure, sigma_cells = (
            guess.tractions[:, 0],
            self.inversion.prior.smooth_mm / self.inversion.forward.cells.pitch_mm,
        )
        carries = used * smoothed(pressure * observation.region, sigma_cells).flatten(1).gather(1, index)
        power = carries**single.CARRYING_EXPONENT
        carries = power * (carries.sum(1) / power.sum(1).clamp(min=1e-9))[:, None]
        carried = self._carried_shear(index, carries, modes)
        sticking_part = _sticking_part(guess.tractions)
        sticking = self._sticking_weights(index, carries, carried, sticking_part)
        slope = self._forward.slope_per_mm(self._law.slope_per_mm, guess.skin)
        whitener = self._whitener(observation, guess.misfit)
        jacobian = self._jacobian(index, used, carried, slope, whitener.per_error)
        curvature = whitener.gram(jacobian).double()
        curvature[:, :cells, :cells] += self._prior_precision(observation, index, used)
        brought = (sticking * used[..., None]).double()
        curvature[:, :cells, :cells] += brought @ brought.mT
        curvature[:, :cells, cells:] -= brought
        curvature[:, cells:, :cells] -= brought.mT
        # Padding has a curvature of one, which keeps it at zero.
        curvature.diagonal(0, 1, 2).add_(torch.cat([1 - used, used.new_ones(len(used), 2 * modes)], 1))
        return BatchedProblem(index, used, carried, jacobian, curvature, slope, whitener, sticking_part)

    def _prior_precision(
        self, observation: BatchedObservation, index: torch.Tensor, used: Float32[torch.Tensor, "batch n"]
    ) -> Float32[torch.Tensor, "batch n n"]:
        """Return the precision of the pressure between the cells of each contact, scaled to its indentation."""
        forward, region = self.inversion.forward, observation.region
        square = (observation.z_mm.square() * region).sum((1, 2)) / region.sum((1, 2))
        strain = square.sqrt().clamp(min=single.MIN_PRIOR_DEPTH_MM) / forward.gel.thickness_mm
        precision = _pairs(self._precision_kernel, index, forward.cells.shape)
        return precision * (used[:, :, None] * used[:, None, :]) / strain.square()[:, None, None]

    def _carried_shear(
        self, index: torch.Tensor, carries: Float32[torch.Tensor, "batch n"], modes: int
    ) -> Float32[torch.Tensor, "batch n modes"]:
        """Return the shear on each cell by its strongest modes, of this number; negligible ones are zero."""
        carried = self._modes[index] * carries[..., None]
        strongest = carried.square().sum(1).topk(modes, 1)
        kept = strongest.values >= (qp.MIN_MODE_POWER * strongest.values[:, :1]).clamp(min=1e-30)
        carried = carried.gather(2, strongest.indices[:, None].expand(-1, carried.shape[1], -1))
        return carried * kept[:, None]

    def _sticking_weights(
        self,
        index: torch.Tensor,
        carries: Float32[torch.Tensor, "batch n"],
        carried: Float32[torch.Tensor, "batch n modes"],
        sticking_part: Numbers,
    ) -> Float32[torch.Tensor, "batch n weights"]:
        """Return `LinearisedBrightnessProblem.sticking_weights` of each contact."""
        shape = self.inversion.forward.cells.shape
        between = [_pairs(kernel, index, shape).mT for kernel in self._tangential_kernels]
        step = (carries.amax(1) / qp.GROWTH_STEPS).clamp(min=1e-9)[:, None]
        weights = carried.new_zeros(len(carried), 2, carried.shape[2], carried.shape[1], dtype=torch.float64)
        for level in range(qp.GROWTH_STEPS):
            above = carries - level * step
            part = above.clamp(min=0).minimum(step) / carries.clamp(min=1e-9)
            held = carried * (above > 0)[..., None]
            weights += (held.mT @ held).double()[:, None] @ (_holding_weights(held, between) * part[:, None, None])
        gram = _damped(carried.mT @ carried)[:, None]
        weights = torch.linalg.solve_ex(gram.expand(-1, 2, -1, -1), weights).result * sticking_part[:, None, None, None]
        return weights.flatten(1, 2).mT.float()

    def _jacobian(
        self,
        index: torch.Tensor,
        used: torch.Tensor,
        carried: torch.Tensor,
        slope: SkinFields,
        per_error: Views,
    ) -> Float32[torch.Tensor, "batch unknowns cells"]:
        """Return the derivative of the signal by each unknown, over the signal's standard deviation."""
        rows, cols = self.inversion.forward.cells.shape
        at = rows - 1 - index // cols, cols - 1 - index % cols
        down, across = self._point_spread
        skin_rows, skin_cols = self._skin_indices
        near = slope[:, skin_rows[:, None], skin_cols]
        pressed, *sheared = (windows[at] for windows in self._height_windows)
        by_modes = [(carried.mT @ each.flatten(2)).view(*carried.mT.shape[:2], *each.shape[2:]) for each in sheared]
        heights = torch.cat([pressed * used[:, :, None, None], *by_modes], 1)
        signal = (down @ (heights * near[:, None]) @ across) * per_error[:, None]
        return signal.flatten(2)

    def _wrench_operator(self, problem: BatchedProblem) -> Float64[torch.Tensor, "batch 6 unknowns"]:
        """Return the force and torque due to a unit of each unknown, N and N·m per MPa."""
        carried, used = problem.carried_shear.double(), problem.used.double()
        x, y = (self._coordinates_mm[problem.index, axis] for axis in (0, 1))
        none = torch.zeros_like(x)
        pressed = torch.stack([none, none, -used, -y * used / 1e3, x * used / 1e3, none], 1)
        common, turned_x, turned_y = (row[:, None] @ carried for row in (used, -y * used / 1e3, x * used / 1e3))
        zero = torch.zeros_like(common)
        along_x = torch.cat([common, zero, zero, zero, zero, turned_x], 1)
        along_y = torch.cat([zero, common, zero, zero, zero, turned_y], 1)
        return torch.cat([pressed, along_x, along_y], 2) * self.inversion.forward.cells.patch.cell_area_mm2

    def _guess_from_heights(self, observation: BatchedObservation) -> _Guess:
        cells, z_mm = self.inversion.forward.cells, observation.z_mm
        rows, cols = (
            self._tensor(cells.offsets(axis)).long().clamp(0, side - 1) for axis, side in enumerate(cells.shape)
        )
        height_mm = z_mm[:, rows[:, None], cols]
        about_mm = self._forward.thickness_change_mm(height_mm)
        tractions = z_mm.new_zeros(len(z_mm), 3, *cells.shape)
        thinning_mm = -about_mm[:, : cells.rows, : cells.cols]
        tractions[:, 0] = thinning_mm.clamp(min=0) * observation.region * single.WINKLER_PER_MM
        one = torch.ones_like(observation.noise)
        return _Guess(tractions, DeformedSkin(height_mm, about_mm, torch.ones_like(about_mm), about_mm), one, one)

    def _misfit(self, observation: BatchedObservation, predicted: Views) -> Numbers:
        """Return the root mean square of the residual over its standard deviation; at least one."""
        whitener = self._whitener(observation, torch.ones_like(observation.noise))
        square = whitener.squared_norm(observation.change - predicted)
        return (square / observation.in_view.sum((1, 2)).clamp(min=1)).clamp(min=1).sqrt()

    def _whitener(self, observation: BatchedObservation, misfit: Numbers) -> BatchedWhitener:
        """Return the inverse covariance of noise and calibration error combined, scaled to the misfit."""
        std = (observation.noise.square() + self.calibration_error**2).sqrt() * misfit
        return BatchedWhitener(observation.in_view / std[:, None, None])

    @cached_property
    def _forward(self) -> ForwardModel:
        return replace(self.inversion.forward, like=torch.zeros((), device=self.device))

    @cached_property
    def _law(self) -> "_DeviceLaw":
        return _DeviceLaw(self.inversion.law, self.device)

    @cached_property
    def _modes(self) -> Float32[torch.Tensor, "cells modes"]:
        return self._tensor(self.inversion.discrete_prior.shear_modes)

    @cached_property
    def _height_windows(self) -> list[Float32[torch.Tensor, "cell_rows cell_cols skin_rows skin_cols"]]:
        kernels, forward = self.inversion.kernels, self.inversion.forward
        tall, wide = kernels.skin_shape
        each = (self._tensor(influence_kernel(forward.cells, one, forward.around)) for one in forward.compliance)
        return [one.unfold(0, tall, 1).unfold(1, wide, 1) for one in each]

    @cached_property
    def _tangential_kernels(self) -> list[Float32[torch.Tensor, "tall wide"]]:
        """Displacement along x by pressure and by shear along x and y, then that along y by pressure and by shear along y."""
        forward = self.inversion.forward
        (by_pressure_x, xx, xy), (by_pressure_y, _, yy) = forward.tangential_compliance
        each = by_pressure_x, xx, xy, by_pressure_y, yy
        return [self._tensor(influence_kernel(forward.cells, one, (0, 0))) for one in each]

    @cached_property
    def _precision_kernel(self) -> Float32[torch.Tensor, "tall wide"]:
        prior = self.inversion.discrete_prior
        return self._tensor(influence_kernel(prior.cells, prior.precision_spectrum, (0, 0)))

    @cached_property
    def _point_spread(self) -> tuple[torch.Tensor, torch.Tensor]:
        down, across = self.inversion.kernels.point_spread
        return self._tensor(down), self._tensor(across)

    @cached_property
    def _skin_indices(self) -> list[torch.Tensor]:
        return [torch.as_tensor(each, device=self.device) for each in self.inversion.kernels.skin_indices]

    @cached_property
    def _coordinates_mm(self) -> Float64[torch.Tensor, "cells 2"]:
        x, y = (self._tensor(axis).double().flatten() for axis in self.inversion.forward.cells.coordinates_mm)
        return torch.stack([x, y], 1)

    def _tensor(self, values: Array) -> torch.Tensor:
        return torch.as_tensor(values, dtype=torch.float32, device=self.device)


class _DeviceLaw:
    """`BrightnessLaw` on a device."""

    def __init__(self, law: BrightnessLaw, device: str) -> None:
        self._height, self._change = (
            torch.as_tensor(knots, dtype=torch.float32, device=device) for knots in (law.height_mm, law.change)
        )
        self._slope = self._change.diff() / self._height.diff()

    def __call__(self, height_mm: torch.Tensor) -> torch.Tensor:
        """Return the relative change of brightness."""
        segment = self._segment(height_mm)
        inside_mm = height_mm.clamp(self._height[0], self._height[-1])
        return self._change[segment] + self._slope[segment] * (inside_mm - self._height[segment])

    def slope_per_mm(self, height_mm: torch.Tensor) -> torch.Tensor:
        """Return the derivative of the change with respect to height."""
        return self._slope[self._segment(height_mm)]

    def _segment(self, height_mm: torch.Tensor) -> torch.Tensor:
        return torch.searchsorted(self._height[1:-1], height_mm.contiguous(), right=True)


def _round_up(count: int, step: int, largest: int) -> int:
    """Return the count rounded up to a multiple of the step, at most the largest."""
    return min(-(-count // step) * step, largest)


def _pairs(kernel: torch.Tensor, index: torch.Tensor, shape: tuple[int, int]) -> Float32[torch.Tensor, "batch n n"]:
    """Return the kernel at the offset of every cell (last axis) from every cell: the response of the one to the other."""
    rows, cols = shape
    row, col = index // cols, index % cols
    return kernel[
        rows - 1 - row[:, :, None] + row[:, None, :],
        cols - 1 - col[:, :, None] + col[:, None, :],
    ]


def _change(tractions: Tractions, before: Tractions, sticking_part: Numbers) -> Numbers:
    """Return `InversionResult.pressure_change` from the tractions and the part that sticks in the iteration before."""
    pressed = tractions[:, 0].sum((1, 2))
    change = (tractions[:, 0] - before[:, 0]).abs().sum((1, 2)) / pressed.clamp(min=1e-9)
    return change.maximum(single.STICKING_CHANGE * (_sticking_part(tractions) - sticking_part).abs())


def _sticking_part(tractions: Tractions) -> Numbers:
    """Return the part of the shear that friction still bears, as `traction_from_brightness` computes it."""
    pressed, along_x, along_y = tractions.sum((2, 3)).unbind(1)
    shear = torch.hypot(along_x, along_y)
    return (1 - shear / (single.SLIDES_FROM * pressed).clamp(min=1e-9)).clamp(min=0)


def _holding_weights(
    modes: Float32[torch.Tensor, "batch n modes"], between: list[torch.Tensor]
) -> Float64[torch.Tensor, "batch 2 modes n"]:
    """Return the weights of shear modes, along x and along y, that hold their cells under unit pressure on each cell."""
    by_pressure_x, *across, by_pressure_y, yy = between
    pushed = torch.cat([modes.mT @ by_pressure_x, modes.mT @ by_pressure_y], 1)
    xx, xy, yy = (modes.mT @ displacement @ modes for displacement in (*across, yy))
    stiff = torch.cat([torch.cat([xx, xy], 2), torch.cat([xy.mT, yy], 2)], 1)
    return -torch.linalg.solve_ex(_damped(stiff), pushed.double()).result.unflatten(1, (2, -1))


def _damped(gram: Float32[torch.Tensor, "batch n n"]) -> Float64[torch.Tensor, "batch n n"]:
    damping = (qp.MODE_DAMPING * gram.amax((1, 2))).clamp(min=1e-12).double()
    return gram.double() + damping[:, None, None] * torch.eye(gram.shape[1], dtype=torch.float64, device=gram.device)
