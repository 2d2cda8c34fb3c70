"""The command line: one file per journey, each a frozen dataclass whose fields are the options and whose `run` works.

Commands import what they need when they run, so that `ninedtact --help` stays quick.
"""

import os
import sys
from collections.abc import Sequence
from typing import Annotated

import tyro

from ninedtact._version import __version__
from ninedtact.cli.calibrate import CalibrateCommand
from ninedtact.cli.check import CheckCommand
from ninedtact.cli.collect import Collect
from ninedtact.cli.dataset import DATASET_DESCRIPTION, DatasetCommand
from ninedtact.cli.demo import Demo
from ninedtact.cli.doctor import Doctor
from ninedtact.cli.export import Export
from ninedtact.cli.force.adapt import Adapt
from ninedtact.cli.force.estimate import Estimate
from ninedtact.cli.force.evaluate import Evaluate
from ninedtact.cli.force.model import DESCRIPTION as MODEL
from ninedtact.cli.force.model import Model
from ninedtact.cli.force.train import Train
from ninedtact.cli.hardware import DESCRIPTION as HARDWARE
from ninedtact.cli.hardware import HardwareCommand
from ninedtact.cli.info import Info
from ninedtact.cli.live import Live
from ninedtact.cli.option_parser import parse_command
from ninedtact.cli.original_calibration import ExportCalibrationCommand, ImportCalibrationCommand
from ninedtact.cli.reconstruct import ReconstructCommand
from ninedtact.cli.record import Record
from ninedtact.cli.simulate import DESCRIPTION as SIMULATE
from ninedtact.cli.simulate import Simulate
from ninedtact.errors import NinedtactError

Command = (
    Annotated[Demo, tyro.conf.subcommand("demo")]
    | Annotated[CalibrateCommand, tyro.conf.subcommand("calibrate")]
    | Annotated[ReconstructCommand, tyro.conf.subcommand("reconstruct")]
    | Annotated[CheckCommand, tyro.conf.subcommand("check")]
    | Annotated[Live, tyro.conf.subcommand("live")]
    | Annotated[Simulate, tyro.conf.subcommand("simulate", description=SIMULATE)]
    | Annotated[Collect, tyro.conf.subcommand("collect")]
    | Annotated[Record, tyro.conf.subcommand("record")]
    | Annotated[Info, tyro.conf.subcommand("info")]
    | Annotated[Export, tyro.conf.subcommand("export")]
    | Annotated[DatasetCommand, tyro.conf.subcommand("dataset", description=DATASET_DESCRIPTION)]
    | Annotated[ImportCalibrationCommand, tyro.conf.subcommand("import-calibration")]
    | Annotated[ExportCalibrationCommand, tyro.conf.subcommand("export-calibration")]
    | Annotated[Train, tyro.conf.subcommand("train")]
    | Annotated[Model, tyro.conf.subcommand("model", description=MODEL)]
    | Annotated[Estimate, tyro.conf.subcommand("estimate")]
    | Annotated[Adapt, tyro.conf.subcommand("adapt")]
    | Annotated[Evaluate, tyro.conf.subcommand("evaluate")]
    | Annotated[HardwareCommand, tyro.conf.subcommand("hardware", description=HARDWARE)]
    | Annotated[Doctor, tyro.conf.subcommand("doctor")]
)
DESCRIPTION = "The software of the 9DTact tactile sensor: images in, calibrated millimetres out."


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; 0 done, 1 the work failed (one line says why), 2 usage."""
    if list(sys.argv[1:] if arguments is None else arguments) == ["--version"]:
        return _print_version()
    try:
        return parse_arguments(arguments).run()
    except NinedtactError as refusal:
        return _report_failure(str(refusal))
    except KeyboardInterrupt:
        return _report_failure(
            "stopped by Ctrl-C or termination; nothing was written half; run the command again to start over"
        )
    except BrokenPipeError:
        return _end_quietly()
    except OSError as trouble:
        return _report_failure(
            f"expected to read and write files, got: {trouble}; free the disk or correct the path and its permissions"
        )


def parse_arguments(arguments: Sequence[str] | None) -> Command:
    """Turn the command line into one command."""
    command: Command = parse_command(Command, DESCRIPTION, arguments)
    return command


def _print_version() -> int:
    """Print the version of the package."""
    print(f"ninedtact {__version__}")
    return 0


def _report_failure(sentence: str) -> int:
    """Say why in one line; the exit code of failed work."""
    print(f"ninedtact: {' '.join(sentence.split())}", file=sys.stderr)
    return 1


def _end_quietly() -> int:
    """Whoever read our output (`| head`) has had enough: leave without a word, also from the interpreter's last flush."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return 1
