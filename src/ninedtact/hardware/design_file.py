"""A design file read with its hardware: `[hardware.shell]` and so on change the parts of a variant."""

import tomllib
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any, get_args

import tomli_w

from ninedtact.design import SensorDesign
from ninedtact.design_file import HARDWARE, DesignFileUnreadable, design_from, design_toml, read_tables, sensor_from
from ninedtact.hardware.design import HardwareDesign, Variant, hardware_for

PARTS = tuple(field.name for field in fields(HardwareDesign) if field.name not in ("sensor", "variant"))
VARIANT = "variant"


def read_hardware(path: Path | str | None, variant: Variant) -> HardwareDesign:
    """The variant with what the file says, its own where it names one; the published sensor if there is none.

    Raises what `read_design` raises.
    """
    if path is None:
        return hardware_for(SensorDesign(), variant)
    tables = read_tables(path)
    hardware = tables.get(HARDWARE, {})
    named, parts = variant_in(hardware, variant, path)
    return altered(hardware_for(sensor_from(tables, path), named), parts, path)


def variant_in(hardware: Any, variant: Variant, path: Path | str) -> tuple[Variant, Any]:
    """The variant that the tables name, or this one; and the tables without it."""
    if not isinstance(hardware, dict) or VARIANT not in hardware:
        return variant, hardware
    named = hardware[VARIANT]
    if named not in get_args(Variant):
        raise DesignFileUnreadable(
            f"expected hardware.variant of {path} to be one of {', '.join(get_args(Variant))}, got {named!r}; correct it"
        )
    return named, {name: table for name, table in hardware.items() if name != VARIANT}


def altered(design: HardwareDesign, tables: Any, path: Path | str) -> HardwareDesign:
    """A design with these tables' dimensions in place of its own."""
    if not isinstance(tables, dict) or not all(isinstance(table, dict) for table in tables.values()):
        raise DesignFileUnreadable(
            f"expected [hardware] of {path} to hold tables, got values; write [hardware.shell] and the like"
        )
    if unknown := [name for name in tables if name not in PARTS]:
        raise DesignFileUnreadable(
            f"expected [hardware] tables {', '.join(PARTS)}, got {unknown[0]!r} in {path}; correct or remove it"
        )
    new = {name: part_from(getattr(design, name), table, path) for name, table in tables.items()}
    return replace(design, **new)


def part_from(part: Any, table: dict[str, Any], path: Path | str) -> Any:
    """One part with this table's dimensions."""
    return design_from({**plain(part), **table}, type(part), path)


def plain(part: Any) -> dict[str, Any]:
    """As TOML would give it back."""
    return tomllib.loads(tomli_w.dumps(asdict(part)))


def hardware_toml(design: HardwareDesign) -> str:
    """Every dimension, as `read_hardware` reads it for the same variant."""
    parts = {name: asdict(getattr(design, name)) for name in PARTS}
    return f"{design_toml(design.sensor)}\n{tomli_w.dumps({HARDWARE: {VARIANT: design.variant, **parts}})}"
