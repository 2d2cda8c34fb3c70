"""Bounds of settings and dimensions, declared once beside the field that they bound, and the reading of files within them.

    @dataclass(frozen=True)
    class CollectSettings:
        tolerance_ms: Annotated[float, Meta(gt=0, le=1000)] = 10.0
        ranges: tuple[Annotated[float, Meta(gt=0)], ...] = (6.0, 6.0, 12.0)
        schedule: Literal["constant", "one cycle"] = "one cycle"

        def __post_init__(self) -> None:
            require_within_bounds(self)

`Meta` is that of msgspec, so that the same declaration is checked where a file is read (`convert_tables_to_class`) and shown where
a command line is made. Not-a-number is within no bounds. None is within all, where the type allows it.

A person may have edited a file, and a disk may have damaged it: only regular files are read, and a checksum over the values tells
whether they are still those that the program wrote.
"""

import json
import os
import re
import stat
import tomllib
from collections.abc import Callable, Collection, Hashable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from functools import cache, wraps
from hashlib import sha256
from inspect import signature
from numbers import Integral, Real
from operator import ge, gt, le, lt
from pathlib import Path
from time import monotonic, sleep
from tokenize import TokenError
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints
from zipfile import BadZipFile
from zlib import error as ZlibError

import msgspec
from msgspec import Meta

import ninedtact
from ninedtact.errors import InputError, NinedtactError

Checked = TypeVar("Checked", bound=Callable[..., Any])
_COMPARISONS = (("ge", "of at least", ge), ("gt", "above", gt), ("le", "of at most", le), ("lt", "below", lt))
"""The attributes of `Meta`, the words for them, and what a value within the bound fulfils."""


def require_within_bounds(part: object, table: str = "", refusal: type[NinedtactError] = InputError) -> None:
    """Raise `refusal` for the first field of a dataclass whose value is of another type, or outside of the bounds beside it.

    table: name of the part in a file or of its settings, for the message.
    """
    place = f"{table}.{{}}" if table else "{}"
    for name, expected, got in _field_violations(part):
        raise refusal(expected=f"{place.format(name)} {expected}", got=got, remedy="correct it")


def require_options_within_bounds(command: object) -> None:
    """Raise `InputError` for the first option of a command, or of a group of options in it, whose value is out of its bounds."""
    for name, expected, got in _field_violations(command):
        raise InputError(expected=f"--{name.replace('_', '-')} {expected}", got=got, remedy="correct it")
    for group in vars(command).values():
        if is_dataclass(group):
            require_options_within_bounds(group)


def _field_violations(part: object) -> Iterator[tuple[str, str, str]]:
    for name, kind in _field_kinds(type(part)):  # type: ignore[arg-type]  # classes are hashable
        for expected, got in _violations(getattr(part, name), kind, {}):
            yield name, expected, got


@cache
def _field_kinds(kind: type) -> tuple[tuple[str, Any], ...]:
    hints = get_type_hints(kind, localns=_PublicNames(), include_extras=True)
    return tuple((field.name, hints[field.name]) for field in fields(kind))


class _PublicNames(dict[str, Any]):
    """What annotations may name that their module imports for type checkers alone."""

    def __missing__(self, name: str) -> Any:
        try:
            return getattr(ninedtact, name)
        except AttributeError:
            raise KeyError(name) from None


def checks_arguments(item: Checked) -> Checked:
    """Let a function of the Python API, or the constructor of a class, refuse what its annotations do not allow.

    Raises `InputError`, in one sentence, for an argument of another type or out of its bounds, and for arrays whose axes of one
    name differ in length.
    """
    if isinstance(item, type):
        item.__init__ = checks_arguments(item.__init__)  # type: ignore[misc]
        return item
    function: Callable[..., Any] = item
    names = tuple(signature(function).parameters)
    owner, _, own_name = function.__qualname__.rpartition(".")

    @cache
    def kinds() -> dict[str, Any]:
        return get_type_hints(function, localns=_PublicNames(), include_extras=True)

    @cache
    def tests() -> dict[str, _Allows]:
        return {name: _test_of(kind) for name, kind in kinds().items()}

    @wraps(function)
    def call(*arguments: Any, **named: Any) -> Any:
        lengths, known = dict[str, int](), tests()
        for name, value in (*zip(names, arguments, strict=False), *named.items()):
            if name in known and not known[name](value, lengths):
                expected, got = next(_violations(value, kinds()[name], lengths))
                place = f" of {owner if own_name == '__init__' else own_name}" if expected.startswith("to be") else ""
                raise InputError(expected=f"{name}{place} {expected}", got=got, remedy="correct it")
        return function(*arguments, **named)

    return call  # type: ignore[return-value]


