"""What a second press would tell: by how much each candidate shrinks what is not known of the ball's depth, of the base of the gel,
of its thickness and of a load. In: what is known of a sensor (`KnownPress`), from its folder or from its design. Out: `PressPlan`.

The image of every candidate is predicted by the model of the calibration (`simulation.calibration_press_models`), and the
information of the images adds up (Gauss–Markov), as in the joint fit: gel, light and view are shared, pose and level belong to each
press. An image counts as many independent observations as that of the calibration does. The error of the model, which one image
cannot reduce, shrinks as in the fit (`twin.fit_parameters.model_error_share`).
"""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Float32
from numpy import ndarray as Array

from ninedtact.calibration.ball.second_press import PressedBall, PressedFlatEnd, PressedObject
from ninedtact.calibration.fits_to_sensor_toml import fitted_ball_press
from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.calibration.twin.ball_press_fit import (
    RELATIVE_THICKNESS_STD,
    prior_of_base,
)
from ninedtact.calibration.twin.fit_parameters import (
    FIT_PARAMETERS,
    NEARLY_RIGID,
    PARAMETER_NAMES,
    POSE_COUNT,
    marginal_information_of_parameter,
    perturb_parameter,
    share_left_of_model_error,
)
from ninedtact.calibration.twin.gel_base import MODULUS_RATIO_MODEL_STD
from ninedtact.calibration.twin.observed_presses import REACH_MM, is_off_rim, tilt_basis
from ninedtact.design import SecondKind, SensorDesign
from ninedtact.mechanics.indenter import Ball, Indenter, LyingCylinder
from ninedtact.mechanics.pose import InvalidPose
from ninedtact.simulation.calibration_images import SECOND_BALL_DEPTH
from ninedtact.simulation.calibration_press_models import BallPressModel, BallPressParameters
from ninedtact.simulation.gel_brightness import BrightnessModel, brightness_model_for_design

_POINT_PITCH_MM = 0.25
"""Pitch of the points at which images are predicted; what they say is scaled to the effective observations."""
_USUAL_OBSERVATIONS, _USUAL_RESIDUAL = 150.0, 0.45
"""Effective observations and residual (RMS, grey levels) of the image of a ball, of real sensors that are not calibrated yet."""
_MEAN_GREY = 150.0
_USUAL_PRESS = BallPressParameters(0.0, 0.0, 1.5, 0.0, 0.0, 2.5, 0.5, 0.6, 0.05, 0.04)
_RELATIVE_MODULUS_STD = 0.25
"""Relative standard deviation of the modulus of a silicone of known hardness."""
_RELATIVE_LOAD_STD = 0.03
"""Error of a load on a kitchen scale, with that of the model of loads (docs/mechanics.md)."""
_FLAT_DEPTH = 0.35
"""Largest depth of a planned flat end, as a fraction of the thickness of the gel."""
_COIN_RADIUS_MM, _COIN_WIDTH_MM = 11.6, 2.3
"""Radius and width of a coin of one euro, on its edge."""
_DARKENING, _BRIGHTENING = 1, 2
_SHARED = len(FIT_PARAMETERS) - POSE_COUNT
_SHARED_COUNT = _SHARED + 3
"""Gel and view, then the slopes of darkening and brightening and the logarithm of the modulus."""
_OWN_COUNT = POSE_COUNT + 1
"""Pose and level of a press."""
_BASE, _LOG_MODULUS = PARAMETER_NAMES.index("gel_to_base_modulus_ratio") - POSE_COUNT, _SHARED_COUNT - 1


@dataclass(frozen=True)
class KnownPress:
    """The press of the calibration's ball, and what its image is worth."""

    design: SensorDesign
    press: BallPressParameters
    light: BrightnessModel
    effective_observations: float = _USUAL_OBSERVATIONS
    residual_rms_grey_levels: float = _USUAL_RESIDUAL
    inverse_distance_std_per_mm: float | None = None
    """What the image of the board tells of the view; None where it is not used."""


