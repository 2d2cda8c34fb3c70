"""Force calibration with known loads: images of presses and their weights → the gel's modulus and base in `sensor.toml`.

Every press is estimated on a few assumed bases of the gel, on each of which the ball of the calibration was explained again
(`sensor_with_other_base`), and the loads tell modulus and base (`gel_fit_to_known_loads`). The calibration is then made again on
the base that was found, so that depth, twin and force have one gel. A network has no gel; loads give it a factor, kept in
`force.toml`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType

import msgspec
import numpy as np

from ninedtact.calibration.drift.reference_check import load_reference_image_checker
from ninedtact.calibration.free_pressing.known_pressing import KeptOutErrors, KnownPressing
from ninedtact.calibration.free_pressing.pressing import FreePressing
from ninedtact.calibration.gel_fit_to_known_loads import (
    AssumedBases,
    ForceScaleImpossible,
    KnownLoadFit,
    KnownLoadPress,
    fit_agreeing_loads,
    fit_known_loads,
    require_same_unit,
)
from ninedtact.calibration.save import save_known_loads
from ninedtact.calibration.sensor_folder import SENSOR_FILE, SensorFolder
from ninedtact.calibration.sensor_toml_schema import KnownLoadTable
from ninedtact.calibration.sensor_with_other_base import load_on_calibration_ball_n, sensor_with_other_base
from ninedtact.calibration.twin.fit_parameters import NEARLY_RIGID
from ninedtact.calibration.twin.gel_base import KnownBase
from ninedtact.capture.strict_image_reading import read_image
from ninedtact.errors import InputError
from ninedtact.force.estimator_and_scale import FORCE_SCALE_FILE, ForceEstimator, ForceScale, write_force_scale
from ninedtact.force.estimator_loading import NONE, PHYSICS
from ninedtact.quantities import Frame
from ninedtact.reading import Reading, read_frame
from ninedtact.shape.calibrated_shape import DepthReader

STANDARD_GRAVITY = 9.80665
_BASES_APART = 2.0
"""Distance of the assumed bases from that of the calibration, in its standard deviations."""
_BALL_PRESS_STD = 0.08
"""Relative error of the load on the ball of the calibration, by the mechanics that explain its image."""
_UNSTATED_STD = 0.15
"""Relative error of an estimator that states none."""
CALIBRATION_BALL = "the ball of the calibration"


def estimated_load_n(reading: Reading) -> float:
    """Return the load that the estimate of a reading states; zero where it pulls, or where there is no estimate."""
    return 0.0 if reading.force is None else max(0.0, -float(reading.force.wrench.force_n[2]))


def weight_of_grams_n(grams: float) -> float:
    """Return the weight in N of a mass in grams under standard gravity."""
    return grams / 1e3 * STANDARD_GRAVITY


@dataclass(frozen=True)
class PressImage:
    """The raw image of a press, and those of the skin without contact with which it is compared."""

    name: str
    frame: Frame
    references: tuple[Frame, ...]


@dataclass
class _PressReader:
    """Reads single presses by a sensor as calibrated."""

    folder: SensorFolder
    _last: tuple[tuple[Frame, ...], DepthReader] | None = None
    """The references that were used last, with their depth reader."""

    def require_references(self, frames: Sequence[Frame]) -> None:
        """Raise `InputError` for images without contact that cannot be those of this sensor."""
        load_reference_image_checker(self.folder).require_faultless(frames)

    def read(self, press: PressImage) -> Reading:
        """Return the reading of a press; raises `ImageImplausible`, which names the image."""
        if self._last is None or self._last[0] is not press.references:
            self._last = press.references, self.folder.shape.depth_reader(*press.references)
        depth_reader = self._last[1]
        reading = read_frame(press.frame, self.folder.shape, depth_reader)
        load_reference_image_checker(self.folder).require_press(press.name, reading, press.references)
        return reading


class KnownLoadCalibration:
    """The calibration of one sensor with known loads, for the estimator that is named."""

    def __init__(
        self,
        folder: SensorFolder,
        force: str = PHYSICS,
        check: Callable[[_PressReader, ForceEstimator], None] = lambda *_: None,
    ) -> None:
        """force: the estimator, as after `--force`. check: called before the calibration is explained on other bases, which takes
        seconds. Raises `InputError`, what loading the estimator raises, and what fitting raises.
        """
        _require_estimator(force)
        self._force = force
        self.finds_gel = force == PHYSICS and folder.record.twin is not None
        """Whether known loads determine the gel; otherwise they determine a factor."""
        if self.finds_gel:
            _require_unedited(folder)
        check(_PressReader(folder), self._estimator_of(folder))
        self.bases, self._sensors = _assume_bases(folder) if self.finds_gel else (AssumedBases(), [folder])
        self._middle = self.bases.ratios.index(self.bases.mean) if self.bases.is_searched else 0
        self._estimators, self._reader = list(map(self._estimator_of, self._sensors)), _PressReader(self.sensor)

    @property
    def sensor(self) -> SensorFolder:
        """The sensor as its images calibrated it."""
        return self._sensors[self._middle]

    @property
    def estimator(self) -> ForceEstimator:
        """The estimator that is calibrated."""
        return self._estimators[self._middle]

    def _estimator_of(self, sensor: SensorFolder) -> ForceEstimator:
        estimator = sensor.estimator(self._force, with_force_scale=False)
        estimator.calibration_checksum = ""  # those of all bases read the images of the sensor as calibrated
        return estimator

    def require_references(self, frames: Sequence[Frame]) -> None:
        """Raise `InputError` for images without contact that cannot be those of this sensor."""
        self._reader.require_references(frames)

    def read(self, press: PressImage) -> Reading:
        """Return the reading of a press by the sensor as calibrated; raises `ImageImplausible`, which names the image."""
        return self.estimator.add_force(self._reader.read(press))

    def estimate(self, press: PressImage, grams: float) -> KnownLoadPress:
        """Return a press with its load, estimated on all bases; raises `ForceScaleImpossible`, `ImageImplausible`."""
        return _estimate(press, grams, self._reader.read(press), self._estimators, self._middle)

    def estimate_calibration_ball(self, grams: float) -> KnownLoadPress:
        """Return the press of the calibration's own ball with its load; raises `InputError`, `ForceScaleImpossible`."""
        if not self.finds_gel:
            raise InputError(
                expected=f"--ball-grams with --force {PHYSICS} and a sensor with a twin",
                got="another estimator or sensor",
                remedy="give images of presses with --press",
            )
        loads = tuple(map(load_on_calibration_ball_n, self._sensors))
        return KnownLoadPress(CALIBRATION_BALL, weight_of_grams_n(grams), loads, _BALL_PRESS_STD, self._middle)

    def fit(self, presses: Sequence[KnownLoadPress]) -> KnownLoadFit:
        """Return what the loads say; raises `ForceScaleImpossible`."""
        return fit_known_loads(presses, self.bases)

    def align(self, pressing: FreePressing) -> KnownPressing:
        """Return free pressing, estimated on all bases and aligned; raises `PressingUnusable` and what reading raises."""
        return KnownPressing(pressing, self.sensor, self._estimators, self.bases)

    def adapted_sensor(
        self,
        fit: KnownLoadFit,
        presses: Sequence[KnownLoadPress],
        images: Sequence[PressImage],
        readings: Mapping[str, Reading] = MappingProxyType({}),
    ) -> SensorFolder:
        """Return the sensor, not saved, with the gel that a fit found; of a sensor without a search for the gel the sensor itself.

        images: those of the presses; the ball of the calibration has none. readings: of presses without images of their own, by
        their names. The modulus is taken from them again on the base that was found, because estimates between the assumed bases
        are interpolated.
        """
        if not self.finds_gel:
            return self.sensor
        sensor = self.sensor
        if self.bases.is_searched:
            sensor = sensor_with_other_base(sensor, KnownBase(fit.ratio, fit.ratio_std))
        estimator = self._estimator_of(sensor)
        readings = {**{image.name: self._reader.read(image) for image in images}, **readings}
        found = []
        for press in presses:
            if press.name == CALIBRATION_BALL:
                load_n = load_on_calibration_ball_n(sensor)
            else:
                estimator.forget()
                load_n = estimated_load_n(readings[press.name].with_force(estimator.estimate(readings[press.name])))
            found.append(replace(press, estimated_n=(load_n,), calibrated=0))
        factor = fit_agreeing_loads(found).factor
        twin = sensor.record.twin
        assert twin is not None
        gel = replace(twin.gel, shear_modulus_mpa=twin.gel.shear_modulus_mpa * factor)
        table = KnownLoadTable(
            presses=len(presses),
            error=fit.error,
            modulus_std=fit.modulus_std,
            modulus_ratio_std=fit.ratio_std,
            correlation=fit.correlation,
            calibrated_modulus_ratio=self.bases.mean,
            calibrated_modulus_ratio_std=self.bases.std,
            shear_factor=fit.shear_factor,
            shear_std=fit.shear_std,
        )
        record = msgspec.structs.replace(sensor.record, twin=msgspec.structs.replace(twin, gel=gel), known_loads=table)
        return SensorFolder(sensor.path, record)

    def save(self, fit: KnownLoadFit, sensor: SensorFolder) -> Path:
        """Write what was found into the sensor folder and return the file; raises `FileFormatError`, `FileNotWritten`.

        sensor: the adapted sensor. A factor of a network belongs to the gel before, so that `force.toml` is removed with it.
        """
        if not self.finds_gel:
            scale = ForceScale(fit.factor, fit.error, len(fit.deviations), fit.shear_factor, fit.shear_std)
            return write_force_scale(sensor.path, self.estimator, scale)
        file = save_known_loads(sensor)
        (sensor.path / FORCE_SCALE_FILE).unlink(missing_ok=True)
        return file


