"""The motion of an object between two readings: the surface that touched is laid onto the surface that touches now.

Points of the earlier surface are moved and compared along the normals of the later one (point to plane), where the object shapes
the skin in both. A `Registration` is made of three parts that can be exchanged: the residual with its derivatives, the weights that
reject what does not belong to both, and the rule that ends the iterations.

Skin that friction drags along changes its height smoothly. Such heights are unknowns of each registration beside the motion, with
a standard deviation of their own: what is left shows the motion of edges, and the covariance of the motion contains them.

Not every motion can be seen: a ball looks the same after any turn, and a flat face while it slides along itself. Noise of the
slopes makes such motions look as if they could be seen a little. Its share of the information is computed and taken off; a
direction whose information is mostly noise is not searched, and its variance is that of the prior.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import radians

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact.robust_noise import robust_std
from ninedtact.tracking.rigid_motion import Covariance, RigidMotion
from ninedtact.tracking.touched_surface import TouchedSurface

Residual = Callable[
    [TouchedSurface, TouchedSurface, RigidMotion],
    tuple[Float[Array, " n"], Float[Array, "n 6"], Float[Array, " n"], Float[Array, "n 3"]],
]
"""Returns, of every point of the earlier surface, the distance to the later one in mm, its derivatives by a small further motion
about the moved centre, whether both touch there (one or zero), and the point relative to the moved centre."""
Weights = Callable[[Float[Array, " n"], Float[Array, " n"]], Float[Array, " n"]]
"""Returns the weight of every point from its distance and whether both touch there."""
Termination = Callable[[int, Float[Array, "6"]], bool]
"""Returns whether the search ends, from the number of the iteration and its step in mm."""

_MAX_ITERATIONS = 50
_MIN_AREA_MM2 = 0.7
"""Area of the points, each by its weight, below which two surfaces do not overlap."""
LEAST_DISTANCE_MM = 0.004
"""Standard deviation of heights that is assumed at least."""
_MOST_NOISE_MM = 0.008
"""Error of heights beyond which distances are taken for those of a poor guess."""
_CORRELATED_MM2 = 1.5
"""Area over which errors of heights are alike: they come from the model of light and gel, not from the camera's noise."""
_DRAGGED_MM = 0.03
"""Standard deviation of smooth changes of height."""
_IN_GEL_MM = 0.2
"""Depth below the skin that dragged skin does not explain."""
_SLOPE_ERROR_MM = 0.35
"""Distance over which errors of heights change: their slopes are wrong by the error of the heights over this."""
_SYSTEMATIC_STD = np.array([0.006, 0.006, 0.006, 0.002, 0.002, 0.001])
_LAG, _LAG_OF_TURN = np.array([0.03, 0.03, 0.02, 0.003, 0.003, 0]), 0.02
"""Errors, mm and rad, that light and gel leave: at rest, per mm of displacement, and of the turn per turn, because scattered light
of the skin that is dragged along lets an object appear to lag behind. Found on five simulated sensors and ten objects, none of
them in the benchmark; sharp sensors err less."""
_SEARCHED, _CLAIMED = 0.5, 0.7
"""Shares of the information about a direction that must not be noise for it to be searched, and for what is found to be claimed."""
_PRIOR_MM, PRIOR_RAD = 5.0, 2.0
"""Standard deviation of a motion that is not seen: as large as the skin, and any angle."""
_UPRIGHT, _UPRIGHT_RAD = np.array([1.0, 1, 1, 0, 0, 1]), radians(1)
"""One for each direction in which an object that does not tilt may move; standard deviation of what it tilts all the same."""


def point_to_plane(
    earlier: TouchedSurface, later: TouchedSurface, motion: RigidMotion
) -> tuple[Float[Array, " n"], Float[Array, "n 6"], Float[Array, " n"], Float[Array, "n 3"]]:
    """Return the distances of moved points to the later surface along its normals (`Residual`)."""
    moved = motion(earlier.points_mm)
    height, slope_x, slope_y, held = later.sample(moved)
    length = np.sqrt(1 + slope_x**2 + slope_y**2)
    normal = np.column_stack([slope_x, slope_y, -np.ones_like(slope_x)]) / length[:, None]
    lever = moved - motion(earlier.centre_mm)
    distance = (height - moved[:, 2]) / length
    return distance, np.hstack([normal, np.cross(lever, normal)]), held, lever


@dataclass(frozen=True)
class RejectOutliers:
    """Weights that fall with the square of the distance beyond some typical distances (Cauchy)."""

    typical_distances: float = 2.0

    def __call__(self, distance: Float[Array, " n"], both: Float[Array, " n"]) -> Float[Array, " n"]:
        """Return the weights; zero where not both touch."""
        shared = both > 0.5
        if not shared.any():
            return np.zeros_like(both)
        typical = float(robust_std(distance[shared])) + 1e-4
        return np.asarray(shared / (1 + (distance / (self.typical_distances * typical)) ** 2))


