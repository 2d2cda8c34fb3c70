"""What presses with known loads say about a gel: its shear modulus, and how far the base under it yields.

The image of a press shows strain. Its load is the strain's, f(r), times a factor e^g that scales the assumed shear modulus; r is
the modulus of the gel over that of its base. On a base that yields more, the same image means a softer gel that is pressed less
thin, so that f falls with r, for deep presses faster than for light ones. Known loads w therefore determine g + log f(r) well, and
r by how this differs from press to press:

    log w = g + log f(r) + e        g ~ N(0, 0.25²), r ~ the calibration's value and ±, r ≥ 0, e ~ N(0, σ²)

σ is the estimator's error of one press. f is known at a few r, at which the calibration's ball was explained again, and
interpolated between them. Given r, g follows in closed form; r is searched on a grid, because near a rigid base its distribution
is far from Gaussian. An estimator without a gel has one f, and the factor alone is unknown.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.interpolate import PchipInterpolator

from ninedtact.errors import ForceEstimationError
from ninedtact.force.estimator_and_scale import WIDEST_FACTOR
from ninedtact.quantities import EstimateWarning

MODULUS_STD = 0.25
"""Relative standard deviation of the shear modulus before anything is weighed: silicone of one name varies by a quarter."""
CONTRADICTION_SIGMAS = 3.5
"""Deviation of a load from what the other presses say, in standard deviations, from which it contradicts them."""
_LEAST_CONTRADICTION = 0.4
"""Logarithm of the deviation below which a load contradicts nothing: the estimate of one object may be off by as much."""
_DOUBTFUL_STD = 0.15
"""Relative error that is added to that of an estimate with warnings, such as one beyond the range of the calibration."""
_SCALE_STD_N = 0.01
"""Error of a kitchen scale, which shows whole grams."""
_LEAST_RATIO_STD = 0.02
"""Standard deviation of the base that no loads reduce: the error of the mechanics of deep presses moves the result by as much."""
_GRID = 241
"""Number of bases on which the distribution is computed."""


class ForceScaleImpossible(ForceEstimationError):
    """Presses with known loads do not determine the gel, or the force scale, of a sensor."""


@dataclass(frozen=True)
class KnownLoadPress:
    """One press under a known load, and its load as the estimator states it for each assumed base of the gel."""

    name: str
    weighed_n: float
    estimated_n: tuple[float, ...]
    """−F_z for each base, before the calibration with known loads."""
    relative_std: float
    """Relative standard deviation of the estimates without the errors of modulus and base."""
    calibrated: int = 0
    """Index of the base that the ball of the calibration tells among the assumed ones."""
    warnings: tuple[EstimateWarning, ...] = ()
    """Reasons to distrust the estimate."""

    def __post_init__(self) -> None:
        if not (0 < self.weighed_n < np.inf):
            raise ForceScaleImpossible(
                expected=f"{self.name} with a weight above zero",
                got=f"{self.weighed_n:g} N",
                remedy="read the scale again",
            )
        if not all(0 < estimated_n < np.inf for estimated_n in self.estimated_n):
            raise ForceScaleImpossible(
                expected=f"{self.name} to show a press",
                got=f"an estimate of {min(self.estimated_n):g} N under {self.weighed_n:.2f} N",
                remedy="let the object rest on the middle of the skin, and give the image of that",
            )

    @property
    def calibrated_n(self) -> float:
        """The estimated load before the calibration with known loads."""
        return self.estimated_n[self.calibrated]

    @property
    def std(self) -> float:
        """Relative standard deviation of the estimated over the true load."""
        return float(
            np.sqrt(
                self.relative_std**2
                + (_DOUBTFUL_STD if self.warnings else 0.0) ** 2
                + (_SCALE_STD_N / self.weighed_n) ** 2
            )
        )


@dataclass(frozen=True)
class AssumedBases:
    """The bases on which presses are estimated, as gel over base modulus, and what the calibration says of them."""

    ratios: tuple[float, ...] = (0.0,)
    """In rising order; a single one where the base is not searched."""
    mean: float = 0.0
    std: float = 0.0

    @property
    def is_searched(self) -> bool:
        """Whether the base is one of the unknowns."""
        return len(self.ratios) > 1

    @cached_property
    def grid(self) -> Float[Array, " bases"]:
        """The bases on which the distribution is computed."""
        return np.linspace(self.ratios[0], self.ratios[-1], _GRID) if self.is_searched else np.array(self.ratios)

    @cached_property
    def log_prior(self) -> Float[Array, " bases"]:
        """Logarithm of the density before loads are known, at the bases of the grid."""
        return -0.5 * ((self.grid - self.mean) / self.std) ** 2 if self.is_searched else np.zeros(1)

    def interpolate(self, presses: Sequence[KnownLoadPress]) -> Float[Array, "bases presses"]:
        """Return the logarithms of the estimated loads on the bases of the grid."""
        logs = np.log([press.estimated_n for press in presses]).T
        return np.asarray(PchipInterpolator(self.ratios, logs)(self.grid)) if self.is_searched else logs


@dataclass(frozen=True)
class _Posterior:
    """The distribution of factor and base after some loads are known."""

    grid: Float[Array, " bases"]
    weight: Float[Array, " bases"]
    """Probability of each base."""
    factor: Float[Array, " bases"]
    """Mean of the logarithm of the factor on each base."""
    factor_variance: float
    """Its variance on one base."""

    @property
    def ratio(self) -> float:
        """Mean of the base."""
        return float(self.weight @ self.grid)

    @property
    def covariance(self) -> Float[Array, "2 2"]:
        """Covariance of the logarithm of the factor and of the base."""
        off = np.stack([self.factor - self.weight @ self.factor, self.grid - self.ratio])
        covariance = (self.weight * off) @ off.T + np.diag([self.factor_variance, 0.0])
        if len(self.grid) == 1:
            return np.asarray(covariance)
        # The factor follows the base, so that the loads stay explained.
        along = np.array([np.interp(self.ratio, self.grid, np.gradient(self.factor, self.grid)), 1.0])
        return np.asarray(covariance + _LEAST_RATIO_STD**2 * np.outer(along, along))

    def predict(self, logs: Float[Array, "bases presses"]) -> tuple[Float[Array, " presses"], Float[Array, " presses"]]:
        """Return mean and variance of the logarithms of the loads of presses."""
        on_bases = self.factor[:, None] + logs
        mean = self.weight @ on_bases
        return mean, self.weight @ (on_bases - mean) ** 2 + self.factor_variance


def _infer(
    bases: AssumedBases,
    logs: Float[Array, "bases presses"],
    weighed: Float[Array, " presses"],
    std: Float[Array, " presses"],
) -> _Posterior:
    """Return the distribution given the logarithms of weighed loads; that of the calibration for no presses."""
    precision = std**-2
    wanted = weighed - logs
    variance = 1 / (precision.sum() + MODULUS_STD**-2)
    factor = variance * (wanted @ precision)
    misfit = wanted**2 @ precision - factor**2 / variance
    log_weight = bases.log_prior - 0.5 * misfit
    weight = np.exp(log_weight - log_weight.max())
    return _Posterior(bases.grid, weight / weight.sum(), factor, float(variance))


@dataclass(frozen=True)
class KnownLoadFit:
    """The gel that known loads determine, and how well each load agrees with the others."""

    factor: float
    """True over assumed shear modulus on this base: what the estimates on it must be multiplied by."""
    ratio: float
    """Modulus of the gel over that of its base; that of the calibration where the base is not searched."""
    covariance: tuple[tuple[float, float], tuple[float, float]]
    """Covariance of the logarithm of the factor and of the ratio."""
    error: float
    """Relative standard deviation, common to all loads like the given ones, that factor and base leave."""
    estimated_n: tuple[float, ...]
    """The load of each press with this gel."""
    unadapted: float
    """Root mean square relative error before the fit."""
    left_out: float | None
    """The same of each press as the others predict it; None for a single press."""
    deviations: tuple[float, ...]
    """Deviation of each load from what the others, or for a single press the calibration, say, in standard deviations."""
    shear_factor: float = 1.0
    """What F_x, F_y and T_z must be multiplied by beyond `factor`; loads of a scale do not tell it."""
    shear_std: float = 0.0
    """Its relative standard deviation."""

    @property
    def modulus_std(self) -> float:
        """Relative standard deviation of the shear modulus."""
        return float(np.sqrt(self.covariance[0][0]))

    @property
    def correlation(self) -> float:
        """Correlation of the logarithm of the modulus with the ratio; zero where the ratio is not searched."""
        return self.covariance[0][1] / (self.modulus_std * self.ratio_std) if self.ratio_std > 0 else 0.0

    @property
    def ratio_std(self) -> float:
        """Standard deviation of the ratio of the moduli."""
        return float(np.sqrt(self.covariance[1][1]))


def fit_known_loads(presses: Sequence[KnownLoadPress], bases: AssumedBases = AssumedBases()) -> KnownLoadFit:
    """Return the gel that explains the loads; raises `ForceScaleImpossible`, which names a load that contradicts others."""
    if not presses:
        raise ForceScaleImpossible(
            expected="at least one press of known weight", got="none", remedy="press with one weight or more"
        )
    require_same_unit(presses)
    fit = fit_agreeing_loads(presses, bases)
    worst = find_contradiction(presses, bases)
    if worst is not None:
        raise _contradiction_error(presses[worst], fit.deviations[worst], len(presses) > 1)
    return fit


def fit_agreeing_loads(presses: Sequence[KnownLoadPress], bases: AssumedBases = AssumedBases()) -> KnownLoadFit:
    """Return the gel that explains the loads best, however they agree."""
    logs, weighed, std = _logarithms(presses, bases)
    before = np.log([press.calibrated_n for press in presses])
    left_out, deviations = _leave_one_out(bases, logs, weighed, std)
    found = _infer(bases, logs, weighed, std)
    covariance = found.covariance
    factor = float(np.interp(found.ratio, found.grid, found.factor))
    at_ratio = np.array([np.interp(found.ratio, found.grid, column) for column in logs.T])
    variance = found.predict(logs)[1]
    return KnownLoadFit(
        factor=float(np.exp(factor)),
        ratio=found.ratio,
        covariance=(tuple(covariance[0].tolist()), tuple(covariance[1].tolist())),
        error=float(np.sqrt(variance.mean())),
        estimated_n=tuple(np.exp(factor + at_ratio).tolist()),
        unadapted=_rms(weighed - before),
        left_out=_rms(left_out) if len(presses) > 1 else None,
        deviations=tuple(deviations.tolist()),
    )


def require_same_unit(presses: Sequence[KnownLoadPress]) -> None:
    """Raise `ForceScaleImpossible` for a load so far from the estimate that it cannot be of this image."""
    for press in presses:
        if not 1 / WIDEST_FACTOR < press.weighed_n / press.calibrated_n < WIDEST_FACTOR:
            raise ForceScaleImpossible(
                expected=f"{press.name} with a weight near the estimated {press.calibrated_n:.2f} N",
                got=f"{press.weighed_n:.2f} N",
                remedy="give grams, and the image that was taken under that weight",
            )


def find_contradiction(presses: Sequence[KnownLoadPress], bases: AssumedBases = AssumedBases()) -> int | None:
    """Return the number of the press whose load contradicts the others most, or a single one the calibration; None without one."""
    left_out, deviations = _leave_one_out(bases, *_logarithms(presses, bases))
    worst = int(np.abs(deviations).argmax())
    contradicts = abs(deviations[worst]) > CONTRADICTION_SIGMAS and abs(left_out[worst]) > _LEAST_CONTRADICTION
    return worst if contradicts else None


def _logarithms(
    presses: Sequence[KnownLoadPress], bases: AssumedBases
) -> tuple[Float[Array, "bases presses"], Float[Array, " presses"], Float[Array, " presses"]]:
    """Return the logarithms of the estimated loads on the bases, those of the known loads, and their standard deviations."""
    weighed = np.log([press.weighed_n for press in presses])
    return bases.interpolate(presses), weighed, np.array([press.std for press in presses])


def _leave_one_out(
    bases: AssumedBases,
    logs: Float[Array, "bases presses"],
    weighed: Float[Array, " presses"],
    std: Float[Array, " presses"],
) -> tuple[Float[Array, " presses"], Float[Array, " presses"]]:
    """Return how far the logarithm of each load is off from what the others say, and the same in standard deviations."""
    left_out, deviations = np.empty_like(weighed), np.empty_like(weighed)
    for number in range(len(weighed)):
        use = np.arange(len(weighed)) != number
        mean, variance = _infer(bases, logs[:, use], weighed[use], std[use]).predict(logs[:, [number]])
        left_out[number] = weighed[number] - mean[0]
        deviations[number] = left_out[number] / np.sqrt(variance[0] + std[number] ** 2)
    return left_out, deviations


def _contradiction_error(press: KnownLoadPress, deviation: float, has_others: bool) -> ForceScaleImpossible:
    """Return the error for a load that contradicts the others, or the calibration."""
    return ForceScaleImpossible(
        expected=f"loads that one gel explains to {CONTRADICTION_SIGMAS:g} standard deviations",
        got=f"{press.name} with {press.weighed_n:.2f} N, {abs(deviation):.1f} standard deviations "
        f"{'above' if deviation > 0 else 'below'} what "
        + ("the other presses say" if has_others else "the calibration says"),
        remedy="weigh it again, or leave it out; each image must belong to its weight, and the scale be set to zero with the "
        "sensor on it",
    )


def _rms(values: Float[Array, " n"]) -> float:
    """Return the root mean square of the values."""
    return float(np.sqrt(np.mean(np.square(values))))
