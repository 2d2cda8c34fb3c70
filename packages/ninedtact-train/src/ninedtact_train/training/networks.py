"""Network architectures that estimate a wrench from an image: six numbers, or twelve with the logarithms of scales.

    moments                      this project's small network, whose torque arms are exact (`MomentsNetwork`)
    densenet121 … densenet201    DenseNet (Huang 2017); the paper uses densenet169
    resnet18, resnet50, vit      ResNet (He 2016) and a small vision transformer (Dosovitskiy 2021), which the paper compares with

`build_network` builds every architecture by name, for any number of channels and outputs. The numbers are in units of the
labels' scale; `WrenchNetwork` converts them, and the scales of their errors, to N and N·m. DenseNet and ResNet have the
parameter names of torchvision, so that published weights load strictly. The vision transformer takes patches of 10 pixels and
averages all tokens. docs/references.md has the citations.

The `moments` network predicts a force and a torque for every cell of a coarse map and sums them: T = Σ (torque of the cell +
arm × force of the cell), with the arm from the skin's centre to the cell's. Convolutions are translation-invariant, so the same
contact elsewhere gives the same force, and the change of its torque is computed exactly instead of learnt. Strided convolutions
have kernels of even size, so that the cells lie symmetric about the centre. The blocks are plain residual blocks: separable
ones with as many weights and kernels of 5 × 5 run no faster and take 3.5 times as long to train on a CPU.
"""

from collections import OrderedDict
from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor, nn

from ninedtact.errors import InputError
from ninedtact.force.network_input import NetworkInputSettings
from ninedtact.quantities import centred_axis_mm

DENSENET_LAYERS = {
    "densenet121": (32, (6, 12, 24, 16), 64),
    "densenet161": (48, (6, 12, 36, 24), 96),
    "densenet169": (32, (6, 12, 32, 32), 64),
    "densenet201": (32, (6, 12, 48, 32), 64),
}
"""Growth rate, number of layers of each block, and channels after the first convolution."""
BOTTLENECK = 4


class DenseLayer(nn.Module):
    """A dense layer, which appends `growth` channels to its input."""

    def __init__(self, channels: int, growth: int) -> None:
        super().__init__()
        self.norm1 = nn.BatchNorm2d(channels)
        self.conv1 = nn.Conv2d(channels, BOTTLENECK * growth, 1, bias=False)
        self.norm2 = nn.BatchNorm2d(BOTTLENECK * growth)
        self.conv2 = nn.Conv2d(BOTTLENECK * growth, growth, 3, padding=1, bias=False)

    def forward(self, x: Tensor) -> Tensor:
        """Return the input (n, channels, h, w) with new channels appended, (n, channels + growth, h, w)."""
        narrow = self.conv1(torch.relu(self.norm1(x)))
        return torch.cat([x, self.conv2(torch.relu(self.norm2(narrow)))], dim=1)


def dense_block(channels: int, growth: int, layers: int) -> nn.Sequential:
    """Return a dense block, each layer of which takes the outputs of all layers before it."""
    names = (f"denselayer{number + 1}" for number in range(layers))
    return nn.Sequential(OrderedDict((name, DenseLayer(channels + n * growth, growth)) for n, name in enumerate(names)))


