"""Mirrored, turned, shifted and scaled: images and wrenches alike.

A point X of the skin goes to scale·R·M·X + t: M mirrors, R turns about the skin's centre, t shifts. A force goes to R·M·F; a torque
turns as a force does and changes its sign with every mirror, for it is an axial vector; a shifted force has another arm,
T + t × F. The scale is an error of the calibration: the image alone has it.
"""

from dataclasses import dataclass, replace
from math import radians

import torch
import torch.nn.functional as nnf
from torch import Tensor

from ninedtact.force.training.batches import TouchBatch


@dataclass(frozen=True)
class Moves:
    """How far."""

    mirror: bool = True
    """Along x, along y, both or neither, as often."""
    moved_share: float = 0.5
    """Part of the images that are turned, shifted and scaled; the others stay sharp."""
    turn_most_deg: float = 10.0
    shift_most_mm: float = 0.6
    scale: float = 0.005
    """Standard deviation."""

    def __call__(self, batch: TouchBatch, mm_per_px: float, generator: torch.Generator) -> TouchBatch:
        """Every image by its own move."""
        return moved(batch, self.drawn(len(batch.wrench), generator), mm_per_px)

    def drawn(self, n: int, generator: torch.Generator) -> "Move":
        """One move for each image."""
        device = generator.device

        def even(*shape: int) -> Tensor:
            return 2 * torch.rand(n, *shape, generator=generator, device=device) - 1

        chosen = (torch.rand(n, generator=generator, device=device) < self.moved_share).float()
        mirror = even(2).sign() if self.mirror else torch.ones(n, 2, device=device)
        turn = chosen * even() * radians(self.turn_most_deg)
        shift = chosen[:, None] * even(2) * self.shift_most_mm
        scale = 1 + chosen * self.scale * torch.randn(n, generator=generator, device=device)
        return Move(mirror, turn, shift, scale)


@dataclass(frozen=True)
class Move:
    """Of n images: signs (n, 2) along x and y, angles (n) from x to y, shifts (n, 2) in mm, scales (n)."""

    mirror: Tensor
    turn_rad: Tensor
    shift_mm: Tensor
    scale: Tensor

    @property
    def linear(self) -> Tensor:
        """R·M, (n, 2, 2)."""
        cos, sin = self.turn_rad.cos(), self.turn_rad.sin()
        turn = torch.stack([torch.stack([cos, -sin], 1), torch.stack([sin, cos], 1)], 1)
        return turn * self.mirror[:, None, :]


def moved(batch: TouchBatch, move: Move, mm_per_px: float) -> TouchBatch:
    """Images, references and wrenches after it."""
    grid = where_from(move, batch.images.shape, mm_per_px)
    references = None if batch.references is None else looked_up(batch.references, grid)
    return replace(
        batch,
        images=looked_up(batch.images, grid),
        references=references,
        wrench=wrench_after(move, batch.wrench),
    )


def wrench_after(move: Move, wrench: Tensor) -> Tensor:
    """(n, 6), N and N·m about the skin's centre."""
    sign = move.mirror.prod(1, keepdim=True)
    linear = move.linear
    force, torque = wrench[:, :3], wrench[:, 3:]
    f_plane = torch.einsum("nij,nj->ni", linear, force[:, :2])
    t_plane = sign * torch.einsum("nij,nj->ni", linear, torque[:, :2])
    force = torch.cat([f_plane, force[:, 2:]], 1)
    torque = torch.cat([t_plane, sign * torque[:, 2:]], 1)
    arm_m = nnf.pad(move.shift_mm, (0, 1)) / 1e3
    return torch.cat([force, torque + torch.linalg.cross(arm_m, force)], 1)


def where_from(move: Move, shape: torch.Size, mm_per_px: float) -> Tensor:
    """For every pixel of the moved images, the place in the old ones, as `grid_sample` counts: (n, rows, cols, 2)."""
    n, rows, cols = shape
    # From the centre to the centre of the last pixel.
    half_mm = torch.tensor([(cols - 1) / 2, (rows - 1) / 2], device=move.shift_mm.device) * mm_per_px
    back = torch.linalg.inv(move.linear * move.scale[:, None, None])
    start = -torch.einsum("nij,nj->ni", back, move.shift_mm)
    theta = torch.cat([back * half_mm / half_mm[:, None], (start / half_mm)[..., None]], 2)
    return nnf.affine_grid(theta, [n, 1, rows, cols], align_corners=True)


def looked_up(fields: Tensor, grid: Tensor) -> Tensor:
    """Fields (n, rows, cols) at those places; beyond the border they repeat."""
    found = nnf.grid_sample(fields[:, None], grid, mode="bicubic", padding_mode="border", align_corners=True)
    return found[:, 0]
