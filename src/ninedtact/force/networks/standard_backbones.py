"""Published network architectures: DenseNet, ResNet and a small vision transformer, for any number of channels and outputs.

DenseNet (Huang 2017) and ResNet (He 2016) have the parameter names of torchvision, so that published weights load strictly. The
vision transformer (Dosovitskiy 2021) takes patches of 10 pixels and averages all tokens. docs/references.md has the citations.
"""

from collections import OrderedDict
from itertools import pairwise

import torch
from torch import Tensor, nn

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


def transition(channels: int) -> nn.Sequential:
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
                parts.append((f"transition{number}", transition(end)))
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


class Basic(nn.Module):
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
        self, block: type[Basic] | type[Bottleneck], layers: tuple[int, ...], channels: int, outputs: int
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


def build_resnet(name: str, channels: int, outputs: int) -> ResNet:
    """Return the ResNet of this name in `RESNET_LAYERS`, with random weights."""
    return ResNet(Bottleneck if name == "resnet50" else Basic, RESNET_LAYERS[name], channels, outputs)


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
