"""What is known of a sensor beside its images, told to networks that ask: its gel's thickness, and how its light answers.

The light tells more than light. Its numbers are fitted to a ball press with mechanics that are taken for granted; where a gel's
base yields, they come out unlike those of any gel on a rigid one, and a network can tell by them what the heights that were
read with them mean.

What a network of force is shown: the one place where its input is built, live and in training.

    heights              Reading.height ─▶ heights at places ─▶ divided by the gel's thickness (─▶ and what is known of the sensor)
    deformation, mixed   Reading.rectified, .reference ─▶ darker, brighter, reference

Training keeps heights in mm (`places.heights_at_places`) or grey images, changes them, and then calls the same functions as the
live path.
"""

from dataclasses import dataclass, field, replace
from enum import StrEnum
from itertools import islice
from typing import Any

import numpy as np
from jaxtyping import Float32
from numpy import ndarray as Array

from ninedtact.design import FieldOfView, Gel, SensingArea
from ninedtact.errors import ForceError
from ninedtact.force.deformation import (
    ChannelLayout,
    DeformationReader,
    deformation_channels,
    split_brightness_change,
    stack_deformation_channels,
)
from ninedtact.mechanics.array_namespace import array_namespace_of
from ninedtact.quantities import HeightMap, Rectified
from ninedtact.reading import Reading
from ninedtact.shape.calibrated_shape import CalibratedShape
from ninedtact.shape.depth import TYPICAL_GLOBAL_DIMMING, TYPICAL_POINT_SPREAD_MM
from ninedtact.shape.orthorectification import SkinGrid, orthorectified_heights


@dataclass(frozen=True)
class SensorFeatures:
    """Of one sensor; the defaults are usual ones, and stand where a calibration tells none."""

    thickness_mm: float = Gel().thickness_mm
    darkening_per_mm: float = 0.1
    """Relative darkening of the first tenth of a millimetre that is pressed in, per mm."""
    brightening_per_mm: float = 0.35
    """Relative brightening, per mm that the skin bulges."""
    point_spread_mm: float = TYPICAL_POINT_SPREAD_MM
    """How far light scatters in the gel, a standard deviation."""
    global_dimming: float = TYPICAL_GLOBAL_DIMMING
    """Relative loss of light everywhere, per mean darkening of the view."""

    @property
    def row(self) -> Float32[Array, " traits"]:
        """All numbers, as training keeps them."""
        return np.array(list(vars(self).values()), np.float32)


TYPICAL_FEATURES = SensorFeatures()
FEATURE_COUNT = len(TYPICAL_FEATURES.row)


def sensor_features_of(shape: CalibratedShape, gel: Gel) -> SensorFeatures:
    """As the calibration has them."""
    curve, usual = shape.curve, TYPICAL_FEATURES
    if curve.signal != "ratio":
        return SensorFeatures(gel.thickness_mm)
    return SensorFeatures(
        gel.thickness_mm,
        initial_slope(curve.darkening, curve.indentation_mm, usual.darkening_per_mm),
        initial_slope(curve.brightening, curve.bulge_mm, usual.brightening_per_mm),
        usual.point_spread_mm if shape.deblurring is None else shape.deblurring.point_spread_mm,
        shape.loss.global_dimming,
    )


def initial_slope(signal: tuple[float, ...], mm: tuple[float, ...], usual: float) -> float:
    """Of a curve at its beginning."""
    return signal[1] / mm[1] if len(signal) > 1 and mm[1] > 0 else usual


WHOLE_MM_PER_PX = 0.0522
"""Of the published rectified image."""


class NetworkInputImpossible(ForceError):
    """A network's input that cannot be built, or cannot be had of this reading."""


class InputChannels(StrEnum):
    """What the channels are, in their order; the words are kept with the model."""

    HEIGHTS = "height / gel thickness"
    HEIGHTS_AND_GEL = "height / gel thickness, gel thickness / 2.5 mm"
    HEIGHTS_AND_SENSOR = "height / gel thickness, traits of the sensor / usual ones"
    DEFORMATION = ChannelLayout.PLAIN.value
    MIXED = ChannelLayout.ORIGINAL.value

    @property
    def of_heights(self) -> bool:
        """Whether they are made of the height map, and not of the image."""
        return self in TRAITS_TOLD

    @property
    def layout(self) -> ChannelLayout:
        """Of those made of images."""
        return ChannelLayout(self.value)

    @property
    def number(self) -> int:
        """How many."""
        return 1 + TRAITS_TOLD[self] if self.of_heights else 3


