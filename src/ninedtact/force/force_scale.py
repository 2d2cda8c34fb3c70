"""From a few presses of known weight to the newtons of one's own sensor.

Images tell strain, not stress: the gel's modulus, which varies from batch to batch by a quarter, is a factor on all
six axes that no image shows. A kitchen scale does. Where presses of several weights show it, the factor may also
grow or fall with the load (a gel that stiffens as it thins): F_true = k·F·(F/F_0)^c. Which of the two is believed is
decided by leaving out one press at a time.

`force.toml` in a sensor's folder: what its weighed presses said, one table for each estimator that they were read by.
"""

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import tomli_w
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact.atomic_write import open_atomic_file
from ninedtact.errors import FileFormatError, ForceError
from ninedtact.force.estimator import ForceEstimator
from ninedtact.quantities import Traction, Wrench, WrenchEstimate
from ninedtact.reading import Reading

FEWEST = 2
FEWEST_FOR_CURVE = 4
WIDEST_FACTOR = 5.0
"""Between what is estimated and what was weighed: more is a wrong unit or a wrong sensor."""
CURVE_MUST_GAIN = 0.8
"""The curve is believed where it takes a fifth off the error of presses that it was not fitted to."""
STANDARD_GRAVITY = 9.80665


class ForceScaleImpossible(ForceError):
    """Weighed presses that do not tell how strong a sensor's gel is."""


@dataclass(frozen=True)
class KnownLoadPress:
    """One press under a known load."""

    estimated_n: float
    """−F_z as the estimator reads it, without adaptation."""
    weighed_n: float

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
    """What a sensor's own weighed presses say about its forces. The default changes nothing."""

    factor: float = 1.0
    curve: float = 0.0
    """Power of the load by which the factor grows."""
    about_n: float = 1.0
    """Load at which the factor is `factor`."""
    error: float = 0.0
    """Of a force so corrected, as a part of it: root mean square over presses left out of the fit."""
    presses: int = 0

    def at(self, load_n: float) -> float:
        """What a wrench with this estimated load is multiplied by."""
        if self.curve == 0 or load_n <= 0:
            return self.factor
        nearby = np.clip(load_n / self.about_n, 1 / WIDEST_FACTOR, WIDEST_FACTOR)
        return float(self.factor * nearby**self.curve)

    def __call__(self, estimate: WrenchEstimate) -> WrenchEstimate:
        """The estimate in this sensor's newtons, its error with it."""
        wrench = estimate.wrench
        factor = self.at(-float(wrench.force_n[2]))
        scaled = Wrench(wrench.force_n * factor, wrench.torque_nm * factor, wrench.about_mm, wrench.stamp_ns)
        error = np.hypot(estimate.error * factor, self.error * np.abs(scaled.six))
        return replace(estimate, wrench=scaled, error=error, traction=scaled_traction(estimate.traction, factor))


def scaled_traction(traction: Traction | None, factor: float) -> Traction | None:
    """The same tractions, so many times as strong."""
    if traction is None:
        return None
    times = np.float32(factor)
    return replace(traction, pressure_mpa=traction.pressure_mpa * times, shear_mpa=traction.shear_mpa * times)


class ScaledForceEstimator(ForceEstimator):
    """An estimator that answers in one sensor's newtons."""

    def __init__(self, estimator: ForceEstimator, adaptation: ForceScale) -> None:
        self.name, self.estimator, self.adaptation = estimator.name, estimator, adaptation

    def estimate(self, reading: Reading) -> WrenchEstimate:
        """Zero stays zero."""
        return self.adaptation(self.estimator.estimate(reading))

    def forget(self) -> None:
        """Start anew."""
        self.estimator.forget()


@dataclass(frozen=True)
class ForceScaleFit:
    """An adaptation and what each way of adapting would leave as error, on presses that it had not seen."""

    adaptation: ForceScale
    unadapted: float
    """Root mean square relative error without any."""
    by_factor: float
    by_curve: float | None
    """None where there are too few presses, or too alike."""


