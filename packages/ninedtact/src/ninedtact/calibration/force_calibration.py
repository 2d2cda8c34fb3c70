"""Force-scale calibration of a sensor from presses with known loads: images of a real sensor on a scale, or simulated presses.

Leave-one-out errors decide between a constant factor and a power law of the load (`ForceScale`).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact.calibration.drift.reference_check import load_reference_image_checker
from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.capture.frame_source import ImageFileList
from ninedtact.capture.strict_image_reading import read_image
from ninedtact.errors import ForceEstimationError, InputError
from ninedtact.force.estimator_and_scale import (
    MAX_EXPONENT,
    WIDEST_FACTOR,
    ForceEstimator,
    ForceScale,
    write_force_scale,
)
from ninedtact.force.estimator_loading import NONE, PHYSICS
from ninedtact.quantities import EstimateWarning, Frame
from ninedtact.reading import Reading, read_frame
from ninedtact.shape.calibrated_shape import DepthReader
from ninedtact.shape.image_plausibility import require_plausible_image

FEWEST = 2
_FEWEST_FOR_CURVE = 4
_CURVE_MUST_GAIN = 0.8
"""The power law is used where its leave-one-out error is below this fraction of that of a constant factor."""
_MAX_ERROR = 0.35
"""Leave-one-out error (root mean square, relative) above which presses contradict each other."""
STANDARD_GRAVITY = 9.80665


class ForceScaleImpossible(ForceEstimationError):
    """Presses with known loads do not determine the force scale of a sensor."""


@dataclass(frozen=True)
class KnownLoadPress:
    """One press under a known load."""

    estimated_n: float
    """−F_z of the estimator without a force scale."""
    weighed_n: float
    warnings: tuple[EstimateWarning, ...] = ()
    """Reasons to distrust the estimate."""

    def __post_init__(self) -> None:
        if not (0 < self.weighed_n < np.inf):
            raise ForceScaleImpossible(
                expected="a weight above zero", got=f"{self.weighed_n:g} N", remedy="read the scale again"
            )
        if not (0 < self.estimated_n < np.inf):
            raise ForceScaleImpossible(
                expected="a press that the image shows",
                got=f"an estimate of {self.estimated_n:g} N under {self.weighed_n:.2f} N",
                remedy="let the object rest on the middle of the skin, and give the image of that",
            )
        ratio = self.weighed_n / self.estimated_n
        if not 1 / WIDEST_FACTOR < ratio < WIDEST_FACTOR:
            raise ForceScaleImpossible(
                expected=f"a weight near the estimated {self.estimated_n:.2f} N",
                got=f"{self.weighed_n:.2f} N",
                remedy="give grams, and the image that was taken under that weight",
            )


@dataclass(frozen=True)
class ForceScaleFit:
    """A fitted force scale, and the leave-one-out errors of both ways of scaling."""

    adaptation: ForceScale
    unadapted: float
    """Root mean square relative error without a force scale."""
    by_factor: float
    by_curve: float | None
    """None where there are too few presses, or where their loads are too similar."""


def estimated_load_n(reading: Reading) -> float:
    """Return the load that the estimate of a reading states; zero where it pulls, or where there is no estimate."""
    return 0.0 if reading.force is None else max(0.0, -float(reading.force.wrench.force_n[2]))


def fit_force_scale(presses: Sequence[KnownLoadPress]) -> ForceScaleFit:
    """Fit the force scale whose leave-one-out error is smallest; raises `ForceScaleImpossible`."""
    if len(presses) < FEWEST:
        raise ForceScaleImpossible(
            expected=f"at least {FEWEST} presses of known weight",
            got=f"{len(presses)}",
            remedy="press with two weights or more",
        )
    load = np.log([press.estimated_n for press in presses])
    wanted = np.log([press.weighed_n for press in presses]) - load
    by_factor = _left_out_rms(load, wanted, 0)
    by_curve = _left_out_rms(load, wanted, 1) if _loads_determine_power_law(load) else None
    bends = by_curve is not None and by_curve < _CURVE_MUST_GAIN * by_factor
    about = float(np.exp(load.mean()))
    curve, factor = (*_fit_line(load - load.mean(), wanted),) if bends else (0.0, wanted.mean())
    error = by_curve if bends and by_curve is not None else by_factor
    if error > _MAX_ERROR:
        raise ForceScaleImpossible(
            expected=f"presses that agree on one force scale to {_MAX_ERROR:.0%}",
            got=f"a scatter of {error:.0%}",
            remedy="check that each image belongs to its weight, and that the scale was set to zero with the "
            "sensor on it",
        )
    if abs(curve) > MAX_EXPONENT:
        raise ForceScaleImpossible(
            expected=f"a factor that changes at most with the power {MAX_EXPONENT:g} of the load",
            got=f"the power {curve:.1f}",
            remedy="check that each image belongs to its weight",
        )
    found = ForceScale(float(np.exp(factor)), float(curve), about, error, len(presses))
    return ForceScaleFit(found, _rms(wanted), by_factor, by_curve)


def _loads_determine_power_law(load: Float[Array, " n"]) -> bool:
    """Return whether the loads (logarithms) determine a power law: at least four of them, over more than a factor of two."""
    return len(load) >= _FEWEST_FOR_CURVE and bool(np.ptp(load) > np.log(2))


def _left_out_rms(load: Float[Array, " n"], wanted: Float[Array, " n"], degree: int) -> float:
    """Return the root mean square relative error of each press as a polynomial fit to the others predicts it."""
    others = ~np.eye(len(load), dtype=bool)
    # The domain is stated because NumPy below 2 cannot find one for a single load.
    fits = [np.polynomial.Polynomial.fit(load[use], wanted[use], degree, domain=[-1, 1]) for use in others]
    return _rms(np.array([wanted[n] - fit(load[n]) for n, fit in enumerate(fits)]))


def _fit_line(x: Float[Array, " n"], y: Float[Array, " n"]) -> tuple[float, float]:
    """Return slope and intercept of the least-squares line."""
    slope, height = np.polyfit(x, y, 1)
    return float(slope), float(height)


def _rms(values: Float[Array, " n"]) -> float:
    """Return the root mean square of the values."""
    return float(np.sqrt(np.mean(np.square(values))))


def weight_of_grams_n(grams: float) -> float:
    """Return the weight in N of a mass in grams under standard gravity."""
    return grams / 1e3 * STANDARD_GRAVITY


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
                expected="an estimator to calibrate",
                got=f"--force {NONE}",
                remedy=f"name {PHYSICS} or a force model",
            )
        self.estimator: ForceEstimator = folder.estimator(force, with_force_scale=False)
        self._shape, self._check = folder.shape, load_reference_image_checker(folder)
        self._depth_reader: DepthReader | None = None

    def use_reference(self, frames: Sequence[Frame]) -> None:
        """Compare the following images with the mean of these, which show no contact; raises `InputError`."""
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
                expected="each image once, with its load",
                got=f"{path} with {loads_g[path.resolve()]:g} g and with {grams:g} g",
                remedy="give every press an image of its own",
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
