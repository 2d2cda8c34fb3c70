"""The interface of every force estimator, and the force scale of a sensor. A reading goes in; a wrench, its standard deviation and
warnings come out.

Images show strain, not stress. The gel's shear modulus varies by a quarter from batch to batch and is an unknown factor on all six
axes, which presses on a kitchen scale determine (`calibration.force_calibration`). Until then, a quarter of every force is part of
its stated error. The factor may also depend on the load, because the gel stiffens as it thins: F_true = k·F·(F/F_0)^c. F_z and the
torques T_x and T_y, which F_z makes about the skin's centre, follow this power law, which was fitted to loads; shear and the twist
T_z have its factor at light load.

The fitted scale is kept in `force.toml` in the sensor folder, in one table for each estimator.
"""

import tomllib
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
import tomli_w
from jaxtyping import Float
from msgspec import Meta
from numpy import ndarray as Array

from ninedtact.atomic_write import open_atomic_file
from ninedtact.bounds_and_checked_reading import CHECKSUM_KEY, convert_tables_to_class, mapping_checksum, read_text_file
from ninedtact.errors import FileFormatError
from ninedtact.quantities import EstimateWarning, Traction, Wrench, WrenchEstimate
from ninedtact.reading import Reading


class ForceEstimator(ABC):
    """Estimates the wrench of readings. It may start from the previous reading to be quicker; `forget` makes it start anew."""

    name: str
    """The name that is displayed, and the key of the force scale in a sensor folder."""
    model_sha256: str = ""
    """SHA-256 of the file of its network, which tells two models of one name apart; empty for estimators without a network."""

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


MAX_EXPONENT = 3.0
"""Largest magnitude of the exponent of the load; a larger one means that images or weights were exchanged."""
WIDEST_FACTOR = 5.0
"""Largest ratio between known and estimated load, in either direction; a larger one means a wrong unit or a wrong sensor."""


@dataclass(frozen=True)
class ForceScale:
    """Factor by which a sensor's estimated wrenches are multiplied, as a function of the load; the default is a factor of one."""

    factor: Annotated[float, Meta(ge=1 / WIDEST_FACTOR, le=WIDEST_FACTOR)] = 1.0
    curve: Annotated[float, Meta(ge=-MAX_EXPONENT, le=MAX_EXPONENT)] = 0.0
    """Exponent c of the load, with which the factor changes."""
    about_n: Annotated[float, Meta(ge=1e-3, le=1e3)] = 1.0
    """Load F_0 at which the factor is `factor`."""
    error: Annotated[float, Meta(ge=0, le=1)] = 0.0
    """Relative error of a scaled force: root mean square over presses that are left out of the fit one at a time."""
    presses: Annotated[int, Meta(ge=0, le=10_000)] = 0
    """Number of presses of known load that the scale was fitted to."""
    model_sha256: Annotated[str, Meta(max_length=64)] = ""
    """`ForceEstimator.model_sha256` of the estimator; assigned when the scale is written."""

    def at(self, load_n: float) -> float:
        """Return the factor for a wrench with this estimated load."""
        if self.curve == 0:
            return self.factor
        nearby = np.clip(load_n / self.about_n, 1 / WIDEST_FACTOR, WIDEST_FACTOR)
        return float(self.factor * nearby**self.curve)

    def _has_slope_at(self, load_n: float) -> bool:
        """Return whether the factor changes with the load there; it is constant far from `about_n`."""
        return bool(1 / WIDEST_FACTOR < load_n / self.about_n < WIDEST_FACTOR)

    def __call__(self, estimate: WrenchEstimate) -> WrenchEstimate:
        """Return the estimate with wrench, covariance and tractions scaled; the error of the scale, common to all axes, is
        included.

        The estimate's torques are about the skin's centre.
        """
        wrench = estimate.wrench
        under_load, light = self.at(-float(wrench.force_n[2])), self.at(0.0)
        factors = np.array([light, light, under_load, under_load, under_load, light])
        six = wrench.six * factors
        scaled = Wrench(six[:3], six[3:], wrench.about_mm, wrench.stamp_ns)
        covariance = self._scale_covariance(estimate, factors) + self.error**2 * np.outer(six, six)
        traction = None if estimate.traction is None else _scale_traction(estimate.traction, under_load, light)
        return replace(estimate, wrench=scaled, covariance=covariance, traction=traction)

    def _scale_covariance(self, estimate: WrenchEstimate, factors: Float[Array, "6"]) -> Float[Array, "6 6"]:
        """Return the covariance of the scaled wrench: an error of the load also changes the factor, by the power law's slope."""
        covariance, six = estimate.covariance, estimate.wrench.six
        load_n = -six[2]
        if not self.curve or not self._has_slope_at(load_n) or not np.isfinite(covariance).all():
            # Estimates without a stated error have infinite variances, which stay infinite.
            with np.errstate(invalid="ignore"):
                return covariance * np.outer(factors, factors)
        jacobian = np.diag(factors)
        jacobian[2:5, 2] += self.curve * factors[2:5] * six[2:5] / six[2]
        return jacobian @ covariance @ jacobian.T


