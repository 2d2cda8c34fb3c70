"""The linearised brightness problems of many observations at once, and their quadratic programmes, as torch tensors.

It is the batched counterpart of `ninedtact.force.traction.linearisation_and_qp`: problems of different size are padded with
unknowns that have no effect.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import torch
from jaxtyping import Bool, Float32, Float64, Int

from ninedtact.force.traction import linearisation_and_qp as qp
from ninedtact.force.traction.traction_from_brightness import LEVEL_STD
from ninedtact_train.batched.contact_cells import Numbers, Views

_EXCHANGES = 6
"""Largest number of exchanges of bounded unknowns in each iteration; the inversion of one image takes one to five. Unknowns that
are then still on the wrong side are exchanged in the next iteration."""

SkinFields = Float32[torch.Tensor, "batch skin_rows skin_cols"]
Tractions = Float32[torch.Tensor, "batch 3 cell_rows cell_cols"]


@dataclass(frozen=True)
class BatchedWhitener:
    """`linearisation_and_qp.Whitener` of each observation."""

    per_error: Views

    def whiten(self, residual: Views) -> Float32[torch.Tensor, "batch cells"]:
        """Return residuals over their errors, less what is common to all cells as far as the level's error allows."""
        weighted, common = (residual * self.per_error).flatten(1), self._common
        return weighted - common * ((common * weighted).sum(1, keepdim=True) * self._level_gain)

    def gram(self, columns: Float32[torch.Tensor, "batch n cells"]) -> Float32[torch.Tensor, "batch n n"]:
        """Return the products of fields that are divided by their errors already, less what is common to all cells."""
        common = columns @ self._common[..., None]
        return torch.baddbmm(columns @ columns.mT, common * self._level_gain[..., None], common.mT, alpha=-1)

    def squared_norm(self, residual: Views) -> Numbers:
        """Return the squared norm of the residuals in the covariance of noise, calibration and level."""
        return (self.whiten(residual) * (residual * self.per_error).flatten(1)).sum(1)

    @cached_property
    def _common(self) -> Float32[torch.Tensor, "batch cells"]:
        return LEVEL_STD * self.per_error.flatten(1)

    @cached_property
    def _level_gain(self) -> Float32[torch.Tensor, "batch 1"]:
        return 1 / (1 + self._common.square().sum(1, keepdim=True))


@dataclass(frozen=True)
class BatchedProblem:
    """`LinearisedBrightnessProblem` of each observation."""

    index: Int[torch.Tensor, "batch n"]
    """The cells of the contact region, row after row, then cells outside it up to the size of the batch."""
    used: Float32[torch.Tensor, "batch n"]
    """One on the cells of the contact region, zero on the others."""
    carried_shear: Float32[torch.Tensor, "batch n modes"]
    jacobian: Float32[torch.Tensor, "batch unknowns cells"]
    curvature: Float64[torch.Tensor, "batch unknowns unknowns"]
    slope: SkinFields
    whitener: BatchedWhitener
    sticking_part: Numbers

    def negative_gradient(self, residual: Views) -> Float64[torch.Tensor, "batch unknowns"]:
        """Return the negative gradient of half the squared norm of the residuals, by each unknown."""
        return (self.jacobian @ self.whitener.whiten(residual)[..., None])[..., 0].double()

    def tractions(self, unknowns: Float64[torch.Tensor, "batch unknowns"], shape: tuple[int, int]) -> Tractions:
        """Return pressure and shear on the view."""
        x = unknowns.float()
        count, modes = self.carried_shear.shape[1:]
        pressure = x[:, :count] * self.used
        shear = x[:, count:].view(-1, 2, modes) @ self.carried_shear.mT
        values = torch.cat([pressure[:, None], shear], 1)
        tractions = values.new_zeros(len(x), 3, shape[0] * shape[1])
        return tractions.scatter_(2, self.index[:, None].expand_as(values), values).view(-1, 3, *shape)


@dataclass(frozen=True)
class BatchedQPSolution:
    """`QPSolution` of each observation."""

    x: Float64[torch.Tensor, "batch unknowns"]
    free: Bool[torch.Tensor, "batch unknowns"]
    factor: Float64[torch.Tensor, "batch unknowns unknowns"]
    wrong: Bool[torch.Tensor, "batch unknowns"]
    """The unknowns on the wrong side of their bound."""
    is_factored: Bool[torch.Tensor, " batch"]
    """Whether the curvature was positive definite; otherwise nothing was solved."""

    @property
    def converged(self) -> Bool[torch.Tensor, " batch"]:
        """Whether the curvature was positive definite and no unknown is on the wrong side of its bound."""
        return self.is_factored & ~self.wrong.any(1)

    def whiten_rows(
        self, rows: Float64[torch.Tensor, "batch rows unknowns"]
    ) -> Float64[torch.Tensor, "batch rows unknowns"]:
        """Return linear forms of the unknowns so that their products are their covariances."""
        columns = (rows * self.free[:, None]).mT
        return torch.linalg.solve_triangular(self.factor, columns, upper=False).mT


def solve_nonnegative_qps(
    curvature: Float64[torch.Tensor, "batch n n"],
    target: Float64[torch.Tensor, "batch n"],
    free: Bool[torch.Tensor, "batch n"],
    bounded: int,
    stop_early: bool,
) -> BatchedQPSolution:
    """Return the minimum of ½ xᵀHx − bᵀx where the first `bounded` unknowns are not negative (`solve_nonnegative_qp`).

    stop_early: whether to wait after every exchange for the device, to end when none of the batch needs another.
    """
    root = curvature.diagonal(0, 1, 2).sqrt()
    is_bounded = torch.arange(free.shape[1], device=free.device) < bounded
    solution = _solve_free(curvature, target, free, root, is_bounded)
    for _ in range(_EXCHANGES - 1):
        if stop_early and not solution.wrong.any():
            break
        solution = _solve_free(curvature, target, solution.free ^ solution.wrong, root, is_bounded)
    return replace(solution, x=torch.where(is_bounded, solution.x.clamp(min=0), solution.x))


def _solve_free(
    curvature: torch.Tensor, target: torch.Tensor, free: torch.Tensor, root: torch.Tensor, is_bounded: torch.Tensor
) -> BatchedQPSolution:
    """Return the minimum over the free unknowns, the others being zero, and which unknowns are on the wrong side."""
    held = (~free).to(curvature.dtype)
    part = curvature * (1 - held)[:, :, None] * (1 - held)[:, None, :]
    part.diagonal(0, 1, 2).add_(held)
    factor, failed_at = torch.linalg.cholesky_ex(part)
    x = torch.cholesky_solve((target * free)[..., None], factor)[..., 0]
    gradient = target - (curvature @ x[..., None])[..., 0]
    rising = ~free & (gradient > qp.WRONG_SIDE_STDS * root)
    negative = free & is_bounded & (x * root < -qp.WRONG_SIDE_STDS)
    return BatchedQPSolution(x, free, factor, rising | negative, failed_at == 0)
