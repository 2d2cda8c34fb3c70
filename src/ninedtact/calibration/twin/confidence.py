"""How certain fitted parameters are, when what they leave unexplained is smooth."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact.calibration.twin.parameters import NAMES


@dataclass(frozen=True)
class Confidence:
    """Standard deviations and correlations of the searched parameters."""

    points: float
    """Observations that speak independently."""
    deviation: dict[str, float]
    correlation: Float[Array, "parameters parameters"]

    def closest(self, name: str) -> tuple[str, float]:
        """The parameter that this one is hardest to tell from, and their correlation."""
        row = self.correlation[NAMES.index(name)].copy()
        row[NAMES.index(name)] = 0
        other = int(np.abs(row).argmax())
        return NAMES[other], float(row[other])


def confidence(slopes: Float[Array, "rows parameters"], rest: Float[Array, " n"], points: float) -> Confidence:
    """From the Jacobian and the rest, as of `points` independent observations (Gauss–Markov)."""
    variance = np.sum(rest**2) / max(points - slopes.shape[1], 1.0)
    covariance = np.linalg.pinv(slopes.T @ slopes, hermitian=True) * variance
    deviation = np.sqrt(np.maximum(np.diag(covariance), 0))
    safe = np.where(deviation > 0, deviation, 1)
    return Confidence(points, dict(zip(NAMES, deviation.tolist(), strict=True)), covariance / np.outer(safe, safe))


def independent_points(rest: Float[Array, "rows cols"]) -> float:
    """How many observations speak independently: their number over the sum of their mutual correlations.

    rest: what a fit leaves, as an image; not-a-number where nothing was observed.
    """
    seen = np.isfinite(rest)
    known, values = seen.astype(float), rest[seen]
    field = np.where(seen, rest - values.mean(), 0.0)
    correlation = lagged(field) / np.maximum(lagged(known), 1) / np.mean(values**2)
    centre = correlation.shape[0] // 2, correlation.shape[1] // 2
    rows, cols = np.indices(correlation.shape)
    lag = np.hypot(rows - centre[0], cols - centre[1]).astype(int)
    ring = np.bincount(lag.ravel(), correlation.ravel()) / np.bincount(lag.ravel())
    first_zero = int(np.argmax(ring <= 0)) or len(ring)
    neighbours = float(correlation[lag < first_zero].sum())
    return float(max(values.size / max(neighbours, 1.0), len(NAMES) + 1.0))


def lagged(field: Float[Array, "rows cols"]) -> Float[Array, "lags_y lags_x"]:
    """Autocorrelation sums at all lags, lag zero in the middle."""
    from scipy.signal import fftconvolve

    return np.asarray(fftconvolve(field, field[::-1, ::-1]))
