"""Settings of the hardware that a training runs on; they load no torch, so that the command line reads them quickly."""

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class ComputeSettings:
    """Lightning's flags for the hardware that a training runs on; they change its speed, not what is learnt."""

    accelerator: str = "auto"
    """cpu, gpu, auto …"""
    devices: int | str = 1
    """How many devices, or which: 2, auto, 0,3."""
    nodes: int = 1
    """Machines."""
    strategy: str = "auto"
    """Strategy for several devices, such as ddp."""
    precision: Literal["32-true", "bf16-mixed", "16-mixed"] = "32-true"
    """Numeric precision; bf16-mixed is faster on a GPU."""
    loader_workers: int = 0
    """Processes that load batches; 0: the training's own process."""