@dataclass(frozen=True)
class EndAtSmallStep:
    """The search ends where a step moves no point by more than this, or after so many."""

    step_mm: float = 2e-3
    iterations: int = 12

    def __call__(self, iteration: int, step: Float[Array, "6"]) -> bool:
        """Return whether the search ends."""
        return bool(np.abs(step).max() < self.step_mm) or iteration + 1 >= self.iterations


@dataclass(frozen=True)
class RegistrationResult:
    """The motion of the object from the earlier reading to the later one."""

    motion: RigidMotion
    covariance: Covariance
    """Of the error at `centre_mm`, mm and rad (`rigid_motion`)."""
    centre_mm: Float[Array, "3"]
    """Centre of the earlier surface after the motion."""
    overlap: float
    """Share of the earlier surface that touches in the later reading too."""
    rms_mm: float
    """Root mean square distance of the surfaces."""
    share_in_gel: float
    """Share of the later surface that the object would have had inside the gel in the earlier reading."""

    @property
    def std(self) -> Float[Array, "6"]:
        """Standard deviations at the centre: mm along x, y, z, then rad about them."""
        return np.sqrt(np.diag(self.covariance))


@dataclass(frozen=True)
class Registration:
    """Finds motions between readings; its parts can be exchanged."""

    residual: Residual = point_to_plane
    weights: Weights = RejectOutliers()
    ends: Termination = EndAtSmallStep()
    is_upright: bool = False
    """Whether the object is taken not to tilt. Then the displacement of a ball is seen, which may otherwise have rolled."""

    def __call__(
        self, earlier: TouchedSurface, later: TouchedSurface, guess: RigidMotion = RigidMotion()
    ) -> RegistrationResult | None:
        """Return the motion from one surface to the next, from a guess near by; None where they do not overlap."""
        motion, dragged_mm, iteration = guess, np.zeros(len(earlier.points_mm)), 0
        while (linear := self._linearise(earlier, later, motion, dragged_mm)) is not None:
            step = linear.step
            dragged_mm = earlier.smooth_fields @ linear.fit.coefficients_after(step)
            motion = motion.perturbed(motion(earlier.centre_mm), step / linear.scale)
            if self.ends(iteration, step) or iteration + 1 == _MAX_ITERATIONS:
                return _result(earlier, later, motion, linear)
            iteration += 1
        return None

    def _linearise(
        self, earlier: TouchedSurface, later: TouchedSurface, motion: RigidMotion, dragged_mm: Float[Array, " n"]
    ) -> "_Linearisation | None":
        """Return the problem about a motion and heights of dragged skin; None where the surfaces do not overlap."""
        distance, derivative, both, lever = self.residual(earlier, later, motion)
        weight = self.weights(distance - dragged_mm, both)
        if weight.sum() * earlier.point_area_mm2 < _MIN_AREA_MM2:
            return None
        radius_mm = earlier.radius_of_gyration_mm
        scale = np.array([1, 1, 1, radius_mm, radius_mm, radius_mm])
        free = _UPRIGHT if self.is_upright else np.ones(6)
        rms_mm = float(np.sqrt(weight @ (distance - dragged_mm) ** 2 / weight.sum()))
        # A poor guess makes distances large, which is not noise.
        error_mm = float(np.clip(rms_mm, LEAST_DISTANCE_MM, _MOST_NOISE_MM))
        stiffness = _variance_of_point(error_mm, earlier) / _DRAGGED_MM**2
        fit = _fit_motion_and_fields(distance, derivative * free / scale, earlier.smooth_fields, weight, stiffness)
        noise = _information_of_noise(weight, lever, error_mm) * np.outer(free / scale, free / scale)
        values, directions = np.linalg.eigh(fit.information)
        signal = values - np.einsum("ij,ik,kj->j", directions, noise, directions)
        return _Linearisation(fit, scale, free, values, directions, signal, float((both > 0.5).mean()), rms_mm)


@dataclass(frozen=True)
class _Linearisation:
    """The least squares about one motion, and how much of its information is not noise."""

    fit: "_Fit"
    scale: Float[Array, "6"]
    """Divides a step to give mm and rad: all six parts of a step are mm at the rim of the surface."""
    free: Float[Array, "6"]
    """One for each part of the motion that is free, zero for a tilt that is taken not to be."""
    values: Float[Array, "6"]
    """Information about each direction: eigenvalues."""
    directions: Float[Array, "6 6"]
    """Eigenvectors, as columns."""
    signal: Float[Array, "6"]
    """The information without the share of noise."""
    overlap: float
    rms_mm: float

    @property
    def step(self) -> Float[Array, "6"]:
        """The Gauss–Newton step along the directions that are searched."""
        along = -(self.directions.T @ self.fit.gradient) / np.maximum(self.values, 1e-12)
        return np.asarray(self.directions @ np.where(self.signal > _SEARCHED * self.values, along, 0))

    def covariance(self, variance_mm2: float) -> Covariance:
        """Return the covariance of the motion for a variance of one point; the prior's for what is not seen."""
        signal = np.where(self.signal > _CLAIMED * self.values, self.signal / variance_mm2, 0)
        free, radius_mm = self.free, self.scale[5]
        prior = free * ([_PRIOR_MM] * 3 + [PRIOR_RAD * radius_mm] * 3) + (1 - free) * _UPRIGHT_RAD * radius_mm
        known = self.directions * signal @ self.directions.T
        return np.asarray(np.linalg.inv(known + np.diag(prior**-2)) / np.outer(self.scale, self.scale))