@dataclass(frozen=True)
class CandidatePress:
    """One more press on the same gel."""

    name: str
    indenter: Indenter
    depth_mm: float
    second: PressedObject | None = None
    """What a calibration would fit; None for an object that it does not use."""
    has_known_load: bool = False

    @classmethod
    def of(
        cls, second: PressedObject, depth_mm: float, name: str = "", has_known_load: bool = False
    ) -> "CandidatePress":
        """Return the press of an object that a calibration uses."""
        return cls(name or second.name, second.indenter, depth_mm, second, has_known_load)

    @property
    def calibrates(self) -> bool:
        """Whether a calibration uses all that the press tells."""
        return self.second is not None and not self.has_known_load


@dataclass(frozen=True)
class PlannedErrors:
    """Standard deviations after the presses."""

    depth_mm: float
    """Of the depth of the calibration's ball."""
    modulus_ratio: float
    """Of the modulus of the gel over that of its base."""
    thickness_mm: float
    relative_load: float
    """Of the load of the calibration's ball."""


@dataclass(frozen=True)
class PressPlan:
    """The errors with the calibration's ball alone, and with each candidate, the best for the depth first."""

    known: KnownPress
    alone: PlannedErrors
    candidates: tuple[tuple[CandidatePress, PlannedErrors], ...]

    @property
    def calibrating(self) -> tuple[CandidatePress, ...]:
        """The best of the candidates of each kind that a calibration uses, the best first."""
        best: dict[SecondKind, CandidatePress] = {}
        for one, _ in self.candidates:
            if one.calibrates and one.second is not None:
                best.setdefault(one.second.kind, one)
        return tuple(best.values())


def known_press_of_sensor(folder: SensorFolder) -> KnownPress:
    """Return the press of the ball of a calibrated sensor; raises `CalibrationError` for one without a twin."""
    table = folder.require_twin()
    board = table.board_press
    return KnownPress(
        folder.record.design,
        fitted_ball_press(table),
        table.light,
        table.fit.effective_observations,
        table.fit.image_rmse_grey_levels,
        board.inverse_distance_std_per_mm if board is not None and board.accepted else None,
    )


def known_press_of_design(design: SensorDesign) -> KnownPress:
    """Return a usual press of the ball of a design, before any image."""
    gel, light = design.gel, brightness_model_for_design(design)
    thinner = min(1.0, gel.thickness_mm / SensorDesign().gel.thickness_mm)
    press = replace(
        _USUAL_PRESS,
        depth_mm=_USUAL_PRESS.depth_mm * thinner,
        thickness_mm=gel.thickness_mm,
        point_spread_mm=light.point_spread_mm,
        saturation=light.saturation,
        inverse_distance_per_mm=light.inverse_distance_per_mm,
        gel_to_base_modulus_ratio=max(gel.gel_to_base_modulus_ratio, NEARLY_RIGID),
    )
    return KnownPress(design, press, light)


def candidate_presses(known: KnownPress) -> Iterator[CandidatePress]:
    """Yield what is at hand in a workshop: other balls, the same ball again, a coin, a flat end at a known depth, a scale.

    Larger balls are pressed to a contact of the same area, which a hand presses as easily.
    """
    ball, depth_mm = known.design.ball, known.press.depth_mm
    for factor in (0.4, 0.6, 1.5, 2.5):
        radius_mm = round(factor * ball.radius_mm, 1)
        yield CandidatePress.of(
            PressedBall(radius_mm),
            depth_mm * min(1.0, SECOND_BALL_DEPTH * radius_mm / depth_mm, ball.radius_mm / radius_mm),
            f"ball of radius {radius_mm:g} mm",
        )
    same = PressedBall(ball.radius_mm)
    yield CandidatePress.of(same, 0.5 * depth_mm, "the same ball, half as deep")
    yield CandidatePress.of(same, 1.25 * depth_mm, "the same ball, a quarter deeper")
    yield CandidatePress.of(same, depth_mm, "the same ball, as deep")
    yield CandidatePress.of(same, depth_mm, "the same ball on a kitchen scale", has_known_load=True)
    yield CandidatePress("edge of a coin", LyingCylinder(_COIN_RADIUS_MM, _COIN_WIDTH_MM), 0.7 * depth_mm)
    flat = known.design.flat_end
    flat = replace(flat, depth_mm=min(flat.depth_mm, _FLAT_DEPTH * known.press.thickness_mm))
    name = f"flat end of {2 * flat.radius_mm:g} mm at a known depth (feeler gauge)"
    yield CandidatePress.of(PressedFlatEnd(flat), flat.depth_mm, name)


