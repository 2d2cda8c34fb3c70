"""Network architectures that estimate a wrench from an image: six numbers, or twelve with the logarithms of scales.

    moments                      this project's small network, whose torque arms are exact (`wrench_network.MomentsNetwork`)
    densenet121 … densenet201    DenseNet with torchvision's parameter names; the paper uses densenet169
    resnet18, resnet50, vit      the architectures that the paper compares with

The numbers are in units of the labels' scale; `WrenchNetwork` converts them to N and N·m.
"""

from ninedtact.force.networks.wrench_network import (
    NETWORK_NAMES,
    LabelScale,
    NetworkUnknown,
    WrenchNetwork,
    build_network,
)

__all__ = ["NETWORK_NAMES", "LabelScale", "NetworkUnknown", "WrenchNetwork", "build_network"]
