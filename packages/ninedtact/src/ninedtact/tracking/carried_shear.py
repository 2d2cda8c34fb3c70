"""The shear of skin that an object carries along, from the object's tracked motion and the pressure, by Coulomb's law.

A twist about the normal hardly raises the gel, so that a single image shows little of its torque, of many objects nothing at all.
From image to image the object itself shows how far it carries the skin along: what sticks moves with it, and the compliance of the
gel tells the shear that this takes, up to what friction holds (`mechanics.friction`). Shear that was there before the object was
first seen is not known, so that a contact counts from its beginning.

Fields lie on a grid that moves and turns with the object: what sticks stays at its place on it. All are computed for some friction
coefficients, each weighted by how well it predicts the load along the skin: images hide a twist, but not this load, and while all
slides it is just what friction holds.
"""

from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from jaxtyping import Float, Float32
from numpy import ndarray as Array
from scipy.interpolate import make_interp_spline
from scipy.special import softmax

from ninedtact.design import Gel
from ninedtact.mechanics.friction import FrictionLimit, ShearSolution, slip_mask, solve_shear
from ninedtact.mechanics.skin import PeriodicGrid
from ninedtact.quantities import Traction, WrenchEstimate
from ninedtact.tracking.object_tracker import ObjectMotion
from ninedtact.tracking.sliding_load import skin_of, square_grid
from ninedtact.tracking.sliding_springs import friction_log_prior, load_variance
from ninedtact.tracking.slip import INCIPIENT_SHARE

_SOLVED_FRICTION = np.geomspace(0.1, 2.5, 5).astype(np.float32)
"""Coefficients for which shear is computed."""
_FRICTION = np.geomspace(0.1, 2.5, 41)
"""Coefficients that are weighed; between those above, what depends on them is interpolated."""
_SEEN_STD_RAD = 0.05
"""Standard deviation of a turn up to which it is seen."""
_TORQUE_ERROR, _LEAST_TORQUE_ERROR = 0.3, 0.02
"""Error of the torque over itself, and over the load times the radius of gyration: pressure is blurred, and covers more of the skin
than the object does. Found on a simulated gear, cross, key, star and letter."""
_USUAL_TWIST = 0.3
"""Torque of a twist for which the errors of single images are stated (`force.hidden_twist`), over load times radius of gyration."""
_LEAST_TURN = 0.1
"""Torque over load times radius of gyration from which a turn is seen in it."""
_AT_LIMIT = 0.9
"""Part of what friction holds from which a place counts as sliding: at rest, noise of the pressure lifts the limit off it."""
_ANY_TORQUE_NM = 1.0
"""Standard deviation of a torque without a stated error: more than any that a gel bears."""
_TOLERANCE_MM, _MAX_ITERATIONS = 2e-3, 60


@dataclass(frozen=True)
class CarriedShear:
    """What the motion of an object tells of the shear under it."""

    torque_nm: float
    """Torque about the normal through `centre_mm` that the object applies to the skin."""
    torque_std_nm: float
    centre_mm: Float[Array, "2"]
    """Centre of pressure."""
    load_n: float
    radius_mm: float
    """Radius of gyration of the pressure about the centre."""
    sticking_share: float
    """Share of the contact that sticks, weighted by pressure, at the median of what friction may be."""
    p_incipient: float
    """Probability that less than `INCIPIENT_SHARE` of it sticks."""

    @property
    def leverage_nm(self) -> float:
        """The load times the radius of gyration."""
        return self.load_n * self.radius_mm / 1e3

    def is_turn_under(self, drag_n: float) -> bool:
        """Return whether more of the shear belongs to a turn than to a force along the skin, and the turn is seen in it."""
        return abs(self.torque_nm) > max(drag_n * self.radius_mm / 1e3, _LEAST_TURN * self.leverage_nm)

    def correct(self, estimate: WrenchEstimate) -> WrenchEstimate:
        """Return an estimate of the wrench about the skin's centre, with this torque as a second measurement beside its own.

        The error of the first is that of a twist which the image hides; it falls with the twist that the motion shows.
        """
        centre_mm = np.array([*self.centre_mm, 0.0])
        moved = estimate.about(centre_mm)
        shown = np.hypot(self.torque_nm, self.torque_std_nm) / (_USUAL_TWIST * self.leverage_nm)
        hidden = np.array([1, 1, 1, 1, 1, min(float(shown), 1.0)])
        covariance, six = np.outer(hidden, hidden) * moved.covariance, moved.wrench.six
        covariance[5, 5] = min(covariance[5, 5], _ANY_TORQUE_NM**2)
        gain = covariance[:, 5] / (covariance[5, 5] + self.torque_std_nm**2)
        six = six + gain * (self.torque_nm - six[5])
        wrench = replace(moved.wrench, force_n=six[:3], torque_nm=six[3:])
        return replace(moved, wrench=wrench, covariance=covariance - np.outer(gain, covariance[5])).about_skin_centre()


