"""Reading and writing of design files with the dimensions of the parts, which the tables `[hardware.shell]` and so on change."""

from dataclasses import asdict, replace
from pathlib import Path
from typing import get_args

import tomli_w

from ninedtact.design import (
    HARDWARE_TABLE,
    SensorDesign,
    convert_tables_to_design,
    design_to_toml,
    read_design_tables,
    sensor_design_from_tables,
)
from ninedtact.errors import FileFormatError
from ninedtact_hardware.design import PART_TABLES, DesignVariant, HardwareDesign, hardware_design_of_variant

VARIANT_KEY = "variant"


def read_hardware_design(path: Path | str | None, variant: DesignVariant) -> HardwareDesign:
    """Read a design file with its hardware tables. Without a file, return the variant in the published size.

    variant: what the file's dimensions are applied to, unless the file names a variant of its own. Raises what
    `read_design_file` raises.
    """
    if path is None:
        return hardware_design_of_variant(SensorDesign(), variant)
    tables = read_design_tables(path)
    hardware = tables.get(HARDWARE_TABLE, {})
    parts = dict(hardware) if isinstance(hardware, dict) else {HARDWARE_TABLE: hardware}
    named = parts.pop(VARIANT_KEY, variant)
    if named not in get_args(DesignVariant):
        raise FileFormatError(
            expected=f"hardware.variant of {path} to be one of {', '.join(get_args(DesignVariant))}",
            got=f"{named!r}",
            remedy="correct it",
        )
    if not all(isinstance(table, dict) for table in parts.values()):
        raise FileFormatError(
            expected=f"[hardware] of {path} to hold tables", got="values", remedy="write [hardware.shell] and the like"
        )
    if unknown := [name for name in parts if name not in PART_TABLES]:
        raise FileFormatError(
            expected=f"[hardware] tables {', '.join(PART_TABLES)}",
            got=f"{unknown[0]!r} in {path}",
            remedy="correct or remove it",
        )
    design = hardware_design_of_variant(sensor_design_from_tables(tables, path), named)
    merged = {name: {**asdict(getattr(design, name)), **table} for name, table in parts.items()}
    found = convert_tables_to_design(merged, HardwareDesign, path)
    return replace(design, **{name: getattr(found, name) for name in parts})


def hardware_design_to_toml(design: HardwareDesign) -> str:
    """Return a design file with every dimension, which `read_hardware_design` reads back as the same design."""
    parts = {name: asdict(getattr(design, name)) for name in PART_TABLES}
    return f"{design_to_toml(design.sensor)}\n{tomli_w.dumps({HARDWARE_TABLE: {VARIANT_KEY: design.variant, **parts}})}"
