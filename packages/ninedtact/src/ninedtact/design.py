"""The design of a sensor: what is known of it before any image, and its TOML file, with one table per part of the design and
only what differs from the published sensor. The defaults are the published 9DTact.
"""

from dataclasses import asdict, dataclass, fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, get_args, get_type_hints

import msgspec
import tomli_w
from msgspec import Meta

from ninedtact.bounds import checks_arguments, require_within_bounds
from ninedtact.checked_reading import convert_tables_to_class, parse_toml, read_text_file
from ninedtact.errors import FileFormatError, InputError

ACRYLIC_REFRACTIVE_INDEX, SILICONE_REFRACTIVE_INDEX = 1.49, 1.41
"""Handbook values of window and gel; no maker states those of these sheets and silicones."""


_MarginMm = Annotated[float, Meta(ge=0, le=50)]
_OriginMm = Annotated[float, Meta(ge=-1000, le=1000)]
_RelaxingShare = Annotated[float, Meta(ge=0, le=0.9)]
_RelaxationTimeS = Annotated[float, Meta(ge=0.01, le=1e5)]
_AngleDeg = Annotated[float, Meta(ge=-360, le=360)]


class DesignImpossible(InputError):
    """A dimension or a combination of dimensions that no sensor can have."""


def require_positive(name: str, value: float) -> None:
    """Refuse zero, negative values and not-a-number; raises `DesignImpossible`."""
    if not value > 0:
        raise DesignImpossible(expected=f"{name} above zero", got=f"{value}", remedy="correct the design")


_MAX_DEPTH_ON_YIELDING_BASE = 1.25
"""Depth over thickness to which presses were compared with finite elements (docs/mechanics.md)."""


@dataclass(frozen=True)
class Gel:
    """The translucent layer that is pressed, bonded to a stiffer transparent one."""

    thickness_mm: Annotated[float, Meta(ge=0.3, le=15.0)] = 2.5
    shear_modulus_mpa: Annotated[float, Meta(ge=0.003, le=3.0)] = 0.093
    """That of Shore A 5 by Gent's relation (docs/references.md); a calibration with known loads measures it far better."""
    poisson_ratio: float = 0.5
    """Silicone keeps its volume: 0.5 is exact, not a limit."""
    finite_strain: float = 1.0
    """Share of what neo-Hookean rubber does otherwise than a linear layer when it is pressed deep, 0 to 1."""
    base_thickness_mm: Annotated[float, Meta(ge=0.1, le=100.0)] = 9.2
    """Thickness of the transparent layer that the gel is bonded to, above the window."""
    gel_to_base_modulus_ratio: Annotated[float, Meta(ge=0, le=10)] = 0.04
    """Shear modulus of the gel over that of the transparent layer below it; zero is a rigid base. Tables of Shore hardness give
    0.1 to 0.14 for Shore A 5 on Shore A 45, and images of balls on real sensors rather 0.01 to 0.06."""
    relaxing_shares: tuple[_RelaxingShare, ...] = (0.04, 0.05)
    """Shares of the modulus that are lost while an object is held, one for each term of a Prony series. No maker states them; they
    are known to a factor of two (docs/mechanics.md)."""
    relaxation_times_s: tuple[_RelaxationTimeS, ...] = (5.0, 100.0)
    """The time of each term."""

    def __post_init__(self) -> None:
        # A gel of a closed form, or of one step of a fit, may be thicker or softer than one that is made.
        require_positive("gel.thickness_mm", self.thickness_mm)
        require_positive("gel.shear_modulus_mpa", self.shear_modulus_mpa)
        shares, times_s, ratio = self.relaxing_shares, self.relaxation_times_s, self.gel_to_base_modulus_ratio
        are_terms = len(shares) == len(times_s) and sum(shares) < 1 and all(time_s > 0 for time_s in times_s)
        for expected, got, holds in (
            ("gel.poisson_ratio above −1 and at most 0.5", self.poisson_ratio, -1 < self.poisson_ratio <= 0.5),
            ("gel.finite_strain from 0 to 1", self.finite_strain, 0 <= self.finite_strain <= 1),
            (
                "gel.base_thickness_mm above zero (a gel without a layer below it has gel.gel_to_base_modulus_ratio 0)",
                self.base_thickness_mm,
                self.base_thickness_mm > 0,
            ),
            (
                "gel.relaxing_shares below 1 in all, and as many gel.relaxation_times_s above zero",
                f"{shares} and {times_s}",
                are_terms,
            ),
            ("gel.gel_to_base_modulus_ratio from 0, a rigid base, to 10", ratio, 0 <= ratio <= 10),
        ):
            if not holds:
                raise DesignImpossible(expected=expected, got=f"{got}", remedy="correct the design")

    @property
    def has_rigid_base(self) -> bool:
        """Whether the layer below the gel does not yield."""
        return self.gel_to_base_modulus_ratio == 0

    @property
    def base(self) -> "Gel":
        """The layer below the gel, bonded to the rigid window; only where it yields."""
        return Gel(self.base_thickness_mm, self.shear_modulus_mpa / self.gel_to_base_modulus_ratio, self.poisson_ratio)

    @property
    def max_depth_mm(self) -> float:
        """How deep an object can be pressed: to a rigid base, or on one that yields as deep as the model of the gel was checked."""
        return self.thickness_mm * (1.0 if self.has_rigid_base else _MAX_DEPTH_ON_YIELDING_BASE)


