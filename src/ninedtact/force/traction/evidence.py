"""What tractions are read from: the image itself, by the sensor's law of light; or a height map, where no light is known.

Light says more. A height map is light that was put back where it came from, as far as noise allowed, then looked up; parts
of a contact that are narrower than light scatters come out blurred, and what is dark there and what is bright do not
cancel as heights do. The inversion predicts light instead: nothing has to be put back.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field

import numpy as np

from ninedtact.force.traction.brightness import HEIGHTS_THEMSELVES, BrightnessLaw, law_of
from ninedtact.force.traction.cells import Cells
from ninedtact.force.traction.observation import Observation, View, facts, placed, roughness, seen_at, shrunk
from ninedtact.force.traction.refusals import TractionImpossible
from ninedtact.quantities import Rectified
from ninedtact.reading import Reading
from ninedtact.shape.calibrated import CalibratedShape
from ninedtact.shape.depth import DepthCurve
from ninedtact.shape.loss import Loss

LEAST_NOISE = 2e-4
"""Of a cell's relative brightness: a tenth of a grey level's step, averaged over a cell."""
LEAST_NOISE_MM = 0.002


class Evidence(ABC):
    """What tractions are read from."""

    law: BrightnessLaw
    point_spread_mm: float

    @abstractmethod
    def observed(self, reading: Reading, cells: Cells) -> Observation:
        """The reading on the cells."""


@dataclass(frozen=True)
class ByLight(Evidence):
    """The image itself, by the sensor's law of light."""

    curve: DepthCurve
    loss: Loss
    point_spread_mm: float
    kept: list[tuple[Rectified, View]] = field(default_factory=list, init=False, repr=False, compare=False)
    """The last reference on the cells: it changes once a session."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "law", law_of(self.curve))

    def observed(self, reading: Reading, cells: Cells) -> Observation:
        """Needs the reading's reference; raises `TractionImpossible`."""
        if reading.reference is None:
            raise TractionImpossible(
                "expected a reading with its untouched reference, got none; read by height, or bind a reference first"
            )
        below, pixel, beyond = placed(reading.height, cells)
        change = seen_at(self.changed(reading.rectified, reading.reference, cells), pixel)
        return Observation(change, max(roughness(change), LEAST_NOISE), self.error(below.z_mm), *facts(below), beyond)

    def changed(self, image: Rectified, reference: Rectified, cells: Cells) -> View:
        """Relative change of brightness of every cell, the light that is lost everywhere given back."""
        if not self.kept or self.kept[0][0] is not reference or self.kept[0][1].shape != cells.shape:
            self.kept[:] = [(reference, np.maximum(shrunk(reference.grey, cells), np.float32(1)))]
        lost = self.loss(image.grey, reference.grey)
        return shrunk(image.grey, cells) / self.kept[0][1] * np.float32(1 / (1 + lost)) - np.float32(1)

    def error(self, z_mm: View) -> View:
        """The depth curve's error as brightness, the mean over its range: what is wrong in one place is wrong near it, too."""
        return np.full(z_mm.shape, self.curve_error, np.float32)

    @property
    def curve_error(self) -> float:
        """Mean over the curve of its error in mm times its slope."""
        steps = np.diff(self.curve.darkening) / np.maximum(np.diff(self.curve.indentation_mm), 1e-9)
        return float(np.mean(steps * np.array(self.curve.error_mm)[1:]))


@dataclass(frozen=True)
class ByHeight(Evidence):
    """The height map alone, where nothing is known of light."""

    error_mm: float = 0.01
    law: BrightnessLaw = HEIGHTS_THEMSELVES
    point_spread_mm: float = 0.0

    def observed(self, reading: Reading, cells: Cells) -> Observation:
        """Of the reading, its height is all that is looked at."""
        below, _, beyond = placed(reading.height, cells)
        error = np.full(cells.shape, self.error_mm, np.float32)
        return Observation(below.z_mm, max(roughness(below.z_mm), LEAST_NOISE_MM), error, *facts(below), beyond)


def by_light(calibrated: CalibratedShape) -> ByLight:
    """The evidence of a calibrated sensor; raises `TractionImpossible` where its calibration knows no light."""
    if calibrated.deblurring is None:
        raise TractionImpossible(
            "expected a calibration that knows how light scatters, got one without; calibrate with the method 'physics'"
        )
    return ByLight(calibrated.curve, calibrated.loss, calibrated.deblurring.point_spread_mm)
