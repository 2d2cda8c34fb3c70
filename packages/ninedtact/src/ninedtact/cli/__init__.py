"""The command line: one file per command, each a frozen dataclass whose fields are the options and whose `run` does the work.

Only the command that is named is imported, and a command imports what it needs when it runs, so that `ninedtact` starts quickly.
Commands of the sibling distributions are found by their entry points; those of one that is not installed say how to install it.

tyro reads the fields. Its rules are extended here, once for all commands: defaults that say nothing are left out (none, false, an
empty list), an option that may be left out shows only its type, and the lines of a docstring are joined to sentences.
"""

import ast
import os
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import is_dataclass, make_dataclass, replace
from importlib import import_module
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any, Union, get_args, get_origin

import tyro
from tyro.constructors import ConstructorRegistry, StructConstructorSpec, StructFieldSpec, StructTypeInfo

from ninedtact._version import __version__, installation_command
from ninedtact.cli.plain_text import spell_what_outputs_cannot_print
from ninedtact.errors import InputError, MissingLibraryError, NinedtactError, printable_text

COMMANDS = {
    "demo": "demo:DemoCommand",
    "calibrate": "calibrate:CalibrateCommand",
    "reconstruct": "reconstruct:ReconstructCommand",
    "check": "check:CheckCommand",
    "compare": "compare:CompareCommand",
    "live": "live:LiveCommand",
    "play": "live:PlayCommand",
    "ros2": "ros2_foxglove_and_serve:Ros2Command",
    "foxglove": "ros2_foxglove_and_serve:FoxgloveCommand",
    "serve": "ros2_foxglove_and_serve:ServeCommand",
    "simulate": "simulate:SimulateCommand",
    "simulate dataset": "[datasets]",
    "simulate sequences": "[datasets]",
    "collect": "[datasets]",
    "record": "record:RecordCommand",
    "info": "recording_info_and_export:InfoCommand",
    "export": "recording_info_and_export:ExportCommand",
    "dataset": "[datasets]",
    "import-calibration": "original_calibration:ImportCalibrationCommand",
    "export-calibration": "original_calibration:ExportCalibrationCommand",
    "train": "[train]",
    "model": "[train]",
    "estimate": "estimate:EstimateCommand",
    "track": "track:TrackCommand",
    "adapt": "adapt:AdaptCommand",
    "evaluate": "[datasets]",
    "hardware": "[hardware]",
    "camera-delay": "camera_delay:CameraDelayCommand",
    "doctor": "doctor:DoctorCommand",
}
"""Module and class of every command, in the order of `ninedtact --help`, or in brackets the extra that installs the distribution
which brings the command (an entry point of the group `ninedtact.commands`). A group of commands is a union of classes; its module
describes it in `DESCRIPTION`. A command of two words joins a group of this distribution."""
DESCRIPTION = "The software of the 9DTact tactile sensor: camera images in, shape in mm and force in N out."
_OF_A_SENSOR = ("--source", "--sensor")
_SILENT_DEFAULTS = ("", "None", "False")
_NO_DEFAULT = "tyro.MISSING"
"""Beginning of what tyro gives as the default of an option that is required."""


class CommandNotInstalled(MissingLibraryError):
    """The distribution that brings a command is not installed."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; 0 done, 1 the work failed (one line says why), 2 usage."""
    spell_what_outputs_cannot_print()
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
        print(f"ninedtact {__version__}")
        return 0
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
    for count in (2, 1):
        name = " ".join(words[:count])
        if name in COMMANDS:
            command, description = load_command(name)
            return _parse_command(command, description, words[count:], f"ninedtact {name}")
    overview: Any = Union[tuple(map(_overview_entry, (name for name in COMMANDS if " " not in name)))]  # noqa: UP007
    return _parse_command(overview, DESCRIPTION, words, "ninedtact")


def load_command(name: str) -> tuple[Any, str | None]:
    """Return the class of a command, or the union of a group's, and the description of a group.

    Raises `CommandNotInstalled` for a command of a distribution that is not installed.
    """
    module_name, class_name = _command_place(name)
    module = import_module(module_name)
    command = getattr(module, class_name)
    for other in COMMANDS:
        if other.startswith(f"{name} "):
            command |= _overview_entry(other)
    return command, None if isinstance(command, type) else module.DESCRIPTION


def _command_place(name: str) -> tuple[str, str]:
    place = COMMANDS[name]
    if not place.startswith("["):
        module_name, _, class_name = place.partition(":")
        return f"ninedtact.cli.{module_name}", class_name
    found = tuple(entry_points(group="ninedtact.commands", name=name))
    if not found:
        raise CommandNotInstalled(
            expected=f"the distribution that brings 'ninedtact {name}'",
            got="none",
            remedy=f"run {installation_command(place.strip('[]'))}",
        )
    return found[0].module, found[0].attr


def _overview_entry(name: str) -> Any:
    """Return a command's line in the help of the program or of its group, made from its source: importing all takes a second."""
    try:
        summary = _command_summary(*_command_place(name))
    except CommandNotInstalled:
        summary = f"Not installed; run {installation_command(COMMANDS[name].strip('[]'))}"
    stub = make_dataclass(f"_{name.replace(' ', '_')}", ())
    return Annotated[stub, tyro.conf.subcommand(name.split()[-1], description=summary)]


