"""The command line: one file per command, each a frozen dataclass whose fields are the options and whose `run` does the work.

Only the command that is named is imported, and a command imports what it needs when it runs, so that `ninedtact` starts quickly.
"""

import os
import sys
from collections.abc import Iterable, Sequence
from contextlib import suppress
from importlib import import_module
from typing import Annotated, Any, Union

import tyro

from ninedtact._version import __version__
from ninedtact.cli.option_parser import parse_command
from ninedtact.errors import NinedtactError

COMMANDS = {
    "demo": "demo:Demo",
    "calibrate": "calibrate:CalibrateCommand",
    "reconstruct": "reconstruct:ReconstructCommand",
    "check": "check:CheckCommand",
    "live": "live:Live",
    "play": "live:Play",
    "ros2": "ros2_foxglove_and_serve:Ros2",
    "foxglove": "ros2_foxglove_and_serve:Foxglove",
    "serve": "ros2_foxglove_and_serve:Serve",
    "simulate": "simulate:Simulate",
    "collect": "collect:Collect",
    "record": "record:Record",
    "info": "recording_info_and_export:Info",
    "export": "recording_info_and_export:Export",
    "dataset": "dataset:DatasetCommand",
    "import-calibration": "original_calibration:ImportCalibrationCommand",
    "export-calibration": "original_calibration:ExportCalibrationCommand",
    "train": "train_and_model:Train",
    "model": "train_and_model:Model",
    "estimate": "estimate:Estimate",
    "adapt": "fit_force_scale:Adapt",
    "evaluate": "evaluate:Evaluate",
    "hardware": "hardware:HardwareCommand",
    "camera-delay": "camera_delay:CameraDelayCommand",
    "doctor": "doctor:Doctor",
}
"""Module and class of every command, in the order of `ninedtact --help`. A group of commands is a union of classes; its module
describes it in `DESCRIPTION`."""
DESCRIPTION = "The software of the 9DTact tactile sensor: camera images in, shape in mm and force in N out."


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; 0 done, 1 the work failed (one line says why), 2 usage."""
    try:
        try:
            return _run_command(arguments)
        finally:
            sys.stdout.flush()  # the interpreter's own last flush could not fail with a sentence and an exit code
    except BrokenPipeError:  # whoever read our output (`| head`) has had enough
        return _discard_output()
    except OSError as trouble:
        _discard_output()
        return _report_failure(
            f"expected to read and write files, got: {trouble}; free the disk or correct the path and its permissions"
        )


def _run_command(arguments: Sequence[str] | None) -> int:
    """Run one command and return its exit code; raises `OSError` from files and from the output."""
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


def parse_arguments(arguments: Sequence[str] | None) -> Any:
    """Return the command that the command line names, with its options; the program's own arguments where None is given."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    if words and words[0] in COMMANDS:
        command, description = load_command(words[0])
        return parse_command(command, description, words[1:], f"ninedtact {words[0]}")
    return parse_command(command_union(COMMANDS), DESCRIPTION, words, "ninedtact")


def load_command(name: str) -> tuple[Any, str | None]:
    """Return the class of a command, or the union of a group's, and the description of a group."""
    module_name, _, class_name = COMMANDS[name].partition(":")
    module = import_module(f"ninedtact.cli.{module_name}")
    command = getattr(module, class_name)
    return command, None if isinstance(command, type) else module.DESCRIPTION


def command_union(names: Iterable[str]) -> Any:
    """Return the union of commands from which tyro builds subcommands."""
    members = []
    for name in names:
        command, description = load_command(name)
        members.append(Annotated[command, tyro.conf.subcommand(name, description=description)])
    return Union[tuple(members)]  # noqa: UP007 - the members are known only at run time


def _print_version() -> int:
    """Print the version of the package."""
    print(f"ninedtact {__version__}")
    return 0


def _report_failure(sentence: str) -> int:
    """Say why in one line; the exit code of failed work."""
    print(f"ninedtact: {' '.join(sentence.split())}", file=sys.stderr)
    return 1


def _discard_output() -> int:
    """Throw away what is left of the output where it cannot be written, also from the interpreter's last flush; return 1."""
    with suppress(OSError, ValueError):  # there is no output, or one that a test took away
        sys.stdout.flush()
        return 1
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return 1
