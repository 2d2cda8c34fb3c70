"""Network architectures that estimate a wrench from an image: six numbers, or twelve with the logarithms of scales.

    moments                     this project's small network, whose torque arms are exact (`MomentsNetwork`)
    densenet121, densenet169    DenseNet (Huang 2017); the paper uses densenet169

`build_network` builds every architecture by name, for any number of channels and outputs. The numbers are in units of the
labels' scale; `WrenchNetwork` converts them, and the scales of their errors, to N and N·m. DenseNet has the parameter names of
torchvision, so that published weights load strictly. docs/references.md has the citations.

The `moments` network predicts a force and a torque for every cell of a coarse map and sums them: T = Σ (torque of the cell +
arm × force of the cell), with the arm from the skin's centre to the cell's. Convolutions are translation-invariant, so the same
contact elsewhere gives the same force, and the change of its torque is computed exactly instead of learnt. Strided convolutions
have kernels of even size, so that the cells lie symmetric about the centre. The blocks are plain residual blocks: separable
ones with as many weights and kernels of 5 × 5 run no faster and take 3.5 times as long to train on a CPU.
"""

from collections import OrderedDict
from collections.abc import Iterable
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from ninedtact.force.network_input import NetworkInputSettings
from ninedtact.quantities import centred_axis_mm
from ninedtact_train.training.settings import NetworkName

DENSENET_BLOCKS = {"densenet121": (6, 12, 24, 16), "densenet169": (6, 12, 32, 32)}
"""Number of layers of each dense block."""
GROWTH, STEM_CHANNELS, BOTTLENECK = 32, 64, 4


class DenseLayer(nn.Module):
    """A dense layer, which appends `GROWTH` channels to its input."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.norm1 = nn.BatchNorm2d(channels)
        self.conv1 = nn.Conv2d(channels, BOTTLENECK * GROWTH, 1, bias=False)
        self.norm2 = nn.BatchNorm2d(BOTTLENECK * GROWTH)
        self.conv2 = nn.Conv2d(BOTTLENECK * GROWTH, GROWTH, 3, padding=1, bias=False)

    def forward(self, x: Tensor) -> Tensor:
        """Return the input (n, channels, h, w) with new channels appended, (n, channels + `GROWTH`, h, w)."""
        narrow = self.conv1(torch.relu(self.norm1(x)))
        return torch.cat([x, self.conv2(torch.relu(self.norm2(narrow)))], dim=1)


class DenseNet(nn.Module):
    """DenseNet of this name in `DENSENET_BLOCKS`, from images of any size to `outputs` numbers, with random weights."""

    def __init__(self, name: str, channels: int, outputs: int) -> None:
        super().__init__()
        parts: dict[str, nn.Module] = {
            "conv0": nn.Conv2d(channels, STEM_CHANNELS, 7, stride=2, padding=3, bias=False),
            "norm0": nn.BatchNorm2d(STEM_CHANNELS),
            "relu0": nn.ReLU(),
            "pool0": nn.MaxPool2d(3, stride=2, padding=1),
        }
        width = STEM_CHANNELS
        for number, layers in enumerate(DENSENET_BLOCKS[name], start=1):
            if number > 1:
                halved = (
                    nn.BatchNorm2d(width),
                    nn.ReLU(),
                    nn.Conv2d(width, width // 2, 1, bias=False),
                    nn.AvgPool2d(2, 2),
                )
                parts[f"transition{number - 1}"] = _named(zip(("norm", "relu", "conv", "pool"), halved, strict=True))
                width //= 2
            dense = (DenseLayer(width + layer * GROWTH) for layer in range(layers))
            parts[f"denseblock{number}"] = _named((f"denselayer{n}", layer) for n, layer in enumerate(dense, start=1))
            width += layers * GROWTH
        self.features = _named([*parts.items(), ("norm5", nn.BatchNorm2d(width))])
        self.classifier = nn.Linear(width, outputs)

    def forward(self, x: Tensor) -> Tensor:
        """Return the outputs (n, outputs) for images (n, channels, h, w)."""
        return self.classifier(torch.relu(self.features(x)).mean((2, 3)))


def _named(parts: Iterable[tuple[str, nn.Module]]) -> nn.Sequential:
    return nn.Sequential(OrderedDict(parts))


HALVINGS = 2
"""Number of times that the image is halved: a cell of the coarse map is four pixels wide."""
FIRST, WIDTH = 24, 48
BLOCKS = 4
Layer = nn.Sequential


def convolution(before: int, after: int, kernel: int, stride: int = 1) -> Layer:
    """Return a convolution with batch normalisation, padded so that the image's centre stays in place."""
    padding = (kernel - stride + 1) // 2
    return Layer(nn.Conv2d(before, after, kernel, stride, padding, bias=False), nn.BatchNorm2d(after))


