"""The hardware design of one sensor: its sensor design and every dimension of its parts, with reading and writing of
design files. Lengths in mm.

Assembly frame: x along the long side, y along the short side, z towards the skin. The origin lies in the middle of the
base's outer bottom face, z is the optical axis, and cable and USB leave at -y. In a design file the tables
`[hardware.shell]` and so on change the parts of a variant.

The functions at the end give the radius that the lens sees, by refraction from the lens front through air, acrylic and silicone.
"""

from dataclasses import asdict, dataclass, fields, replace
from math import asin, hypot, radians, sin, tan
from pathlib import Path
from typing import Any, Literal, get_args

import tomli_w

from ninedtact.design import (
    ACRYLIC_REFRACTIVE_INDEX,
    HARDWARE_TABLE,
    SILICONE_REFRACTIVE_INDEX,
    DesignFileUnreadable,
    SensorDesign,
    convert_tables_to_design,
    design_to_toml,
    read_design_tables,
    sensor_design_from_tables,
)
from ninedtact_hardware.assembly_dimensions import HorizontalDimensions, StackHeights
from ninedtact_hardware.part_dimensions import (
    ORIGINAL_BASE,
    ORIGINAL_BOARD,
    ORIGINAL_FASTENERS,
    ORIGINAL_MOULDS,
    ORIGINAL_RING,
    ORIGINAL_SHELL,
    BaseDimensions,
    CalibrationBoardDimensions,
    CameraDimensions,
    FastenerDimensions,
    GelLayerDimensions,
    LedBoardDimensions,
    LightIsolationRingDimensions,
    MouldDimensions,
    ShellDimensions,
    WindowDimensions,
)

DesignVariant = Literal["default", "original"]


@dataclass(frozen=True)
class HardwareDesign:
    """The chosen dimensions of every part; `horizontal_dimensions` and `heights` hold what follows from them."""

    sensor: SensorDesign = SensorDesign()
    variant: DesignVariant = "default"
    base: BaseDimensions = BaseDimensions()
    shell: ShellDimensions = ShellDimensions()
    ring: LightIsolationRingDimensions = LightIsolationRingDimensions()
    window: WindowDimensions = WindowDimensions()
    board: LedBoardDimensions = LedBoardDimensions()
    camera: CameraDimensions = CameraDimensions()
    gels: GelLayerDimensions = GelLayerDimensions()
    moulds: MouldDimensions = MouldDimensions()
    pin_frame: CalibrationBoardDimensions = CalibrationBoardDimensions()
    fasteners: FastenerDimensions = FastenerDimensions()

    @property
    def horizontal_dimensions(self) -> HorizontalDimensions:
        """Widths and positions in x and y."""
        return HorizontalDimensions(self)

    @property
    def heights(self) -> StackHeights:
        """Heights of the faces above the base's outer face, z."""
        return StackHeights(self)


def default_hardware_design(sensor: SensorDesign = SensorDesign()) -> HardwareDesign:
    """Return the design with the improvements that docs/hardware.md lists."""
    return HardwareDesign(sensor)


def original_hardware_design(sensor: SensorDesign = SensorDesign()) -> HardwareDesign:
    """Return the design with the dimensions of the original 9DTact."""
    return HardwareDesign(
        sensor,
        "original",
        base=ORIGINAL_BASE,
        shell=ORIGINAL_SHELL,
        ring=ORIGINAL_RING,
        board=ORIGINAL_BOARD,
        moulds=ORIGINAL_MOULDS,
        fasteners=ORIGINAL_FASTENERS,
    )


def hardware_design_of_variant(sensor: SensorDesign, variant: DesignVariant) -> HardwareDesign:
    """Return the design of the variant with this name."""
    return original_hardware_design(sensor) if variant == "original" else default_hardware_design(sensor)


