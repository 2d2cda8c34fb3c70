"""The design of a sensor: what is known of it before any image, and its TOML file, with one table per part of the design and
only what differs from the published sensor. The defaults are the published 9DTact.
"""

import tomllib
from dataclasses import asdict, dataclass, fields, is_dataclass
from math import isfinite
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, get_type_hints

import msgspec
import tomli_w

from ninedtact.checked_reading import convert_tables_to_class, read_text_file
from ninedtact.errors import FileFormatError, InputError

ACRYLIC_REFRACTIVE_INDEX, SILICONE_REFRACTIVE_INDEX = 1.49, 1.41
"""Handbook values of window and gel; no maker states those of these sheets and silicones."""


class DesignImpossible(InputError):
    """A dimension or a combination of dimensions that no sensor can have."""


def require_positive(name: str, value: float) -> None:
    """Refuse zero, negative values and not-a-number; raises `DesignImpossible`."""
    if not value > 0:
        raise DesignImpossible(f"expected {name} above zero, got {value}; correct the design")


@dataclass(frozen=True)
class Bounds:
    """The least and greatest value of a dimension: what moulds, silicones, lenses, printers and a computer's memory can do.

    They stand beside the type of a field, `Annotated[float, Bounds(0.3, 15.0)]`; each of several numbers keeps them. Every part of
    a `SensorDesign` keeps its own. Gels that belong to no sensor, as those of closed forms, are free; a camera very far away is one
    whose lines of sight are parallel.
    """

    least: float
    most: float


def require_within_bounds(table: str, part: object) -> None:
    """Refuse a part of which a dimension is out of its bounds; raises `DesignImpossible`.

    table: name of the part in the design file, for the message.
    """
    hints = get_type_hints(type(part), include_extras=True)
    for name, value in vars(part).items():
        for bounds in getattr(hints[name], "__metadata__", ()):
            for number in value if isinstance(value, tuple) else (value,):
                if not bounds.least <= number <= bounds.most:
                    raise DesignImpossible(
                        f"expected {table}.{name} from {bounds.least:g} to {bounds.most:g}, got {number:g}; correct the design"
                    )


@dataclass(frozen=True)
class Gel:
    """The translucent layer that is pressed, bonded to a stiffer transparent one."""

    thickness_mm: Annotated[float, Bounds(0.3, 15.0)] = 2.5
    shear_modulus_mpa: Annotated[float, Bounds(0.003, 3.0)] = 0.093
    """That of Shore A 5 by Gent's relation (docs/references.md); a calibration with known loads measures it far better."""
    poisson_ratio: float = 0.5
    """Silicone keeps its volume: 0.5 is exact, not a limit."""
    finite_strain: float = 0.0
    """Share of what neo-Hookean rubber does otherwise than a linear layer when it is pressed deep, 0 to 1; `calibrate` fits it."""

    def __post_init__(self) -> None:
        require_positive("gel.thickness_mm", self.thickness_mm)
        require_positive("gel.shear_modulus_mpa", self.shear_modulus_mpa)
        if not -1 < self.poisson_ratio <= 0.5:
            raise DesignImpossible(
                f"expected gel.poisson_ratio above −1 and at most 0.5, got {self.poisson_ratio}; correct the design"
            )
        if not 0 <= self.finite_strain <= 1:
            raise DesignImpossible(
                f"expected gel.finite_strain from 0 to 1, got {self.finite_strain}; correct the design"
            )


def shore_a_to_shear_modulus_mpa(shore_a: float) -> float:
    """Return the shear modulus in MPa of a rubber of this hardness (Gent 1958, docs/references.md; a third of his
    Young's modulus).

    Raises `DesignImpossible` outside of 1 to 95, where the scale has no meaning.
    """
    if not 1 <= shore_a <= 95:
        raise DesignImpossible(
            f"expected a Shore A hardness from 1 to 95, got {shore_a:g}; take a softer or harder gel"
        )
    return 0.0981 * (56 + 7.62336 * shore_a) / (0.137505 * (254 - 2.54 * shore_a)) / 3


