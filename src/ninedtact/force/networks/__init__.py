"""Networks of force, by name: an image of any kind → six numbers, or six and the logarithms of their scales.

    moments                      ours: small, and exact about places (`moments.py`)
    densenet121 … densenet201    the paper's is 169; names of parameters are torchvision's
    resnet18, resnet50, vit      what the paper compares with

Numbers are in units of the labels' scale; `wrench.WrenchNetwork` turns them into N and N·m.
"""

from ninedtact.force.networks.wrench_network import (
    NETWORK_NAMES,
    LabelScale,
    NetworkUnknown,
    WrenchNetwork,
    build_network,
)

__all__ = ["NETWORK_NAMES", "LabelScale", "NetworkUnknown", "WrenchNetwork", "build_network"]
