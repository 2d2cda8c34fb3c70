"""Force-scale calibration of a sensor from presses with known loads: images of a real sensor on a scale, or simulated presses."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from ninedtact.calibration.drift.diagnosis_and_reference_check import load_reference_image_checker
from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.capture.strict_image_reading import ImageFileList, read_image
from ninedtact.errors import InputError
from ninedtact.force.estimator_interface import ForceEstimator
from ninedtact.force.estimator_loading import CORRECTED, NONE, PHYSICS
from ninedtact.force.known_load_scale import (
    ForceScaleFit,
    ForceScaleImpossible,
    KnownLoadPress,
    estimated_load_n,
    fit_force_scale,
    weight_of_grams_n,
    write_force_scale,
)
from ninedtact.quantities import Frame
from ninedtact.reading import Reading, read_frame
from ninedtact.shape.depth import DepthReader
from ninedtact.shape.image_plausibility import require_plausible_image


@dataclass(frozen=True)
class ForceCalibration:
    """The force scale of a sensor, and the presses that it was fitted to."""

    estimator: str
    fit: ForceScaleFit
    presses: list[KnownLoadPress]
    file: Path | None
    """File that the scale was saved in; None where it was not saved."""


def calibrate_force(
    folder: SensorFolder,
    reference: Sequence[Path],
    presses: Sequence[tuple[Path, float]],
    force: str = PHYSICS,
    save: bool = True,
) -> ForceCalibration:
    """Fit the force scale of a sensor to images of presses with known loads, and save it in the sensor folder.

    reference: images without contact. presses: images with the load of each in grams. force: the estimator, as after `--force`.
    Raises `InputError`, `ForceScaleImpossible`, and what reading images and sensor folders raises.
    """
    _require_one_load_for_each_image(presses)
    reader = UnscaledForceReader(folder, force)
    reader.use_reference([Frame(read_image(path)) for path in reference])
    estimated = list(_estimate_presses(reader, presses))
    fit = fit_force_scale(estimated)
    file = write_force_scale(folder.path, reader.estimator, fit.adaptation) if save else None
    return ForceCalibration(reader.estimator.name, fit, estimated, file)


class UnscaledForceReader:
    """Estimates the force of single presses by an estimator without its force scale, for the calibration with known loads."""

    def __init__(self, folder: SensorFolder, force: str = PHYSICS) -> None:
        """force: the estimator, as after `--force`; raises `InputError` and what loading it raises."""
        if force == NONE:
            raise InputError(
                f"expected an estimator to calibrate, got --force {NONE}; name {CORRECTED}, {PHYSICS} or a force model"
            )
        self.estimator: ForceEstimator = folder.estimator(force, with_force_scale=False)
        self._shape, self._check = folder.shape, load_reference_image_checker(folder)
        self._depth_reader: DepthReader | None = None

    def use_reference(self, frames: Sequence[Frame]) -> None:
        """Compare the following images with the mean of these, which show no contact; raises `ReferenceImplausible`."""
        self._check.require_faultless(frames)
        self._depth_reader = self._shape.depth_reader(*frames)

    def read(self, name: str, frame: Frame) -> Reading:
        """Return the reading of an image with its estimate; raises `ImageImplausible`, which names the image."""
        assert self._depth_reader is not None
        reading = read_frame(frame, self._shape, self._depth_reader)
        require_plausible_image(name, reading.rectified, self._depth_reader.reference, reading.height)
        self.estimator.forget()
        return reading.with_force(self.estimator.estimate(reading))


def _require_one_load_for_each_image(presses: Sequence[tuple[Path, float]]) -> None:
    """Raise `ForceScaleImpossible` where an image is given twice."""
    loads_g = dict[Path, float]()
    for path, grams in presses:
        if path.resolve() in loads_g:
            raise ForceScaleImpossible(
                f"expected each image once, with its load, got {path} with {loads_g[path.resolve()]:g} g and with {grams:g} g; "
                "give every press an image of its own"
            )
        loads_g[path.resolve()] = grams


def _estimate_presses(reader: UnscaledForceReader, presses: Sequence[tuple[Path, float]]) -> Iterator[KnownLoadPress]:
    """Yield the estimated force of every press with its load; raises `ForceScaleImpossible`, naming the image."""
    with ImageFileList([path for path, _ in presses]) as images:
        for (path, grams), frame in zip(presses, images, strict=True):
            reading = reader.read(str(path), frame)
            try:
                yield KnownLoadPress(estimated_load_n(reading), weight_of_grams_n(grams), reading.warnings)
            except ForceScaleImpossible as refusal:
                raise ForceScaleImpossible(f"{path}: {refusal}") from refusal