def shear_modulus_mpa_to_shore_a(shear_modulus_mpa: float) -> float:
    """Return the Shore A hardness of a rubber of this shear modulus in MPa, by the same relation; below 1, where the scale has no
    meaning, for very soft rubbers."""
    stiffness = 3 * shear_modulus_mpa * 0.137505 / 0.0981
    return (254 * stiffness - 56) / (7.62336 + 2.54 * stiffness)


@dataclass(frozen=True)
class RectifiedImageSize:
    """The rectified image: its size in pixels, and the raw image for which one pixel there is one pixel here."""

    rows: Annotated[int, Bounds(16, 4000)] = 345
    cols: Annotated[int, Bounds(16, 4000)] = 460
    raw_long_side_px: Annotated[int, Bounds(64, 10_000)] = 640
    """A raw image of another size is rectified to the same number of mm, in the same number of pixels."""

    def __post_init__(self) -> None:
        for name in ("rows", "cols", "raw_long_side_px"):
            require_positive(f"field_of_view.{name}", getattr(self, name))


@dataclass(frozen=True)
class CameraGeometry:
    """The wide-angle camera under the gel, which looks straight up through the middle of the skin."""

    distance_mm: Annotated[float, Bounds(2.0, 1e7)] = 14.05
    """From the lens front to the untouched skin. So near, pressed skin is seen displaced outwards, see docs/accuracy.md."""

    lens_angle_deg: float = 160.0
    """Angle that the lens sees in air, from side to side along the image's diagonal."""

    def __post_init__(self) -> None:
        require_positive("camera.distance_mm", self.distance_mm)
        if not 20 <= self.lens_angle_deg <= 170:
            raise DesignImpossible(
                f"expected camera.lens_angle_deg from 20 to 170, got {self.lens_angle_deg}; correct the design"
            )


@dataclass(frozen=True)
class SensingArea:
    """The part of the skin that is evaluated, in the middle of a larger gel."""

    width_mm: Annotated[float, Bounds(4.0, 200.0)] = 24.0
    """Along x, the image's columns."""
    height_mm: Annotated[float, Bounds(4.0, 200.0)] = 18.0
    """Along y, the image's rows."""
    margin_mm: Annotated[tuple[float, float], Bounds(0.0, 50.0)] = (2.25, 1.75)
    """Distance of the area from the wall of the gel's opening, x and y: near a wall the gel is stiffer."""
    overlap_mm: Annotated[float, Bounds(0.0, 20.0)] = 0.5
    """How far the pressed gel lies on the rim around the opening, on each side."""

    def __post_init__(self) -> None:
        require_positive("sensing_area.width_mm", self.width_mm)
        require_positive("sensing_area.height_mm", self.height_mm)
        if not (min(self.margin_mm) >= 0 and self.overlap_mm >= 0):
            raise DesignImpossible(
                f"expected sensing_area margins and overlap of zero or more, got {self.margin_mm} and {self.overlap_mm}; "
                "correct the design"
            )

    @property
    def area_mm2(self) -> float:
        """Area in mm², width times height."""
        return self.width_mm * self.height_mm

    @property
    def size_mm(self) -> tuple[float, float]:
        """Width and height of the sensing area."""
        return self.width_mm, self.height_mm

    @property
    def opening_mm(self) -> tuple[float, float]:
        """Width and height of the opening that the gel fills."""
        return self.width_mm + 2 * self.margin_mm[0], self.height_mm + 2 * self.margin_mm[1]

    @property
    def gel_mm(self) -> tuple[float, float]:
        """Width and height of the pressed gel."""
        return self.opening_mm[0] + 2 * self.overlap_mm, self.opening_mm[1] + 2 * self.overlap_mm


