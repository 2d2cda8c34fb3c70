"""The one place that knows all networks."""

from torch import nn

from ninedtact.errors import NinedtactError
from ninedtact.force.inputs import InputSettings
from ninedtact.force.networks import densenet, resnet
from ninedtact.force.networks.moments import MomentsNetwork
from ninedtact.force.networks.vit import PATCH_PX, VisionTransformer

NAMES = ("moments", *densenet.LAYERS, *resnet.LAYERS, "vit")
SMALLEST_PX = 32
"""Sides of an image that is halved five times."""


class NetworkUnknown(NinedtactError):
    """A name that no network has, or an image that it cannot take."""


def network(name: str, settings: InputSettings, outputs: int, unit: tuple[float, ...]) -> nn.Module:
    """A network with random weights, (n, channels, rows, cols) → (n, outputs); raises `NetworkUnknown`.

    outputs: 6, or 12 with the logarithms of scales. unit: of each of the six, N and N·m.
    """
    require_size(name, settings)
    channels = settings.channels.number
    if name in densenet.LAYERS:
        return densenet.densenet(name, channels, outputs)
    if name in resnet.LAYERS:
        return resnet.resnet(name, channels, outputs)
    if name == "vit":
        return VisionTransformer(channels, outputs)
    return MomentsNetwork(settings, outputs, unit)


def require_size(name: str, settings: InputSettings) -> None:
    """Refuse what a network cannot take."""
    if name not in NAMES:
        raise NetworkUnknown(f"expected one of {', '.join(NAMES)}, got {name!r}; name one of them")
    rows, cols = settings.rows, settings.cols
    if name == "moments" and (rows % 4 or cols % 4):
        raise NetworkUnknown(f"expected sides that are multiples of 4 for moments, got {cols} x {rows}; take 80 x 60")
    smallest = {"moments": 4, "vit": PATCH_PX}.get(name, SMALLEST_PX)
    if min(rows, cols) < smallest:
        raise NetworkUnknown(
            f"expected at least {smallest} x {smallest} pixels for {name}, got {cols} x {rows}; take larger images"
        )
