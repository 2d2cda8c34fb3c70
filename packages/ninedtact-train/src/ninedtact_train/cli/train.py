"""ninedtact train: a data set → a force model in one file."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, make_dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_type_hints

import tyro

from ninedtact.cli.result_and_interrupt import print_notice, print_result
from ninedtact.cli.shared_options import JsonOption
from ninedtact.force.network_input import InputChannels, resize_input_settings
from ninedtact.required_libraries import require_libraries
from ninedtact_train.dataset.split import HeldOutSettings
from ninedtact_train.training.settings import TRAINING_PRESETS, ComputeSettings, TrainingSettings

if TYPE_CHECKING:
    from ninedtact_train.training.train import TrainingResult

_REQUIRED_PACKAGES = ("torch", "lightning", "onnx", "onnxscript", "onnxruntime", "tensorboard", "pyarrow")


def _optional_fields(settings: type, names: Sequence[str]) -> list[tuple[str, Any, None]]:
    """Return fields of settings as options that are None where they are not given; their help is the description beside each."""
    hints = get_type_hints(settings, include_extras=True)
    help_texts = {name: next(meta.description for meta in hints[name].__metadata__) for name in names}
    return [(name, Annotated[hints[name] | None, tyro.conf.arg(help=text)], None) for name, text in help_texts.items()]


_CHANNELS = tuple(channels.name.lower() for channels in InputChannels)
_PresetChanges: Any = make_dataclass(
    "_PresetChanges",
    [
        *_optional_fields(TrainingSettings, ("network", "epochs", "batch", "learning_rate")),
        ("channels", Annotated[Literal[_CHANNELS] | None, tyro.conf.arg(help="Input channels of the network.")], None),
        ("size", Annotated[tuple[int, int] | None, tyro.conf.arg(help="Columns and rows of the input.")], None),
    ],
    frozen=True,
)
"""The options that change a preset."""


@dataclass(frozen=True)
class TrainCommand:
    """Train a force model on a data set. Run again after a stop, it continues after the last complete epoch."""

    data: Path
    """Data set that `ninedtact dataset build` or `ninedtact simulate dataset` made."""
    out: Path
    """Folder for the model, curves, logs and checkpoints: new, empty, or begun with the same options."""
    preset: Literal["default", "paper"] = "default"
    """default: a small network on heights. paper: DenseNet-169 on whole images, as published. Other options change the preset."""
    sensors: Path | None = None
    """Folder with a sensor folder for each sensor of the data, by name, for computing heights.
    By default the calibrations that the recordings of a data set carried are used, and simulated sensors are calibrated from their
    own simulated images."""
    changes: Annotated[_PresetChanges, tyro.conf.arg(name="")] = _PresetChanges()
    held_out: Annotated[HeldOutSettings, tyro.conf.arg(name="")] = HeldOutSettings()
    name: str = "network"
    """Name of the model."""
    licence: str = "MIT"
    """Licence of the model."""
    workers: int = 1
    """Number of processes; they compute heights from images."""
    compute: Annotated[ComputeSettings, tyro.conf.arg(name="")] = ComputeSettings()
    json: JsonOption = False

    def run(self) -> int:
        """Train, and print the scores on the held-out pairs."""
        require_training_packages()
        settings = self.settings()
        self._require_inputs(settings)  # at once: importing torch takes seconds
        from ninedtact_train.workflows.dataset_training import match_input_width_to_dataset, train_on_dataset

        trained = train_on_dataset(
            self.data,
            self.out,
            match_input_width_to_dataset(settings, self.data, self.sensors),
            self.held_out,
            sensors=self.sensors,
            workers=self.workers,
            name=self.name,
            licence=self.licence,
            machine=self.compute,
            progress=not self.json,
            notify=print_notice,
        )
        return (
            0
            if trained is None
            else print_result(self.json, _result_to_json(trained), _format_training_result(trained))
        )

    def _require_inputs(self, settings: TrainingSettings) -> None:
        """Raise `FileFormatError` without data, and `CalibrationError` where heights lack one."""
        from ninedtact_train.dataset.folder import find_pair_files
        from ninedtact_train.dataset.split import read_split
        from ninedtact_train.workflows.dataset_calibrations import require_sensor_calibrations

        if self.held_out.split is not None:
            read_split(self.held_out.split)
        find_pair_files(self.data)
        if settings.input.channels.of_heights:
            require_sensor_calibrations(self.data, self.sensors, ", or train on images: --channels deformation")

    def settings(self) -> TrainingSettings:
        """Return the preset with these options; raises `InputError`."""
        preset = TRAINING_PRESETS[self.preset]
        changes = {name: value for name, value in vars(self.changes).items() if value is not None}
        grid = preset.input
        if channels := changes.pop("channels", None):
            grid = replace(grid, channels=InputChannels[channels.upper()])
        if size := changes.pop("size", None):
            grid = resize_input_settings(grid, size)
        return replace(preset, input=grid, seed=self.held_out.seed, **changes)


def require_training_packages() -> None:
    """Raise `MissingLibraryError` before work begins."""
    require_libraries("train", *_REQUIRED_PACKAGES)


def _result_to_json(trained: "TrainingResult") -> dict[str, Any]:
    training = trained.model.card.training
    return {
        "model": str(trained.path),
        "epochs": training.epochs,
        "best_epoch": training.best_epoch,
        "seconds": training.seconds,
        "pairs": training.pairs,
        "held_out": trained.evaluation.to_json_dict(),
    }


def _format_training_result(trained: "TrainingResult") -> Iterator[str]:
    from ninedtact_train.evaluation.report import format_evaluation_report

    training = trained.model.card.training
    yield (
        f"{trained.path}: {training.pairs} pairs of {training.sensors} sensors and {training.objects} objects, "
        f"{training.epochs} epochs in {training.seconds / 60:.1f} minutes, best epoch {training.best_epoch}"
    )
    yield "on the held-out pairs:"
    yield from format_evaluation_report(trained.evaluation)