def plan_second_press(known: KnownPress) -> PressPlan:
    """Return by how much each candidate shrinks the errors; those that the gel does not allow are left out."""
    first, found = _PressInformation.of_ball(known), []
    for candidate in candidate_presses(known):
        with suppress(InvalidPose):
            found.append((candidate, _errors_with(known, first, candidate)))
    best_first = sorted(found, key=lambda one: one[1].depth_mm)
    return PressPlan(known, _errors(known, first), tuple(best_first))


def errors_with_candidate(known: KnownPress, candidate: CandidatePress) -> PlannedErrors:
    """Return the errors with one candidate; raises `InvalidPose` where the gel does not allow it."""
    return _errors_with(known, _PressInformation.of_ball(known), candidate)


def _errors_with(known: KnownPress, first: "_PressInformation", candidate: CandidatePress) -> PlannedErrors:
    press = replace(known.press, depth_mm=candidate.depth_mm, drag_x_mm=0.0, drag_y_mm=0.0, x_mm=0.0, y_mm=0.0)
    face_radius_mm = None if candidate.second is None else candidate.second.face_radius_mm
    return _errors(known, first, _PressInformation.of(known, press, candidate.indenter, face_radius_mm), candidate)


@dataclass(frozen=True)
class _PressInformation:
    """What the image of one press says, and how its load follows from the parameters."""

    matrix: Float[Array, "parameters parameters"]
    """Information of the image: shared parameters first, then those of the press."""
    log_load: Float[Array, " parameters"]
    """Derivative of the logarithm of the load."""

    @classmethod
    def of_ball(cls, known: KnownPress) -> "_PressInformation":
        """Return the information of the press of the calibration's ball."""
        return cls.of(known, known.press, Ball(known.design.ball.radius_mm))

    @classmethod
    def of(
        cls, known: KnownPress, press: BallPressParameters, indenter: Indenter, face_radius_mm: float | None = None
    ) -> "_PressInformation":
        """Return the information of a press; raises `InvalidPose` where it leaves nothing of the gel.

        face_radius_mm: radius of a flat face, whose rim is not fitted and whose tilt is not known.
        """
        model = BallPressModel(known.design, indenter=indenter).starting_from(press)
        middle, points_mm = press.centre_mm, _points_around(press, face_radius_mm)
        tilt = None
        if face_radius_mm is not None:
            (x, y), (middle_x, middle_y) = points_mm, middle
            tilt = tilt_basis(x[0] - middle_x, y[0] - middle_y, face_radius_mm)
        brightness = np.array([1.0, known.light.darkening_per_mm, known.light.brightening_per_mm])

        def predict(one: BallPressParameters) -> tuple[Float[Array, "n 3"], float]:
            basis = model.linear_basis(one, middle, points_mm)
            basis = basis if tilt is None else basis - tilt @ (tilt.T @ basis)
            return basis, float(np.log(np.sum(model.contact(one).pressure_mpa)))

        basis, log_load = predict(press)
        image = basis @ brightness
        by_own, load_by_own = [], []
        for index in range(len(FIT_PARAMETERS)):
            vector, step = perturb_parameter(press.vector, index)
            try:
                moved, moved_log_load = predict(BallPressParameters.from_vector(vector))
            except InvalidPose:  # deeper than the gel allows: take the other side
                moved, moved_log_load = predict(BallPressParameters.from_vector(2 * press.vector - vector))
                step = -step
            by_own.append((moved @ brightness - image) / step)
            load_by_own.append((moved_log_load - log_load) / step)
        nothing = np.zeros_like(image)
        shared = [*by_own[POSE_COUNT:], basis[:, _DARKENING], basis[:, _BRIGHTENING], nothing]
        jacobian = _MEAN_GREY * np.column_stack([*shared, *by_own[:POSE_COUNT], image])
        worth = known.effective_observations / image.size / known.residual_rms_grey_levels**2
        by_load = np.array([*load_by_own[POSE_COUNT:], 0.0, 0.0, 1.0, *load_by_own[:POSE_COUNT], 0.0])
        return cls(worth * jacobian.T @ jacobian, by_load)

    def placed(self, number: int, count: int) -> Float[Array, "all all"]:
        """Return the information among the parameters of this many presses, of which this is one."""
        size = _SHARED_COUNT + count * _OWN_COUNT
        where, whole = _indices(number), np.zeros((size, size))
        whole[np.ix_(where, where)] = self.matrix
        return whole


