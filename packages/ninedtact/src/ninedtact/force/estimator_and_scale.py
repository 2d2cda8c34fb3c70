"""The interface of every force estimator, and the force scale of a sensor. A reading goes in; a wrench, its standard deviation and
warnings come out.

Images show strain, not stress. The gel's shear modulus varies by a quarter from batch to batch and is an unknown factor on all six
axes, and one ball hardly tells how far the base below the gel yields. Presses on a kitchen scale determine both
(`calibration.force_calibration`). Until then, their errors are part of every stated error.

Modulus and base are properties of the gel and stand in `sensor.toml`. The factor that known loads give the output of a network is
kept in `force.toml` in the sensor folder, in one table for each estimator.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
import tomli_w
from msgspec import Meta

from ninedtact.atomic_write import open_atomic_file
from ninedtact.checked_reading import (
    CHECKSUM_KEY,
    convert_tables_to_class,
    mapping_checksum,
    parse_toml,
    read_text_file,
)
from ninedtact.errors import FileFormatError, InputError
from ninedtact.quantities import EstimateWarning, Traction, Wrench, WrenchEstimate
from ninedtact.reading import Reading


class ForceEstimator(ABC):
    """Estimates the wrench of readings. It may start from the previous reading to be quicker; `forget` makes it start anew."""

    name: str
    """The name that is displayed, and the key of the force scale in a sensor folder."""
    model_sha256: str = ""
    """SHA-256 of the file of its network, which tells two models of one name apart; empty for estimators without a network."""
    calibration_checksum: str = ""
    """That of the calibration whose readings alone it estimates (`SensorFolder.calibration_checksum`); empty for any sensor's."""

    @property
    def notices(self) -> tuple[str, ...]:
        """Sentences that a person must know of every estimate."""
        return ()

    @abstractmethod
    def estimate(self, reading: Reading) -> WrenchEstimate:
        """Return the wrench of the object on the skin, torques about the skin's centre; exactly zero where nothing touches.

        For an image that cannot be a press on this sensor it is the `unknown_wrench_estimate` with the warnings of the reading.
        """

    def add_force(self, reading: Reading) -> Reading:
        """Return the reading with its wrench."""
        return reading.with_force(self.estimate(reading))

    def require_own_reading(self, reading: Reading) -> None:
        """Raise `InputError` for a reading of another calibration than the one that this estimator was made for."""
        own, others = self.calibration_checksum, reading.calibration_checksum
        if own and others and own != others:
            raise InputError(
                expected=f"a reading of the sensor that this estimator was made for (calibration {own[:8]})",
                got=f"one of another sensor or calibration ({others[:8]})",
                remedy="take shape and estimator from one load_sensor(FOLDER)",
            )

    @abstractmethod
    def forget(self) -> None:
        """Forget the previous reading, so that the next one is estimated independently of it."""


class NoForceEstimator(ForceEstimator):
    """The estimator of a sensor without one: its readings have no wrench, and its estimate is zero with an infinite standard
    deviation."""

    name = "no force"

    def add_force(self, reading: Reading) -> Reading:
        """Return the reading as it is."""
        return reading

    def estimate(self, reading: Reading) -> WrenchEstimate:
        """Return a wrench of zero with an infinite standard deviation."""
        return unknown_wrench_estimate(reading.frame.stamp_ns)

    def forget(self) -> None:
        """Do nothing: no reading is remembered."""


def unknown_wrench_estimate(stamp_ns: int, warnings: tuple[EstimateWarning, ...] = ()) -> WrenchEstimate:
    """Return the estimate where nothing is known: a wrench of zero with an infinite standard deviation."""
    return WrenchEstimate(zero_wrench(stamp_ns), np.diag(np.full(6, np.inf)), touching=False, warnings=warnings)


def zero_wrench(stamp_ns: int = 0) -> Wrench:
    """Return a wrench of exactly zero, that of no contact."""
    return Wrench(np.zeros(3), np.zeros(3), stamp_ns=stamp_ns)


SHEAR_COMPONENTS = np.array([True, True, False, False, False, True])
"""The components of a wrench that shear makes: F_x, F_y and T_z."""
WIDEST_FACTOR = 5.0
"""Largest ratio between known and estimated load, in either direction; a larger one means a wrong unit or a wrong sensor."""


