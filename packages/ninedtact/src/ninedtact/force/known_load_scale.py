"""Force scale of a sensor: the factor from estimated to true forces, fitted to a few presses with known loads.

Images show strain, not stress. The gel's shear modulus varies by a quarter from batch to batch and is an unknown factor on all six
axes, which presses on a kitchen scale determine. Until then, a quarter of every force is part of its stated error. The factor may
also depend on the load, because the gel stiffens as it thins: F_true = k·F·(F/F_0)^c. Leave-one-out errors decide between a
constant factor and this power law. The power law was fitted to loads: F_z and the torques T_x and T_y, which F_z makes about the
skin's centre, follow it; shear and the twist T_z have its factor at light load.

The fitted scale is kept in `force.toml` in the sensor folder, in one table for each estimator.
"""

import tomllib
from collections.abc import Mapping, Sequence
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
from ninedtact.checked_reading import CHECKSUM_KEY, convert_tables_to_class, mapping_checksum, read_text_file
from ninedtact.errors import FileFormatError, ForceEstimationError
from ninedtact.force.estimator_interface import ForceEstimator, unknown_wrench_estimate
from ninedtact.quantities import EstimateWarning, Traction, Wrench, WrenchEstimate
from ninedtact.reading import Reading

FEWEST = 2
FEWEST_FOR_CURVE = 4
_MAX_EXPONENT = 3.0
"""Largest magnitude of the exponent of the load; a larger one means that images or weights were exchanged."""
WIDEST_FACTOR = 5.0
"""Largest ratio between known and estimated load, in either direction; a larger one means a wrong unit or a wrong sensor."""
CURVE_MUST_GAIN = 0.8
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
            raise ForceScaleImpossible(f"expected a weight above zero, got {self.weighed_n:g} N; read the scale again")
        if not (0 < self.estimated_n < np.inf):
            raise ForceScaleImpossible(
                f"expected a press that the image shows, got an estimate of {self.estimated_n:g} N under "
                f"{self.weighed_n:.2f} N; let the object rest on the middle of the skin, and give the image of that"
            )
        ratio = self.weighed_n / self.estimated_n
        if not 1 / WIDEST_FACTOR < ratio < WIDEST_FACTOR:
            raise ForceScaleImpossible(
                f"expected a weight near the estimated {self.estimated_n:.2f} N, got {self.weighed_n:.2f} N; give grams, and "
                "the image that was taken under that weight"
            )


@dataclass(frozen=True)
class ForceScale:
    """Factor by which a sensor's estimated wrenches are multiplied, as a function of the load; the default is a factor of one."""

    factor: Annotated[float, Meta(ge=1 / WIDEST_FACTOR, le=WIDEST_FACTOR)] = 1.0
    curve: Annotated[float, Meta(ge=-_MAX_EXPONENT, le=_MAX_EXPONENT)] = 0.0
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
            f"expected at least {FEWEST} presses of known weight, got {len(presses)}; press with two weights or more"
        )
    load = np.log([press.estimated_n for press in presses])
    wanted = np.log([press.weighed_n for press in presses]) - load
    by_factor = left_out_rms(load, wanted, 0)
    by_curve = left_out_rms(load, wanted, 1) if loads_determine_power_law(load) else None
    bends = by_curve is not None and by_curve < CURVE_MUST_GAIN * by_factor
    about = float(np.exp(load.mean()))
    curve, factor = (*fit_line(load - load.mean(), wanted),) if bends else (0.0, wanted.mean())
    error = by_curve if bends and by_curve is not None else by_factor
    if error > _MAX_ERROR:
        raise ForceScaleImpossible(
            f"expected presses that agree on one force scale to {_MAX_ERROR:.0%}, got a scatter of {error:.0%}; check that each "
            "image belongs to its weight, and that the scale was set to zero with the sensor on it"
        )
    if abs(curve) > _MAX_EXPONENT:
        raise ForceScaleImpossible(
            f"expected a factor that changes at most with the power {_MAX_EXPONENT:g} of the load, got the power {curve:.1f}; "
            "check that each image belongs to its weight"
        )
    found = ForceScale(float(np.exp(factor)), float(curve), about, error, len(presses))
    return ForceScaleFit(found, rms(wanted), by_factor, by_curve)


def loads_determine_power_law(load: Float[Array, " n"]) -> bool:
    """Return whether the loads (logarithms) determine a power law: at least four of them, over more than a factor of two."""
    return len(load) >= FEWEST_FOR_CURVE and bool(np.ptp(load) > np.log(2))


def left_out_rms(load: Float[Array, " n"], wanted: Float[Array, " n"], degree: int) -> float:
    """Return the root mean square relative error of each press as a polynomial fit to the others predicts it."""
    others = ~np.eye(len(load), dtype=bool)
    # The domain is stated because NumPy below 2 cannot find one for a single load.
    fits = [np.polynomial.Polynomial.fit(load[use], wanted[use], degree, domain=[-1, 1]) for use in others]
    return rms(np.array([wanted[n] - fit(load[n]) for n, fit in enumerate(fits)]))


def fit_line(x: Float[Array, " n"], y: Float[Array, " n"]) -> tuple[float, float]:
    """Return slope and intercept of the least-squares line."""
    slope, height = np.polyfit(x, y, 1)
    return float(slope), float(height)


def rms(values: Float[Array, " n"]) -> float:
    """Return the root mean square of the values."""
    return float(np.sqrt(np.mean(np.square(values))))


def weight_of_grams_n(grams: float) -> float:
    """Return the weight in N of a mass in grams under standard gravity."""
    return grams / 1e3 * STANDARD_GRAVITY


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