TRAITS_TOLD = {
    InputChannels.HEIGHTS: 0,
    InputChannels.HEIGHTS_AND_GEL: 1,
    InputChannels.HEIGHTS_AND_SENSOR: FEATURE_COUNT,
}
"""How many of a sensor's traits are channels of their own, each the same everywhere."""


@dataclass(frozen=True)
class NetworkInputSettings:
    """Channels and grid of a network's input; raises `NetworkInputImpossible`."""

    channels: InputChannels = InputChannels.HEIGHTS_AND_GEL
    rows: int = 60
    cols: int = 80
    mm_per_px: float = 0.3

    def __post_init__(self) -> None:
        if min(self.rows, self.cols) < 1 or not self.mm_per_px > 0:
            raise NetworkInputImpossible(
                f"expected an input of at least one pixel that covers some skin, got {self.cols} x {self.rows} pixels of "
                f"{self.mm_per_px} mm; correct them"
            )

    @property
    def grid(self) -> SkinGrid:
        """Where its pixels are."""
        return SkinGrid(self.rows, self.cols, self.mm_per_px)

    @property
    def shape(self) -> tuple[int, int, int]:
        """InputChannels, rows, columns."""
        return self.channels.number, self.rows, self.cols


def full_resolution_input(channels: InputChannels) -> NetworkInputSettings:
    """All pixels of the rectified image."""
    view = FieldOfView()
    return NetworkInputSettings(channels, view.rows, view.cols, WHOLE_MM_PER_PX)


def resize_network_input(settings: NetworkInputSettings, size: tuple[int, int]) -> NetworkInputSettings:
    """The same skin on so many columns and rows."""
    cols, rows = size
    width_mm = settings.cols * settings.mm_per_px
    return replace(settings, rows=rows, cols=cols, mm_per_px=width_mm / cols if cols else 0.0)


def scale_network_input_width(settings: NetworkInputSettings, width_mm: float) -> NetworkInputSettings:
    """The same pixels on skin of another width than the published sensor's."""
    return replace(settings, mm_per_px=settings.mm_per_px * (width_mm / SensingArea().width_mm))


@dataclass
class NetworkInputBuilder:
    """From a reading to what the network is shown. It keeps the last reference at the network's size."""

    settings: NetworkInputSettings = field(default_factory=NetworkInputSettings)
    traits: SensorFeatures = TYPICAL_FEATURES
    """Of this sensor."""
    reader: DeformationReader | None = field(default=None, init=False, repr=False)

    def __call__(self, reading: Reading) -> Float32[Array, "channels rows cols"]:
        """Of one reading; raises `NetworkInputImpossible`, `ImagesDoNotMatch`."""
        if self.settings.channels.of_heights:
            return self.of_height(reading.height)
        if reading.reference is None:
            raise NetworkInputImpossible(
                "expected a reading that carries the untouched image of its session, got none; read with a Sensor"
            )
        return self.of_image(reading.rectified, reading.reference)

    def of_height(self, height: HeightMap) -> Float32[Array, "channels rows cols"]:
        """Of a height map."""
        z_mm = orthorectified_heights(height, self.settings.grid)
        return np.asarray(stack_height_channels(z_mm, self.traits.row, self.settings.channels))

    def of_image(self, rectified: Rectified, reference: Rectified) -> Float32[Array, "channels rows cols"]:
        """Of an image and the untouched one, both shown whole whatever their pixels measure; raises `ImagesDoNotMatch`."""
        if self.reader is None or self.reader.reference is not reference:
            self.reader = DeformationReader(reference, (self.settings.rows, self.settings.cols))
        return deformation_channels(self.reader(rectified), self.settings.channels.layout)


def stack_height_channels(z_mm: Any, traits: Any, channels: InputChannels) -> Any:
    """Heights (…, rows, cols) and traits (…, 5) of NumPy or torch → (…, channels, rows, cols)."""
    per_image = traits[..., None, None]
    relative = z_mm / per_image[..., 0, :, :]
    told = (per_image[..., at, :, :] / float(usual) + 0 * relative for at, usual in enumerate(TYPICAL_FEATURES.row))
    return array_namespace_of(relative).stack((relative, *islice(told, TRAITS_TOLD[channels])), axis=-3)


def stack_image_channels(images: Any, references: Any, of: InputChannels) -> Any:
    """Grey images and their references (…, rows, cols) of NumPy or torch → (…, 3, rows, cols)."""
    darker, brighter = split_brightness_change(images, references)
    return stack_deformation_channels(darker, brighter, references, of.layout)