PART_TABLES = tuple(field.name for field in fields(HardwareDesign) if field.name not in ("sensor", "variant"))
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
    named, parts = _split_variant(hardware, variant, path)
    return _replace_dimensions(hardware_design_of_variant(sensor_design_from_tables(tables, path), named), parts, path)


def _split_variant(hardware: Any, variant: DesignVariant, path: Path | str) -> tuple[DesignVariant, Any]:
    """Return the variant that the tables name, or else the given one, and the tables without it."""
    if not isinstance(hardware, dict) or VARIANT_KEY not in hardware:
        return variant, hardware
    named = hardware[VARIANT_KEY]
    if named not in get_args(DesignVariant):
        raise DesignFileUnreadable(
            f"expected hardware.variant of {path} to be one of {', '.join(get_args(DesignVariant))}, got {named!r}; correct it"
        )
    return named, {name: table for name, table in hardware.items() if name != VARIANT_KEY}


def _replace_dimensions(design: HardwareDesign, tables: Any, path: Path | str) -> HardwareDesign:
    """Return a design in which the dimensions of these tables replace its own."""
    if not isinstance(tables, dict) or not all(isinstance(table, dict) for table in tables.values()):
        raise DesignFileUnreadable(
            f"expected [hardware] of {path} to hold tables, got values; write [hardware.shell] and the like"
        )
    if unknown := [name for name in tables if name not in PART_TABLES]:
        raise DesignFileUnreadable(
            f"expected [hardware] tables {', '.join(PART_TABLES)}, got {unknown[0]!r} in {path}; correct or remove it"
        )
    new = {}
    for name, table in tables.items():
        part = getattr(design, name)
        new[name] = convert_tables_to_design({**asdict(part), **table}, type(part), path)
    return replace(design, **new)


def hardware_design_to_toml(design: HardwareDesign) -> str:
    """Return a design file with every dimension, which `read_hardware_design` reads back as the same design."""
    parts = {name: asdict(getattr(design, name)) for name in PART_TABLES}
    return f"{design_to_toml(design.sensor)}\n{tomli_w.dumps({HARDWARE_TABLE: {VARIANT_KEY: design.variant, **parts}})}"


def lens_view_radius_mm(design: HardwareDesign, height_mm: float | None = None) -> float:
    """Return the radius in mm that the lens sees at a height in the assembly, not below its front; at the skin if none is given.

    The pupil is taken to be at the lens front, where wide-angle lenses have it nearly.
    """
    levels, angle = design.heights, _lens_half_angle_rad(design)
    height = levels.skin if height_mm is None else height_mm
    air = min(height, levels.floor_top) - levels.lens_front
    acrylic = min(max(height - levels.floor_top, 0.0), design.window.thick_mm)
    silicone = max(height - levels.window_top, 0.0)
    return (
        air * tan(angle)
        + acrylic * _refracted_slope(angle, ACRYLIC_REFRACTIVE_INDEX)
        + silicone * _refracted_slope(angle, SILICONE_REFRACTIVE_INDEX)
    )


def sensing_corner_distance_mm(design: HardwareDesign) -> float:
    """Return the distance from the optical axis to a corner of the sensing area, which the lens must reach."""
    area = design.sensor.sensing_area
    return hypot(area.width_mm, area.height_mm) / 2


def required_camera_distance_mm(design: HardwareDesign) -> float:
    """Return the least camera distance from which the lens sees the corner of the sensing area."""
    more = (sensing_corner_distance_mm(design) - lens_view_radius_mm(design)) / _refracted_slope(
        _lens_half_angle_rad(design), SILICONE_REFRACTIVE_INDEX
    )
    return design.sensor.camera.distance_mm + more


def _lens_half_angle_rad(design: HardwareDesign) -> float:
    """Return half the angle that the lens sees in air."""
    return radians(design.sensor.camera.lens_angle_deg / 2)


def _refracted_slope(angle_rad: float, index: float) -> float:
    """Return the radius gained per mm of height in a material, by Snell's law."""
    return tan(asin(sin(angle_rad) / index))
