"""The schema of `sensor.toml`: every table and key of a calibrated sensor, in the order of the file.

The file is readable and diffable, and together with the stored images it is enough to rebuild the sensor. Every `std` is one
standard deviation.
"""

import math
import re
from datetime import datetime
from typing import Annotated, Any

import msgspec
from msgspec import Meta, Struct, field

from ninedtact.bounds import require_within_bounds
from ninedtact.checked_reading import mapping_checksum
from ninedtact.design import Gel, SecondKind, SensorDesign
from ninedtact.errors import UNPRINTABLE, InputError
from ninedtact.force.estimator_and_scale import WIDEST_FACTOR
from ninedtact.mechanics.base_deflection import STIFFENING
from ninedtact.shape.deblurring import Deblurring
from ninedtact.shape.depth import DepthCurve, DepthMethod, GlobalDimmingModel, Smoothing
from ninedtact.shape.lens_and_rectification import (
    CameraRotation,
    LensModel,
    LensModelCorrection,
    Points,
    RadialBasisProjection,
)
from ninedtact.simulation.gel_brightness import BrightnessModel

SENSOR_FORMAT = 9
"""Format number, raised with every change that makes older files unreadable."""
NOT_CALIBRATED = ("format", "id", "created", "software")
"""Keys at the top of the file that the checksum leaves out: they may change without a change of any calibrated number."""
MAX_MISSING_FRACTION = 0.10
"""Largest fraction of the pins that may be predicted instead of detected."""
MAX_ASYMMETRY = 0.08
"""Asymmetry of the bulge above which a press of the ball counts as sheared (straight real press 0.013, sheared one 0.22)."""

_Number = Annotated[float, Meta(ge=-1e9, le=1e9)]
"""A finite number without a range of its own."""
_Error = Annotated[float, Meta(ge=0, le=1e9)]
"""A standard deviation or another error."""
_Grey = Annotated[float, Meta(ge=0, le=255)]
_Share = Annotated[float, Meta(ge=0, le=1)]
_Count = Annotated[int, Meta(ge=0, le=10_000)]
_SkinMm = Annotated[float, Meta(ge=-300, le=300)]
"""A position on the skin or along it."""
_DepthMm = Annotated[float, Meta(ge=0, le=15)]
_MmPerPx = Annotated[float, Meta(ge=0.001, le=1)]
_PixelSide = Annotated[int, Meta(ge=16, le=20_000)]
_Sha256 = Annotated[str, Meta(pattern="^[0-9a-f]{64}$")]


_Entry = Annotated[float, Meta(ge=-10, le=10)]
_Radial = Annotated[float, Meta(ge=-1000, le=1000)]
_Centre = Annotated[float, Meta(ge=-2, le=2)]
_RawPx = Annotated[float, Meta(ge=-20_000, le=20_000)]


class LensCorrectionTable(Struct, frozen=True, forbid_unknown_fields=True):
    """A smooth correction on top of the lens model (`LensModelCorrection`)."""

    width_mm: Annotated[float, Meta(ge=0.1, le=100)]
    points_mm: Annotated[list[tuple[_SkinMm, _SkinMm]], Meta(min_length=1)]
    weights_px: list[tuple[_RawPx, _RawPx]]

    def __post_init__(self) -> None:
        if len(self.weights_px) != len(self.points_mm):
            raise ValueError(
                f"{len(self.points_mm)} points_mm and {len(self.weights_px)} weights_px, not as many of both"
            )


class LensModelTable(
    Struct, tag_field="kind", tag="model", frozen=True, forbid_unknown_fields=True, omit_defaults=True
):
    """The parameters of `LensModel`: homography, distortion centre, radial and tangential terms, in image units."""

    homography: tuple[_Entry, _Entry, _Entry, _Entry, _Entry, _Entry, _Entry, _Entry]
    centre: tuple[_Centre, _Centre]
    radial: Annotated[tuple[_Radial, ...], Meta(max_length=8)]
    tangential: tuple[_Entry, _Entry]
    correction: LensCorrectionTable | None = None
    """None where the lens model alone predicts left-out pins as well."""


class PinMapTable(Struct, tag_field="kind", tag="paper", frozen=True, forbid_unknown_fields=True):
    """The pins through which the paper's map goes (`RadialBasisProjection`): on the skin and in the raw image."""

    points_mm: Annotated[list[tuple[_SkinMm, _SkinMm]], Meta(min_length=9)]
    points_px: list[tuple[_RawPx, _RawPx]]

    def __post_init__(self) -> None:
        if len(self.points_px) != len(self.points_mm):
            raise ValueError(
                f"{len(self.points_mm)} points_mm and {len(self.points_px)} points_px, not as many of both"
            )


