"""Command line arguments → one command, with help texts as a person expects them.

The options are the fields of the commands' dataclasses, read by tyro. Its rules are extended here, once for all commands: defaults
that say nothing are left out (none, false, an empty list), an option that may be left out shows only its type, and the lines of a
docstring are joined to sentences.
"""

from collections.abc import Callable, Sequence
from dataclasses import is_dataclass, replace
from typing import Annotated, Any, get_args, get_origin

import tyro
from tyro.constructors import ConstructorRegistry, StructConstructorSpec, StructFieldSpec, StructTypeInfo

_SILENT_DEFAULTS = ("", "None", "False")
_NO_DEFAULT = "tyro.MISSING"


def parse_command(commands: Any, description: str, arguments: Sequence[str] | None) -> Any:
    """Parse the arguments into one of the commands (a union of dataclasses), the program's own arguments where None is given.

    Exits with code 0 after --help and 2 on wrong usage.
    """
    return tyro.cli(
        commands,
        prog="ninedtact",
        description=description,
        args=arguments,
        registry=_plain_help_registry(),
        config=(tyro.conf.DisallowNone, tyro.conf.FlagCreatePairsOff),
    )


def _plain_help_registry() -> ConstructorRegistry:
    """Return tyro's rules with one more, which rewrites the help of every dataclass field."""
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
        return replace(spec, fields=tuple(_with_plain_help(field) for field in spec.fields))

    return registry


def _with_plain_help(field: StructFieldSpec) -> StructFieldSpec:
    """Return the field with a short hint of its default, a plain placeholder and whole sentences."""
    repeatable = any(marker is tyro.conf.UseAppendAction for marker in _metadata(field.type))
    hint = tyro.conf.arg(help_behavior_hint=_default_hint(repeatable), metavar=_placeholder(field.type, repeatable))
    return replace(field, type=Annotated[field.type, hint], helptext=_joined_lines(field.helptext))  # type: ignore[arg-type]


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
