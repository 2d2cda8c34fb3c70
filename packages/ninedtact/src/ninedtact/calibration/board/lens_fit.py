"""The fit of the lens model to pins, and its leave-one-out error: how well it predicts a pin that is left out of the fit."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.optimize import least_squares

from ninedtact.shape.lens_and_rectification import (
    LensModel,
    LensModelCorrection,
    Points,
    central_mm_per_px,
    gaussian_basis_matrix,
)

_RADIAL_TERM_COUNTS = (1, 2, 3)
_HUBER_SCALE_PX = 1.5
"""Residual above which the loss is linear, so that one wrong spot does not bend the lens."""

_MAX_ITERATIONS = 60
"""Largest number of iterations. Real lenses take 20 to 30; one without distortion has no defined centre and would take thousands.
"""


@dataclass(frozen=True)
class LensFit:
    """A lens model with the pins it was fitted to."""

    lens: LensModel
    points_mm: Points
    points_px: Points
    derivative: Float[Array, "m k"]
    """Jacobian of the 2n pixel residuals by the k parameters, x and y of a pin in successive rows."""

    @cached_property
    def residual_px(self) -> Points:
        """Return the residuals in pixels: projected by the model minus found in the image."""
        return self.lens.to_px(self.points_mm) - self.points_px

    @cached_property
    def leave_one_out_errors_mm(self) -> Points:
        """Return, for every pin, its position as predicted by the model fitted to all others, minus its true position, in mm on the
        skin.

        The errors follow from the exact update of the linearised fit (PRESS, Allen 1974): residual / (1 − leverage), with a 2×2
        block per pin. They agree with n refits to within two per cent (tests/calibration/test_board.py).
        """
        return np.asarray(
            np.linalg.solve(self.lens.px_per_mm(self.points_mm), self._left_out_residual_px[..., None])[..., 0]
        )

    @cached_property
    def _inverse_normal_matrix(self) -> Float[Array, "k k"]:
        """The parameters' covariance for residuals of unit variance."""
        return np.linalg.pinv(self.derivative.T @ self.derivative)

    @property
    def _pin_derivatives(self) -> Float[Array, "n 2 k"]:
        """The Jacobian of every pin."""
        return self.derivative.reshape(len(self.points_mm), 2, -1)

    @cached_property
    def _left_out_residual_px(self) -> Points:
        """The residual of every pin for the lens that is fitted to all others: (1 − leverage)⁻¹ residual."""
        blocks = self._pin_derivatives
        leverage = blocks @ self._inverse_normal_matrix @ blocks.transpose(0, 2, 1)
        return np.asarray(np.linalg.solve(np.eye(2) - leverage, self.residual_px[..., None])[..., 0])

    @cached_property
    def residuals_without_each_pin_px(self) -> Float[Array, "n n 2"]:
        """The residuals at all pins (second axis) of the lens that is fitted without each pin (first axis)."""
        blocks = self._pin_derivatives
        change_px = np.einsum(
            "jak,kl,ibl,ib->ija", blocks, self._inverse_normal_matrix, blocks, self._left_out_residual_px, optimize=True
        )
        return np.asarray(self.residual_px + change_px)

    @property
    def leave_one_out_rms_mm(self) -> float:
        """Return the root mean square length of the leave-one-out errors."""
        return rms_vector_length(self.leave_one_out_errors_mm)

    def mm_per_px_std(self, reach_mm: float) -> float:
        """Return the standard error of `central_mm_per_px`, from the fit's covariance."""
        freedom = self.residual_px.size - self.derivative.shape[1]
        variance = (self.residual_px**2).sum() / freedom
        gradient = _scale_gradient(self.lens, reach_mm)
        covariance = self._inverse_normal_matrix * variance
        return float(np.sqrt(gradient @ covariance @ gradient))


_INITIAL_RADIAL = 0.1
"""Without distortion its centre has no derivative, and a search that starts there may stay there."""


def fit_lens(points_mm: Points, points_px: Points, near: LensModel) -> LensFit:
    """Return the lens model that best predicts left-out pins; radial terms are added only as long as they reduce that error.

    near: a lens to start from.
    """
    affordable = [
        terms for terms in _RADIAL_TERM_COUNTS if len(points_mm) > len(near.parameters) - len(near.radial) + terms
    ]
    fits = [
        refine_lens(points_mm, points_px, with_radial_term_count(near, terms))
        for terms in affordable or _RADIAL_TERM_COUNTS[:1]
    ]
    return min(fits, key=lambda fit: fit.leave_one_out_rms_mm)


def fit_lens_with_terms(points_mm: Points, points_px: Points, raw_shape: tuple[int, int], terms: int) -> LensFit:
    """Return a lens model with this many radial terms, started from the best affine map."""
    return refine_lens(points_mm, points_px, _fit_affine_lens(points_mm, points_px, raw_shape, terms))


