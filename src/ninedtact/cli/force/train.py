"""ninedtact train: a data set → a force model in one file."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import tyro

from ninedtact.cli.force.training_data import Division, HeldOut, TrainingData, designed_width_mm
from ninedtact.cli.terminal import print_result
from ninedtact.errors import NinedtactError

if TYPE_CHECKING:
    from ninedtact.force.training.settings import ComputeSettings, TrainingSettings
    from ninedtact.force.training.train import TrainingResult

Shown = Literal["heights", "heights_and_gel", "heights_and_sensor", "deformation", "mixed"]
Precision = Literal["32-true", "bf16-mixed", "16-mixed"]
LIBRARIES = ("torch", "lightning", "onnx", "onnxscript", "onnxruntime", "tensorboard", "pyarrow")


class TrainingNeeds(NinedtactError):
    """A library that training stands on is not there."""


@dataclass(frozen=True)
class Hardware:
    """Lightning's own flags."""

    accelerator: str = "auto"
    """cpu, gpu, auto …"""
    devices: str = "1"
    """How many, or which: 2, auto, 0,3."""
    nodes: int = 1
    """Machines."""
    strategy: str = "auto"
    """ddp and so on, where there are several."""
    precision: Precision = "32-true"
    """bf16-mixed is quicker on a GPU."""
    workers: int = 0
    """Processes that gather examples while others are learnt."""

    def machine(self) -> "ComputeSettings":
        """The same as training names it."""
        from ninedtact.force.training.settings import ComputeSettings

        devices = int(self.devices) if self.devices.isdigit() else self.devices
        return ComputeSettings(self.accelerator, devices, self.nodes, self.strategy, self.precision, self.workers)


@dataclass(frozen=True)
class Train:
    """Train a force model. Run again after a stop, it goes on after the last whole epoch."""

    data: Path
    """Data set that `ninedtact dataset build` or `ninedtact simulate dataset` made."""
    out: Path
    """Folder for the model, curves, logs and checkpoints: new, empty, or begun with the same options."""
    preset: Literal["default", "paper"] = "default"
    """default: a small network on heights; paper: DenseNet-169 on whole images, as published. The options below change it."""
    sensors: Path | None = None
    """Folder with a sensor folder for each sensor of the data, by name: heights are read by these. Twins make their own."""
    network: str | None = None
    """moments, densenet121, 161, 169 or 201, resnet18 or 50, vit."""
    channels: Shown | None = None
    """What the network is shown."""
    size: tuple[int, int] | None = None
    """Columns and rows of it."""
    epochs: int | None = None
    """How often all pairs are learnt."""
    batch: int | None = None
    """How many pairs a step learns from."""
    learning_rate: float | None = None
    """The highest, where the preset varies it."""
    seed: int = 0
    """Of the first weights, of the order, of what is changed by chance and of what is held out."""
    held_out: HeldOut | None = None
    """What the kept epoch is best on: sensors and objects that are not learnt; objects alone where there is one sensor."""
    held_out_part: float = 0.1
    """Of the objects, of the sensors or of the pairs."""
    split: Path | None = None
    """Split file; its part to test is neither learnt from nor looked at."""
    name: str = "network"
    """What the model is called."""
    licence: str = "MIT"
    """Of the model."""
    reading_workers: int = 1
    """Processes that read images into heights."""
    hardware: tyro.conf.OmitArgPrefixes[Hardware] = Hardware()
    json: bool = False
    """Print the figures as one JSON object."""

    def run(self) -> int:
        """Train, and say how good it is on what was held out."""
        require_libraries()
        trained = self.trained()
        return 0 if trained is None else print_result(self.json, figures(trained), lines(trained))

    def trained(self) -> "TrainingResult | None":
        """The model; None on all processes but the first."""
        from ninedtact.force.training.train import train_network

        settings, progress = self.settings, not self.json
        data = TrainingData(self.data, settings.input, self.sensors, self.reading_workers, progress)
        examples, ids = data.read()
        rows = Division(self.held_out, self.held_out_part, self.split, self.seed).rows(ids, examples)
        return train_network(
            examples,
            rows,
            settings,
            self.out,
            name=self.name,
            licence=self.licence,
            machine=self.hardware.machine(),
            progress=progress,
        )

    @property
    def settings(self) -> "TrainingSettings":
        """The preset with what was asked for otherwise, on skin as wide as that of the data's twins.

        Raises `TrainingImpossible`, `NetworkUnknown`.
        """
        from ninedtact.force.network_input import InputChannels, resize_network_input, scale_network_input_width
        from ninedtact.force.training.settings import TRAINING_PRESETS

        preset = TRAINING_PRESETS[self.preset]
        shown = (
            preset.input
            if self.channels is None
            else replace(preset.input, channels=InputChannels[self.channels.upper()])
        )
        grid = shown if self.size is None else resize_network_input(shown, self.size)
        if (width_mm := designed_width_mm(self.data)) is not None:
            grid = scale_network_input_width(grid, width_mm)
        asked = {
            name: getattr(self, name)
            for name in ("network", "epochs", "batch", "learning_rate")
            if getattr(self, name) is not None
        }
        return replace(preset, input=grid, seed=self.seed, **asked)


def require_libraries() -> None:
    """Refuse before work begins; raises `TrainingNeeds`."""
    from importlib.util import find_spec

    missing = [name for name in LIBRARIES if find_spec(name) is None]
    if missing:
        raise TrainingNeeds(
            f"expected {', '.join(LIBRARIES)}, got none of {', '.join(missing)}; pip install 'ninedtact[train,datasets]'"
        )


def figures(trained: "TrainingResult") -> dict[str, Any]:
    """For a script."""
    training = trained.model.card.training
    return {
        "model": str(trained.path),
        "epochs": training.epochs,
        "best_epoch": training.best_epoch,
        "seconds": training.seconds,
        "pairs": training.pairs,
        "held_out": trained.evaluation.to_json_dict(),
    }


def lines(trained: "TrainingResult") -> Iterator[str]:
    """For a person."""
    from ninedtact.force.evaluation.report import format_evaluation_report as table

    training = trained.model.card.training
    yield (
        f"{trained.path}: {training.pairs} pairs of {training.sensors} sensors and {training.objects} objects, "
        f"{training.epochs} epochs in {training.seconds / 60:.1f} minutes, kept epoch {training.best_epoch}"
    )
    yield "on the pairs that were held out:"
    yield from table(trained.evaluation)
