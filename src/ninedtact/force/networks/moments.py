"""The small network that ships: a force and a torque from every cell of a coarse map, summed with exact arms.

Convolutions see the same everywhere, so the same touch elsewhere gives the same force; that its torque about the skin's
centre is another is arithmetic, not learnt: T = Σ (torque of the cell + arm × force of the cell), the arm from the skin's centre
to the cell's. Halvings are by kernels of even size, so that the cells lie symmetric about the centre. Blocks are plain
residuals (He 2016, docs/references.md): separable ones of as many weights, with kernels of 5 × 5, answer no sooner and take
3.5 times as long to train on a processor.
"""

import torch
from torch import Tensor, nn

from ninedtact.force.inputs import InputSettings
from ninedtact.quantities import centred_axis_mm

HALVINGS = 2
"""A cell is four pixels wide."""
FIRST, WIDTH = 24, 48
BLOCKS = 4
Layer = nn.Sequential


def convolution(before: int, after: int, kernel: int, stride: int = 1) -> Layer:
    """Convolution and normalisation; the padding keeps the image's centre where it is."""
    padding = (kernel - stride + 1) // 2
    return Layer(nn.Conv2d(before, after, kernel, stride, padding, bias=False), nn.BatchNorm2d(after))


class Block(nn.Module):
    """Two convolutions beside a shortcut."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.first, self.second = convolution(width, width, 3), convolution(width, width, 3)
        self.active = nn.Hardswish()

    def forward(self, x: Tensor) -> Tensor:
        """(n, width, h, w), the same shape again."""
        return self.active(x + self.second(self.active(self.first(x))))


class Moments(nn.Module):
    """Forces and torques of cells → their sum about the skin's centre, all in units of the labels' scale."""

    def __init__(self, settings: InputSettings, unit: tuple[float, ...]) -> None:
        super().__init__()
        cell_mm, shrink = settings.mm_per_px * 2**HALVINGS, 2**HALVINGS
        x, y = (
            torch.from_numpy(centred_axis_mm(side // shrink, cell_mm) / 1e3) for side in (settings.cols, settings.rows)
        )
        self.register_buffer("x_m", x[None, :], persistent=False)
        self.register_buffer("y_m", y[:, None], persistent=False)
        self.register_buffer("unit", torch.tensor(unit, dtype=torch.float32))
        self.x_m: Tensor
        self.y_m: Tensor
        self.unit: Tensor

    def forward(self, cells: Tensor) -> Tensor:
        """(n, 6, rows, cols) → (n, 6)."""
        unit = self.unit[:, None, None]
        fx, fy, fz, tx, ty, tz = (cells.float() * unit).unbind(1)
        x, y = self.x_m, self.y_m
        parts = torch.stack([fx, fy, fz, tx + y * fz, ty - x * fz, tz + x * fy - y * fx], 1)
        return parts.sum((2, 3)) / self.unit


class MomentsNetwork(nn.Module):
    """Images of one size → six numbers, or twelve with the logarithms of their scales."""

    def __init__(self, settings: InputSettings, outputs: int, unit: tuple[float, ...], blocks: int = BLOCKS) -> None:
        super().__init__()
        channels = settings.channels.number
        halve = (
            Layer(convolution(before, after, 4, 2), nn.Hardswish())
            for before, after in ((channels, FIRST), (FIRST, WIDTH))
        )
        self.features = Layer(*halve, *(Block(WIDTH) for _ in range(blocks)))
        self.cells = nn.Conv2d(WIDTH, 6, 1)
        for weights in self.cells.parameters():
            nn.init.zeros_(weights)  # so that the first answer is not the sum of hundreds of random cells
        self.moments = Moments(settings, unit)
        self.spread = spread(2 * WIDTH + 3 * channels, outputs - 6) if outputs > 6 else None

    def forward(self, x: Tensor) -> Tensor:
        """(n, channels, rows, cols) → (n, outputs)."""
        found = self.features(x)
        wrench = self.moments(self.cells(found))
        if self.spread is None:
            return wrench
        seen = [found.mean((2, 3)), found.amax((2, 3)), x.mean((2, 3)), x.amax((2, 3)), x.amin((2, 3))]
        return torch.cat([wrench, self.spread(torch.cat(seen, 1)).float()], 1)


def spread(before: int, after: int) -> Layer:
    """How sure the answer is, from what the whole image holds."""
    return Layer(nn.Linear(before, WIDTH), nn.Hardswish(), nn.Linear(WIDTH, after))