def refine_lens(points_mm: Points, points_px: Points, start: LensModel) -> LensFit:
    """Return the lens with all parameters fitted by robust least squares."""

    def residual(parameters: Float[Array, " k"]) -> Float[Array, " m"]:
        return (start.with_parameters(parameters).to_px(points_mm) - points_px).ravel()

    def derivative(parameters: Float[Array, " k"]) -> Float[Array, "m k"]:
        return start.with_parameters(parameters).px_per_parameter(points_mm).reshape(2 * len(points_mm), -1)

    solution = least_squares(
        residual,
        start.parameters,
        derivative,
        x_scale="jac",
        loss="huber",
        f_scale=_HUBER_SCALE_PX,
        max_nfev=_MAX_ITERATIONS,
    )
    return LensFit(start.with_parameters(solution.x), points_mm, points_px, derivative(solution.x))


def with_radial_term_count(lens: LensModel, terms: int) -> LensModel:
    """Return the same lens with more or fewer radial terms; new ones are zero."""
    return replace(lens, radial=(*lens.radial, *(0.0,) * terms)[:terms])


def _fit_affine_lens(points_mm: Points, points_px: Points, raw_shape: tuple[int, int], terms: int) -> LensModel:
    """Return the best lens without distortion, but for a first radial term from which a search can start."""
    straight = LensModel((), (0.0, 0.0), (_INITIAL_RADIAL, *(0.0,) * (terms - 1)), (0.0, 0.0), raw_shape)
    units = (points_px - straight.middle_px) / straight.unit_px
    rows = np.linalg.lstsq(np.column_stack([points_mm, np.ones(len(points_mm))]), units, rcond=None)[0].T
    return replace(straight, homography=(*rows.ravel().tolist(), 0.0, 0.0))


def _scale_gradient(lens: LensModel, reach_mm: float) -> Float[Array, " k"]:
    """Return the derivative of the mm per pixel around the skin centre by each parameter."""
    base, step = lens.parameters, 1e-6
    return np.array(
        [
            (
                central_mm_per_px(lens.with_parameters(base + dp), reach_mm)
                - central_mm_per_px(lens.with_parameters(base - dp), reach_mm)
            )
            / (2 * step)
            for dp in np.eye(len(base)) * step
        ]
    )


_CORRECTION_WIDTHS = (1.5, 2.0, 3.0)
"""Widths of the smooth correction that are tried, in pitches of the pins."""
_CORRECTION_NOISES = (0.3, 0.03, 0.003, 0.0003)
"""Variances of a pin's own error that are tried, relative to that of the correction."""
_MIN_CORRECTION_GAIN = 0.1
"""Part of the leave-one-out error that a correction must remove to be used. Where the lens model fits, the best of all candidates
removes up to 0.03 by chance (three real boards).
"""
MIN_CORRECTED_ERROR = 0.024
"""Leave-one-out error of the lens model alone, in pitches, above which it needs a correction: 0.06 mm for the design's board, where
the certificate begins to warn. Below it, a smooth residual may be the displacement of the imprints by their depth, up to 0.05 mm on
simulated sensors, which is no property of the lens.
"""


@dataclass(frozen=True)
class LensCorrectionFit:
    """A smooth correction of a lens model, with its own leave-one-out errors."""

    correction: LensModelCorrection
    leave_one_out_errors_mm: Points


def fit_smooth_lens_residual(fit: LensFit, pitch_mm: float) -> LensCorrectionFit | None:
    """Return the smooth correction that best predicts left-out pins, or None where the lens model alone is as good.

    The residuals of the lens are regressed by a Gaussian process (Rasmussen & Williams 2006, algorithm 2.1). Each pin is left out
    of the lens, by the linearised update, and of the regression.
    """
    found = [
        _fit_correction(fit, width * pitch_mm, noise) for width in _CORRECTION_WIDTHS for noise in _CORRECTION_NOISES
    ]
    best = min(found, key=lambda one: rms_vector_length(one.leave_one_out_errors_mm))
    gain = 1 - rms_vector_length(best.leave_one_out_errors_mm) / max(fit.leave_one_out_rms_mm, 1e-12)
    return best if gain >= _MIN_CORRECTION_GAIN else None


def _fit_correction(fit: LensFit, width_mm: float, noise: float) -> LensCorrectionFit:
    """Return the correction of this width and relative variance of a pin's own error."""
    smoothed = gaussian_basis_matrix(fit.points_mm, fit.points_mm, width_mm) + noise * np.eye(len(fit.points_mm))
    weights = np.linalg.solve(smoothed, -fit.residual_px)
    inverse = np.linalg.inv(smoothed)
    # The errors at pins that the regression is not given, from the inverse for all pins (ibid., equation 5.12).
    errors_px = np.einsum("ij,ija->ia", inverse, fit.residuals_without_each_pin_px) / np.diag(inverse)[:, None]
    errors_mm = np.linalg.solve(fit.lens.px_per_mm(fit.points_mm), errors_px[..., None])[..., 0]
    return LensCorrectionFit(LensModelCorrection(fit.points_mm, weights, width_mm), np.asarray(errors_mm))


def rms_vector_length(vectors: Points) -> float:
    """Return the root mean square length of n vectors."""
    return float(np.sqrt((vectors**2).sum(axis=1).mean()))
