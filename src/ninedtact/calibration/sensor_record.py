"""What `sensor.toml` holds, field by field, as it stands in the file. Readable, diffable, enough to rebuild everything."""

from datetime import datetime

from msgspec import Struct, field

from ninedtact.calibration.ball.ball_fit import DepthMethod
from ninedtact.calibration.board.lattice import CameraRotation
from ninedtact.design import Gel, SensorDesign
from ninedtact.shape.deblur import Deblurring
from ninedtact.shape.depth import DepthCurve, Smoothing
from ninedtact.shape.loss import Loss
from ninedtact.simulation.illumination import BrightnessModel

SENSOR_FORMAT = 3
"""Rises when an older program could no longer read the file."""


class LensModelTable(Struct, tag_field="kind", tag="lens", frozen=True, forbid_unknown_fields=True):
    """`shape.lens.LensModel`, its parameters in image units."""

    homography: tuple[float, float, float, float, float, float, float, float]
    centre: tuple[float, float]
    radial: tuple[float, ...]
    tangential: tuple[float, float]


class PinMapTable(Struct, tag_field="kind", tag="paper", frozen=True, forbid_unknown_fields=True):
    """`shape.pin_map.PinMap`: the paper's map through these pins."""

    points_mm: list[tuple[float, float]]
    points_px: list[tuple[float, float]]


class PixelMapTable(Struct, tag_field="kind", tag="map", frozen=True, forbid_unknown_fields=True):
    """A rectification given pixel by pixel in a file of the folder, as the original project stores it."""

    file: str
    sha256: str


class GridTable(Struct, frozen=True, forbid_unknown_fields=True):
    """The rectified grid and the raw image."""

    mm_per_px: float
    raw_rows: int
    raw_cols: int
    calibrated_area_mm: tuple[float, float, float, float]
    """x from, x to, y from, y to."""
    camera_rotation_deg: CameraRotation = 0


class StoredImage(Struct, frozen=True, forbid_unknown_fields=True):
    """One image that the sensor was calibrated from."""

    file: str
    sha256: str


class BoardQuality(Struct, frozen=True, forbid_unknown_fields=True):
    """How good the camera calibration is."""

    pins_found: int
    pins_expected: int
    missing: list[str]
    loo_rms_mm: float
    """Root mean square of the leave-one-out error: each pin predicted from all others."""
    loo_max_mm: float
    loo_rms_mm_original: float
    """The same of the paper's way on the same image."""
    mm_per_px: float
    mm_per_px_error: float
    contrast_grey_levels: float
    noise_grey_levels: float
    lens: str
    camera_rotation_deg: CameraRotation


class BallQuality(Struct, frozen=True, forbid_unknown_fields=True):
    """How good the depth calibration is."""

    method: DepthMethod
    radius_px: float
    radius_mm: float
    """Of the contact circle."""
    ball_radius_mm: float
    deepest_mm: float
    fit_mae_mm: float
    half_mae_mm: float
    range_mm: float
    """Deepest indentation that the curve covers."""
    noise_mm: float
    drop_grey_levels: float
    asymmetry: float
    overexposed: float
    """Part of the reference image at or above 250."""


class Certificate(Struct, frozen=True, forbid_unknown_fields=True):
    """The figures of the calibration."""

    board: BoardQuality
    ball: BallQuality
    warnings: list[str]


class DepthTable(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """The depth curve and what follows it."""

    method: DepthMethod
    noise_mm: float
    smoothing: Smoothing
    curve: DepthCurve
    loss: Loss = Loss()
    deblurring: Deblurring | None = None
    """The point-spread that a fine reading undoes, where it is known."""


class FittedParameterTable(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """One number of the twin, how certain it is, and what it is hardest to tell from."""

    value: float
    deviation: float | None = None
    closest: str | None = None
    correlation: float | None = None


class TwinFitQuality(Struct, frozen=True, forbid_unknown_fields=True):
    """The fit of mechanics and light to the ball press."""

    rmse_grey_radial: float
    """Of the radial brightness profile, grey levels."""
    rmse_grey_image: float
    """Of the whole image within 8 mm of the contact, grey levels."""
    depth_mm: float
    drag_mm: tuple[float, float]
    """How far the ball was dragged after the press."""
    independent_points: float
    """As many observations the unexplained rest is worth."""
    seconds: float
    parameters: dict[str, FittedParameterTable]


class BoardPressTable(Struct, frozen=True, forbid_unknown_fields=True):
    """The board's image as the twin draws it."""

    believed: bool
    """Whether it looks as drawn; if not, lens and nearness are without it."""
    depth_mm: float
    """Of the imprints."""
    depth_error_mm: float
    inverse_distance_per_mm: float
    inverse_distance_error_per_mm: float
    point_spread_mm: float
    """Under the pins; the ball's is in the light."""
    unexplained_grey: float
    """Root mean square over the board, grey levels."""
    contrast_grey: float
    """Of the imprints in the raw image, grey levels."""


class TwinTable(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """What stands in for the sensor when it is not there."""

    gel: Gel
    """With the thickness that the image of the press shows."""
    light: BrightnessModel
    noise_grey_levels: float
    fit: TwinFitQuality
    imprints: BoardPressTable | None = None


class SensorRecord(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """The whole file."""

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
