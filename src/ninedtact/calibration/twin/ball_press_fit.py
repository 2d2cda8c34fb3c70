"""The fit of the digital twin to one ball press: the pose of the press, the thickness of the gel and the brightness model that
explain the whole image, with their uncertainties. In: the rectified images before and after the press, and the contact circle in
them. Out: `TwinFit`, from `fit_twin`.

The residual is not noise but a model error, smooth over millimetres. The number of independent observations is therefore estimated
from the residual itself, and the design's gel thickness is added as one more observation. Where the residual is plain noise, that
observation has no weight.
"""

from dataclasses import dataclass
from functools import cached_property
from time import perf_counter

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.optimize import least_squares

from ninedtact.calibration.ball.contact_circle import ContactCircle
from ninedtact.calibration.twin.ball_press_model import (
    PARAMETER_NAMES,
    BallPressModel,
    ObservedBallPress,
    ParameterVector,
    ball_press_of,
    parameter_bounds,
    parameter_scales,
    step_parameter,
)
from ninedtact.design import SensorDesign
from ninedtact.mechanics.contact_result import Contact
from ninedtact.quantities import Rectified
from ninedtact.shape.depth import mean_darkening
from ninedtact.simulation.illumination import BrightnessModel


@dataclass(frozen=True)
class ParameterUncertainty:
    """Standard deviations and correlations of the searched parameters."""

    points: float
    """Effective number of independent observations."""
    deviation: dict[str, float]
    correlation: Float[Array, "parameters parameters"]

    def closest(self, name: str) -> tuple[str, float]:
        """Return the parameter with which this one is most correlated, and their correlation."""
        row = self.correlation[PARAMETER_NAMES.index(name)].copy()
        row[PARAMETER_NAMES.index(name)] = 0
        other = int(np.abs(row).argmax())
        return PARAMETER_NAMES[other], float(row[other])


def _estimate_uncertainty(
    slopes: Float[Array, "rows parameters"], rest: Float[Array, " n"], points: float
) -> ParameterUncertainty:
    """Return the uncertainty from the Jacobian and the residual, as of `points` independent observations (Gauss–Markov)."""
    variance = np.sum(rest**2) / max(points - slopes.shape[1], 1.0)
    covariance = np.linalg.pinv(slopes.T @ slopes, hermitian=True) * variance
    deviation = np.sqrt(np.maximum(np.diag(covariance), 0))
    safe = np.where(deviation > 0, deviation, 1)
    return ParameterUncertainty(
        points, dict(zip(PARAMETER_NAMES, deviation.tolist(), strict=True)), covariance / np.outer(safe, safe)
    )


def effective_observation_count(rest: Float[Array, "rows cols"]) -> float:
    """Return the effective number of independent observations: their number divided by the sum of their mutual correlations.

    rest: the residual of a fit as an image; not-a-number where nothing was observed.
    """
    seen = np.isfinite(rest)
    known, values = seen.astype(float), rest[seen]
    field = np.where(seen, rest - values.mean(), 0.0)
    correlation = _autocorrelation_sums(field) / np.maximum(_autocorrelation_sums(known), 1) / np.mean(values**2)
    centre = correlation.shape[0] // 2, correlation.shape[1] // 2
    rows, cols = np.indices(correlation.shape)
    lag = np.hypot(rows - centre[0], cols - centre[1]).astype(int)
    ring = np.bincount(lag.ravel(), correlation.ravel()) / np.bincount(lag.ravel())
    first_zero = int(np.argmax(ring <= 0)) or len(ring)
    neighbours = float(correlation[lag < first_zero].sum())
    return float(max(values.size / max(neighbours, 1.0), len(PARAMETER_NAMES) + 1.0))


def _autocorrelation_sums(field: Float[Array, "rows cols"]) -> Float[Array, "lags_y lags_x"]:
    """Return the autocorrelation sums at all lags, with lag zero in the middle."""
    from scipy.signal import fftconvolve

    return np.asarray(fftconvolve(field, field[::-1, ::-1]))


THICKNESS_SPREAD = 0.22
"""Relative standard deviation of the thickness with which moulded gels act, about the designed one: from fits to six real sensors
(`simulation.real_fits`)."""
START = {"thickness_mm": 2.0, "point_spread_mm": 0.45, "saturation": 0.4, "inverse_distance_per_mm": 0.04}
RULE_BIAS_MM = 0.1
"""Usual excess of the depth that the rule of the disc's edge gives."""
WIDEST_GUESS = 0.95
"""Radius of the disc for the initial guess, as a fraction of the ball's radius, where the disc is wider than the ball (as in thick
gel) and does not determine the depth.
"""
DRAG_PER_ASYMMETRY_MM = 3.0
"""Usual drag of a press per asymmetry of its bulge; used for the initial guess only."""
TRIES = 40