@dataclass(frozen=True)
class ForceScale:
    """The factor on the forces of one estimator, and the relative error that is common to all of them."""

    factor: Annotated[float, Meta(ge=1 / WIDEST_FACTOR, le=WIDEST_FACTOR)] = 1.0
    error: Annotated[float, Meta(ge=0, le=1)] = 0.0
    """Relative error of a scaled force that modulus and base of the gel leave."""
    presses: Annotated[int, Meta(ge=0, le=10_000)] = 0
    """Number of presses of known load that determine it."""
    shear_factor: Annotated[float, Meta(ge=1 / WIDEST_FACTOR, le=WIDEST_FACTOR)] = 1.0
    """Factor on F_x, F_y and T_z beyond that on all forces, which only a force/torque sensor tells."""
    shear_error: Annotated[float, Meta(ge=0, le=1)] = 0.0
    """Relative error of that factor."""
    model_sha256: Annotated[str, Meta(max_length=64)] = ""
    """`ForceEstimator.model_sha256` of the estimator; assigned when the scale is written."""

    def __call__(self, estimate: WrenchEstimate) -> WrenchEstimate:
        """Return the estimate with wrench, covariance and tractions scaled; the errors of both factors, each common to its axes,
        are included.
        """
        wrench, factors = estimate.wrench, self.factor * np.where(SHEAR_COMPONENTS, self.shear_factor, 1.0)
        six = factors * wrench.six
        scaled = Wrench(six[:3], six[3:], wrench.about_mm, wrench.stamp_ns)
        covariance = np.outer(factors, factors) * estimate.covariance + self.error**2 * np.outer(six, six)
        if self.shear_error:
            sheared = SHEAR_COMPONENTS * six
            covariance = covariance + self.shear_error**2 * np.outer(sheared, sheared)
        traction = None if estimate.traction is None else self._scale_traction(estimate.traction)
        return replace(estimate, wrench=scaled, covariance=covariance, traction=traction)

    def _scale_traction(self, traction: Traction) -> Traction:
        """Return a traction with pressure and shear multiplied by their factors."""
        return replace(
            traction,
            pressure_mpa=traction.pressure_mpa * np.float32(self.factor),
            shear_mpa=traction.shear_mpa * np.float32(self.factor * self.shear_factor),
            gel=replace(traction.gel, shear_modulus_mpa=traction.gel.shear_modulus_mpa * self.factor),
        )


_MODULUS_ERROR, _BASE_ERROR = 0.25, 0.1
"""Relative errors of forces due to the modulus of the gel, because silicone of one name and hardness varies, and to its base, where
no calibration tells how well it is known."""
_FORCE_PER_MODULUS_RATIO = 3.0
"""Relative change of the forces that explain one image, per change of the modulus of the gel over that of its base: the median of
seven twins of real sensors on bases 3 and 10 times as stiff as the gel (0.3 to 7)."""
MODULUS_KNOWN = ForceScale(error=_BASE_ERROR, presses=1)
"""The scale of a simulated sensor whose gel's modulus is given, and whose base is not."""


def force_error_of_base(modulus_ratio_std: float | None) -> float:
    """Return the relative error of forces due to the base of the gel.

    modulus_ratio_std: how well the ball of the calibration tells the modulus of the gel over that of its base; None where this is
    not known.
    """
    return _BASE_ERROR if modulus_ratio_std is None else _FORCE_PER_MODULUS_RATIO * modulus_ratio_std


def force_scale_of_ball(modulus_ratio_std: float | None) -> ForceScale:
    """Return the scale of a sensor that was never pressed with known loads; the argument is that of `force_error_of_base`."""
    return ForceScale(error=min(float(np.hypot(_MODULUS_ERROR, force_error_of_base(modulus_ratio_std))), 1.0))


UNCALIBRATED = force_scale_of_ball(None)
"""The scale of an estimator that was never calibrated with known loads, on a sensor of whose base nothing is known."""


_EDITED_NOTICE = (
    "force.toml was edited or damaged after the force calibration: its checksum is not that of its numbers; run "
    "'ninedtact adapt' again if you did not edit it"
)