class MomentsResidualBlock(nn.Module):
    """Residual block: two convolutions beside a shortcut."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.first, self.second = convolution(width, width, 3), convolution(width, width, 3)
        self.active = nn.Hardswish()

    def forward(self, x: Tensor) -> Tensor:
        """Return the block's output, which has the shape (n, width, h, w) of its input."""
        return self.active(x + self.second(self.active(self.first(x))))


class CellWrenchSum(nn.Module):
    """Sums forces and torques of cells about the skin's centre; all are in units of the labels' scale."""

    def __init__(self, settings: NetworkInputSettings, unit: tuple[float, ...]) -> None:
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
        """Return the total wrench (n, 6) of the cells' wrenches (n, 6, rows, cols)."""
        unit = self.unit[:, None, None]
        fx, fy, fz, tx, ty, tz = (cells.float() * unit).unbind(1)
        x, y = self.x_m, self.y_m
        parts = torch.stack([fx, fy, fz, tx + y * fz, ty - x * fz, tz + x * fy - y * fx], 1)
        return parts.sum((2, 3)) / self.unit


class MomentsNetwork(nn.Module):
    """The `moments` network, from images of one size to six numbers, or twelve with the logarithms of their scales."""

    def __init__(
        self, settings: NetworkInputSettings, outputs: int, unit: tuple[float, ...], blocks: int = BLOCKS
    ) -> None:
        super().__init__()
        channels = settings.channels.number
        halve = (
            Layer(convolution(before, after, 4, 2), nn.Hardswish())
            for before, after in ((channels, FIRST), (FIRST, WIDTH))
        )
        self.features = Layer(*halve, *(MomentsResidualBlock(WIDTH) for _ in range(blocks)))
        self.cells = nn.Conv2d(WIDTH, 6, 1)
        for weights in self.cells.parameters():
            nn.init.zeros_(weights)  # the initial output would otherwise be the sum of hundreds of random cells
        self.moments = CellWrenchSum(settings, unit)
        self.spread = error_scale_head(2 * WIDTH + 3 * channels, outputs - 6) if outputs > 6 else None

    def forward(self, x: Tensor) -> Tensor:
        """Return the outputs (n, outputs) for images (n, channels, rows, cols)."""
        found = self.features(x)
        wrench = self.moments(self.cells(found))
        if self.spread is None:
            return wrench
        seen = [found.mean((2, 3)), found.amax((2, 3)), x.mean((2, 3)), x.amax((2, 3)), x.amin((2, 3))]
        return torch.cat([wrench, self.spread(torch.cat(seen, 1)).float()], 1)


def error_scale_head(before: int, after: int) -> Layer:
    """Return the layers that predict the logarithms of the scales from statistics of the whole image."""
    return Layer(nn.Linear(before, WIDTH), nn.Hardswish(), nn.Linear(WIDTH, after))


def build_network(
    name: NetworkName, settings: NetworkInputSettings, outputs: int, unit: tuple[float, ...]
) -> nn.Module:
    """Return a network with random weights from (n, channels, rows, cols) to (n, outputs).

    outputs: 6, or 12 with the logarithms of scales. unit: the unit of each of the six numbers, N and N·m.
    """
    if name == "moments":
        return MomentsNetwork(settings, outputs, unit)
    return DenseNet(name, settings.channels.number, outputs)


SMALLEST_LOG, LARGEST_LOG = -8.0, 5.0
"""Limits of the logarithm of a predicted scale, in units of the labels' scale."""


@dataclass(frozen=True)
class LabelScale:
    """Unit and offset of a network's six numbers: wrench = number · unit + offset."""

    unit: tuple[float, ...]
    offset: tuple[float, ...]


class WrenchNetwork(nn.Module):
    """A network of any architecture with its output in N and N·m, and optionally the scale of its Laplace distribution."""

    def __init__(
        self, name: NetworkName, settings: NetworkInputSettings, labels: LabelScale, with_scale: bool = True
    ) -> None:
        super().__init__()
        self.network = build_network(name, settings, 12 if with_scale else 6, labels.unit)
        for part in ("unit", "offset"):
            self.register_buffer(part, torch.tensor(getattr(labels, part), dtype=torch.float32))
        self.register_buffer("gain", torch.ones(6))
        self.register_buffer("power", torch.ones(6))
        self.unit: Tensor
        self.offset: Tensor
        self.gain: Tensor
        self.power: Tensor
        """The returned scale is gain · scale^power in units of the labels, from held-out images (`trained_network`)."""

    def forward(self, x: Tensor) -> tuple[Tensor, ...]:
        """Return the wrench (n, 6) for images (n, channels, rows, cols) and, for networks with a scale, that scale (n, 6)."""
        numbers = self.network(x).float()
        wrench = numbers[:, :6] * self.unit + self.offset
        if numbers.shape[1] == 6:
            return (wrench,)
        log_scale = numbers[:, 6:].clamp(SMALLEST_LOG, LARGEST_LOG)
        return wrench, self.unit * self.gain * torch.exp(self.power * log_scale)