def _require_estimator(force: str) -> None:
    """Raise `InputError` where no estimator is named."""
    if force == NONE:
        raise InputError(
            expected="an estimator to calibrate",
            got=f"--force {NONE}",
            remedy=f"name {PHYSICS} or a force model",
        )


def _require_unedited(folder: SensorFolder) -> None:
    """Raise `InputError` for a sensor whose numbers were edited: writing the file anew would vouch for them."""
    if folder.is_edited:
        raise InputError(
            expected=f"{folder.path / SENSOR_FILE} as the calibration wrote it",
            got="one that was edited or damaged",
            remedy="restore it, or calibrate again",
        )


def _assume_bases(folder: SensorFolder) -> tuple[AssumedBases, list[SensorFolder]]:
    """Return the bases on which presses are estimated, and the sensor on each.

    They lie around the base that the image of the ball tells; an earlier calibration with known loads does not count twice.
    """
    sensor, known, twin = folder, folder.record.known_loads, folder.record.twin
    assert twin is not None
    if folder.record.design.gel.has_rigid_base:
        return AssumedBases(), [folder if known is None else sensor_with_other_base(folder, KnownBase(0.0))]
    fitted = twin.fit.parameters["gel_to_base_modulus_ratio"]
    mean, std = fitted.value, fitted.std or 0.0
    if known is not None:
        mean, std = known.calibrated_modulus_ratio, known.calibrated_modulus_ratio_std
        sensor = sensor_with_other_base(folder, KnownBase(mean, std))
    softest, stiffest = mean + _BASES_APART * std, max(mean - _BASES_APART * std, NEARLY_RIGID)
    sensors = {mean: sensor, softest: sensor_with_other_base(sensor, KnownBase(softest))}
    if stiffest < mean:
        sensors[stiffest] = sensor_with_other_base(sensor, KnownBase(stiffest))
    ratios = tuple(sorted(sensors))
    return AssumedBases(ratios, mean, std), [sensors[ratio] for ratio in ratios]


