"""ResNet (He 2016, docs/references.md) with the parameter names of torchvision."""

from torch import Tensor, nn

LAYERS = {"resnet18": (2, 2, 2, 2), "resnet50": (3, 4, 6, 3)}
WIDTHS = (64, 128, 256, 512)


class Basic(nn.Module):
    """Two convolutions beside a shortcut."""

    expansion = 1

    def __init__(self, channels: int, width: int, stride: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(channels, width, 3, stride, 1, bias=False)
        self.bn1 = nn.BatchNorm2d(width)
        self.conv2 = nn.Conv2d(width, width, 3, 1, 1, bias=False)
        self.bn2 = nn.BatchNorm2d(width)
        self.downsample = shortcut(channels, width, stride)

    def forward(self, x: Tensor) -> Tensor:
        """(n, channels, h, w) → (n, width, h/stride, w/stride)."""
        y = self.bn1(self.conv1(x)).relu()
        y = self.bn2(self.conv2(y))
        return (y + (x if self.downsample is None else self.downsample(x))).relu()


class Bottleneck(nn.Module):
    """A convolution between a narrowing and a widening one, beside a shortcut."""

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
        """(n, channels, h, w) → (n, 4 width, h/stride, w/stride)."""
        y = self.bn1(self.conv1(x)).relu()
        y = self.bn2(self.conv2(y)).relu()
        y = self.bn3(self.conv3(y))
        return (y + (x if self.downsample is None else self.downsample(x))).relu()


def shortcut(channels: int, width: int, stride: int) -> nn.Sequential | None:
    """What brings the input to the output's size; None where it has it."""
    if stride == 1 and channels == width:
        return None
    return nn.Sequential(nn.Conv2d(channels, width, 1, stride, bias=False), nn.BatchNorm2d(width))


class ResNet(nn.Module):
    """Images of any size → `outputs` numbers."""

    def __init__(
        self, block: type[Basic] | type[Bottleneck], layers: tuple[int, ...], channels: int, outputs: int
    ) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(channels, 64, 7, 2, 3, bias=False)
        self.bn1 = nn.BatchNorm2d(64)
        self.maxpool = nn.MaxPool2d(3, 2, 1)
        befores = 64, *(width * block.expansion for width in WIDTHS)
        for number, (width, count) in enumerate(zip(WIDTHS, layers, strict=True)):
            stride = 1 if number == 0 else 2
            first = block(befores[number], width, stride)
            others = (block(befores[number + 1], width, 1) for _ in range(count - 1))
            setattr(self, f"layer{number + 1}", nn.Sequential(first, *others))
        self.fc = nn.Linear(befores[-1], outputs)

    def forward(self, x: Tensor) -> Tensor:
        """(n, channels, h, w) → (n, outputs)."""
        x = self.maxpool(self.bn1(self.conv1(x)).relu())
        for number in range(len(WIDTHS)):
            x = getattr(self, f"layer{number + 1}")(x)
        return self.fc(x.mean((2, 3)))


def resnet(name: str, channels: int, outputs: int) -> ResNet:
    """One of `LAYERS`, weights random."""
    return ResNet(Bottleneck if name == "resnet50" else Basic, LAYERS[name], channels, outputs)