def fit_force_scale(presses: Sequence[KnownLoadPress]) -> ForceScaleFit:
    """The adaptation that predicts presses left out of its own fit best; raises `ForceScaleImpossible`."""
    if len(presses) < FEWEST:
        raise ForceScaleImpossible(
            f"expected at least {FEWEST} presses of known weight, got {len(presses)}; press with two weights or more"
        )
    load = np.log([press.estimated_n for press in presses])
    wanted = np.log([press.weighed_n for press in presses]) - load
    by_factor = left_out_rms(load, wanted, 0)
    by_curve = left_out_rms(load, wanted, 1) if can_bend(load) else None
    bends = by_curve is not None and by_curve < CURVE_MUST_GAIN * by_factor
    about = float(np.exp(load.mean()))
    curve, factor = (*line(load - load.mean(), wanted),) if bends else (0.0, wanted.mean())
    error = by_curve if bends and by_curve is not None else by_factor
    found = ForceScale(float(np.exp(factor)), float(curve), about, error, len(presses))
    return ForceScaleFit(found, rms(wanted), by_factor, by_curve)


def can_bend(load: Float[Array, " n"]) -> bool:
    """Whether the loads are many and different enough to tell a curve: a factor of two from the least to the most."""
    return len(load) >= FEWEST_FOR_CURVE and bool(np.ptp(load) > np.log(2))


def left_out_rms(load: Float[Array, " n"], wanted: Float[Array, " n"], degree: int) -> float:
    """Relative error of every press as the others predict it."""
    others = ~np.eye(len(load), dtype=bool)
    fits = [np.polynomial.Polynomial.fit(load[use], wanted[use], degree) for use in others]
    return rms(np.array([wanted[n] - fit(load[n]) for n, fit in enumerate(fits)]))


def line(x: Float[Array, " n"], y: Float[Array, " n"]) -> tuple[float, float]:
    """Slope and height at zero."""
    slope, height = np.polyfit(x, y, 1)
    return float(slope), float(height)


def rms(values: Float[Array, " n"]) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def weight_of_grams_n(grams: float) -> float:
    """What so many grams weigh."""
    return grams / 1e3 * STANDARD_GRAVITY


FORCE_SCALE_FILE = "force.toml"


class ForceScaleFileDamaged(FileFormatError):
    """A file of adaptations that cannot be understood."""


def read_force_scale(sensor: Path, estimator: str) -> ForceScale:
    """The adaptation of this sensor for this estimator; one that changes nothing where there is none.

    Raises `ForceScaleFileDamaged`.
    """
    return read_force_scale_tables(sensor).get(estimator, ForceScale())


def write_force_scale(sensor: Path, estimator: str, adaptation: ForceScale) -> Path:
    """Add or replace one estimator's table; raises `ForceScaleFileDamaged`, `FileNotWritten`."""
    found = {**read_force_scale_tables(sensor), estimator: adaptation}
    plain: dict[str, Any] = {name: msgspec.to_builtins(one) for name, one in found.items()}
    with open_atomic_file(sensor / FORCE_SCALE_FILE) as file:
        tomli_w.dump(plain, file)
    return sensor / FORCE_SCALE_FILE


def read_force_scale_tables(sensor: Path) -> dict[str, ForceScale]:
    """Every table of the file; none where there is no file."""
    path = sensor / FORCE_SCALE_FILE
    if not path.exists():
        return {}
    try:
        return msgspec.convert(tomllib.loads(path.read_text(encoding="utf-8")), dict[str, ForceScale])
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError, msgspec.ValidationError) as trouble:
        raise ForceScaleFileDamaged(
            f"expected {path} as 'ninedtact adapt' wrote it, got: {trouble}; delete it and run 'ninedtact adapt' again"
        ) from trouble