@dataclass(frozen=True)
class TwinFit:
    """The best parameters, their residual and their uncertainties."""

    forward: BallPressModel
    vector: ParameterVector
    slopes: Float[Array, "3"]
    rest_grey: Float[Array, " n"]
    """Residual, observed minus predicted, in grey levels at the observed points."""
    confidence: ParameterUncertainty
    seconds: float
    evaluations: int

    @cached_property
    def parameters(self) -> dict[str, float]:
        """Return all parameters by name, the searched ones and those solved linearly."""
        level, dark, bright = (float(slope) for slope in self.slopes)
        solved = {"loss": level - 1, "darkening_per_mm": dark / level, "brightening_per_mm": bright / level}
        return {**dict(zip(PARAMETER_NAMES, self.vector.tolist(), strict=True)), **solved}

    @property
    def drag_mm(self) -> tuple[float, float]:
        """Displacement of the ball along the skin after the press."""
        return self.parameters["drag_x_mm"], self.parameters["drag_y_mm"]

    @property
    def contact(self) -> Contact:
        """The solved contact of the skin under the ball, with pressures in shear moduli."""
        return self.forward.contact(ball_press_of(self.parameters))

    @property
    def image_rmse_grey_levels(self) -> float:
        """Root mean square residual over all observed points."""
        return float(np.sqrt(np.mean(self.rest_grey**2)))

    @cached_property
    def radial_rmse_grey_levels(self) -> float:
        """Root mean square residual of the radial profile, 0.1 to 8 mm from the contact's centre."""
        return float(np.sqrt(np.mean(self.radial_rest[1] ** 2)))

    @cached_property
    def radial_rest(self) -> tuple[Float[Array, " rings"], Float[Array, " rings"]]:
        """Return radius and mean residual of rings of 0.05 mm."""
        x, y = (
            axis.ravel() - self.parameters[name]
            for axis, name in zip(self.forward.observed.points_mm, PARAMETER_NAMES, strict=False)
        )
        radius = np.hypot(x, y)
        ring = (radius / 0.05).astype(int)
        count = np.bincount(ring)
        mean = np.bincount(ring, self.rest_grey) / np.maximum(count, 1)
        middle = (np.arange(count.size) + 0.5) * 0.05
        kept = (count > 0) & (middle > 0.1) & (middle < 8.0)
        return middle[kept], mean[kept]

    @cached_property
    def light(self) -> BrightnessModel:
        """Return the brightness model of the sensor that the fit found."""
        named, darkening = self.parameters, self.mean_darkening
        return BrightnessModel(
            darkening_per_mm=max(named["darkening_per_mm"], 0.0),
            saturation=named["saturation"],
            brightening_per_mm=max(named["brightening_per_mm"], 0.0),
            point_spread_mm=named["point_spread_mm"],
            global_dimming=max(-named["loss"], 0.0) / darkening if darkening > 0 else 0.0,
            inverse_distance_per_mm=named["inverse_distance_per_mm"],
            thickness_mm=self.forward.design.gel.thickness_mm,
        )

    @cached_property
    def mean_darkening(self) -> float:
        """Mean darkening of the whole view, to which the loss of light is proportional."""
        observed = self.forward.observed
        return mean_darkening(observed.after.grey, observed.before.grey, self.parameters["loss"])


@dataclass(frozen=True)
class ParameterPrior:
    """Prior knowledge of a parameter, from other sources than the image."""

    name: str
    value: float
    deviation: float


@dataclass(frozen=True)
class _PriorTerms:
    """Prior terms as observations beside those of the image."""

    beliefs: tuple[ParameterPrior, ...] = ()
    deviation_grey: float = 0.0
    """Grey levels that correspond to one standard deviation of a prior: the residual of an independent observation."""

    def miss(self, vector: ParameterVector) -> Float[Array, " beliefs"]:
        """Return the deviation of the vector from the priors, in grey levels."""
        off = [(vector[PARAMETER_NAMES.index(one.name)] - one.value) / one.deviation for one in self.beliefs]
        return self.deviation_grey * np.array(off, float)

    @property
    def slope(self) -> Float[Array, "beliefs parameters"]:
        """Return the derivative of `miss` by the parameters."""
        rows = [np.array([name == one.name for name in PARAMETER_NAMES]) / one.deviation for one in self.beliefs]
        return self.deviation_grey * np.array(rows, float).reshape(-1, len(PARAMETER_NAMES))