def _transition_layer(channels: int) -> nn.Sequential:
    """Return a transition layer, which halves the channels and the image's size."""
    parts = nn.BatchNorm2d(channels), nn.ReLU(), nn.Conv2d(channels, channels // 2, 1, bias=False), nn.AvgPool2d(2, 2)
    return nn.Sequential(OrderedDict(zip(("norm", "relu", "conv", "pool"), parts, strict=True)))


class DenseNet(nn.Module):
    """DenseNet from images of any size to `outputs` numbers."""

    def __init__(self, growth: int, blocks: tuple[int, ...], first: int, channels: int, outputs: int) -> None:
        super().__init__()
        parts: list[tuple[str, nn.Module]] = [
            ("conv0", nn.Conv2d(channels, first, 7, stride=2, padding=3, bias=False)),
            ("norm0", nn.BatchNorm2d(first)),
            ("relu0", nn.ReLU()),
            ("pool0", nn.MaxPool2d(3, stride=2, padding=1)),
        ]
        widths = list(dense_block_channels(growth, blocks, first))
        for number, (layers, (width, end)) in enumerate(zip(blocks, widths, strict=True), 1):
            parts.append((f"denseblock{number}", dense_block(width, growth, layers)))
            if number < len(blocks):
                parts.append((f"transition{number}", _transition_layer(end)))
        last = widths[-1][1]
        self.features = nn.Sequential(OrderedDict([*parts, ("norm5", nn.BatchNorm2d(last))]))
        self.classifier = nn.Linear(last, outputs)

    def forward(self, x: Tensor) -> Tensor:
        """Return the outputs (n, outputs) for images (n, channels, h, w)."""
        return self.classifier(torch.relu(self.features(x)).mean((2, 3)))


def dense_block_channels(growth: int, blocks: tuple[int, ...], first: int) -> list[tuple[int, int]]:
    """Return the numbers of channels before and after every dense block."""
    befores = [first]
    for layers in blocks:
        befores.append((befores[-1] + layers * growth) // 2)
    return [(before, 2 * after) for before, after in pairwise(befores)]


def build_densenet(name: str, channels: int, outputs: int) -> DenseNet:
    """Return the DenseNet of this name in `DENSENET_LAYERS`, with random weights."""
    growth, blocks, first = DENSENET_LAYERS[name]
    return DenseNet(growth, blocks, first, channels, outputs)


RESNET_LAYERS = {"resnet18": (2, 2, 2, 2), "resnet50": (3, 4, 6, 3)}
RESNET_WIDTHS = (64, 128, 256, 512)


class BasicBlock(nn.Module):
    """Basic residual block: two convolutions beside a shortcut."""

    expansion = 1

    def __init__(self, channels: int, width: int, stride: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(channels, width, 3, stride, 1, bias=False)
        self.bn1 = nn.BatchNorm2d(width)
        self.conv2 = nn.Conv2d(width, width, 3, 1, 1, bias=False)
        self.bn2 = nn.BatchNorm2d(width)
        self.downsample = shortcut(channels, width, stride)

    def forward(self, x: Tensor) -> Tensor:
        """Return the block's output (n, width, h/stride, w/stride) for an input (n, channels, h, w)."""
        y = self.bn1(self.conv1(x)).relu()
        y = self.bn2(self.conv2(y))
        return (y + (x if self.downsample is None else self.downsample(x))).relu()


class Bottleneck(nn.Module):
    """Bottleneck residual block: a convolution between a narrowing and a widening one, beside a shortcut."""

    expansion = 4

    def __init__(self, channels: int, width: int, stride: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(channels, width, 1, bias=False)
        self.bn1 = nn.BatchNorm2d(width)
        self.conv2 = nn.Conv2d(width, width, 3, stride, 1, bias=False)
        self.bn2 = nn.BatchNorm2d(width)
        self.conv3 = nn.Conv2d(width, 4 * width, 1, bias=False)
        self.bn3 = nn.BatchNorm2d(4 * width)
        self.downsample = shortcut(channels, 4 * width, stride)

    def forward(self, x: Tensor) -> Tensor:
        """Return the block's output (n, 4 width, h/stride, w/stride) for an input (n, channels, h, w)."""
        y = self.bn1(self.conv1(x)).relu()
        y = self.bn2(self.conv2(y)).relu()
        y = self.bn3(self.conv3(y))
        return (y + (x if self.downsample is None else self.downsample(x))).relu()


def shortcut(channels: int, width: int, stride: int) -> nn.Sequential | None:
    """Return the projection of a block's input to its output's size, None where the sizes are equal."""
    if stride == 1 and channels == width:
        return None
    return nn.Sequential(nn.Conv2d(channels, width, 1, stride, bias=False), nn.BatchNorm2d(width))


class ResNet(nn.Module):
    """ResNet from images of any size to `outputs` numbers."""

    def __init__(
        self, block: type[BasicBlock] | type[Bottleneck], layers: tuple[int, ...], channels: int, outputs: int
    ) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(channels, 64, 7, 2, 3, bias=False)
        self.bn1 = nn.BatchNorm2d(64)
        self.maxpool = nn.MaxPool2d(3, 2, 1)
        befores = 64, *(width * block.expansion for width in RESNET_WIDTHS)
        for number, (width, count) in enumerate(zip(RESNET_WIDTHS, layers, strict=True)):
            stride = 1 if number == 0 else 2
            first = block(befores[number], width, stride)
            others = (block(befores[number + 1], width, 1) for _ in range(count - 1))
            setattr(self, f"layer{number + 1}", nn.Sequential(first, *others))
        self.fc = nn.Linear(befores[-1], outputs)

    def forward(self, x: Tensor) -> Tensor:
        """Return the outputs (n, outputs) for images (n, channels, h, w)."""
        x = self.maxpool(self.bn1(self.conv1(x)).relu())
        for number in range(len(RESNET_WIDTHS)):
            x = getattr(self, f"layer{number + 1}")(x)
        return self.fc(x.mean((2, 3)))


def _build_resnet(name: str, channels: int, outputs: int) -> ResNet:
    """Return the ResNet of this name in `RESNET_LAYERS`, with random weights."""
    return ResNet(Bottleneck if name == "resnet50" else BasicBlock, RESNET_LAYERS[name], channels, outputs)


VIT_PATCH_PX = 10
VIT_WIDTH = 192
VIT_HEADS = 3
VIT_DEPTH = 8


class VisionTransformer(nn.Module):
    """Vision transformer from images of any size to `outputs` numbers; its sinusoidal position encoding depends on no size."""

    def __init__(self, channels: int, outputs: int) -> None:
        super().__init__()
        self.patches = nn.Conv2d(channels, VIT_WIDTH, VIT_PATCH_PX, VIT_PATCH_PX)
        layer = nn.TransformerEncoderLayer(
            VIT_WIDTH, VIT_HEADS, 4 * VIT_WIDTH, dropout=0.0, activation="gelu", batch_first=True, norm_first=True
        )
        self.encoder = nn.TransformerEncoder(layer, VIT_DEPTH, nn.LayerNorm(VIT_WIDTH), enable_nested_tensor=False)
        self.head = nn.Linear(VIT_WIDTH, outputs)

    def forward(self, x: Tensor) -> Tensor:
        """Return the outputs (n, outputs) for images (n, channels, h, w)."""
        tokens = self.patches(x)
        rows, cols = tokens.shape[-2:]
        tokens = tokens.flatten(2).transpose(1, 2) + sinusoidal_position_encoding(rows, cols).to(tokens)
        return self.head(self.encoder(tokens).mean(1))


def sinusoidal_position_encoding(rows: int, cols: int) -> Tensor:
    """Return the sines and cosines of every patch's row and column, (rows·cols, `VIT_WIDTH`)."""
    rates = 100.0 ** -torch.linspace(0, 1, VIT_WIDTH // 4)
    down, right = (torch.arange(side)[:, None] * rates for side in (rows, cols))
    of_row, of_col = (torch.cat([angle.sin(), angle.cos()], 1) for angle in (down, right))
    both = torch.cat([of_row[:, None].expand(-1, cols, -1), of_col[None].expand(rows, -1, -1)], 2)
    return both.reshape(rows * cols, VIT_WIDTH)


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
        return _build_resnet(name, channels, outputs)
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
