"""The fit of the digital twin to one ball press: the pose of the press, the thickness of the gel and the brightness model that
explain the whole image, with their uncertainties. In: the rectified images before and after the press, and the contact circle in
them. Out: `TwinFit`, from `fit_twin_to_ball_press`.

The residual is not noise but a model error, smooth over millimetres. The number of independent observations is therefore estimated
from the residual itself, and the design's gel thickness is added as one more observation. Where the residual is plain noise, that
observation has no weight.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from time import perf_counter

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.optimize import least_squares, lsq_linear

from ninedtact.calibration.ball.contact_circle import ContactCircle
from ninedtact.calibration.twin.ball_press_model import (
    FIT_PARAMETERS,
    PARAMETER_NAMES,
    ROUGH_PATCH,
    BallPressModel,
    ObservedBallPress,
    ParameterVector,
    extract_press_parameters,
    parameter_bounds,
    parameter_scales,
    perturb_parameter,
)
from ninedtact.design import SensorDesign
from ninedtact.mechanics.contact_result import Contact
from ninedtact.quantities import Rectified
from ninedtact.shape.depth import mean_view_darkening
from ninedtact.simulation.gel_brightness import BrightnessModel


@dataclass(frozen=True)
class FitUncertainty:
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
) -> FitUncertainty:
    """Return the uncertainty from the Jacobian and the residual, as of `points` independent observations (Gauss–Markov)."""
    variance = np.sum(rest**2) / max(points - slopes.shape[1], 1.0)
    covariance = np.linalg.pinv(slopes.T @ slopes, hermitian=True) * variance
    deviation = np.sqrt(np.maximum(np.diag(covariance), 0))
    safe = np.where(deviation > 0, deviation, 1)
    return FitUncertainty(
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
    from scipy.fft import irfft2, next_fast_len, rfft2

    rows, cols = field.shape
    padded = next_fast_len(2 * rows - 1), next_fast_len(2 * cols - 1, real=True)
    sums = irfft2(np.abs(rfft2(field, padded)) ** 2, padded)
    return np.asarray(np.roll(sums, (rows - 1, cols - 1), (0, 1))[: 2 * rows - 1, : 2 * cols - 1])


THICKNESS_SPREAD = 0.22
"""Relative standard deviation of the thickness with which moulded gels act, about the designed one: from fits to six real sensors
(`simulation.real_sensor_twins`)."""
FINITE_STRAIN, FINITE_STRAIN_SPREAD = 0.5, 0.5
"""Share of finite strain before the image is seen, and its standard deviation: from a linear layer to a neo-Hookean gel."""
START = {
    "thickness_mm": 2.0,
    "point_spread_mm": 0.45,
    "saturation": 0.4,
    "inverse_distance_per_mm": 0.04,
    "finite_strain": FINITE_STRAIN,
}
RULE_BIAS_MM = 0.1
"""Usual excess of the depth that the rule of the disc's edge gives."""
WIDEST_GUESS = 0.95
"""Radius of the disc for the initial guess, as a fraction of the ball's radius, where the disc is wider than the ball (as in thick
gel) and does not determine the depth.
"""
DRAG_PER_ASYMMETRY_MM = 3.0
"""Usual drag of a press per asymmetry of its bulge; used for the initial guess only."""
MOST_ROUGH_STEPS, MOST_FINE_STEPS = 40, 10
"""Largest number of steps of the first search, which yields the scatter and a start for the second, and of the second."""
ROUGH, FINE = 3e-3, 5e-5
"""Relative reduction of the sum of squares below which each search ends. With 200 effective observations these are steps of 0.8 and
0.1 standard deviations of the result."""
NEAR = 1e-2
"""Relative reduction of the sum of squares below which the derivatives by the parameters of the contact, which cost a contact each,
are kept for the next step."""
STEP_LENGTHS = (1.0, 0.4)
"""Fractions of a step that are tried until one reduces the sum of squares."""


@dataclass(frozen=True)
class TwinFit:
    """The best parameters, their residual and their uncertainties."""

    forward: BallPressModel
    vector: ParameterVector
    slopes: Float[Array, "3"]
    rest_grey: Float[Array, " n"]
    """Residual, observed minus predicted, in grey levels at the observed points."""
    confidence: FitUncertainty
    seconds: float

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
        return self.forward.contact(extract_press_parameters(self.parameters))

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
        named, darkening = self.parameters, self.mean_view_darkening
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
    def mean_view_darkening(self) -> float:
        """Mean darkening of the whole view, to which the loss of light is proportional."""
        observed = self.forward.observed
        return mean_view_darkening(observed.after.grey, observed.before.grey, self.parameters["loss"])


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


@dataclass(frozen=True)
class _Solution:
    """The result of one search."""

    vector: ParameterVector
    slopes: Float[Array, "n parameters"]
    """Jacobian of the residual there, with one row for every prior."""