def fit_twin(
    before: Rectified,
    after: Rectified,
    circle: ContactCircle,
    design: SensorDesign,
    beliefs: tuple[ParameterPrior, ...] = (),
    near: ParameterVector | None = None,
) -> TwinFit:
    """Fit mechanics and light to one press of the design's ball, found at `circle`.

    beliefs: prior terms from other images. near: initial parameters, where approximate values are known.
    """
    began = perf_counter()
    middle_mm = _pixel_to_skin_mm(before, circle.centre_px)
    forward = BallPressModel(ObservedBallPress(before, after, middle_mm), design)
    free, searched = (
        _fit_least_squares(forward, _initial_guess(forward, circle), _PriorTerms()) if near is None else (near, 0)
    )
    points = effective_observation_count(forward.observed.image(forward.fit_linear_terms(free)[1]))
    prior = _make_prior_terms(forward, free, points, beliefs)
    vector, again = _fit_least_squares(forward, free, prior)
    slopes, rest = forward.fit_linear_terms(vector)
    sure = _estimate_uncertainty(_residual_jacobian(forward, vector, prior), rest, points)
    return TwinFit(forward, vector, slopes, rest, sure, perf_counter() - began, searched + again)


def _initial_guess(forward: BallPressModel, circle: ContactCircle) -> ParameterVector:
    """Return the initial guess from the disc: its centre, the depth by the rule of its edge, the drag by the asymmetry
    of its bulge.
    """
    radius_mm, ball_mm = circle.radius_px * forward.observed.before.mm_per_px, forward.design.ball.radius_mm
    radius_mm = radius_mm if radius_mm < ball_mm else WIDEST_GUESS * ball_mm
    depth_mm = ball_mm - np.sqrt(ball_mm**2 - radius_mm**2) - RULE_BIAS_MM
    drag = DRAG_PER_ASYMMETRY_MM * np.array(circle.leaning)
    x, y = forward.observed.middle_mm
    guess = {"x_mm": x, "y_mm": y, "depth_mm": depth_mm, "drag_x_mm": drag[0], "drag_y_mm": drag[1], **START}
    guess["thickness_mm"] *= forward.design.gel.thickness_mm / SensorDesign().gel.thickness_mm
    low, high = parameter_bounds()
    return np.clip([guess[name] for name in PARAMETER_NAMES], low + 1e-3, high - 1e-3)


def _fit_least_squares(
    forward: BallPressModel, start: ParameterVector, prior: _PriorTerms
) -> tuple[ParameterVector, int]:
    """Return the least-squares parameters from a start, and the number of predicted images that this took."""

    def miss(vector: ParameterVector) -> Float[Array, " n"]:
        return np.append(forward.fit_linear_terms(vector)[1], prior.miss(vector))

    def slope(vector: ParameterVector) -> Float[Array, "n parameters"]:
        return _residual_jacobian(forward, vector, prior)

    found = least_squares(
        miss, start, slope, parameter_bounds(), x_scale=parameter_scales(), xtol=1e-5, ftol=1e-6, max_nfev=TRIES
    )
    return found.x, found.nfev + int(found.njev or 0) * len(PARAMETER_NAMES)


def _make_prior_terms(
    forward: BallPressModel, vector: ParameterVector, points: float, beliefs: tuple[ParameterPrior, ...]
) -> _PriorTerms:
    """Return the design's thickness and other priors, each as one observation among this many independent ones."""
    rest, design_mm = forward.fit_linear_terms(vector)[1], forward.design.gel.thickness_mm
    mould = ParameterPrior("thickness_mm", design_mm, THICKNESS_SPREAD * design_mm)
    return _PriorTerms((mould, *beliefs), float(np.sqrt(np.sum(rest**2) / points)))


def _residual_jacobian(
    forward: BallPressModel, vector: ParameterVector, prior: _PriorTerms
) -> Float[Array, "n parameters"]:
    """Return the Jacobian of the residual, with one row for every prior."""
    return np.vstack([_image_jacobian(forward, vector), prior.slope])


def _image_jacobian(forward: BallPressModel, vector: ParameterVector) -> Float[Array, "n parameters"]:
    """Return the derivative of the residual by each searched parameter, with level and slopes refitted."""
    here = forward.fit_linear_terms(vector)[1]
    columns = []
    for index in range(len(PARAMETER_NAMES)):
        moved, step = step_parameter(vector, index)
        columns.append((forward.fit_linear_terms(moved)[1] - here) / step)
    return np.column_stack(columns)


def _pixel_to_skin_mm(image: Rectified, px: tuple[float, float]) -> tuple[float, float]:
    """Return the position on the skin in mm of a pixel (x, y) of a rectified image."""
    rows, cols = image.grey.shape
    return (px[0] - (cols - 1) / 2) * image.mm_per_px, (px[1] - (rows - 1) / 2) * image.mm_per_px
