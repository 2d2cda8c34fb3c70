"""Networks that output a wrench in N and N·m: the shipped `moments` network, and `WrenchNetwork`, which wraps any architecture.

The `moments` network predicts a force and a torque for every cell of a coarse map and sums them: T = Σ (torque of the cell + arm ×
force of the cell), with the arm from the skin's centre to the cell's. Convolutions are translation-invariant, so the same contact
elsewhere gives the same force, and the change of its torque is computed exactly instead of learnt. Strided convolutions have
kernels of even size, so that the cells lie symmetric about the centre. The blocks are plain residual blocks (He 2016,
docs/references.md): separable ones with as many weights and kernels of 5 × 5 run no faster and take 3.5 times as long to train on a
CPU.

`build_network` builds every architecture by name. `WrenchNetwork` converts its numbers, and the scales of their errors, to N and
N·m.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from ninedtact.errors import InputError
from ninedtact.force.network_input import NetworkInputSettings
from ninedtact.force.networks.standard_backbones import (
    DENSENET_LAYERS,
    RESNET_LAYERS,
    VIT_PATCH_PX,
    VisionTransformer,
    build_densenet,
    build_resnet,
)
from ninedtact.quantities import centred_axis_mm

HALVINGS = 2
"""Number of times that the image is halved: a cell of the coarse map is four pixels wide."""
FIRST, WIDTH = 24, 48
BLOCKS = 4
Layer = nn.Sequential


def convolution(before: int, after: int, kernel: int, stride: int = 1) -> Layer:
    """Return a convolution with batch normalisation, padded so that the image's centre stays in place."""
    padding = (kernel - stride + 1) // 2
    return Layer(nn.Conv2d(before, after, kernel, stride, padding, bias=False), nn.BatchNorm2d(after))


class MomentsBlock(nn.Module):
    """Residual block: two convolutions beside a shortcut."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.first, self.second = convolution(width, width, 3), convolution(width, width, 3)
        self.active = nn.Hardswish()

    def forward(self, x: Tensor) -> Tensor:
        """Return the block's output, which has the shape (n, width, h, w) of its input."""
        return self.active(x + self.second(self.active(self.first(x))))


class Moments(nn.Module):
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
        self.features = Layer(*halve, *(MomentsBlock(WIDTH) for _ in range(blocks)))
        self.cells = nn.Conv2d(WIDTH, 6, 1)
        for weights in self.cells.parameters():
            nn.init.zeros_(weights)  # the initial output would otherwise be the sum of hundreds of random cells
        self.moments = Moments(settings, unit)
        self.spread = spread(2 * WIDTH + 3 * channels, outputs - 6) if outputs > 6 else None

    def forward(self, x: Tensor) -> Tensor:
        """Return the outputs (n, outputs) for images (n, channels, rows, cols)."""
        found = self.features(x)
        wrench = self.moments(self.cells(found))
        if self.spread is None:
            return wrench
        seen = [found.mean((2, 3)), found.amax((2, 3)), x.mean((2, 3)), x.amax((2, 3)), x.amin((2, 3))]
        return torch.cat([wrench, self.spread(torch.cat(seen, 1)).float()], 1)


def spread(before: int, after: int) -> Layer:
    """Return the layers that predict the logarithms of the scales from statistics of the whole image."""
    return Layer(nn.Linear(before, WIDTH), nn.Hardswish(), nn.Linear(WIDTH, after))


NETWORK_NAMES = ("moments", *DENSENET_LAYERS, *RESNET_LAYERS, "vit")
SMALLEST_PX = 32
"""Smallest side of an image for architectures that halve it five times."""


class NetworkUnknown(InputError):
    """No network has this name, or the network cannot take images of this size."""


def build_network(name: str, settings: NetworkInputSettings, outputs: int, unit: tuple[float, ...]) -> nn.Module:
    """Return a network with random weights from (n, channels, rows, cols) to (n, outputs); raises `NetworkUnknown`.

    outputs: 6, or 12 with the logarithms of scales. unit: the unit of each of the six numbers, N and N·m.
    """
    require_network_input_size(name, settings)
    channels = settings.channels.number
    if name in DENSENET_LAYERS:
        return build_densenet(name, channels, outputs)
    if name in RESNET_LAYERS:
        return build_resnet(name, channels, outputs)
    if name == "vit":
        return VisionTransformer(channels, outputs)
    return MomentsNetwork(settings, outputs, unit)


def require_network_input_size(name: str, settings: NetworkInputSettings) -> None:
    """Raise `NetworkUnknown` for an unknown name, or an image size that the network cannot take."""
    if name not in NETWORK_NAMES:
        raise NetworkUnknown(f"expected one of {', '.join(NETWORK_NAMES)}, got {name!r}; name one of them")
    rows, cols = settings.rows, settings.cols
    if name == "moments" and (rows % 4 or cols % 4):
        raise NetworkUnknown(f"expected sides that are multiples of 4 for moments, got {cols} x {rows}; take 80 x 60")
    smallest = {"moments": 4, "vit": VIT_PATCH_PX}.get(name, SMALLEST_PX)
    if min(rows, cols) < smallest:
        raise NetworkUnknown(
            f"expected at least {smallest} x {smallest} pixels for {name}, got {cols} x {rows}; take larger images"
        )


SMALLEST_LOG, LARGEST_LOG = -8.0, 5.0
"""Limits of the logarithm of a predicted scale, in units of the labels' scale."""


@dataclass(frozen=True)
class LabelScale:
    """Unit and offset of a network's six numbers: wrench = number · unit + offset."""

    unit: tuple[float, ...]
    offset: tuple[float, ...]


class WrenchNetwork(nn.Module):
    """A network of any architecture with its output in N and N·m, and optionally the scale of its Laplace distribution."""

    def __init__(self, name: str, settings: NetworkInputSettings, labels: LabelScale, with_scale: bool = True) -> None:
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
        """The returned scale is gain · scale^power in units of the labels, from held-out images (`error_scale_and_model_card`)."""

    def forward(self, x: Tensor) -> tuple[Tensor, ...]:
        """Return the wrench (n, 6) for images (n, channels, rows, cols) and, for networks with a scale, that scale (n, 6)."""
        numbers = self.network(x).float()
        wrench = numbers[:, :6] * self.unit + self.offset
        if numbers.shape[1] == 6:
            return (wrench,)
        log_scale = numbers[:, 6:].clamp(SMALLEST_LOG, LARGEST_LOG)
        return wrench, self.unit * self.gain * torch.exp(self.power * log_scale)
