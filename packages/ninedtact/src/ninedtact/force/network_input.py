"""Construction of the input of force networks from a reading, and from stored training examples.

    heights              Reading.height ─▶ orthorectified heights ─▶ divided by the gel's thickness (─▶ features of the sensor)
    deformation, mixed   Reading.rectified, .reference ─▶ darker, brighter, reference

Training stores heights in mm (`orthorectification.orthorectified_heights`) or grey images, augments them, and then calls the same
stacking functions as the live path.

The features of a sensor are its gel's thickness and the parameters of its light. The calibration fits them to a ball press and
assumes a rigid base. Above a compliant base they therefore differ from those of any gel on a rigid one, so that a network can infer
from them how to interpret the heights, which are computed with them.
"""

from dataclasses import dataclass, field, replace
from enum import StrEnum
from itertools import islice
from typing import Annotated, Any

import numpy as np
from jaxtyping import Float32
from msgspec import Meta
from numpy import ndarray as Array

from ninedtact.bounds import require_within_bounds
from ninedtact.design import PUBLISHED_MM_PER_PX, Gel, RectifiedImageSize, SensingArea
from ninedtact.errors import ForceEstimationError
from ninedtact.force.brightness_channels import (
    ChannelLayout,
    DeformationBuilder,
    deformation_network_input,
    split_darker_brighter,
    stack_deformation_channels,
)
from ninedtact.mechanics.numpy_or_torch_arrays import array_namespace_of
from ninedtact.quantities import HeightMap, Rectified
from ninedtact.reading import Reading
from ninedtact.shape.calibrated_shape import CalibratedShape
from ninedtact.shape.depth import TYPICAL_GLOBAL_DIMMING, TYPICAL_POINT_SPREAD_MM
from ninedtact.shape.orthorectification import SkinGrid, orthorectified_heights


@dataclass(frozen=True)
class SensorParameterInputs:
    """Gel thickness and light parameters of one sensor, as a network's input; the defaults are typical values."""

    thickness_mm: float = Gel().thickness_mm
    darkening_per_mm: float = 0.1
    """Relative darkening of the first tenth of a millimetre of indentation, per mm."""
    brightening_per_mm: float = 0.35
    """Relative brightening, per mm of bulge."""
    point_spread_mm: float = TYPICAL_POINT_SPREAD_MM
    """Standard deviation of the distance over which light scatters in the gel."""
    global_dimming: float = TYPICAL_GLOBAL_DIMMING
    """Relative loss of light everywhere, per mean darkening of the view."""

    @property
    def row(self) -> Float32[Array, " features"]:
        """All features in order, as training stores them."""
        return np.array(list(vars(self).values()), np.float32)


TYPICAL_FEATURES = SensorParameterInputs()


def sensor_features_of(shape: CalibratedShape, gel: Gel) -> SensorParameterInputs:
    """Return the features of a calibrated sensor with this gel."""
    curve, typical = shape.curve, TYPICAL_FEATURES
    if curve.signal != "ratio":
        return SensorParameterInputs(gel.thickness_mm)
    return SensorParameterInputs(
        gel.thickness_mm,
        _initial_slope(curve.darkening, curve.indentation_mm, typical.darkening_per_mm),
        _initial_slope(curve.brightening, curve.bulge_mm, typical.brightening_per_mm),
        typical.point_spread_mm if shape.deblurring is None else shape.deblurring.point_spread_mm,
        shape.loss.global_dimming,
    )


class InputChannels(StrEnum):
    """The channels of a network's input and their order; the text is stored in the model's card."""

    HEIGHTS = "height / gel thickness"
    HEIGHTS_AND_GEL = "height / gel thickness, gel thickness / 2.5 mm"
    HEIGHTS_AND_SENSOR = "height / gel thickness, sensor features / typical values"
    DEFORMATION = ChannelLayout.PLAIN.value
    MIXED = ChannelLayout.ORIGINAL.value

    @property
    def of_heights(self) -> bool:
        """Whether they are computed from the height map, and not from the image."""
        return self in _FEATURE_CHANNELS

    @property
    def needs_sensor_features(self) -> bool:
        """Whether features of the sensor beyond its gel's thickness are channels."""
        return _FEATURE_CHANNELS.get(self, 0) > 1

    @property
    def sensor_features(self) -> int:
        """Number of a sensor's features that are channels of their own, each constant over the image: the last channels."""
        return _FEATURE_CHANNELS.get(self, 0)

    @property
    def layout(self) -> ChannelLayout:
        """The layout of channels that are computed from the image."""
        return ChannelLayout(self.value)

    @property
    def number(self) -> int:
        """The number of channels."""
        return 1 + self.sensor_features if self.of_heights else 3