@dataclass(frozen=True)
class _Placed:
    """The grid of an object at one time."""

    grid: PeriodicGrid
    centre_mm: Float[Array, "2"]
    yaw_rad: float

    @property
    def axes(self) -> Float32[Array, "2 2"]:
        """The grid's axes as columns, in those of the sensor."""
        cos, sin = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        return np.array([[cos, -sin], [sin, cos]], np.float32)

    @property
    def points_mm(self) -> Float32[Array, "2 rows cols"]:
        """Where the points of the grid are on the skin."""
        places_mm = np.tensordot(self.axes, self.grid.positions_mm.astype(np.float32), 1)
        return places_mm + self.centre_mm.astype(np.float32)[:, None, None]


@dataclass
class CarriedSkin:
    """Follows the skin under one object; give it every image of a contact in turn."""

    _last: _Placed | None = field(default=None, init=False)
    """None before the object was seen."""
    _shear: ShearSolution | None = field(default=None, init=False)
    """Shear and displacement on the grid, for every friction coefficient, along the grid's axes."""
    _path: int = field(default=0, init=False)
    """Path of the motion that places the grid."""
    _origin_mm: Float[Array, "3"] = field(default_factory=lambda: np.zeros(3), init=False)
    """Place of the grid's middle when the path began."""
    _yaw_rad: float = field(default=0.0, init=False)
    """Turn of the grid when the path began."""
    _log_likelihood: Float[Array, " frictions"] = field(default_factory=lambda: np.zeros(len(_FRICTION)), init=False)
    """That of every coefficient by the image that speaks against it most: the errors of all images are alike."""

    def release(self) -> None:
        """Forget the contact."""
        self._last, self._shear, self._log_likelihood = None, None, np.zeros(len(_FRICTION))

    def update(
        self, motion: ObjectMotion, traction: Traction, tangential_n: Float[Array, "2"], friction: float
    ) -> CarriedShear | None:
        """Return what the motion since the contact began tells; None where it is not seen, and under less than two cells of
        pressure, which bear no torque.

        Where another path begins meanwhile, the skin is as the last one left it.
        tangential_n: load along the skin that the image shows. friction: coefficient; not a number where it is not known.
        """
        if not motion.is_known or not motion.std[5] < _SEEN_STD_RAD or not traction.pressure_mpa.max() > 0:
            return None
        moved, is_first = motion.motion, self._last is None
        if self._last is None or self._shear is None:
            self._last, self._shear = _skin_at_rest(traction)
        before = self._last
        if is_first or motion.path != self._path:
            self._path, self._yaw_rad = motion.path, before.yaw_rad - moved.yaw_rad
            self._origin_mm = moved.inverse(np.array([*before.centre_mm, 0.0]))
        now = replace(before, centre_mm=moved(self._origin_mm)[:2], yaw_rad=self._yaw_rad + moved.yaw_rad)
        carried_mm = before.axes @ _columns(self._shear.displacement_mm) + _columns(now.points_mm - before.points_mm)
        target_mm = (now.axes.T @ carried_mm).reshape(self._shear.displacement_mm.shape)
        pressure_mpa = _sample(traction, now.points_mm)
        if np.count_nonzero(pressure_mpa) < 2:
            return None
        limit = FrictionLimit(_SOLVED_FRICTION[:, None, None] * pressure_mpa)
        tolerance_mm = np.full((len(_SOLVED_FRICTION), 1, 1), _TOLERANCE_MM, np.float32)
        operators = skin_of(now.grid, traction.gel).operators
        self._shear = solve_shear(operators, target_mm, limit, self._shear, tolerance_mm, _MAX_ITERATIONS)
        self._last = now
        unlike = _log_likelihood(now, pressure_mpa, self._shear.shear_mpa, tangential_n)
        self._log_likelihood = np.fmin(self._log_likelihood, unlike)
        weight = softmax(self._log_likelihood + friction_log_prior(_FRICTION, friction))
        return _summarise(now, pressure_mpa, limit, self._shear.shear_mpa, weight, traction.gel, float(motion.std[5]))


def _skin_at_rest(traction: Traction) -> tuple[_Placed, ShearSolution]:
    """Return a grid about the centre of pressure, over skin that is not sheared."""
    grid = square_grid(traction)
    middle = _Placed(grid, np.zeros(2), 0.0)
    centre_mm = _mean_over(middle.points_mm, _sample(traction, middle.points_mm))
    none = np.zeros((len(_SOLVED_FRICTION), 1, 1), np.float32)
    still = np.zeros((len(_SOLVED_FRICTION), 2, *grid.shape), np.float32)
    step_length = skin_of(grid, traction.gel).operators.first_step_lengths(none)[1]
    return replace(middle, centre_mm=centre_mm), ShearSolution(still, still, none, none, none, step_length)