@dataclass(frozen=True)
class PinBoard:
    """The calibration board: coplanar pins on a square lattice, long side along x."""

    rows: Annotated[int, Bounds(3, 60)] = 7
    cols: Annotated[int, Bounds(3, 60)] = 9
    pitch_mm: Annotated[float, Bounds(0.5, 30.0)] = 2.5
    pin_diameter_mm: Annotated[float, Bounds(0.2, 15.0)] = 1.2

    def __post_init__(self) -> None:
        require_positive("pin_board.pitch_mm", self.pitch_mm)
        require_positive("pin_board.pin_diameter_mm", self.pin_diameter_mm)
        if self.rows < 3 or self.cols < 3:
            raise DesignImpossible(
                f"expected a pin board of at least 3 x 3 pins, got {self.cols} x {self.rows}; a lens cannot be fitted to fewer"
            )

    @property
    def count(self) -> int:
        """Number of pins on the board."""
        return self.rows * self.cols


@dataclass(frozen=True)
class BallGauge:
    """The ball with which depth is calibrated."""

    radius_mm: Annotated[float, Bounds(0.5, 60.0)] = 4.0

    def __post_init__(self) -> None:
        require_positive("ball.radius_mm", self.radius_mm)


@dataclass(frozen=True)
class ForceTorqueMount:
    """Position and orientation of a force/torque sensor under the tactile sensor: its own frame in the sensor frame."""

    origin_mm: Annotated[tuple[float, float, float], Bounds(-1000.0, 1000.0)] = (0.0, 0.0, -35.0)
    """Origin of its frame; that of the paper lies 35 mm below the skin."""
    rotation_deg: Annotated[tuple[float, float, float], Bounds(-360.0, 360.0)] = (0.0, 0.0, 0.0)
    """Rotation of its frame about the sensor's x axis, then y, then z. With none, its z points out of the skin as the
    sensor's does."""
    sign: Literal[1, -1] = 1
    """1 for a device that reports the load on its tool side, on which the sensor stands; −1 for one that reports the
    reaction."""

    def __post_init__(self) -> None:
        for name in ("origin_mm", "rotation_deg"):
            if not all(map(isfinite, getattr(self, name))):
                raise DesignImpossible(
                    f"expected force_torque.{name} of three numbers, got {getattr(self, name)}; correct the design"
                )


@dataclass(frozen=True)
class SensorDesign:
    """The design of one sensor. The calibration searches for it, the twin simulates it, the hardware is built from it."""

    gel: Gel = Gel()
    sensing_area: SensingArea = SensingArea()
    camera: CameraGeometry = CameraGeometry()
    field_of_view: RectifiedImageSize = RectifiedImageSize()
    pin_board: PinBoard = PinBoard()
    ball: BallGauge = BallGauge()
    force_torque: ForceTorqueMount = ForceTorqueMount()

    def __post_init__(self) -> None:
        for table, part in vars(self).items():
            require_within_bounds(table, part)


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
    return convert_tables_to_design(
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


def convert_tables_to_design(tables: dict[str, Any], kind: type[Design], path: Path | str) -> Design:
    """Convert tables strictly to a design of this class; raises as `read_design_file` does."""
    _require_known_keys(tables, kind, path, ())
    try:
        return convert_tables_to_class(tables, kind)
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


PUBLISHED_RECTIFIED_COLS, PUBLISHED_MM_PER_PX = 460, 0.0522
"""The published rectified image of 24 mm. Smaller images show the same skin with larger pixels; wider skin has larger pixels
too."""


def rectified_mm_per_px(size: tuple[int, int], design: SensorDesign = SensorDesign()) -> float:
    """Return the pixel pitch of rectified images of this size (cols, rows), which are as wide as the sensing area."""
    return (
        PUBLISHED_MM_PER_PX
        * PUBLISHED_RECTIFIED_COLS
        / size[0]
        * (design.sensing_area.width_mm / SensingArea().width_mm)
    )


def rectified_grid_of_design(design: SensorDesign) -> tuple[tuple[int, int], float]:
    """Return the (rows, cols) and the mm per pixel of the rectified images of a design of which no sensor is calibrated yet."""
    view = design.field_of_view
    finer = view.raw_long_side_px / RectifiedImageSize().raw_long_side_px
    wider = design.sensing_area.width_mm / SensingArea().width_mm
    return (view.rows, view.cols), PUBLISHED_MM_PER_PX * wider / finer
