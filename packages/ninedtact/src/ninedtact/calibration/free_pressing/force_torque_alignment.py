"""The alignment of a force/torque sensor with the skin, from free pressing that both have seen.

The images give a wrench w(t) of the object on the skin, about the skin's centre, with a covariance; the force/torque sensor gives

    m(t + τ) = ± Q(R, o) · D(g, s) · w(t) + b(t) + e

R rotates the axes of the skin into those of the device, o is the origin of the device in the frame of the skin, and the sign tells
a device that reports the reaction (`design.ForceTorqueMount`). D scales all of w by the shear modulus, e^g, and F_x, F_y and T_z by
a further e^s. b is bias and drift, linear between knots a minute apart. τ is found first, from the magnitudes of the forces, which
no rotation changes. The rest follows by Gauss–Newton iteration from all 24 rotations of a cube with both signs, so that a device
may be turned or upside down. What the data do not determine keeps its prior.

The errors of one contact are those of its object and place: a contact counts as `_OBSERVATIONS` independent observations, however
many images show it, and its weight falls with its deviation (Student's t), so that one that contradicts the others hardly counts.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from scipy.spatial.transform import Rotation

from ninedtact.calibration.free_pressing.pressing import ForceTorqueSamples, PressingUnusable
from ninedtact.capture.force_torque.wrench_source_from_address import mount_rotation
from ninedtact.design import ForceTorqueMount
from ninedtact.force.estimator_and_scale import SHEAR_COMPONENTS

LONGEST_DELAY_S = 0.6
"""Largest difference between the clocks of images and samples; a larger one is refused."""
_SEARCHED_S, _DELAY_STEP_S = 1.0, 0.01
_KNOTS_APART_S = 60.0
_OBSERVATIONS = 2.0
_FLOOR = np.array([0.03, 0.03, 0.03, 5e-4, 5e-4, 5e-4])
"""Error of every moment that no estimate states: light contact that is overlooked, the drift of the reference image."""
_PRIOR_STD = {"delay": 1.0, "modulus": 0.27, "shear": 0.25, "origin": 0.05, "rotation": np.pi}
"""Standard deviations before the recording: s, logarithms of factors, m, rad."""
_BIAS_STD = np.array([100.0, 100.0, 100.0, 5.0, 5.0, 5.0])
_STUDENT_DEGREES = 4.0
_LEAST_CORRELATION = 0.6
"""Correlation of the forces' magnitudes below which the samples are not those of the images."""
_LEAST_FREE_SHARE = 0.8
"""Share of the moments without contact that tell the bias at first; near a contact the delay mixes them with it."""
_ITERATIONS, _FIRST_ITERATIONS, _FIRST_MOMENTS, _STARTS = 30, 5, 100, 6
_HELD_ITERATIONS = 2
"""Iterations of the search that move origin and bias only, which are far off where the device is turned."""
_TURNING = np.array([0, 1, 2, 6, 7, 8])
"""Numbers of the parameters that are held meanwhile."""

_MIRROR = np.array([-1.0, 1.0, 1.0, 1.0, -1.0, -1.0])
"""Factors of the components of a wrench under a reflection x → −x; torque is a pseudovector."""
_MIRRORED_COST_DROP = 1.0
"""Drop of the cost with mirrored images from which the camera is taken to mirror them. The cost drops by 4 to 7 where contacts are
dragged with a third of their load, and by 1.3 to 4 with a twentieth. Under straight presses, which cannot show it, the two costs
differ by less than 0.4."""


@dataclass(frozen=True)
class EstimatedMoments:
    """What the images of some moments show, torques about the skin's centre."""

    at_s: Float[Array, " n"]
    group: Int[Array, " n"]
    """The contact of each moment by its number; below zero for the times between, in which nothing touches."""
    six: Float[Array, "n 6"]
    covariance: Float[Array, "n 6 6"]

    def select(self, chosen: Bool[Array, " n"]) -> "EstimatedMoments":
        """Return some of the moments."""
        return EstimatedMoments(self.at_s[chosen], self.group[chosen], self.six[chosen], self.covariance[chosen])

    @property
    def mirrored(self) -> "EstimatedMoments":
        """The moments as a camera that mirrors its images left to right would show them."""
        return replace(self, six=self.six * _MIRROR, covariance=self.covariance * np.outer(_MIRROR, _MIRROR))

    @property
    def force_n(self) -> Float[Array, " n"]:
        """Magnitude of the force."""
        return np.asarray(np.linalg.norm(self.six[:, :3], axis=1))