def _estimate(
    press: PressImage, grams: float, reading: Reading, estimators: Sequence[ForceEstimator], calibrated: int = 0
) -> KnownLoadPress:
    """Return a press with its load by all estimators; error and warnings are those of the calibrated one.

    All read the heights of the calibrated base, which are first guesses: the image counts, and its law is that of each estimator.
    """
    found = []
    for estimator in estimators:
        estimator.forget()
        found.append(reading.with_force(estimator.estimate(reading)))
    load_n, std = estimated_load_n(found[calibrated]), found[calibrated].wrench_std
    is_stated = std is not None and np.isfinite(std[2]) and load_n > 0
    relative = float(std[2]) / load_n if is_stated and std is not None else _UNSTATED_STD
    loads, warnings = tuple(map(estimated_load_n, found)), found[calibrated].warnings
    return KnownLoadPress(press.name, weight_of_grams_n(grams), loads, relative, calibrated, warnings)


@dataclass(frozen=True)
class ForceCalibration:
    """What known loads determined, and the presses that it was fitted to."""

    estimator: str
    fit: KnownLoadFit
    presses: list[KnownLoadPress]
    sensor: SensorFolder
    """The sensor with the gel that was found."""
    finds_gel: bool
    """Whether the loads determined the gel; otherwise a factor."""
    file: Path | None
    """File that it was saved in; None where it was not saved."""
    pressing: KnownPressing | None = None
    """What free pressing told, where there was some."""
    kept_out: KeptOutErrors | None = None
    """Errors of contacts of the free pressing that were left out of the fit."""


