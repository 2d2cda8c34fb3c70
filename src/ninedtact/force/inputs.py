"""What a network of force is shown: the one place where its input is built, live and in training.

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

from ninedtact.design import FieldOfView, SensingArea
from ninedtact.errors import NinedtactError
from ninedtact.force.deformation import DeformationReader, Layout, channels, network_input, parts
from ninedtact.force.places import PlaceGrid, heights_at_places
from ninedtact.force.traits import NUMBER, USUAL, Traits
from ninedtact.mechanics.array_namespace import array_namespace_of
from ninedtact.quantities import HeightMap, Rectified
from ninedtact.reading import Reading

WHOLE_MM_PER_PX = 0.0522
"""Of the published rectified image."""


class InputImpossible(NinedtactError):
    """A network's input that cannot be built, or cannot be had of this reading."""


class Channels(StrEnum):
    """What the channels are, in their order; the words are kept with the model."""

    HEIGHTS = "height / gel thickness"
    HEIGHTS_AND_GEL = "height / gel thickness, gel thickness / 2.5 mm"
    HEIGHTS_AND_SENSOR = "height / gel thickness, traits of the sensor / usual ones"
    DEFORMATION = Layout.PLAIN.value
    MIXED = Layout.ORIGINAL.value

    @property
    def of_heights(self) -> bool:
        """Whether they are made of the height map, and not of the image."""
        return self in TRAITS_TOLD

    @property
    def layout(self) -> Layout:
        """Of those made of images."""
        return Layout(self.value)

    @property
    def number(self) -> int:
        """How many."""
        return 1 + TRAITS_TOLD[self] if self.of_heights else 3


TRAITS_TOLD = {Channels.HEIGHTS: 0, Channels.HEIGHTS_AND_GEL: 1, Channels.HEIGHTS_AND_SENSOR: NUMBER}
"""How many of a sensor's traits are channels of their own, each the same everywhere."""


@dataclass(frozen=True)
class InputSettings:
    """Channels and grid of a network's input; raises `InputImpossible`."""

    channels: Channels = Channels.HEIGHTS_AND_GEL
    rows: int = 60
    cols: int = 80
    mm_per_px: float = 0.3

    def __post_init__(self) -> None:
        if min(self.rows, self.cols) < 1 or not self.mm_per_px > 0:
            raise InputImpossible(
                f"expected an input of at least one pixel that covers some skin, got {self.cols} x {self.rows} pixels of "
                f"{self.mm_per_px} mm; correct them"
            )

    @property
    def grid(self) -> PlaceGrid:
        """Where its pixels are."""
        return PlaceGrid(self.rows, self.cols, self.mm_per_px)

    @property
    def shape(self) -> tuple[int, int, int]:
        """Channels, rows, columns."""
        return self.channels.number, self.rows, self.cols


def whole(channels: Channels) -> InputSettings:
    """All pixels of the rectified image."""
    view = FieldOfView()
    return InputSettings(channels, view.rows, view.cols, WHOLE_MM_PER_PX)


def with_size(settings: InputSettings, size: tuple[int, int]) -> InputSettings:
    """The same skin on so many columns and rows."""
    cols, rows = size
    width_mm = settings.cols * settings.mm_per_px
    return replace(settings, rows=rows, cols=cols, mm_per_px=width_mm / cols if cols else 0.0)


def with_width(settings: InputSettings, width_mm: float) -> InputSettings:
    """The same pixels on skin of another width than the published sensor's."""
    return replace(settings, mm_per_px=settings.mm_per_px * (width_mm / SensingArea().width_mm))


@dataclass
class NetworkInput:
    """From a reading to what the network is shown. It keeps the last reference at the network's size."""

    settings: InputSettings = field(default_factory=InputSettings)
    traits: Traits = USUAL
    """Of this sensor."""
    reader: DeformationReader | None = field(default=None, init=False, repr=False)

    def __call__(self, reading: Reading) -> Float32[Array, "channels rows cols"]:
        """Of one reading; raises `InputImpossible`, `ImagesDoNotMatch`."""
        if self.settings.channels.of_heights:
            return self.of_height(reading.height)
        if reading.reference is None:
            raise InputImpossible(
                "expected a reading that carries the untouched image of its session, got none; read with a Sensor"
            )
        return self.of_image(reading.rectified, reading.reference)

    def of_height(self, height: HeightMap) -> Float32[Array, "channels rows cols"]:
        """Of a height map."""
        z_mm = heights_at_places(height, self.settings.grid)
        return np.asarray(height_channels(z_mm, self.traits.row, self.settings.channels))

    def of_image(self, rectified: Rectified, reference: Rectified) -> Float32[Array, "channels rows cols"]:
        """Of an image and the untouched one, both shown whole whatever their pixels measure; raises `ImagesDoNotMatch`."""
        if self.reader is None or self.reader.reference is not reference:
            self.reader = DeformationReader(reference, (self.settings.rows, self.settings.cols))
        return network_input(self.reader(rectified), self.settings.channels.layout)


def height_channels(z_mm: Any, traits: Any, channels: Channels) -> Any:
    """Heights (…, rows, cols) and traits (…, 5) of NumPy or torch → (…, channels, rows, cols)."""
    per_image = traits[..., None, None]
    relative = z_mm / per_image[..., 0, :, :]
    told = (per_image[..., at, :, :] / float(usual) + 0 * relative for at, usual in enumerate(USUAL.row))
    return array_namespace_of(relative).stack((relative, *islice(told, TRAITS_TOLD[channels])), axis=-3)


def image_channels(images: Any, references: Any, of: Channels) -> Any:
    """Grey images and their references (…, rows, cols) of NumPy or torch → (…, 3, rows, cols)."""
    darker, brighter = parts(images, references)
    return channels(darker, brighter, references, of.layout)