def make_lens_model_table(lens: LensModel, correction: LensModelCorrection | None) -> LensModelTable:
    """Return a lens model with its correction, where it has one, as a table of the file."""
    table = correction and LensCorrectionTable(
        correction.width_mm, _to_pairs(correction.points_mm), _to_pairs(correction.weights_px)
    )
    return LensModelTable(lens.homography, lens.centre, lens.radial, lens.tangential, table)  # type: ignore[arg-type]


def make_pin_map_table(pin_map: RadialBasisProjection) -> PinMapTable:
    """Return the paper's map as a table of the file."""
    return PinMapTable(_to_pairs(pin_map.points_mm), _to_pairs(pin_map.points_px))


def _to_pairs(points: Points) -> list[tuple[float, float]]:
    return [(x, y) for x, y in points.tolist()]


class PixelMapTable(Struct, tag_field="kind", tag="map", frozen=True, forbid_unknown_fields=True):
    """A rectification given pixel by pixel in a file of the folder, as imported from the original project."""

    file: str
    sha256: _Sha256


class GridTable(Struct, frozen=True, forbid_unknown_fields=True):
    """The rectified grid and the size of the raw image."""

    mm_per_px: _MmPerPx
    raw_rows: _PixelSide
    raw_cols: _PixelSide
    calibrated_area_mm: tuple[_SkinMm, _SkinMm, _SkinMm, _SkinMm]
    """Smallest and largest x, then smallest and largest y, of the area that the board's pins cover."""
    camera_rotation_deg: CameraRotation = 0
    camera_mirrored: bool = False
    """Whether the camera mirrors its images left to right."""

    def __post_init__(self) -> None:
        left, right, top, bottom = self.calibrated_area_mm
        if not (left < right and top < bottom):
            raise ValueError(f"a calibrated_area_mm without area, {self.calibrated_area_mm}")


class StoredCalibrationImage(Struct, frozen=True, forbid_unknown_fields=True):
    """One image that the sensor was calibrated from: its path in the folder and its hash."""

    file: str
    sha256: _Sha256


