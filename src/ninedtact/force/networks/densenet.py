"""DenseNet (Huang 2017, docs/references.md) with the parameter names of torchvision, so that published weights load strictly."""

from collections import OrderedDict
from itertools import pairwise

import torch
from torch import Tensor, nn

LAYERS = {
    "densenet121": (32, (6, 12, 24, 16), 64),
    "densenet161": (48, (6, 12, 36, 24), 96),
    "densenet169": (32, (6, 12, 32, 32), 64),
    "densenet201": (32, (6, 12, 48, 32), 64),
}
"""Growth rate, layers of each block, and channels after the first convolution."""
BOTTLENECK = 4


class DenseLayer(nn.Module):
    """Adds `growth` channels to those that it is given."""

    def __init__(self, channels: int, growth: int) -> None:
        super().__init__()
        self.norm1 = nn.BatchNorm2d(channels)
        self.conv1 = nn.Conv2d(channels, BOTTLENECK * growth, 1, bias=False)
        self.norm2 = nn.BatchNorm2d(BOTTLENECK * growth)
        self.conv2 = nn.Conv2d(BOTTLENECK * growth, growth, 3, padding=1, bias=False)

    def forward(self, x: Tensor) -> Tensor:
        """(n, channels, h, w) → (n, channels + growth, h, w)."""
        narrow = self.conv1(torch.relu(self.norm1(x)))
        return torch.cat([x, self.conv2(torch.relu(self.norm2(narrow)))], dim=1)


def dense_block(channels: int, growth: int, layers: int) -> nn.Sequential:
    """Layers that each see all before them."""
    names = (f"denselayer{number + 1}" for number in range(layers))
    return nn.Sequential(OrderedDict((name, DenseLayer(channels + n * growth, growth)) for n, name in enumerate(names)))


def transition(channels: int) -> nn.Sequential:
    """Half the channels, half the size."""
    parts = nn.BatchNorm2d(channels), nn.ReLU(), nn.Conv2d(channels, channels // 2, 1, bias=False), nn.AvgPool2d(2, 2)
    return nn.Sequential(OrderedDict(zip(("norm", "relu", "conv", "pool"), parts, strict=True)))


class DenseNet(nn.Module):
    """Images of any size → `outputs` numbers."""

    def __init__(self, growth: int, blocks: tuple[int, ...], first: int, channels: int, outputs: int) -> None:
        super().__init__()
        parts: list[tuple[str, nn.Module]] = [
            ("conv0", nn.Conv2d(channels, first, 7, stride=2, padding=3, bias=False)),
            ("norm0", nn.BatchNorm2d(first)),
            ("relu0", nn.ReLU()),
            ("pool0", nn.MaxPool2d(3, stride=2, padding=1)),
        ]
        widths = list(widths_of(growth, blocks, first))
        for number, (layers, (width, end)) in enumerate(zip(blocks, widths, strict=True), 1):
            parts.append((f"denseblock{number}", dense_block(width, growth, layers)))
            if number < len(blocks):
                parts.append((f"transition{number}", transition(end)))
        last = widths[-1][1]
        self.features = nn.Sequential(OrderedDict([*parts, ("norm5", nn.BatchNorm2d(last))]))
        self.classifier = nn.Linear(last, outputs)

    def forward(self, x: Tensor) -> Tensor:
        """(n, channels, h, w) → (n, outputs)."""
        return self.classifier(torch.relu(self.features(x)).mean((2, 3)))


def widths_of(growth: int, blocks: tuple[int, ...], first: int) -> list[tuple[int, int]]:
    """Channels before and after every block."""
    befores = [first]
    for layers in blocks:
        befores.append((befores[-1] + layers * growth) // 2)
    return [(before, 2 * after) for before, after in pairwise(befores)]


def densenet(name: str, channels: int, outputs: int) -> DenseNet:
    """One of `LAYERS`, weights random."""
    growth, blocks, first = LAYERS[name]
    return DenseNet(growth, blocks, first, channels, outputs)