_Allows = Callable[[Any, dict[str, int]], bool]
"""Whether a value is of a type and within its bounds; lengths of the axes of arrays, by name, are compared and added."""


def _violations(value: Any, kind: Any, lengths: dict[str, int]) -> Iterator[tuple[str, str]]:
    """Yield what is expected and what is given in its place, in words, where a value has another type, or violates a bound."""
    if _test_of(kind)(value, lengths):
        return
    origin, arguments = get_origin(kind), get_args(kind)
    if origin is Annotated and _test_of(arguments[0])(value, lengths):
        for meta in arguments[1:]:
            if isinstance(meta, Meta) and not _keeps(value, meta):
                yield describe_bounds(meta), describe_value(value)
    elif origin is Annotated:
        yield from _violations(value, arguments[0], lengths)
    elif origin in (Union, UnionType):
        members = [found for each in arguments for found in _violations(value, each, lengths)]
        of_type = [found for found in members if not found[0].startswith("to be ")]
        yield from of_type[:1] or [(f"to be {_describe_kind(kind, lengths)}", describe_value(value))]
    elif _is_sequence_of(kind, value):
        for each, member in zip(value, _member_kinds(kind, value), strict=True):
            yield from _violations(each, member, lengths)
    else:
        yield f"to be {_describe_kind(kind, lengths)}", describe_value(value)


@cache
def _test_of(kind: Any) -> _Allows:
    """Return the test of a type, made once, because a stream makes some objects of a hundred times a second."""
    origin, arguments = get_origin(kind), get_args(kind)
    if kind is Any or isinstance(kind, TypeVar):
        return lambda value, lengths: True
    if origin is Literal:
        return lambda value, lengths: isinstance(value, Hashable) and value in arguments
    if origin is Annotated:
        test, bounds = _test_of(arguments[0]), [each for each in arguments[1:] if isinstance(each, Meta)]
        if not bounds:
            return test
        return lambda value, lengths: test(value, lengths) and all(_keeps(value, each) for each in bounds)
    if origin in (Union, UnionType):
        tests = [_test_of(each) for each in arguments]
        return lambda value, lengths: any(test(value, lengths) for test in tests)
    if hasattr(kind, "dim_str"):  # a type of arrays
        return _array_test(kind)
    if origin in (tuple, Sequence):
        return lambda value, lengths: (
            _is_sequence_of(kind, value)
            and all(
                _test_of(member)(each, lengths) for each, member in zip(value, _member_kinds(kind, value), strict=True)
            )
        )
    if kind is float:  # not-a-number is no number
        return lambda value, lengths: isinstance(value, Real) and value == value
    wanted: Any = Integral if kind is int else origin or kind
    return lambda value, lengths: isinstance(value, wanted)


def _is_sequence_of(kind: Any, value: Any) -> bool:
    """Return whether a value has as many members as a sequence of a type."""
    arguments = get_args(kind)
    any_number = get_origin(kind) is Sequence or Ellipsis in arguments
    is_sequence = get_origin(kind) in (tuple, Sequence) and isinstance(value, tuple | list)
    return is_sequence and (any_number or len(value) == len(arguments))


def _member_kinds(kind: Any, value: Sequence[Any]) -> tuple[Any, ...]:
    arguments = get_args(kind)
    return arguments[:1] * len(value) if get_origin(kind) is Sequence or Ellipsis in arguments else arguments


def _array_test(kind: Any) -> _Allows:
    import numpy as np  # which commands that read no arrays do without

    axes, is_numpy = kind.dim_str.split(), kind.array_type is np.ndarray
    dtypes = {np.dtype(name) for name in kind.dtypes if name in np.sctypeDict}
    any_shape = any(axis[0] in ".*#" for axis in axes)

    def allows(value: Any, lengths: dict[str, int]) -> bool:
        if isinstance(value, np.ndarray):
            if value.dtype not in dtypes:
                return False
        elif is_numpy or not hasattr(value, "shape"):
            return False
        if any_shape:
            return True
        return len(axes) == len(value.shape) and all(
            axis == "_" or length == (int(axis) if axis.isdigit() else lengths.setdefault(axis, length))
            for axis, length in zip(axes, value.shape, strict=True)
        )

    return allows