_FEATURE_CHANNELS = {
    InputChannels.HEIGHTS: 0,
    InputChannels.HEIGHTS_AND_GEL: 1,
    InputChannels.HEIGHTS_AND_SENSOR: len(TYPICAL_FEATURES.row),
}


@dataclass(frozen=True)
class NetworkInputSettings:
    """Channels and grid of a network's input; raises `ForceEstimationError`."""

    channels: InputChannels = InputChannels.HEIGHTS_AND_GEL
    rows: Annotated[int, Meta(ge=1, le=4000)] = 60
    cols: Annotated[int, Meta(ge=1, le=4000)] = 80
    mm_per_px: Annotated[float, Meta(ge=0.001, le=20)] = 0.3

    def __post_init__(self) -> None:
        require_within_bounds(self, "input", ForceEstimationError)

    @property
    def grid(self) -> SkinGrid:
        """The grid of its pixels on the skin."""
        return SkinGrid(self.rows, self.cols, self.mm_per_px)

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of channels, rows and columns."""
        return self.channels.number, self.rows, self.cols


def full_resolution_input_settings(channels: InputChannels) -> NetworkInputSettings:
    """Return settings with all pixels of the rectified image."""
    view = RectifiedImageSize()
    return NetworkInputSettings(channels, view.rows, view.cols, PUBLISHED_MM_PER_PX)


def resize_input_settings(settings: NetworkInputSettings, size: tuple[int, int]) -> NetworkInputSettings:
    """Return settings that show the same skin on another number of columns and rows."""
    cols, rows = size
    width_mm = settings.cols * settings.mm_per_px
    return replace(settings, rows=rows, cols=cols, mm_per_px=width_mm / cols if cols else 0.0)


def scale_input_settings_to_width(settings: NetworkInputSettings, width_mm: float) -> NetworkInputSettings:
    """Return settings with the same pixels on skin of another width than the published sensor's."""
    return replace(settings, mm_per_px=settings.mm_per_px * (width_mm / SensingArea().width_mm))


@dataclass
class NetworkInputBuilder:
    """Builds the network's input from a reading. It keeps the last reference at the network's size."""

    settings: NetworkInputSettings = field(default_factory=NetworkInputSettings)
    features: SensorParameterInputs = TYPICAL_FEATURES
    """Features of the sensor whose readings are given."""
    _reader: DeformationBuilder | None = field(default=None, init=False, repr=False)

    def __call__(self, reading: Reading) -> Float32[Array, "channels rows cols"]:
        """Return the input for one reading; raises `InputError`."""
        if self.settings.channels.of_heights:
            return self.of_height(reading.height)
        return self.of_image(reading.rectified, reading.reference)

    def of_height(self, height: HeightMap) -> Float32[Array, "channels rows cols"]:
        """Return the input for a height map."""
        z_mm = orthorectified_heights(height, self.settings.grid)
        return np.asarray(stack_height_channels(z_mm, self.features.row, self.settings.channels))

    def of_image(self, rectified: Rectified, reference: Rectified) -> Float32[Array, "channels rows cols"]:
        """Return the input for an image and its reference, resized whole to the network's size; raises `InputError`."""
        reader = self._reader
        if reader is None or reader.reference is not reference:
            self._reader = reader = DeformationBuilder(reference, (self.settings.rows, self.settings.cols))
        return deformation_network_input(reader(rectified), self.settings.channels.layout)


def stack_height_channels(z_mm: Any, features: Any, channels: InputChannels) -> Any:
    """Stack heights (…, rows, cols) and features (…, 5) of NumPy or torch to (…, channels, rows, cols)."""
    per_image = features[..., None, None]
    relative = z_mm / per_image[..., 0, :, :]
    constant = (
        per_image[..., at, :, :] / float(typical) + 0 * relative for at, typical in enumerate(TYPICAL_FEATURES.row)
    )
    return array_namespace_of(relative).stack((relative, *islice(constant, channels.sensor_features)), axis=-3)


def stack_image_channels(images: Any, references: Any, channels: InputChannels) -> Any:
    """Stack grey images and their references (…, rows, cols) of NumPy or torch to (…, 3, rows, cols)."""
    darker, brighter = split_darker_brighter(images, references)
    return stack_deformation_channels(darker, brighter, references, channels.layout)


def _initial_slope(signal: tuple[float, ...], length_mm: tuple[float, ...], typical: float) -> float:
    """Return the slope of a curve between its first two knots, a typical one where it has only one."""
    return signal[1] / length_mm[1] if len(signal) > 1 and length_mm[1] > 0 else typical
