"""Reading and writing a sensor design as a TOML file: one table per part of the design, only what differs from the
published sensor."""

import tomllib
from dataclasses import asdict, fields, is_dataclass
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

import msgspec
import tomli_w

from ninedtact.checked_reading import convert_within_bounds, read_text_file
from ninedtact.design import SensorDesign
from ninedtact.errors import FileFormatError

HARDWARE_TABLE = "hardware"
"""Table of the parts' own dimensions, which only the package `hardware` reads."""
Design = TypeVar("Design")


class DesignFileUnreadable(FileFormatError):
    """A design file that is missing, is not TOML, or has a key or value that no design has."""


def read_design_file(path: Path | str) -> SensorDesign:
    """Read a sensor design; what the file does not state is as in the published sensor.

    Raises `DesignFileUnreadable`, and `DesignImpossible` for dimensions that no sensor can have.
    """
    return sensor_design_from_tables(read_design_tables(path), path)


def sensor_design_from_tables(tables: dict[str, Any], path: Path | str) -> SensorDesign:
    """Return the sensor design of a file's tables without those of the hardware; raises as `read_design_file` does."""
    return convert_design_tables(
        {name: part for name, part in tables.items() if name != HARDWARE_TABLE}, SensorDesign, path
    )


def read_design_tables(path: Path | str) -> dict[str, Any]:
    """Read the file's tables, of a sensor folder's `sensor.toml` those of its design; raises `DesignFileUnreadable`."""
    try:
        tables = tomllib.loads(read_text_file(path, accepts_pipe=True))
    except (OSError, ValueError, RecursionError) as trouble:
        raise DesignFileUnreadable(
            f"expected a design in TOML, got {path} ({trouble}); give a file such as 'ninedtact hardware export' writes"
        ) from trouble
    is_sensor = "format" in tables and isinstance(tables.get("design"), dict)
    return dict(tables["design"]) if is_sensor else tables


def convert_design_tables(tables: dict[str, Any], kind: type[Design], path: Path | str) -> Design:
    """Convert tables strictly to a design of this class; raises as `read_design_file` does."""
    _require_known_keys(tables, kind, path, ())
    try:
        return convert_within_bounds(tables, kind)
    except msgspec.ValidationError as trouble:
        raise DesignFileUnreadable(
            f"expected every value of {path} to have its own type, got: {trouble}; correct the file"
        ) from trouble


def _require_known_keys(tables: dict[str, Any], kind: type[Any], path: Path | str, within: tuple[str, ...]) -> None:
    """Refuse keys that the design does not have; raises `DesignFileUnreadable`."""
    hints, known = get_type_hints(kind), {field.name for field in fields(kind)}
    for name, value in tables.items():
        if name not in known:
            where = f" in [{'.'.join(within)}]" if within else ""
            more = f", {HARDWARE_TABLE}" if kind is SensorDesign else ""
            raise DesignFileUnreadable(
                f"expected one of {', '.join(sorted(known))}{more}{where}, got {name!r} in {path}; correct or remove it"
            )
        if isinstance(value, dict) and is_dataclass(hints[name]):
            _require_known_keys(value, hints[name], path, (*within, name))


def design_to_toml(design: SensorDesign) -> str:
    """Return every dimension of a design as TOML, which `read_design_file` reads back."""
    return tomli_w.dumps(asdict(design))