class BoardQuality(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """The quality of the camera calibration."""

    pins_found: _Count
    pins_expected: _Count
    missing_pins: list[str]
    leave_one_out_rms_mm: _Error
    """Root mean square of the leave-one-out error: each pin predicted from all others."""
    leave_one_out_max_mm: _Error
    published_method_rms_mm: _Error
    """Leave-one-out error (RMS) of the paper's method on the same image."""
    mm_per_px: _MmPerPx
    mm_per_px_std: _Error
    contrast_grey_levels: _Number
    """Median darkening of the imprints."""
    noise_grey_levels: _Grey
    """Standard deviation of one raw pixel."""
    lens: str
    camera_rotation_deg: CameraRotation
    uncorrected_rms_mm: _Error | None = None
    """Leave-one-out error (RMS) of the lens model without its smooth correction; None where no correction is used."""


class BallQuality(Struct, frozen=True, forbid_unknown_fields=True):
    """The quality of the depth calibration."""

    method: DepthMethod
    contact_radius_px: _Error
    contact_radius_mm: _Error
    ball_radius_mm: _Error
    max_indentation_mm: _DepthMm
    """Depth of the ball's lowest point."""
    reconstruction_mae_mm: _Error
    """Mean absolute error of the ball's reconstructed surface."""
    cross_validation_mae_mm: _Error
    """Mean absolute error of one half of the disc, reconstructed with the curve of the other half, over four cuts."""
    range_mm: _DepthMm
    """Largest indentation that the depth curve covers."""
    noise_mm: _DepthMm
    """Standard deviation of one pixel's height from image to image."""
    darkening_grey_levels: _Number
    """Darkening at the deepest point."""
    asymmetry: _Number
    """Unevenness of the bulge around the disc, as a fraction of the darkening."""
    overexposed_fraction: _Share
    """Fraction of the reference image at or above grey level 250."""


class LengthPlausibility(Struct, frozen=True, forbid_unknown_fields=True):
    """Whether the stated pitch of the board and radius of the ball are those of other sensors of the design."""

    pitch_mm: _Error
    pitch_wrong_probability: _Share
    likely_pitch_mm: _Error
    """The pitch that fits best, should the stated one be wrong."""
    ball_radius_mm: _Error
    ball_radius_wrong_probability: _Share
    likely_ball_radius_mm: _Error
    """The radius that fits best, should the stated one be wrong."""

    @property
    def wrong_probability(self) -> float:
        """Probability that one of the two lengths is wrong."""
        return self.pitch_wrong_probability + self.ball_radius_wrong_probability


class SecondPressQuality(Struct, frozen=True, forbid_unknown_fields=True):
    """The press of a second object, which was fitted together with the first ball."""

    radius_mm: _Error
    """Radius of the ball, or of the rod with the flat end."""
    max_indentation_mm: _DepthMm
    """Depth of its lowest point."""
    max_indentation_std_mm: _Error
    residual_rms_grey_levels: _Error
    first_mm: _DepthMm
    """Depth of the first ball's lowest point, by its own press and this one."""
    first_std_mm: _Error
    """Its standard deviation."""
    first_alone_mm: _DepthMm
    """The same depth by the press of the first ball alone."""
    first_std_alone_mm: _Error
    """Its standard deviation."""
    stated_mm: _Error
    """The stated length that the images test: the radius of a ball, the depth of a flat end."""
    stated_std_mm: _Error
    """Its stated error; zero for a radius."""
    likely_mm: _Error
    """The length that fits both images best, if the radius of the first ball is right."""
    likely_std_mm: _Error

    @property
    def stated_deviation(self) -> float:
        """Difference of the stated length from that of the images, in standard deviations."""
        return abs(self.likely_mm - self.stated_mm) / math.hypot(self.likely_std_mm, self.stated_std_mm)

    @property
    def first_deviation(self) -> float:
        """Difference of the two depths of the first ball, in standard deviations of that by its own press alone."""
        return abs(self.first_mm - self.first_alone_mm) / self.first_std_alone_mm


class ProbableCause(Struct, frozen=True, forbid_unknown_fields=True):
    """The most probable cause of what is wrong with images or a calibration."""

    cause: str
    """Its name, such as "out of focus"; "unknown" where checks fail and nothing explains it."""
    because: str
    """The evidence."""
    remedy: str
    """What to do."""

    @property
    def sentence(self) -> str:
        """All three in one line."""
        return f"most probable cause: {self.cause}, because {self.because}; {self.remedy}"


class Certificate(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """The quality of both calibrations, and warnings in words."""

    board: BoardQuality | None = None
    """None where the lens was imported."""
    ball: BallQuality | None = None
    """None where no ball has been pressed yet."""
    second_ball: SecondPressQuality | None = None
    """None where no second ball was pressed."""
    flat_end: SecondPressQuality | None = None
    """None where no flat end was pressed."""
    lengths: LengthPlausibility | None = None
    """None where the lens was imported and no twin was fitted."""
    warnings: list[str] = field(default_factory=list)
    cause: ProbableCause | None = None
    """What probably causes all that is not as it should be; None where all is."""

    @property
    def second_presses(self) -> "dict[SecondKind, SecondPressQuality]":
        """The second presses that were made, by what was pressed."""
        made: dict[SecondKind, SecondPressQuality | None] = {"second_ball": self.second_ball, "flat_end": self.flat_end}
        return {kind: quality for kind, quality in made.items() if quality is not None}


class DepthTable(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """The depth curve and the corrections before and after it."""

    method: DepthMethod
    noise_mm: _DepthMm
    smoothing: Smoothing
    curve: DepthCurve
    dimming: GlobalDimmingModel = GlobalDimmingModel()
    """The loss of light of the whole image when a part of the skin is dark."""
    deblurring: Deblurring | None = None
    """The point spread that a fine reconstruction removes, where it is known."""
    base_stiffening: Annotated[float, Meta(ge=0, le=10)] = STIFFENING
    """How much more the base of this gel yields at finite strain (`BaseDeflection.stiffening`)."""


_Correlation = Annotated[float, Meta(ge=-1.000001, le=1.000001)]
_InverseDistance = Annotated[float, Meta(ge=-1, le=1)]


class FittedParameterTable(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """One parameter of the twin, its uncertainty, and the parameter that it is most correlated with."""

    value: _Number
    std: _Error | None = None
    most_correlated_with: str | None = None
    correlation: _Correlation | None = None


class TwinFitQuality(Struct, frozen=True, forbid_unknown_fields=True):
    """The fit of contact mechanics and light to the ball press."""

    radial_rmse_grey_levels: _Error
    """Root mean square residual of the radial brightness profile."""
    image_rmse_grey_levels: _Error
    """Root mean square residual of the whole image within 8 mm of the contact."""
    depth_mm: _DepthMm
    drag_mm: tuple[_SkinMm, _SkinMm]
    """Displacement of the ball along the skin after the press."""
    effective_observations: _Error
    """Effective number of independent observations, from the correlation of the residual."""
    duration_s: _Error
    parameters: dict[str, FittedParameterTable]


class BoardPressFitTable(Struct, frozen=True, forbid_unknown_fields=True):
    """The fit of the twin to the image of the pressed board."""

    accepted: bool
    """Whether the image agrees with the twin's prediction. If it does not, lens and viewing distance do not use the fit."""
    depth_mm: _DepthMm
    """Depth of the imprints."""
    depth_std_mm: _Error
    inverse_distance_per_mm: _InverseDistance
    inverse_distance_std_per_mm: _Error
    point_spread_mm: _DepthMm
    """Point spread under the pins; that under the ball is in the light."""
    residual_rms_grey_levels: _Error
    contrast_grey_levels: _Number
    """Median darkening of the imprints in the raw image."""


class TwinTable(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """The sensor's digital twin."""

    gel: Gel
    """The design's gel with the thickness that the ball press shows."""
    light: BrightnessModel
    noise_grey_levels: _Grey
    fit: TwinFitQuality
    board_press: BoardPressFitTable | None = None

    def __post_init__(self) -> None:
        require_within_bounds(self.gel, "gel")

    @property
    def modulus_ratio_std(self) -> float | None:
        """Standard deviation of the modulus of the gel over that of its base, by the ball; None where it is not stated."""
        ratio = self.fit.parameters.get("gel_to_base_modulus_ratio")
        return None if ratio is None else ratio.std


class KnownLoadTable(Struct, frozen=True, forbid_unknown_fields=True):
    """What presses with known loads determined of the gel (`ninedtact adapt`); its modulus and base are those of the twin's gel."""

    presses: Annotated[int, Meta(ge=1, le=10_000)]
    error: _Share
    """Relative error that modulus and base leave of all forces like the known ones."""
    modulus_std: _Share
    """Relative standard deviation of the shear modulus."""
    modulus_ratio_std: _Error
    """Standard deviation of `gel_to_base_modulus_ratio`."""
    correlation: _Correlation
    """Correlation of the logarithm of the modulus with the ratio."""
    calibrated_modulus_ratio: Annotated[float, Meta(ge=0, le=10)]
    """The ratio by the image of the ball alone, with which another `ninedtact adapt` begins."""
    calibrated_modulus_ratio_std: _Error
    shear_factor: Annotated[float, Meta(ge=1 / WIDEST_FACTOR, le=WIDEST_FACTOR)] = 1.0
    """Factor on F_x, F_y and T_z beyond the modulus, which a recording with a force/torque sensor tells."""
    shear_std: _Share = 0.0
    """Relative standard deviation of that factor."""


_SENSOR_ID = re.compile(r"(?!\.{1,2}\Z)[^\t\n/\\]{1,100}")
"""Names are shown on pages, stand in tables and may become names of folders."""


def require_sensor_id(sensor_id: str) -> None:
    """Raise `InputError` for text that is no name of a sensor."""
    if not _SENSOR_ID.fullmatch(sensor_id) or UNPRINTABLE.search(sensor_id):
        raise InputError(
            expected="a name of a sensor of 1 to 100 printable characters without slashes",
            got=f"{sensor_id[:120]!r}",
            remedy="choose another, or give one with --id",
        )


class SensorTomlRecord(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """The whole file `sensor.toml`."""

    format: int
    id: str
    created: datetime
    software: str
    design: SensorDesign
    grid: GridTable
    lens: LensModelTable | PinMapTable | PixelMapTable
    depth: DepthTable | None = None
    """None where no ball has been pressed yet."""
    twin: TwinTable | None = None
    known_loads: KnownLoadTable | None = None
    """None where no press was weighed, or for forces by a network."""
    images: dict[str, StoredCalibrationImage] = field(default_factory=dict)
    certificate: Certificate | None = None

    def __post_init__(self) -> None:
        require_sensor_id(self.id)


def sensor_record_checksum(record: SensorTomlRecord) -> str:
    """Return the checksum of all calibrated numbers of a sensor."""
    return mapping_checksum(sensor_record_tables(record), NOT_CALIBRATED)


def sensor_record_tables(record: SensorTomlRecord) -> dict[str, Any]:
    """Return the tables of `sensor.toml`, without the checksum."""
    tables: dict[str, Any] = msgspec.to_builtins(record, builtin_types=(datetime,))
    return tables