@dataclass(frozen=True)
class Alignment:
    """How the samples of a force/torque sensor follow from the wrench on the skin."""

    delay_s: float
    """Time of a sample after that of the image that shows the same."""
    factor: float
    """True over estimated forces."""
    shear_factor: float
    """What F_x, F_y and T_z are to be multiplied by beyond it."""
    origin_mm: Float[Array, "3"]
    rotation: Float[Array, "3 3"]
    """From the axes of the skin to those of the device."""
    sign: int
    knots_s: Float[Array, " knots"]
    bias: Float[Array, "knots 6"]
    covariance: Float[Array, "9 9"]
    """Of delay in s, the logarithms of both factors, origin in m and rotation vector in rad."""
    weights: dict[int, float]
    """Weight of each contact; one for a contact that agrees with the others."""
    excess: float = 1.0
    """By how much the deviations of a middling contact exceed what is stated; at least one. The covariance contains it."""
    correlation: float = 0.0
    """That of the forces' magnitudes."""

    @property
    def std(self) -> Float[Array, "9"]:
        """Standard deviations of the parameters, in the order and units of `covariance`."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def rotation_deg(self) -> Float[Array, "3"]:
        """Rotation of the device about x, then y, then z of the skin, as in `design.ForceTorqueMount`."""
        return np.asarray(Rotation.from_matrix(self.rotation.T).as_euler("xyz", degrees=True))

    def turned_from_deg(self, mount: ForceTorqueMount) -> float:
        """Return the angle between the axes of the device as found and as the design states them."""
        return float(np.degrees(Rotation.from_matrix(mount_rotation(mount) @ self.rotation).magnitude()))

    def is_upside_down(self, mount: ForceTorqueMount) -> bool:
        """Whether the device points into the skin where by the design it points out, or the other way round."""
        return bool((mount_rotation(mount) @ self.rotation)[2, 2] < 0)

    @property
    def drift(self) -> Float[Array, "6"]:
        """Change of the bias from the beginning to the end."""
        return np.asarray(self.bias[-1] - self.bias[0])

    def bias_at(self, at_s: Float[Array, " n"]) -> Float[Array, "n 6"]:
        """Return bias and drift at some times of images."""
        return np.asarray(_hat_functions(at_s, self.knots_s) @ self.bias)

    def wrench_on_skin(self, at_s: Float[Array, " n"], samples: ForceTorqueSamples) -> Float[Array, "n 6"]:
        """Return the measured wrench on the skin, about its centre, at times of images; not-a-number where there is no sample."""
        measured = self.sign * (samples.at(at_s + self.delay_s) - self.bias_at(at_s))
        force_n, torque_nm = measured[:, :3] @ self.rotation, measured[:, 3:] @ self.rotation
        return np.hstack([force_n, torque_nm + np.cross(self.origin_mm / 1e3, force_n)])


def fit_alignment(
    moments: EstimatedMoments, samples: ForceTorqueSamples, mount: ForceTorqueMount, start: Alignment | None = None
) -> Alignment:
    """Return the alignment that explains the samples; raises `PressingUnusable` where there is none.

    mount: where the design has the device. start: a known alignment from which the iteration begins in place of the search.
    """
    if start is not None:
        return _Problem(moments, samples, mount, start.delay_s).solve(start, _ITERATIONS)
    delay_s, correlation = _find_delay(moments, samples)
    _require_related(delay_s, correlation)
    found, cost = _search_alignment(moments, samples, mount, delay_s)
    _require_related(found.delay_s, correlation)
    if _search_alignment(moments.mirrored, samples, mount, delay_s)[1] < cost - _MIRRORED_COST_DROP:
        raise PressingUnusable(
            expected="images that agree with the force/torque sensor",
            got="images that do so only where left and right are exchanged: the camera mirrors them",
            remedy="calibrate again from the stored images with --camera-mirrored, or without it where it was given",
        )
    return replace(found, correlation=correlation)


def _search_alignment(
    moments: EstimatedMoments, samples: ForceTorqueSamples, mount: ForceTorqueMount, delay_s: float
) -> tuple[Alignment, float]:
    """Return the alignment of least cost, searched from starts of all rotations and signs, and this cost."""
    few = _Problem(moments.select(_every_few(moments)), samples, mount, delay_s)
    tried = sorted((few.solve(each, _FIRST_ITERATIONS, _HELD_ITERATIONS) for each in few.starts()), key=few.cost)
    problem = _Problem(moments, samples, mount, delay_s)
    found = min((problem.solve(each, _ITERATIONS) for each in tried[:_STARTS]), key=problem.cost)
    return found, problem.cost(found)


def _every_few(moments: EstimatedMoments) -> Bool[Array, " n"]:
    """Return the moments from which the search begins: evenly spaced ones, with the first and the last."""
    chosen = np.arange(len(moments.at_s)) % max(1, len(moments.at_s) // _FIRST_MOMENTS) == 0
    chosen[[0, -1]] = True
    return chosen


def _require_related(delay_s: float, correlation: float) -> None:
    """Raise `PressingUnusable` for samples that do not follow the images, or much later or earlier."""
    if correlation < _LEAST_CORRELATION:
        raise PressingUnusable(
            expected="forces of the force/torque sensor that rise and fall with those that the images show",
            got=f"a correlation of {correlation:.2f}",
            remedy="record both while pressing the skin, with the force/torque sensor that carries this sensor",
        )
    if abs(delay_s) > LONGEST_DELAY_S:
        raise PressingUnusable(
            expected=f"images and samples whose stamps agree within {LONGEST_DELAY_S:g} s",
            got=f"samples {abs(delay_s):.2f} s {'after' if delay_s > 0 else 'before'} the images or more",
            remedy="take the stamps of both from one clock, or record with --camera-delay-ms",
        )


def _find_delay(moments: EstimatedMoments, samples: ForceTorqueSamples) -> tuple[float, float]:
    """Return the delay at which the magnitudes of the forces correlate best, and that correlation."""
    free = moments.group < 0
    hats, knots_s = _hat_functions(moments.at_s, _knots_s(moments)), _knots_s(moments)
    delays_s = np.arange(-_SEARCHED_S, _SEARCHED_S + _DELAY_STEP_S / 2, _DELAY_STEP_S)
    correlations = []
    for delay_s in delays_s:
        measured = samples.at(moments.at_s + delay_s)[:, :3]
        known = np.isfinite(measured[:, 0])
        bias = _fit_bias(hats[free & known], measured[free & known], len(knots_s))
        force_n = np.linalg.norm(measured - hats @ bias, axis=1)
        pair = moments.force_n[known], force_n[known]
        enough = len(pair[0]) > 2 and min(map(np.std, pair)) > 0
        correlations.append(float(np.corrcoef(*pair)[0, 1]) if enough else 0.0)
    best = int(np.argmax(correlations))
    return float(delays_s[best]), correlations[best]


def _fit_bias(
    hats: Float[Array, "n knots"], measured: Float[Array, "n axes"], knots: int
) -> Float[Array, "knots axes"]:
    """Return the bias without contact, by least squares without the fifth of the moments that is farthest from the median."""
    if len(hats) < knots:
        return np.zeros((knots, measured.shape[1]))
    off = np.linalg.norm(measured - np.median(measured, axis=0), axis=1)
    near = off <= np.quantile(off, _LEAST_FREE_SHARE)
    ridge = 1e-6 * np.eye(knots)
    return np.asarray(np.linalg.solve(hats[near].T @ hats[near] + ridge, hats[near].T @ measured[near]))


def _knots_s(moments: EstimatedMoments) -> Float[Array, " knots"]:
    first, last = float(moments.at_s.min()), float(moments.at_s.max())
    return np.linspace(first, last, 1 + max(1, int(np.ceil((last - first) / _KNOTS_APART_S))))


def _hat_functions(at_s: Float[Array, " n"], knots_s: Float[Array, " knots"]) -> Float[Array, "n knots"]:
    """Return the weights of linear interpolation between knots, one row for each time."""
    return np.stack([np.interp(at_s, knots_s, row) for row in np.eye(len(knots_s))], axis=1)


class _Problem:
    """The least squares problem of some moments and samples."""

    def __init__(
        self, moments: EstimatedMoments, samples: ForceTorqueSamples, mount: ForceTorqueMount, delay_s: float
    ) -> None:
        """delay_s: near which moments without samples are left out."""
        self._mount = mount
        known = np.isfinite(samples.at(moments.at_s + delay_s)[:, 0]) & np.isfinite(moments.covariance).all((1, 2))
        self._moments, self._samples = moments.select(known), samples
        self._knots_s = _knots_s(moments)
        self._hats = _hat_functions(self._moments.at_s, self._knots_s)
        self._groups, self._of_group, count = np.unique(self._moments.group, return_inverse=True, return_counts=True)
        self._inflation = np.maximum(count / _OBSERVATIONS, 1.0)[self._of_group]
        self._delay_s = delay_s
        self._precision = self._prior_precision()

    def _prior_precision(self) -> Float[Array, " parameters"]:
        std = _PRIOR_STD
        nine = [std["delay"], std["modulus"], std["shear"], *[std["origin"]] * 3, *[std["rotation"]] * 3]
        return np.concatenate([nine, np.tile(_BIAS_STD, len(self._knots_s))]) ** -2.0

    def starts(self) -> Iterable[Alignment]:
        """Yield an alignment for each rotation of a cube from the design's, and for each sign."""
        free = self._moments.group < 0
        measured = self._samples.at(self._moments.at_s + self._delay_s)
        bias = _fit_bias(self._hats[free], measured[free], len(self._knots_s))
        for rotation in Rotation.create_group("O").as_matrix():
            for sign in (1, -1):
                yield Alignment(
                    self._delay_s,
                    1.0,
                    1.0,
                    np.array(self._mount.origin_mm),
                    mount_rotation(self._mount).T @ rotation,
                    sign,
                    self._knots_s,
                    bias,
                    np.eye(9),
                    {},
                )

    def solve(self, start: Alignment, iterations: int, held: int = 0) -> Alignment:
        """Return the alignment after some iterations, which end earlier where nothing changes.

        held: number of iterations in which only origin and bias move.
        """
        found = start
        for number in range(iterations):
            deviation, slopes, _ = self._linearise(found)
            weight, scale = self._weights(deviation)
            half = np.repeat(np.sqrt(weight / self._inflation / scale), 6)
            slopes = half[:, None] * slopes.reshape(len(half), -1)
            normal = slopes.T @ slopes + np.diag(self._precision)
            gradient = slopes.T @ (half * deviation.ravel()) - self._precision * self._values(found)
            if number < held:
                normal[_TURNING, _TURNING] += 1e12
            covariance = np.linalg.inv(normal)
            step = covariance @ gradient
            found = self._moved(found, step, covariance[:9, :9], weight, float(np.sqrt(scale)))
            if number >= held and np.abs(step[:9]).max() < 1e-6:
                break
        return found

    def cost(self, found: Alignment) -> float:
        """Return the mean of the robust costs of all moments; each contact counts alike."""
        deviation, _, log_det = self._linearise(found)
        square = np.square(deviation).mean(axis=1)
        cost = 3 * np.log1p(square / _STUDENT_DEGREES) * (1 + _STUDENT_DEGREES) + log_det / 2
        return float(np.average(cost, weights=1 / self._inflation))

    def _weights(self, deviation: Float[Array, "n 6"]) -> tuple[Float[Array, " n"], float]:
        """Return the weight of each moment, which is that of its contact, and by how much variances exceed what is stated."""
        square = np.square(deviation).mean(axis=1)
        of_group = np.bincount(self._of_group, square) / np.bincount(self._of_group)
        touched = of_group[self._groups >= 0]
        scale = max(1.0, float(np.median(touched))) if len(touched) else 1.0
        weight = np.minimum(1.0, (1 + _STUDENT_DEGREES) / (of_group / scale + _STUDENT_DEGREES))
        return weight[self._of_group], scale

    def _linearise(
        self, at: Alignment
    ) -> tuple[Float[Array, "n 6"], Float[Array, "n 6 parameters"], Float[Array, " n"]]:
        """Return deviations, and slopes of the prediction, in standard deviations, with the logarithms of the determinants of their
        covariances.

        The slopes are those at the wrench that estimate and sample agree on: at the estimate, whose noise is that of a regressor,
        shear that only noise shows would count as shear that the sensor does not feel.
        """
        moments, knots = self._moments, len(self._knots_s)
        scaling = at.factor * np.where(SHEAR_COMPONENTS, at.shear_factor, 1.0)
        turn = at.sign * np.kron(np.eye(2), at.rotation)
        lever = np.eye(6)
        lever[3:, :3] = -_cross_matrix(at.origin_mm / 1e3)
        to_samples = turn @ lever @ np.diag(scaling)
        residual = self._samples.at(moments.at_s + at.delay_s) - self._hats @ at.bias - moments.six @ to_samples.T
        known = np.isfinite(residual).all(axis=1)
        residual[~known] = 0.0
        spread = to_samples @ moments.covariance
        covariance = spread @ to_samples.T + np.diag(_FLOOR**2 + self._samples.noise**2)
        whitener = np.linalg.inv(np.linalg.cholesky(covariance))
        precise = whitener.transpose(0, 2, 1) @ (whitener @ residual[:, :, None])
        agreed = moments.six + (spread.transpose(0, 2, 1) @ precise)[:, :, 0]
        about = (agreed * scaling) @ lever.T
        jacobian = np.zeros((len(about), 6, 9 + 6 * knots))
        jacobian[:, :, 0] = -np.nan_to_num(self._samples.slope_at(moments.at_s + at.delay_s))
        jacobian[:, :, 1] = about @ turn.T
        jacobian[:, :, 2] = (agreed * scaling * SHEAR_COMPONENTS) @ lever.T @ turn.T
        for axis, unit in enumerate(np.eye(3)):
            jacobian[:, 3:, 3 + axis] = np.cross(about[:, :3], unit) @ turn[3:, 3:].T
            turned = np.hstack([np.cross(unit, about[:, :3]), np.cross(unit, about[:, 3:])])
            jacobian[:, :, 6 + axis] = turned @ turn.T
        for knot in range(knots):
            jacobian[:, range(6), range(9 + 6 * knot, 15 + 6 * knot)] = self._hats[:, [knot]]
        jacobian[~known] = 0.0
        log_det = -2 * np.log(np.diagonal(whitener, axis1=1, axis2=2)).sum(axis=1)
        return (whitener @ residual[:, :, None])[:, :, 0], whitener @ jacobian, log_det

    def _values(self, at: Alignment) -> Float[Array, " parameters"]:
        """Return the parameters from the middle of their priors; rotation and bias have none."""
        off_m = (at.origin_mm - self._mount.origin_mm) / 1e3
        nine = [at.delay_s, np.log(at.factor), np.log(at.shear_factor), *off_m, 0.0, 0.0, 0.0]
        return np.concatenate([nine, np.zeros(6 * len(self._knots_s))])

    def _moved(
        self,
        at: Alignment,
        step: Float[Array, " parameters"],
        covariance: Float[Array, "9 9"],
        weight: Float[Array, " n"],
        excess: float,
    ) -> Alignment:
        """Return the alignment after a step, none of whose parts is longer than the linearisation holds."""
        turn = step[6:9] * min(1.0, 0.5 / max(float(np.linalg.norm(step[6:9])), 1e-12))
        groups = {
            int(group): float(weight[self._of_group == n][0]) for n, group in enumerate(self._groups) if group >= 0
        }
        return replace(
            at,
            delay_s=at.delay_s + float(np.clip(step[0], -0.05, 0.05)),
            factor=at.factor * float(np.exp(np.clip(step[1], -0.3, 0.3))),
            shear_factor=at.shear_factor * float(np.exp(np.clip(step[2], -0.3, 0.3))),
            origin_mm=at.origin_mm + 1e3 * step[3:6],
            rotation=at.rotation @ Rotation.from_rotvec(turn).as_matrix(),
            bias=at.bias + step[9:].reshape(-1, 6),
            covariance=covariance,
            weights=groups,
            excess=excess,
        )


def _cross_matrix(vector: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """Return the matrix that multiplies as the cross product from the left."""
    x, y, z = vector
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
