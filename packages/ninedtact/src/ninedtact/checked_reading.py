"""Reading of files that a person may have edited, or a disk may have damaged.

Only regular files of a bounded size are read. Values are converted to classes, whose bounds are declared beside their fields, and a
checksum over the values tells whether they are still those that the program wrote.
"""

import json
import re
import stat
import tomllib
from collections.abc import Collection, Mapping
from hashlib import sha256
from pathlib import Path
from tokenize import TokenError
from typing import Any
from zipfile import BadZipFile
from zlib import error as ZlibError

import msgspec

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


def read_text_file(path: Path | str) -> str:
    """Return the text of a UTF-8 file, without the mark with which some editors and spreadsheets let it begin.

    Raises `OSError` as `read_regular_file`, and `UnicodeDecodeError`.
    """
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