def _command_summary(module_name: str, class_name: str) -> str:
    spec = find_spec(module_name)
    assert spec is not None and spec.origin is not None, f"{module_name} is a file of an installed distribution"
    for node in ast.parse(Path(spec.origin).read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ClassDef) and node.name == class_name:
            return " ".join((ast.get_docstring(node) or "").split("\n\n")[0].split())
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "DESCRIPTION":
            return str(ast.literal_eval(node.value))
    raise AssertionError(f"{module_name} has no {class_name} with a docstring and no DESCRIPTION")


def _parse_command(commands: Any, description: str | None, arguments: Sequence[str], program: str) -> Any:
    """Parse the arguments into a command: a dataclass, or one of a union of dataclasses. `program` is its name in the usage.

    Exits with code 0 after --help and 2 on wrong usage; raises `InputError`.
    """
    repeatable: set[str] = set()
    command = tyro.cli(
        commands,
        prog=program,
        description=description,
        args=arguments,
        registry=_plain_help_registry(repeatable),
        config=(tyro.conf.DisallowNone, tyro.conf.FlagCreatePairsOff),
    )
    from ninedtact.bounds import require_options_within_bounds

    _require_each_option_once(arguments, repeatable)
    require_options_within_bounds(command)
    return command


def _require_each_option_once(arguments: Sequence[str], repeatable: set[str]) -> None:
    """Refuse an option that is given again, of which only the last value would count; raises `InputError`."""
    given = Counter(word.partition("=")[0].replace("_", "-") for word in arguments if word.startswith("--"))
    for option, count in given.items():
        if count > 1 and option not in repeatable:
            several = (
                "; name several sensors after one, as in --source left=0 right=2" if option in _OF_A_SENSOR else ""
            )
            raise InputError(f"expected {option} once, got it {count} times{several or '; keep one of them'}")


def _plain_help_registry(repeatable: set[str]) -> ConstructorRegistry:
    """Return tyro's rules with one more, which rewrites the help of every dataclass field.

    repeatable: receives the options that may be given several times.
    """
    registry, open_types = ConstructorRegistry(), []

    @registry.struct_rule
    def rewrite_help(info: StructTypeInfo) -> Any:
        if info.type in open_types or not is_dataclass(info.type):
            return None
        open_types.append(info.type)
        try:
            spec = ConstructorRegistry.get_struct_spec(info)
        finally:
            open_types.pop()
        if not isinstance(spec, StructConstructorSpec):
            return spec
        names = (field.name.replace("_", "-") for field in spec.fields if _is_repeatable(field.type))
        repeatable.update(f"--{name}" for name in names)
        return replace(spec, fields=tuple(_with_plain_help(field) for field in spec.fields))

    return registry


def _with_plain_help(field: StructFieldSpec) -> StructFieldSpec:
    """Return the field with a short hint of its default, a plain placeholder and whole sentences."""
    repeatable = _is_repeatable(field.type)
    hint = tyro.conf.arg(help_behavior_hint=_default_hint(repeatable), metavar=_placeholder(field.type, repeatable))
    return replace(field, type=Annotated[field.type, hint], helptext=_joined_lines(field.helptext))  # type: ignore[arg-type]


def _is_repeatable(field_type: Any) -> bool:
    return any(marker is tyro.conf.UseAppendAction for marker in _metadata(field_type))


def _default_hint(repeatable: bool) -> Callable[[str], str]:
    """Return what tyro calls with the text of a default to write the words behind an option's help."""

    def hint(default: str) -> str:
        if default.startswith(_NO_DEFAULT):
            return "(required, repeatable)" if repeatable else "(required)"
        if default == "True":
            return "This option switches it off."
        if default in _SILENT_DEFAULTS:
            return "(repeatable)" if repeatable else ""
        return f"(default: {default})"

    return hint


def _placeholder(field_type: Any, repeatable: bool) -> str | None:
    """Return the placeholder of a text, or of a list of any length such as `PATH ...`; None where tyro's own is plain."""
    while get_origin(field_type) is Annotated:
        field_type = get_args(field_type)[0]
    if field_type in (str, str | None):
        return "TEXT"
    is_list = get_origin(field_type) is tuple and get_args(field_type)[-1] is Ellipsis
    item = get_args(field_type)[0] if is_list else None
    if repeatable or not isinstance(item, type):
        return None
    return f"{item.__name__.upper().replace('STR', 'TEXT')} ..."


def _metadata(field_type: Any) -> tuple[Any, ...]:
    """Return all annotations of a type, however deeply they are nested."""
    if get_origin(field_type) is not Annotated:
        return ()
    inner, *metadata = get_args(field_type)
    return (*_metadata(inner), *metadata)


def _joined_lines(helptext: Any) -> Callable[[], str | None]:
    """Return a function for the help text without line breaks inside its paragraphs."""

    def text() -> str | None:
        written = helptext() if callable(helptext) else helptext
        if written is None:
            return None
        return "\n\n".join(" ".join(paragraph.split()) for paragraph in written.split("\n\n"))

    return text


def _report_failure(sentence: str) -> int:
    """Say why in one line; the exit code of failed work."""
    print(f"ninedtact: {printable_text(' '.join(sentence.split()))}", file=sys.stderr)
    return 1


def _discard_output() -> int:
    """Throw away what is left of the output where it cannot be written, also from the interpreter's last flush; return 1."""
    with suppress(OSError, ValueError):  # there is no output, or one that a test took away
        sys.stdout.flush()
        return 1
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return 1