_KIND_WORDS = {
    float: "a number",
    int: "a whole number",
    str: "a text",
    bool: "True or False",
    NoneType: "None",
    Path | str: "a path",
    Path: "a path",
    Callable: "a function",
}


def _describe_kind(kind: Any, lengths: Mapping[str, int] = {}) -> str:
    origin, arguments = get_origin(kind), get_args(kind)
    if words := _KIND_WORDS.get(kind) or _KIND_WORDS.get(origin):
        return words
    if origin is Annotated:
        return _describe_kind(arguments[0], lengths)
    if origin is Literal:
        return f"one of {', '.join(map(repr, arguments))}"
    if origin in (Union, UnionType):
        members = dict.fromkeys(_describe_kind(each, lengths) for each in arguments)
        return " or ".join(word for word in members if "a path" not in members or word != "a text")
    if hasattr(kind, "dim_str"):
        axes = ", ".join(str(lengths.get(axis, axis)) for axis in kind.dim_str.split())
        return f"an array of {kind.dtypes[0] if len(kind.dtypes) == 1 else 'numbers'} with shape ({axes})"
    if origin is tuple and Ellipsis not in arguments:
        return f"{len(arguments)} values, each {_describe_kind(arguments[0])}"
    return f"several values, each {_describe_kind(arguments[0])}" if arguments else f"a {kind.__name__}"


def describe_value(value: Any) -> str:
    """Return a value in words, for the message that refuses it."""
    if hasattr(value, "dtype") and hasattr(value, "shape"):
        return f"an array of {value.dtype} with shape {value.shape}"
    if isinstance(value, float):
        return f"{value:g}"
    if value is None or isinstance(value, str | bytes | int | tuple | list):
        return text if len(text := repr(value)) <= 60 else f"{text[:57]}..."
    return f"a {type(value).__name__}"


def _keeps(value: Any, meta: Meta) -> bool:
    """Return whether a value keeps all bounds; text keeps none, and neither does not-a-number."""
    if not isinstance(value, Real):
        return all(getattr(meta, name) is None for name, _, _ in _COMPARISONS)
    return all(keeps(value, bound) for name, _, keeps in _COMPARISONS if (bound := getattr(meta, name)) is not None)


def describe_bounds(meta: Meta) -> str:
    """Return the bounds in words, such as `from 0.3 to 15` or `above 0`."""
    if meta.ge is not None and meta.le is not None:
        return f"from {meta.ge:g} to {meta.le:g}"
    bounds = ((word, getattr(meta, name)) for name, word, _ in _COMPARISONS)
    return " and ".join(f"{word} {bound:g}" for word, bound in bounds if bound is not None)


CHECKSUM_KEY = "checksum"
NPY_READ_ERRORS = (
    OSError,
    ValueError,
    EOFError,
    TypeError,
    OverflowError,
    SyntaxError,
    TokenError,
    MemoryError,
    KeyError,
    RuntimeError,
    BadZipFile,
    ZlibError,
)
"""Exceptions that NumPy raises for a damaged .npy or .npz file."""
_LONGEST_PIPE_S = 5.0
MOST_TEXT_BYTES = 20_000_000
"""Largest size of a text file that is read."""
_MOST_TOML_CHARACTERS = 1_000_000
_KEY_PART = r"""(?:(?<![\w-])[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+"""
_LONG_DOTTED_KEY = re.compile(rf"{_KEY_PART}(?:\.[ \t]*+{_KEY_PART}){{16}}")
_INVALID_VALUE = re.compile(r"(?P<reason>.*?)(?: - at `\$(?P<place>.*)`)?$", re.DOTALL)
_PART_OF_PLACE = re.compile(r"\.?([^.\[\]]+|\[\d+\]|\[\.\.\.\])")


def read_regular_file(path: Path | str, most_bytes: int | None = None) -> bytes:
    """Return the content of a file; raises `OSError`, also for a folder, a pipe, a device, and a file of more than `most_bytes`."""
    found = Path(path).stat()
    if not stat.S_ISREG(found.st_mode):
        kind = "a folder" if stat.S_ISDIR(found.st_mode) else "a pipe or a device"
        raise OSError(f"{path} is {kind} and not a file")
    if most_bytes is not None and found.st_size > most_bytes:
        raise OSError(f"{path} has {found.st_size} bytes, more than the {most_bytes} that such a file can have")
    return Path(path).read_bytes()


