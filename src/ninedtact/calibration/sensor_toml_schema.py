"""The schema of `sensor.toml`: every table and key of a calibrated sensor, in the order of the file.

The file is readable and diffable, and together with the stored images it is enough to rebuild the sensor. Every `std` is one
standard deviation.
"""

from datetime import datetime

from msgspec import Struct, field

from ninedtact.design import Gel, SensorDesign
from ninedtact.shape.depth import Deblurring, DepthCurve, DepthMethod, LightLoss, Smoothing
from ninedtact.shape.rectification import CameraRotation
from ninedtact.simulation.illumination import BrightnessModel

SENSOR_FORMAT = 4
"""Format number, raised with every change that makes older files unreadable. `sensor_folder` refuses such a file with the
command that calibrates the sensor again from its images.
"""


class LensModelTable(Struct, tag_field="kind", tag="model", frozen=True, forbid_unknown_fields=True):
    """The parameters of `shape.lens.LensModel`: homography, distortion centre, radial and tangential terms, in image units."""

    homography: tuple[float, float, float, float, float, float, float, float]
    centre: tuple[float, float]
    radial: tuple[float, ...]
    tangential: tuple[float, float]


class PinMapTable(Struct, tag_field="kind", tag="paper", frozen=True, forbid_unknown_fields=True):
    """The pins through which the paper's map goes (`shape.lens.PinMap`): on the skin and in the raw image."""

    points_mm: list[tuple[float, float]]
    points_px: list[tuple[float, float]]


class PixelMapTable(Struct, tag_field="kind", tag="map", frozen=True, forbid_unknown_fields=True):
    """A rectification given pixel by pixel in a file of the folder, as imported from the original project."""

    file: str
    sha256: str


class GridTable(Struct, frozen=True, forbid_unknown_fields=True):
    """The rectified grid and the size of the raw image."""

    mm_per_px: float
    raw_rows: int
    raw_cols: int
    calibrated_area_mm: tuple[float, float, float, float]
    """Smallest and largest x, then smallest and largest y, of the area that the board's pins cover."""
    camera_rotation_deg: CameraRotation = 0


class StoredImage(Struct, frozen=True, forbid_unknown_fields=True):
    """One image that the sensor was calibrated from: its path in the folder and its hash."""

    file: str
    sha256: str


class BoardQuality(Struct, frozen=True, forbid_unknown_fields=True):
    """The quality of the camera calibration."""

    pins_found: int
    pins_expected: int
    missing_pins: list[str]
    leave_one_out_rms_mm: float
    """Root mean square of the leave-one-out error: each pin predicted from all others."""
    leave_one_out_max_mm: float
    published_method_rms_mm: float
    """Leave-one-out error (RMS) of the paper's method on the same image."""
    mm_per_px: float
    mm_per_px_std: float
    contrast_grey_levels: float
    """Median darkening of the imprints."""
    noise_grey_levels: float
    """Standard deviation of one raw pixel."""
    lens: str
    camera_rotation_deg: CameraRotation


class BallQuality(Struct, frozen=True, forbid_unknown_fields=True):
    """The quality of the depth calibration."""

    method: DepthMethod
    contact_radius_px: float
    contact_radius_mm: float
    ball_radius_mm: float
    max_indentation_mm: float
    """Depth of the ball's lowest point."""
    reconstruction_mae_mm: float
    """Mean absolute error of the ball's reconstructed surface."""
    cross_validation_mae_mm: float
    """Mean absolute error of one half of the disc, reconstructed with the curve of the other half, over four cuts."""
    range_mm: float
    """Largest indentation that the depth curve covers."""
    noise_mm: float
    """Standard deviation of one pixel's height from image to image."""
    darkening_grey_levels: float
    """Darkening at the deepest point."""
    asymmetry: float
    """Unevenness of the bulge around the disc, as a fraction of the darkening."""
    overexposed_fraction: float
    """Fraction of the reference image at or above grey level 250."""


class Certificate(Struct, frozen=True, forbid_unknown_fields=True):
    """The quality of both calibrations, and warnings in words."""

    board: BoardQuality
    ball: BallQuality
    warnings: list[str]


class DepthTable(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """The depth curve and the corrections before and after it."""

    method: DepthMethod
    noise_mm: float
    smoothing: Smoothing
    curve: DepthCurve
    dimming: LightLoss = LightLoss()
    """The loss of light of the whole image when a part of the skin is dark."""
    deblurring: Deblurring | None = None
    """The point spread that a fine reconstruction removes, where it is known."""


class FittedParameterTable(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """One parameter of the twin, its uncertainty, and the parameter that it is most correlated with."""

    value: float
    std: float | None = None
    most_correlated_with: str | None = None
    correlation: float | None = None


class TwinFitQuality(Struct, frozen=True, forbid_unknown_fields=True):
    """The fit of contact mechanics and light to the ball press."""

    radial_rmse_grey_levels: float
    """Root mean square residual of the radial brightness profile."""
    image_rmse_grey_levels: float
    """Root mean square residual of the whole image within 8 mm of the contact."""
    depth_mm: float
    drag_mm: tuple[float, float]
    """Displacement of the ball along the skin after the press."""
    effective_observations: float
    """Effective number of independent observations, from the correlation of the residual."""
    duration_s: float
    parameters: dict[str, FittedParameterTable]


class BoardPressTable(Struct, frozen=True, forbid_unknown_fields=True):
    """The fit of the twin to the image of the pressed board."""

    accepted: bool
    """Whether the image agrees with the twin's prediction. If it does not, lens and viewing distance do not use the fit."""
    depth_mm: float
    """Depth of the imprints."""
    depth_std_mm: float
    inverse_distance_per_mm: float
    inverse_distance_std_per_mm: float
    point_spread_mm: float
    """Point spread under the pins; that under the ball is in the light."""
    residual_rms_grey_levels: float
    contrast_grey_levels: float
    """Median darkening of the imprints in the raw image."""


class TwinTable(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """The sensor's digital twin."""

    gel: Gel
    """The design's gel with the thickness that the ball press shows."""
    light: BrightnessModel
    noise_grey_levels: float
    fit: TwinFitQuality
    board_press: BoardPressTable | None = None


class SensorRecord(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """The whole file `sensor.toml`."""

    format: int
    id: str
    created: datetime
    software: str
    design: SensorDesign
    grid: GridTable
    lens: LensModelTable | PinMapTable | PixelMapTable
    depth: DepthTable
    twin: TwinTable | None = None
    images: dict[str, StoredImage] = field(default_factory=dict)
    certificate: Certificate | None = None
