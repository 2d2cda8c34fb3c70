"""A network's numbers as a wrench in N and N·m, with the scale of its error."""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from ninedtact.force.inputs import InputSettings
from ninedtact.force.networks.named import network

SMALLEST_LOG, LARGEST_LOG = -8.0, 5.0
"""Of a scale in units of the labels' scale: no image is surer or less sure than that."""


@dataclass(frozen=True)
class Labels:
    """What a network's six numbers are counted in: wrench = number · unit + offset."""

    unit: tuple[float, ...]
    offset: tuple[float, ...]


class WrenchNetwork(nn.Module):
    """(n, channels, rows, cols) → the wrench (n, 6) and, from networks with a scale, that of its Laplace distribution (n, 6)."""

    def __init__(self, name: str, settings: InputSettings, labels: Labels, with_scale: bool = True) -> None:
        super().__init__()
        self.network = network(name, settings, 12 if with_scale else 6, labels.unit)
        for part in ("unit", "offset"):
            self.register_buffer(part, torch.tensor(getattr(labels, part), dtype=torch.float32))
        self.register_buffer("gain", torch.ones(6))
        self.register_buffer("power", torch.ones(6))
        self.unit: Tensor
        self.offset: Tensor
        self.gain: Tensor
        self.power: Tensor
        """The scale that is told is gain · scale^power, in units: as held-out images showed (`training.intervals`)."""

    def forward(self, x: Tensor) -> tuple[Tensor, ...]:
        """N and N·m."""
        numbers = self.network(x).float()
        wrench = numbers[:, :6] * self.unit + self.offset
        if numbers.shape[1] == 6:
            return (wrench,)
        log_scale = numbers[:, 6:].clamp(SMALLEST_LOG, LARGEST_LOG)
        return wrench, self.unit * self.gain * torch.exp(self.power * log_scale)