def shore_a_to_shear_modulus_mpa(shore_a: float) -> float:
    """Return the shear modulus in MPa of a rubber of this hardness (Gent 1958, docs/references.md; a third of his
    Young's modulus).

    Raises `DesignImpossible` outside of 1 to 95, where the scale has no meaning.
    """
    if not 1 <= shore_a <= 95:
        raise DesignImpossible(
            expected="a Shore A hardness from 1 to 95", got=f"{shore_a:g}", remedy="take a softer or harder gel"
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

    rows: Annotated[int, Meta(ge=16, le=4000)] = 345
    cols: Annotated[int, Meta(ge=16, le=4000)] = 460
    raw_long_side_px: Annotated[int, Meta(ge=64, le=10_000)] = 640
    """A raw image of another size is rectified to the same number of mm, in the same number of pixels."""

    def __post_init__(self) -> None:
        require_within_bounds(self, "field_of_view", DesignImpossible)


@dataclass(frozen=True)
class CameraGeometry:
    """The wide-angle camera under the gel, which looks straight up through the middle of the skin."""

    distance_mm: Annotated[float, Meta(ge=2.0, le=1e7)] = 14.05
    """From the lens front to the untouched skin. So near, pressed skin is seen displaced outwards, see docs/accuracy.md."""

    lens_angle_deg: Annotated[float, Meta(ge=20, le=170)] = 160.0
    """Angle that the lens sees in air, from side to side along the image's diagonal."""

    def __post_init__(self) -> None:
        require_within_bounds(self, "camera", DesignImpossible)


@dataclass(frozen=True)
class SensingArea:
    """The part of the skin that is evaluated, in the middle of a larger gel."""

    width_mm: Annotated[float, Meta(ge=4.0, le=200.0)] = 24.0
    """Along x, the image's columns."""
    height_mm: Annotated[float, Meta(ge=4.0, le=200.0)] = 18.0
    """Along y, the image's rows."""
    margin_mm: tuple[_MarginMm, _MarginMm] = (2.25, 1.75)
    """Distance of the area from the wall of the gel's opening, x and y: near a wall the gel is stiffer."""
    overlap_mm: Annotated[float, Meta(ge=0.0, le=20.0)] = 0.5
    """How far the pressed gel lies on the rim around the opening, on each side."""

    def __post_init__(self) -> None:
        require_within_bounds(self, "sensing_area", DesignImpossible)

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

    rows: Annotated[int, Meta(ge=3, le=60)] = 7
    cols: Annotated[int, Meta(ge=3, le=60)] = 9
    pitch_mm: Annotated[float, Meta(ge=0.5, le=30.0)] = 2.5
    pin_diameter_mm: Annotated[float, Meta(ge=0.2, le=15.0)] = 1.2

    def __post_init__(self) -> None:
        require_within_bounds(self, "pin_board", DesignImpossible)

    @property
    def count(self) -> int:
        """Number of pins on the board."""
        return self.rows * self.cols


@dataclass(frozen=True)
class BallGauge:
    """The balls with which depth is calibrated."""

    radius_mm: Annotated[float, Meta(ge=0.5, le=60.0)] = 4.0
    second_radius_mm: Annotated[float, Meta(ge=0.5, le=60.0)] = 2.5
    """Radius of the second ball, which need not be pressed; it tells the base of the gel, and so the true depth. That of the first
    where the same ball is pressed again, to another depth."""

    @property
    def second(self) -> "BallGauge":
        """The second ball alone."""
        return BallGauge(self.second_radius_mm, self.second_radius_mm)

    def __post_init__(self) -> None:
        require_within_bounds(self, "ball", DesignImpossible)


SecondKind = Literal["second_ball", "flat_end"]
"""What can be pressed second, which is also the name of its image; that of the skin before it ends in "_reference"."""
SECOND_KINDS: tuple[SecondKind, ...] = get_args(SecondKind)


@dataclass(frozen=True)
class FlatEndGauge:
    """The flat end of a round rod, such as the shank of a drill or a dowel pin, that a stop lets into the gel to a known depth."""

    radius_mm: Annotated[float, Meta(ge=2.0, le=6.0)] = 3.0
    """Radius of the rod, whose edge is at most lightly broken."""
    depth_mm: Annotated[float, Meta(ge=0.2, le=3.0)] = 0.6
    """How deep the stop lets it go, from the first touch."""
    depth_error_mm: Annotated[float, Meta(ge=0.005, le=0.5)] = 0.03
    """Standard deviation of that depth, first touch and tilt included."""

    def __post_init__(self) -> None:
        require_within_bounds(self, "flat_end", DesignImpossible)


@dataclass(frozen=True)
class ForceTorqueMount:
    """Position and orientation of a force/torque sensor under the tactile sensor: its own frame in the sensor frame."""

    origin_mm: tuple[_OriginMm, _OriginMm, _OriginMm] = (0.0, 0.0, -35.0)
    """Origin of its frame; that of the paper lies 35 mm below the skin."""
    rotation_deg: tuple[_AngleDeg, _AngleDeg, _AngleDeg] = (0.0, 0.0, 0.0)
    """Rotation of its frame about the sensor's x axis, then y, then z. With none, its z points out of the skin as the
    sensor's does."""
    sign: Literal[1, -1] = 1
    """1 for a device that reports the load on its tool side, on which the sensor stands; −1 for one that reports the
    reaction."""

    def __post_init__(self) -> None:
        require_within_bounds(self, "force_torque", DesignImpossible)


@checks_arguments
@dataclass(frozen=True)
class SensorDesign:
    """The design of one sensor. The calibration searches for it, the twin simulates it, the hardware is built from it."""

    gel: Gel = Gel()
    sensing_area: SensingArea = SensingArea()
    camera: CameraGeometry = CameraGeometry()
    field_of_view: RectifiedImageSize = RectifiedImageSize()
    pin_board: PinBoard = PinBoard()
    ball: BallGauge = BallGauge()
    flat_end: FlatEndGauge = FlatEndGauge()
    force_torque: ForceTorqueMount = ForceTorqueMount()

    def __post_init__(self) -> None:
        require_within_bounds(self.gel, "gel", DesignImpossible)
        ratio = self.gel.gel_to_base_modulus_ratio
        if ratio > 1 or 0 < ratio < self.gel.shear_modulus_mpa / _GLASS_SHEAR_MODULUS_MPA:
            raise DesignImpossible(
                expected="a base between the gel and glass in stiffness (gel.gel_to_base_modulus_ratio up to 1)",
                got=f"one {'softer than the gel' if ratio > 1 else 'stiffer than glass'} ({ratio:g})",
                remedy="give the modulus of the gel over that of the layer below it, and 0 for a rigid base",
            )


_GLASS_SHEAR_MODULUS_MPA = 30_000.0

HARDWARE_TABLE = "hardware"
"""Table of the parts' own dimensions, which only the package `hardware` reads."""
Design = TypeVar("Design")


def read_design_file(path: Path | str) -> SensorDesign:
    """Read a sensor design; what the file does not state is as in the published sensor.

    Raises `FileFormatError`, and `DesignImpossible` for dimensions that no sensor can have.
    """
    return sensor_design_from_tables(read_design_tables(path), path)


def sensor_design_from_tables(tables: dict[str, Any], path: Path | str) -> SensorDesign:
    """Return the sensor design of a file's tables without those of the hardware; raises as `read_design_file` does."""
    return convert_tables_to_design(
        {name: part for name, part in tables.items() if name != HARDWARE_TABLE}, SensorDesign, path
    )


def read_design_tables(path: Path | str) -> dict[str, Any]:
    """Read the file's tables, of a sensor folder's `sensor.toml` those of its design; raises `FileFormatError`."""
    try:
        tables = parse_toml(read_text_file(path))
    except (OSError, ValueError) as trouble:
        raise FileFormatError(
            expected="a design in TOML",
            got=f"{path} ({trouble})",
            remedy="give a file such as 'ninedtact hardware export' writes",
        ) from trouble
    is_sensor = "format" in tables and isinstance(tables.get("design"), dict)
    return dict(tables["design"]) if is_sensor else tables


def convert_tables_to_design(tables: dict[str, Any], kind: type[Design], path: Path | str) -> Design:
    """Convert tables strictly to a design of this class; raises as `read_design_file` does."""
    _require_known_keys(tables, kind, path, ())
    try:
        return convert_tables_to_class(tables, kind)
    except msgspec.ValidationError as trouble:
        raise FileFormatError(
            f"expected {path} to hold a possible value in every place, got: {trouble}; correct the file"
        ) from trouble


def _require_known_keys(tables: dict[str, Any], kind: type[Any], path: Path | str, within: tuple[str, ...]) -> None:
    """Refuse keys that the design does not have; raises `FileFormatError`."""
    hints, known = get_type_hints(kind), {field.name for field in fields(kind)}
    for name, value in tables.items():
        if name not in known:
            where = f" in [{'.'.join(within)}]" if within else ""
            more = f", {HARDWARE_TABLE}" if kind is SensorDesign else ""
            raise FileFormatError(
                expected=f"one of {', '.join(sorted(known))}{more}{where}",
                got=f"{name!r} in {path}",
                remedy="correct or remove it",
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