def _points_around(
    press: BallPressParameters, face_radius_mm: float | None
) -> tuple[Float32[Array, "1 n"], Float32[Array, "1 n"]]:
    """Return the points at which the image of a press is predicted."""
    axis = np.arange(-REACH_MM, REACH_MM + _POINT_PITCH_MM / 2, _POINT_PITCH_MM)
    x, y = (one.ravel() for one in np.meshgrid(axis, axis))
    inside = np.hypot(x, y) < REACH_MM
    if face_radius_mm is not None:
        inside &= is_off_rim(np.hypot(x, y), face_radius_mm)
    return (
        (x[inside] + press.x_mm).astype(np.float32)[None],
        (y[inside] + press.y_mm).astype(np.float32)[None],
    )


def _indices(number: int) -> list[int]:
    """Return the places of the parameters of one press among those of several."""
    start = _SHARED_COUNT + number * _OWN_COUNT
    return [*range(_SHARED_COUNT), *range(start, start + _OWN_COUNT)]


def _errors(
    known: KnownPress,
    first: _PressInformation,
    second: _PressInformation | None = None,
    candidate: CandidatePress | None = None,
) -> PlannedErrors:
    """Return the errors after one press or two, with the priors of the fit."""
    presses = [first] if second is None else [first, second]
    count = len(presses)
    images = np.sum([one.placed(number, count) for number, one in enumerate(presses)], axis=0)
    beside = _prior_information(known, len(images))
    if second is not None and candidate is not None:
        if candidate.second is not None and candidate.second.known_depth is not None:
            depth = _SHARED_COUNT + _OWN_COUNT + PARAMETER_NAMES.index("depth_mm")
            beside[depth, depth] += 1 / candidate.second.known_depth[1] ** 2
        if candidate.has_known_load:
            row = np.zeros(len(images))
            row[_indices(1)] = second.log_load
            beside += np.outer(row, row) / _RELATIVE_LOAD_STD**2
    covariance = np.linalg.inv(images + beside)
    if not known.design.gel.has_rigid_base:
        share = 1.0
        if count > 1:
            alone = [marginal_information_of_parameter(one.placed(0, 1), _BASE) for one in presses]
            share = share_left_of_model_error(alone, marginal_information_of_parameter(images, _BASE))
        direction = covariance[:, _BASE] / covariance[_BASE, _BASE]
        covariance = covariance + np.outer(direction, direction) * (MODULUS_RATIO_MODEL_STD * share) ** 2
    load = np.zeros(len(covariance))
    load[_indices(0)] = first.log_load
    depth = _SHARED_COUNT + PARAMETER_NAMES.index("depth_mm")
    thickness = PARAMETER_NAMES.index("thickness_mm") - POSE_COUNT
    variances = [covariance[index, index] for index in (depth, _BASE, thickness)]
    return PlannedErrors(*np.sqrt([*variances, load @ covariance @ load]).tolist())


def _prior_information(known: KnownPress, size: int) -> Float[Array, "all all"]:
    """Return what the design, the board and the hardness of the gel tell, as the fit uses them."""
    gel = known.design.gel
    deviations = {
        PARAMETER_NAMES.index("thickness_mm") - POSE_COUNT: RELATIVE_THICKNESS_STD * gel.thickness_mm,
        _BASE: 1e-6
        if gel.has_rigid_base
        else 1 / prior_of_base(gel).residual(known.press.gel_to_base_modulus_ratio)[1],
        PARAMETER_NAMES.index("inverse_distance_per_mm") - POSE_COUNT: known.inverse_distance_std_per_mm or np.inf,
        _LOG_MODULUS: _RELATIVE_MODULUS_STD,
    }
    information = np.zeros((size, size))
    for index, deviation in deviations.items():
        information[index, index] = 1 / deviation**2
    return information
