"""How well a fit determines its parameters. Residuals are model errors, smooth over millimetres, so that the number of independent
observations is estimated from the residual itself.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact.calibration.twin.fit_parameters import (
    BASE_INDEX,
    PARAMETER_NAMES,
    fit_parameters,
    parameters_of_press,
    press_count_of,
)
from ninedtact.simulation.calibration_press_models import ParameterVector


@dataclass(frozen=True)
class FitUncertainty:
    """Standard deviations of the searched parameters, and correlations of those of the first press, gel and view."""

    effective_observations: float
    """Effective number of independent observations."""
    standard_deviations: dict[str, float]
    correlation: Float[Array, "parameters parameters"]

    def most_correlated_parameter(self, name: str) -> tuple[str, float]:
        """Return the parameter with which this one is most correlated, and their correlation."""
        index = PARAMETER_NAMES.index(name)
        row = self.correlation[index].copy()
        row[index] = 0
        other = int(np.abs(row).argmax())
        return PARAMETER_NAMES[other], float(row[other])


def parameter_covariance(
    jacobian: Float[Array, "rows parameters"], residual: Float[Array, "..."], effective_observations: float
) -> Float[Array, "parameters parameters"]:
    """Return the covariance of least-squares parameters, as of this number of independent observations (Gauss–Markov)."""
    degrees_of_freedom = max(effective_observations - jacobian.shape[1], 1.0)
    variance = np.sum(residual**2) / degrees_of_freedom
    return np.linalg.pinv(jacobian.T @ jacobian) * variance


def estimate_uncertainty(
    jacobian: Float[Array, "rows parameters"],
    residual: Float[Array, " n"],
    effective_observations: float,
    model_error: ParameterVector,
) -> FitUncertainty:
    """Return standard deviations and correlations. The Jacobian has the rows of the priors too, the residual has not.

    model_error: how far one standard deviation of what the model leaves open moves all parameters together.
    """
    covariance = parameter_covariance(jacobian, residual, effective_observations) + np.outer(model_error, model_error)
    standard_deviations = np.sqrt(np.maximum(np.diag(covariance), 0))
    divisors = np.where(standard_deviations > 0, standard_deviations, 1)
    names = [parameter.name for parameter in fit_parameters(press_count_of(standard_deviations))]
    named = dict(zip(names, standard_deviations.tolist(), strict=True))
    own = slice(len(PARAMETER_NAMES))
    return FitUncertainty(effective_observations, named, (covariance / np.outer(divisors, divisors))[own, own])


def model_error_share(jacobian: Float[Array, "rows parameters"], rows: list[slice]) -> float:
    """Return the share of the model's error of one image that is left where presses are fitted together: 1 for one press.

    The error of the model moves what each image alone would say of the base, by as much for every image and independently. The
    joint fit moves by less, as far as gel and light that the presses share contradict it. jacobian: that of the joint fit, rows of
    priors last. rows: the rows of each press.
    """
    if len(rows) == 1:
        return 1.0
    alone = [jacobian[one][:, parameters_of_press(number)] for number, one in enumerate(rows)]
    *each, joint = (information_of_parameter(one.T @ one, BASE_INDEX) for one in (*alone, jacobian[: rows[-1].stop]))
    return share_left_of_model_error(each, joint)


def share_left_of_model_error(alone: Sequence[float], joint: float) -> float:
    """Return the share of the model's error that is left, from what each image alone and all together say of the base."""
    return float(min(np.sqrt(np.sum(np.square(alone))) / joint, 1.0))


def information_of_parameter(information: Float[Array, "n n"], index: int) -> float:
    """Return what images say of one parameter when all others are fitted: the inverse of its variance."""
    return float(1 / max(np.linalg.pinv(information, hermitian=True)[index, index], 1e-30))


def effective_observation_count(residual: Float[Array, "rows cols"]) -> float:
    """Return the effective number of independent observations: their number divided by the sum of their mutual correlations.

    residual: the residual of a fit as an image; not-a-number where nothing was observed.
    """
    is_observed = np.isfinite(residual)
    values = residual[is_observed]
    centred = np.where(is_observed, residual - values.mean(), 0.0)
    pair_counts = np.maximum(_autocorrelation_sums(is_observed.astype(float)), 1)
    correlation = _autocorrelation_sums(centred) / pair_counts / np.mean(values**2)
    lag_rows, lag_cols = np.indices(correlation.shape)
    lag = np.hypot(lag_rows - correlation.shape[0] // 2, lag_cols - correlation.shape[1] // 2).astype(int)
    radial_mean = np.bincount(lag.ravel(), correlation.ravel()) / np.bincount(lag.ravel())
    first_zero = int(np.argmax(radial_mean <= 0)) or len(radial_mean)
    correlation_sum = float(correlation[lag < first_zero].sum())
    return float(max(values.size / max(correlation_sum, 1.0), len(PARAMETER_NAMES) + 1.0))


def _autocorrelation_sums(field: Float[Array, "rows cols"]) -> Float[Array, "lags_y lags_x"]:
    """Return the autocorrelation sums at all lags, with lag zero in the middle."""
    from scipy.fft import irfft2, next_fast_len, rfft2

    lags = [2 * side - 1 for side in field.shape]
    padded = [next_fast_len(count) for count in lags]
    sums = irfft2(np.abs(rfft2(field, padded)) ** 2, padded)
    middle = [count // 2 for count in lags]
    return np.asarray(np.roll(sums, middle, (0, 1))[: lags[0], : lags[1]])
