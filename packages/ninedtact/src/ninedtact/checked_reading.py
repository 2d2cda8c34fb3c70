"""Reading of files that a person may have edited or a disk may have damaged: regular files alone, every value within its bounds.

A bound is declared beside the field, as `Annotated[float, Meta(ge=0, le=20)]`; not-a-number is within no bounds. A checksum over
the values of a file tells whether they are still those that the program wrote.
"""

import json
import os
import re
import stat
from collections.abc import Collection, Mapping
from hashlib import sha256
from pathlib import Path
from time import monotonic, sleep
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
_LONGEST_PIPE_S = 5.0
MOST_TEXT_BYTES = 20_000_000
"""Largest size of a text file that is read."""
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
    """Return the text of a UTF-8 file; raises `OSError` as `read_regular_file`, and `UnicodeDecodeError`.

    accepts_pipe: whether another program may write the text into a pipe, for which it has `_LONGEST_PIPE_S`.
    """
    if accepts_pipe and Path(path).is_fifo():
        return _read_pipe(Path(path)).decode()
    return read_regular_file(path, MOST_TEXT_BYTES).decode()


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
    """Return the field and the value beside the reason that msgspec gives."""
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