class ScaledForceEstimator(ForceEstimator):
    """An estimator whose estimates are multiplied by the force scale of one sensor."""

    def __init__(self, estimator: ForceEstimator, adaptation: ForceScale, file_notices: tuple[str, ...] = ()) -> None:
        self.name, self.model_sha256 = estimator.name, estimator.model_sha256
        self.calibration_checksum = estimator.calibration_checksum
        self.estimator, self.adaptation, self._file_notices = estimator, adaptation, file_notices

    @property
    def notices(self) -> tuple[str, ...]:
        """A sentence on the unknown modulus of a sensor without a force calibration, those on its file of force scales, and those
        of the estimator."""
        uncalibrated = (
            f"gel not calibrated for force: all forces ±{self.adaptation.error:.0%}, which is part of the stated errors; "
            "see 'ninedtact adapt'"
        )
        own = () if self.adaptation.presses else (uncalibrated,)
        return (*own, *self._file_notices, *self.estimator.notices)

    def estimate(self, reading: Reading) -> WrenchEstimate:
        """Return the scaled estimate; a wrench of zero stays exactly zero.

        Nothing is estimated from an image that cannot be a press on this sensor: its wrench is zero with an infinite standard
        deviation, and carries a warning.
        """
        self.require_own_reading(reading)
        if reading.image_warnings:
            self.estimator.forget()
            return unknown_wrench_estimate(reading.frame.stamp_ns, reading.image_warnings)
        scaled = self.adaptation(self.estimator.estimate(reading))
        return replace(scaled, warnings=(*reading.reference_warnings, *scaled.warnings))

    def forget(self) -> None:
        """Forget the previous reading."""
        self.estimator.forget()


FORCE_SCALE_FILE = "force.toml"


@dataclass(frozen=True)
class ForceScaleTables:
    """The content of the file of force scales."""

    scales: dict[str, ForceScale]
    """The force scale of each estimator, by its name."""
    is_edited: bool = False
    """Whether the numbers of the file differ from those that `write_force_scale` wrote."""


def apply_sensor_force_scale(
    estimator: ForceEstimator, sensor: Path, of_gel: ForceScale | None = None
) -> ScaledForceEstimator:
    """Return an estimator with the force scale of a sensor folder, `UNCALIBRATED` where there is none.

    of_gel: the error of modulus and base of the gel with which the estimator computes: as known loads left it, which counts before
    the folder's scale, or as the ball of the calibration did, which counts where the folder has none.

    A scale that was fitted to another model of the same name is not used, and a notice says so. Raises `FileFormatError`.
    """
    if of_gel is not None and of_gel.presses:
        return ScaledForceEstimator(estimator, of_gel)
    found = read_force_scales(sensor)
    notices = [_EDITED_NOTICE] if found.is_edited else []
    without_loads = of_gel or UNCALIBRATED
    scale = select_force_scale(estimator, found.scales, without_loads)
    if scale is without_loads and estimator.name in found.scales:
        notices.append(
            f"the force scale in {sensor / FORCE_SCALE_FILE} belongs to another model named {estimator.name!r} and is not used; "
            "run 'ninedtact adapt' with this model"
        )
    return ScaledForceEstimator(estimator, scale, tuple(notices))


def select_force_scale(
    estimator: ForceEstimator, scales: Mapping[str, ForceScale], without_loads: ForceScale = UNCALIBRATED
) -> ForceScale:
    """Return the scale that was fitted to this estimator and its model, another one where there is none."""
    scale = scales.get(estimator.name)
    return without_loads if scale is None or scale.model_sha256 != estimator.model_sha256 else scale


def write_force_scale(sensor: Path, estimator: ForceEstimator, adaptation: ForceScale) -> Path:
    """Add or replace the table of one estimator and return the file; raises `FileFormatError`, `FileNotWritten`.

    A file in which the tables of other estimators were edited gets no checksum, so that it still counts as edited.
    """
    found = read_force_scales(sensor)
    others = {name: scale for name, scale in found.scales.items() if name != estimator.name}
    scales = {**others, estimator.name: replace(adaptation, model_sha256=estimator.model_sha256)}
    plain: dict[str, Any] = {name: msgspec.to_builtins(scale) for name, scale in scales.items()}
    checksum = {} if found.is_edited and others else {CHECKSUM_KEY: mapping_checksum(plain)}
    with open_atomic_file(sensor / FORCE_SCALE_FILE) as file:
        tomli_w.dump({**checksum, **plain}, file)
    return sensor / FORCE_SCALE_FILE


def read_force_scales(sensor: Path) -> ForceScaleTables:
    """Return the force scales of a sensor folder, none where there is no file; raises `FileFormatError`."""
    path = sensor / FORCE_SCALE_FILE
    if not path.exists():
        return ForceScaleTables({})
    try:
        tables = parse_toml(read_text_file(path))
        is_edited = tables.pop(CHECKSUM_KEY, None) != mapping_checksum(tables)
        return ForceScaleTables(convert_tables_to_class(tables, dict[str, ForceScale]), is_edited)
    except (OSError, ValueError, RecursionError) as trouble:
        raise FileFormatError(
            f"expected {path} as 'ninedtact adapt' wrote it, got: {trouble}; delete it and run 'ninedtact adapt' again"
        ) from trouble