def fit_twin_to_ball_press(
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
    if near is None:
        near = _fit_roughly(replace(forward, patch=ROUGH_PATCH), _initial_guess(forward, circle))
    points = effective_observation_count(forward.observed.image(forward.fit_linear_terms(near)[1]))
    found = _fit_finely(forward, near, _make_prior_terms(forward, near, points, beliefs))
    slopes, rest = forward.fit_linear_terms(found.vector)
    sure = _estimate_uncertainty(found.slopes, rest, points)
    return TwinFit(forward, found.vector, slopes, rest, sure, perf_counter() - began)


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


def _fit_roughly(forward: BallPressModel, start: ParameterVector) -> ParameterVector:
    """Return the least-squares parameters from a distant start, by a trust-region method, without prior terms."""

    def miss(vector: ParameterVector) -> Float[Array, " n"]:
        return forward.fit_linear_terms(vector)[1]

    def slope(vector: ParameterVector) -> Float[Array, "n parameters"]:
        return _image_jacobian(forward, vector, miss(vector))

    bounds, scales = parameter_bounds(), parameter_scales()
    share = PARAMETER_NAMES.index("finite_strain")  # which no image determines before the rest is known
    bounds[0][share], bounds[1][share] = start[share] - 1e-3, start[share] + 1e-3
    found = least_squares(miss, start, slope, bounds, x_scale=scales, ftol=ROUGH, xtol=1e-3, max_nfev=MOST_ROUGH_STEPS)
    return np.asarray(found.x)


def _fit_finely(forward: BallPressModel, start: ParameterVector, prior: _PriorTerms) -> _Solution:
    """Return the least-squares parameters with prior terms from a start near by, by Gauss–Newton.

    The contacts are solved to a tolerance, so the sum of squares scatters from one vector to the next, and a search that waits for
    the smallest differences of it does not end. This one ends where the linearised problem promises too little.
    """

    def miss(vector: ParameterVector) -> Float[Array, " n"]:
        return np.append(forward.fit_linear_terms(vector)[1], prior.miss(vector))

    vector, rest, kept = start, miss(start), None
    for _ in range(MOST_FINE_STEPS):
        slopes = np.vstack([_image_jacobian(forward, vector, rest[: forward.observed.count], kept), prior.slope])
        change = _bounded_step(slopes, rest, vector)
        square = np.sum(rest**2)
        promised = 1 - np.sum((rest + slopes @ change) ** 2) / square
        kept = slopes if promised < NEAR else None
        for length in STEP_LENGTHS if promised > FINE else ():
            moved = vector + length * change
            moved_rest = miss(moved)
            if np.sum(moved_rest**2) < square:
                vector, rest = moved, moved_rest
                break
        else:
            break
    return _Solution(vector, slopes)


def _bounded_step(
    slopes: Float[Array, "n parameters"], rest: Float[Array, " n"], vector: ParameterVector
) -> ParameterVector:
    """Return the step that minimises the linearised sum of squares within the bounds of the parameters."""
    low, high = parameter_bounds()
    triangle = np.linalg.cholesky(slopes.T @ slopes)
    target = -np.linalg.solve(triangle, slopes.T @ rest)
    return np.asarray(lsq_linear(triangle.T, target, (low - vector, high - vector), method="bvls").x)


def _make_prior_terms(
    forward: BallPressModel, vector: ParameterVector, points: float, beliefs: tuple[ParameterPrior, ...]
) -> _PriorTerms:
    """Return the design's thickness and other priors, each as one observation among this many independent ones."""
    rest, design_mm = forward.fit_linear_terms(vector)[1], forward.design.gel.thickness_mm
    mould = ParameterPrior("thickness_mm", design_mm, THICKNESS_SPREAD * design_mm)
    strain = ParameterPrior("finite_strain", FINITE_STRAIN, FINITE_STRAIN_SPREAD)
    return _PriorTerms((mould, strain, *beliefs), float(np.sqrt(np.sum(rest**2) / points)))


def _image_jacobian(
    forward: BallPressModel,
    vector: ParameterVector,
    rest: Float[Array, " n"],
    kept: Float[Array, "rows parameters"] | None = None,
) -> Float[Array, "n parameters"]:
    """Return the derivative of the residual, `rest` at this vector, by each searched parameter, with level and slopes refitted.

    kept: the Jacobian at a vector near by, whose derivatives by the parameters of the contact are taken over.
    """
    columns = []
    for index, parameter in enumerate(FIT_PARAMETERS):
        if kept is not None and parameter.moves_contact:
            columns.append(kept[: rest.size, index])
            continue
        moved, step = perturb_parameter(vector, index)
        columns.append((forward.fit_linear_terms(moved)[1] - rest) / step)
    return np.column_stack(columns)


def _pixel_to_skin_mm(image: Rectified, px: tuple[float, float]) -> tuple[float, float]:
    """Return the position on the skin in mm of a pixel (x, y) of a rectified image."""
    rows, cols = image.grey.shape
    return (px[0] - (cols - 1) / 2) * image.mm_per_px, (px[1] - (rows - 1) / 2) * image.mm_per_px