UNCALIBRATED = ForceScale(error=0.25)
"""The scale of a sensor that was never pressed with known loads: silicone of one name and hardness varies by a quarter."""
_UNCALIBRATED_NOTICE = (
    f"gel not calibrated for force: all forces ±{UNCALIBRATED.error:.0%}, which is part of the stated errors; "
    "see 'ninedtact adapt'"
)


_EDITED_NOTICE = (
    "force.toml was edited or damaged after the force calibration: its checksum is not that of its numbers; run "
    "'ninedtact adapt' again if you did not edit it"
)


def _scale_traction(traction: Traction, pressure_factor: float, shear_factor: float) -> Traction:
    """Return a traction with pressure and shear multiplied by their factors."""
    return replace(
        traction,
        pressure_mpa=traction.pressure_mpa * np.float32(pressure_factor),
        shear_mpa=traction.shear_mpa * np.float32(shear_factor),
    )


class ScaledForceEstimator(ForceEstimator):
    """An estimator whose estimates are multiplied by the force scale of one sensor."""

    def __init__(self, estimator: ForceEstimator, adaptation: ForceScale, file_notices: tuple[str, ...] = ()) -> None:
        self.name, self.model_sha256 = estimator.name, estimator.model_sha256
        self.estimator, self.adaptation, self._file_notices = estimator, adaptation, file_notices

    @property
    def notices(self) -> tuple[str, ...]:
        """A sentence on the unknown modulus of a sensor without a force calibration, those on its file of force scales, and those
        of the estimator."""
        own = () if self.adaptation.presses else (_UNCALIBRATED_NOTICE,)
        return (*own, *self._file_notices, *self.estimator.notices)

    def estimate(self, reading: Reading) -> WrenchEstimate:
        """Return the scaled estimate; a wrench of zero stays exactly zero.

        Nothing is estimated from an image that cannot be a press on this sensor: its wrench is zero with an infinite standard
        deviation, and carries a warning.
        """
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


def apply_sensor_force_scale(estimator: ForceEstimator, sensor: Path) -> ScaledForceEstimator:
    """Return an estimator with the force scale of a sensor folder, `UNCALIBRATED` where there is none.

    A scale that was fitted to another model of the same name is not used, and a notice says so. Raises `FileFormatError`.
    """
    found = read_force_scales(sensor)
    notices = [_EDITED_NOTICE] if found.is_edited else []
    scale = select_force_scale(estimator, found.scales)
    if scale is UNCALIBRATED and estimator.name in found.scales:
        notices.append(
            f"the force scale in {sensor / FORCE_SCALE_FILE} belongs to another model named {estimator.name!r} and is not used; "
            "run 'ninedtact adapt' with this model"
        )
    return ScaledForceEstimator(estimator, scale, tuple(notices))


def select_force_scale(estimator: ForceEstimator, scales: Mapping[str, ForceScale]) -> ForceScale:
    """Return the scale that was fitted to this estimator and its model, `UNCALIBRATED` where there is none."""
    scale = scales.get(estimator.name)
    return UNCALIBRATED if scale is None or scale.model_sha256 != estimator.model_sha256 else scale


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
        tables = tomllib.loads(read_text_file(path))
        is_edited = tables.pop(CHECKSUM_KEY, None) != mapping_checksum(tables)
        return ForceScaleTables(convert_tables_to_class(tables, dict[str, ForceScale]), is_edited)
    except (OSError, ValueError, RecursionError) as trouble:
        raise FileFormatError(
            f"expected {path} as 'ninedtact adapt' wrote it, got: {trouble}; delete it and run 'ninedtact adapt' again"
        ) from trouble