def read_text_file(path: Path | str, accepts_pipe: bool = False) -> str:
    """Return the text of a UTF-8 file, without the mark with which some editors and spreadsheets let it begin.

    Raises `OSError` as `read_regular_file`, and `UnicodeDecodeError`.
    accepts_pipe: whether another program may write the text into a pipe, for which it has `_LONGEST_PIPE_S`.
    """
    if accepts_pipe and Path(path).is_fifo():
        return _read_pipe(Path(path)).decode("utf-8-sig")
    return read_regular_file(path, MOST_TEXT_BYTES).decode("utf-8-sig")


def parse_toml(text: str) -> dict[str, Any]:
    """Return the tables of a TOML text; raises `ValueError` also where it is larger or nested more deeply than a file of ours.

    The parser's time and memory grow with the square of the number of keys in a dotted one.
    """
    if len(text) > _MOST_TOML_CHARACTERS:
        raise ValueError(f"{len(text)} characters, more than the {_MOST_TOML_CHARACTERS} that such a file can have")
    if _LONG_DOTTED_KEY.search(text):
        raise ValueError("a key of more than 16 parts")
    try:
        return tomllib.loads(text)
    except RecursionError as error:
        raise ValueError("brackets are nested too deeply") from error


def read_json_object(path: Path | str, most_bytes: int | None = MOST_TEXT_BYTES) -> dict[str, Any]:
    """Return the object of a JSON file as a dictionary; raises `OSError` as `read_regular_file`, and `ValueError`."""
    try:
        found = json.loads(read_regular_file(path, most_bytes).decode())
    except RecursionError as error:
        raise ValueError("brackets are nested too deeply") from error
    if not isinstance(found, dict):
        raise ValueError(f"{path} holds no table of names and values")
    return found


def _read_pipe(path: Path) -> bytes:
    """Return what another program writes into a pipe; raises `OSError` where it writes nothing, too long or too much."""
    pipe, content, began = os.open(path, os.O_RDONLY | os.O_NONBLOCK), b"", monotonic()
    try:
        while monotonic() - began < _LONGEST_PIPE_S and len(content) <= MOST_TEXT_BYTES:
            try:
                part = os.read(pipe, 65536)
            except BlockingIOError:
                part = None
            if part == b"" and content:
                return content
            content += part or b""
            if not part:
                sleep(0.01)
    finally:
        os.close(pipe)
    raise OSError(f"{path} is a pipe into which no program wrote a text within {_LONGEST_PIPE_S:g} s")


def convert_tables_to_class(tables: Any, kind: Any) -> Any:
    """Convert the tables of a file to a class, or another type that msgspec knows, and check every declared bound.

    Raises `msgspec.ValidationError` with the name of the field, its value, and what is possible, and what the class raises.
    """
    try:
        return msgspec.convert(tables, kind)
    except msgspec.ValidationError as error:
        raise msgspec.ValidationError(_describe_invalid_value(str(error), tables, kind)) from error


def _describe_invalid_value(message: str, tables: Any, kind: Any) -> str:
    found = _INVALID_VALUE.match(message)
    if found is None or not found["place"]:
        return message
    value: Any = tables
    names: list[str] = []
    for part in _PART_OF_PLACE.findall(found["place"]):
        if part == "[...]":
            part = _find_refused_key(message, tables, names, kind)
        value = value[int(part[1:-1])] if part.startswith("[") else value[part]
        names.append(part)
    field = ".".join(names).replace(".[", "[")
    text = repr(value)
    return f"{field} = {text if len(text) <= 60 else text[:57] + '...'} ({found['reason']})"


def _find_refused_key(message: str, tables: Any, names: list[str], kind: Any) -> str:
    """Return the key of a mapping of which one value is refused, whose name msgspec does not tell."""

    def reduced(value: Any, rest: list[str], key: str) -> Any:
        return {**value, rest[0]: reduced(value[rest[0]], rest[1:], key)} if rest else {key: value[key]}

    value = tables
    for name in names:
        value = value[name]
    for key in value:
        try:
            msgspec.convert(reduced(tables, names, key), kind)
        except msgspec.ValidationError as error:
            if str(error) == message:
                return str(key)
    return str(next(iter(value)))


def mapping_checksum(tables: Mapping[str, Any], without: Collection[str] = ()) -> str:
    """Return the checksum of a file's values, whatever its comments and the order of its keys; names at the top may be left out."""
    counted = {key: value for key, value in tables.items() if key != CHECKSUM_KEY and key not in without}
    return sha256(json.dumps(counted, sort_keys=True, default=str).encode()).hexdigest()