def calibrate_force(
    folder: SensorFolder,
    reference: Sequence[Path] = (),
    presses: Sequence[tuple[Path, float]] = (),
    force: str = PHYSICS,
    ball_grams: float | None = None,
    save: bool = True,
    pressing: FreePressing | None = None,
) -> ForceCalibration:
    """Calibrate the force of a sensor with images of presses and their loads, and save the result in the sensor folder.

    reference: images without contact. presses: images with the load of each in grams. force: the estimator, as after `--force`.
    ball_grams: load on the ball of the calibration when its image was taken. pressing: free pressing with a force/torque sensor,
    open. Raises `InputError`, `ForceScaleImpossible`, `PressingUnusable`, and what reading images and sensor folders raises.
    """
    _require_estimator(force)
    _require_one_load_for_each_image(presses)
    if ball_grams is not None and not ball_grams > 0:
        raise ForceScaleImpossible(
            expected="a load on the ball of the calibration above zero",
            got=f"{ball_grams:g} g",
            remedy="read the scale again",
        )
    references = tuple(Frame(read_image(path)) for path in reference)
    images = [PressImage(str(path), Frame(read_image(path)), references) for path, _ in presses]
    calibration = KnownLoadCalibration(folder, force, partial(_require_usable, images, [grams for _, grams in presses]))
    known = [calibration.estimate(image, grams) for image, (_, grams) in zip(images, presses, strict=True)]
    if ball_grams is not None:
        known.append(calibration.estimate_calibration_ball(ball_grams))
    aligned = None if pressing is None else calibration.align(pressing)
    weighed, readings, kept_out = list(known), dict[str, Reading](), None
    if aligned is not None:
        known, readings = [*weighed, *aligned.presses(weighed)], aligned.readings
    fit = calibration.fit(known)
    if aligned is not None:
        fit, kept_out = aligned.with_shear(fit), aligned.kept_out_errors(weighed)
    sensor = calibration.adapted_sensor(fit, known, images, readings)
    file = calibration.save(fit, sensor) if save else None
    return ForceCalibration(
        calibration.estimator.name, fit, known, sensor, calibration.finds_gel, file, aligned, kept_out
    )


def _require_usable(
    images: Sequence[PressImage], grams: Sequence[float], reader: _PressReader, estimator: ForceEstimator
) -> None:
    """Raise what is wrong with images, references or weights: `InputError`, `ImageImplausible`, `ForceScaleImpossible`."""
    for image, each in zip(images, grams, strict=True):
        reader.require_references(image.references)
        require_same_unit([_estimate(image, each, reader.read(image), [estimator])])


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