def _result(
    earlier: TouchedSurface, later: TouchedSurface, motion: RigidMotion, linear: _Linearisation
) -> RegistrationResult:
    """Return the result of a search that ended at a motion, one step after the last linearisation."""
    centre_mm = motion(earlier.centre_mm)
    systematic = np.diag(_systematic_variance(motion, centre_mm - earlier.centre_mm))
    covariance = linear.covariance(_variance_of_point(max(linear.rms_mm, LEAST_DISTANCE_MM), earlier)) + systematic
    share_in_gel = _share_in_gel(earlier, motion.inverse(later.points_mm[~later.is_beside]))
    return RegistrationResult(motion, covariance, centre_mm, linear.overlap, linear.rms_mm, share_in_gel)


def _share_in_gel(surface: TouchedSurface, points_mm: Float[Array, "n 3"]) -> float:
    """Return the share of points in view that are below the skin by more than skin changes its height while it is dragged."""
    half_mm = np.array(surface.z_mm.shape[::-1]) * surface.mm_per_px / 2
    seen = points_mm[(np.abs(points_mm[:, :2]) < half_mm).all(axis=1)]
    return float((surface.sample(seen)[0] - seen[:, 2] > _IN_GEL_MM).mean()) if len(seen) else 0.0


def _variance_of_point(error_mm: float, surface: TouchedSurface) -> float:
    """Return the variance of a point, so that many of them within the area over which errors are alike count as one."""
    return error_mm**2 * max(_CORRELATED_MM2 / surface.point_area_mm2, 1.0)


def _systematic_variance(motion: RigidMotion, moved_mm: Float[Array, "3"]) -> Float[Array, "6"]:
    lag = _LAG * float(np.hypot(*moved_mm[:2]))
    lag[5] = _LAG_OF_TURN * motion.yaw_rad
    return np.asarray(_SYSTEMATIC_STD**2 + lag**2)


@dataclass(frozen=True)
class _Fit:
    """Information and gradient of a motion where the coefficients of the smooth fields are free, too."""

    information: Float[Array, "6 6"]
    gradient: Float[Array, "6"]
    _at_rest: Float[Array, " fields"]
    _by_step: Float[Array, "fields 6"]

    def coefficients_after(self, step: Float[Array, "6"]) -> Float[Array, " fields"]:
        """Return the likeliest coefficients after a step of the motion."""
        return self._at_rest + self._by_step @ step


def _fit_motion_and_fields(
    distance: Float[Array, " n"],
    derivative: Float[Array, "n 6"],
    fields: Float[Array, "n fields"],
    weight: Float[Array, " n"],
    stiffness: float,
) -> _Fit:
    """Return the least squares of distance + derivative·step − fields·coefficients, with the stiffness on each coefficient."""
    weighted_fields, weighted_derivative = fields * weight[:, None], derivative * weight[:, None]
    information_of_fields = weighted_fields.T @ fields + stiffness * np.eye(fields.shape[1])
    right_sides = weighted_fields.T @ np.column_stack([distance, derivative])
    solved = np.linalg.solve(information_of_fields, right_sides)
    at_rest, by_step, coupling = solved[:, 0], solved[:, 1:], right_sides[:, 1:]
    information = weighted_derivative.T @ derivative - coupling.T @ by_step
    return _Fit(information, weighted_derivative.T @ distance - coupling.T @ at_rest, at_rest, by_step)


def _information_of_noise(
    weight: Float[Array, " n"], lever: Float[Array, "n 3"], height_error_mm: float
) -> Float[Array, "6 6"]:
    """Return the information that errors of the slopes seem to add: the expectation of derivatives that are errors alone."""
    variance = (height_error_mm / _SLOPE_ERROR_MM) ** 2
    x, y, z = lever.T
    zero, one = np.zeros_like(x), np.ones_like(x)
    # An error of the normal along x, and along y: (error, lever × error).
    parts = (
        np.column_stack([one, zero, zero, zero, z, -y]),
        np.column_stack([zero, one, zero, -z, zero, x]),
    )
    return np.asarray(variance * sum((part * weight[:, None]).T @ part for part in parts))