def _log_likelihood(
    placed: _Placed,
    pressure_mpa: Float32[Array, "rows cols"],
    shear_mpa: Float32[Array, "nodes 2 rows cols"],
    tangential_n: Float[Array, "2"],
) -> Float[Array, " frictions"]:
    """Return how well every coefficient predicts the load along the skin."""
    cell_mm2 = placed.grid.cell_area_mm2
    predicted_n = _interpolate(cell_mm2 * shear_mpa.sum(axis=(2, 3)) @ placed.axes.T)
    misses = ((predicted_n - tangential_n) ** 2).sum(axis=1)
    return -0.5 * np.asarray(misses / load_variance(cell_mm2 * float(pressure_mpa.sum())))


def _interpolate(solved: Float[Array, "nodes ..."]) -> Float[Array, "frictions ..."]:
    """Return numbers at all coefficients from those at the solved ones, linear in the logarithm of friction."""
    return np.asarray(make_interp_spline(np.log(_SOLVED_FRICTION), solved, k=1)(np.log(_FRICTION)))


def _summarise(
    placed: _Placed,
    pressure_mpa: Float32[Array, "rows cols"],
    limit: FrictionLimit,
    shear_mpa: Float32[Array, "nodes 2 rows cols"],
    weight: Float[Array, " frictions"],
    gel: Gel,
    yaw_std_rad: float,
) -> CarriedShear:
    """Return torque, its error, and what sticks, over the friction coefficients."""
    cell_mm2, places_mm = placed.grid.cell_area_mm2, placed.grid.positions_mm
    centre_mm = _mean_over(places_mm, pressure_mpa)
    x_mm, y_mm = places_mm - centre_mm[:, None, None]
    torques_nmm = _interpolate(cell_mm2 * (x_mm * shear_mpa[:, 1] - y_mm * shear_mpa[:, 0]).sum(axis=(1, 2)))
    torque_nmm = float(weight @ torques_nmm)
    spread_nmm = float(np.sqrt(weight @ (torques_nmm - torque_nmm) ** 2))
    radius_mm = float(np.sqrt(_mean_over((x_mm**2 + y_mm**2)[None], pressure_mpa)[0]))
    load_n = cell_mm2 * float(pressure_mpa.sum())
    area_mm2 = cell_mm2 * np.count_nonzero(pressure_mpa)
    # That of a disc of the same radius of gyration on a half-space (Johnson, §3.9), and of a layer that is sheared.
    stiffness_nmm = gel.shear_modulus_mpa * (
        16 / 3 * (np.sqrt(2) * radius_mm) ** 3 + area_mm2 * radius_mm**2 / gel.thickness_mm
    )
    errors_nmm = (
        spread_nmm,
        _TORQUE_ERROR * torque_nmm,
        _LEAST_TORQUE_ERROR * load_n * radius_mm,
        yaw_std_rad * stiffness_nmm,
    )
    sticks = ~slip_mask(shear_mpa, _AT_LIMIT * limit.max_shear_mpa)
    shares = _interpolate((sticks * pressure_mpa).sum(axis=(1, 2)) / pressure_mpa.sum())
    return CarriedShear(
        torque_nmm / 1e3,
        float(np.linalg.norm(errors_nmm)) / 1e3,
        placed.axes @ centre_mm + placed.centre_mm,
        load_n,
        radius_mm,
        float(np.interp(0.5, np.cumsum(weight) - weight / 2, shares)),
        float(weight[shares < INCIPIENT_SHARE].sum()),
    )


def _sample(traction: Traction, points_mm: Float32[Array, "2 rows cols"]) -> Float32[Array, "rows cols"]:
    """Return the pressure at points of the skin, zero out of view."""
    rows, cols = traction.pressure_mpa.shape
    col, row = (points_mm[axis] / traction.mm_per_px + (side - 1) / 2 for axis, side in enumerate((cols, rows)))
    return np.array(cv2.remap(traction.pressure_mpa, col.astype(np.float32), row.astype(np.float32), cv2.INTER_LINEAR))


def _mean_over(values: Float[Array, "n rows cols"], weight: Float[Array, "rows cols"]) -> Float[Array, " n"]:
    """Return the means of fields, weighted."""
    return np.array((values * weight).sum(axis=(1, 2)) / weight.sum(), float)


def _columns(field_mm: Float[Array, "*nodes 2 rows cols"]) -> Float[Array, "*nodes 2 points"]:
    """Return a field of vectors as a matrix of columns."""
    return field_mm.reshape(*field_mm.shape[:-2], -1)
