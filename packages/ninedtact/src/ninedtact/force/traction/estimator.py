"""Force without training: pressure and shear under the contact, from the image and the gel's compliance.

    reading ──observation──▶ signal on cells ──contact region──▶ inversion ──▶ tractions ──sum──▶ wrench and its uncertainty

An incompressible gel that is bonded below rises in front of a dragged object and sinks behind it. The amount determines the shear
that the object applies. Nothing is trained: the prior has only a few parameters (`linearisation.TractionPrior`).
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from threading import Lock
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float32
from numpy import ndarray as Array

from ninedtact.design import Gel
from ninedtact.errors import ForceEstimationError
from ninedtact.force.contact_detection import (
    ContactRegionSettings,
    correlated_noise_limit,
    detect_contact,
    find_contact_region,
    find_faint_contact,
    pressure_reaches_unseen,
)
from ninedtact.force.estimator_and_scale import ForceEstimator, unknown_wrench_estimate, zero_wrench
from ninedtact.force.traction.brightness_from_traction import ForwardModel
from ninedtact.force.traction.linearisation_and_qp import TractionPrior
from ninedtact.force.traction.observation import (
    MARGIN_CELLS,
    CellGrid,
    ObservationModel,
    ObservationOnCells,
    build_brightness_observation_model,
    cell_grid_over_image,
)
from ninedtact.force.traction.traction_from_brightness import (
    InversionResult,
    SolverSettings,
    TractionInversion,
    UncertaintyModel,
)
from ninedtact.quantities import EstimateWarning, HeightMap, Traction, WrenchEstimate, diagonal_covariance
from ninedtact.reading import Reading
from ninedtact.shape.calibrated_shape import CalibratedShape

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController

NO_CONTACT_STD = np.array([0.01, 0.01, 0.03, 2e-4, 2e-4, 5e-5])
"""Standard deviation of the wrench where no contact is detected; half of all contacts of 0.05 N are detected
(docs/force_physics.md)."""

MODELLED_THINNING = 0.9
"""Thinning over the gel's thickness up to which the model of the gel holds (docs/force_physics.md)."""
LARGEST_PRESSURE = 12.0
"""Pressure over the shear modulus up to which the stated errors hold for presses on a sensor's own twin: more of it, which wide
contacts have, changes the gel's thickness too little."""


@dataclass
class TractionForce(ForceEstimator):
    """Estimates pressure and shear maps, and the wrench that they add up to; starts each inversion from the last result."""

    observation_model: ObservationModel
    gel: Gel
    """The gel, with the thickness that the calibration found; its shear modulus scales all forces."""
    prior: TractionPrior = TractionPrior()
    contact_region: ContactRegionSettings = ContactRegionSettings()
    solver: SolverSettings = SolverSettings()
    uncertainty: UncertaintyModel = UncertaintyModel()
    name: str = "force by physics"
    calibration_checksum: str = ""
    last: InversionResult | None = field(default=None, init=False, repr=False)
    _inversions: dict[CellGrid, TractionInversion] = field(default_factory=dict, init=False, repr=False)
    """The inversion for each image size."""

    def estimate(self, reading: Reading) -> WrenchEstimate:
        """Return the wrench about the skin's centre; raises `ForceEstimationError` for a reading that cannot be used, and
        `InputError` for one of another sensor."""
        self.require_own_reading(reading)
        if reading.image_warnings:
            self.forget()
            return unknown_wrench_estimate(reading.stamp_ns, reading.image_warnings)
        with _on_one_blas_thread():  # small matrices are slower on several threads
            return self._invert(reading)

    def forget(self) -> None:
        """Start the next inversion from its own image."""
        self.last = None

    def _invert(self, reading: Reading) -> WrenchEstimate:
        """Observe, find the contact region, invert and sum up."""
        inversion = self._inversion_for(reading.height)
        observation = self.observation_model.observe(reading, inversion.forward.cells)
        region = self._find_region(reading, observation)
        result = None if region is None else inversion.invert(observation, region, self.last)
        if result is None or not result.tractions[0].any():  # no pressure makes skin so dark and bright
            self.forget()
            return WrenchEstimate(
                zero_wrench(reading.frame.stamp_ns), diagonal_covariance(NO_CONTACT_STD), touching=False
            )
        self.last = result
        return self._to_estimate(reading, observation, result)

    def _find_region(self, reading: Reading, observation: ObservationOnCells) -> Float32[Array, "rows cols"] | None:
        """Return where pressure may act, None where nothing touches."""
        threshold = self.contact_region.threshold
        # The noise of a stream was learnt on the cells of the detection; compression makes more of it on smaller ones.
        if reading.stream.learnt_s >= threshold.learnt_after_s and not detect_contact(reading, threshold):
            return None
        return find_contact_region(
            observation.change,
            observation.z_mm,
            observation.in_view,
            observation.noise,
            MARGIN_CELLS,
            self.contact_region,
            correlated_noise_limit(reading, threshold),
            find_faint_contact(reading, threshold),
        )

    def _to_estimate(
        self, reading: Reading, observation: ObservationOnCells, result: InversionResult
    ) -> WrenchEstimate:
        """Return the result in MPa, N and N·m, with its uncertainty and warnings."""
        mpa = self.gel.shear_modulus_mpa
        rows, cols = observation.z_mm.shape
        skin_mm = result.skin.height_mm[:rows, :cols].copy()
        tractions = result.tractions * result.skin.stiffening[:rows, :cols] * np.float32(mpa)
        traction = Traction(
            tractions[0],
            tractions[1:],
            result.problem.kernels.forward.cells.pitch_mm,
            reading.frame.stamp_ns,
            skin_mm,
            self.gel,
        )
        wrench = traction.wrench()
        stiffening = (
            float(tractions[0].sum() / max(mpa * result.tractions[0].sum(), 1e-12)) if self.gel.finite_strain else 1.0
        )
        covariance = self.uncertainty.wrench_covariance(result, wrench.six, mpa, stiffening)
        warnings = tuple(self._warnings(observation, result, traction))
        return WrenchEstimate(wrench, covariance, True, warnings, traction)

    def _warnings(
        self, observation: ObservationOnCells, result: InversionResult, traction: Traction
    ) -> list[EstimateWarning]:
        """Return the reasons for which the result may be wrong."""
        reasons = {
            EstimateWarning.OUT_OF_RANGE: self._is_out_of_range(result),
            EstimateWarning.PART_UNSEEN: pressure_reaches_unseen(traction.pressure_mpa, observation.in_view),
            EstimateWarning.NOT_CONVERGED: result.newton_decrement > self.solver.max_trusted_decrement,
        }
        return [warning for warning, holds in reasons.items() if holds]

    def _is_out_of_range(self, result: InversionResult) -> bool:
        """Return whether, anywhere in the contact, the gel is thinner than the depth curve knows, or thinner or under more pressure
        than the model of the gel holds."""
        pressure = result.tractions[0]
        rows, cols = pressure.shape
        is_too_thin = -result.skin.thickness_change_mm[:rows, :cols] > self.max_known_thinning_mm
        return bool((is_too_thin & (pressure > 0)).any() or pressure.max() > LARGEST_PRESSURE)

    @property
    def max_known_thinning_mm(self) -> float:
        """Thinning of the gel up to which both the depth curve and the model of the gel hold."""
        return min(-self.observation_model.law.deepest_known_mm, MODELLED_THINNING * self.gel.thickness_mm)

    def _inversion_for(self, height: HeightMap) -> TractionInversion:
        """Return the inversion for images of this size, built at the first of them."""
        cells = cell_grid_over_image(height.z_mm.shape, height.mm_per_px, self.gel.thickness_mm)
        if cells not in self._inversions:
            self.forget()
            self._inversions[cells] = self.build_inversion(cells)
        return self._inversions[cells]

    def build_inversion(self, cells: CellGrid) -> TractionInversion:
        """Return the inversion on these cells."""
        model = self.observation_model
        forward = ForwardModel(cells, self.gel, model.point_spread_mm)
        return TractionInversion(forward, model.law, self.prior, self.solver)


def build_traction_force(calibrated: CalibratedShape, gel: Gel | None) -> TractionForce:
    """Return the estimator of a calibrated sensor; raises `ForceEstimationError` without a gel or a light calibration."""
    if gel is None:
        raise ForceEstimationError(
            expected="the gel's thickness and shear modulus",
            got="no gel",
            remedy="give SensorDesign().gel, or the gel of the sensor's twin",
        )
    model = build_brightness_observation_model(calibrated)
    return TractionForce(model, gel, calibration_checksum=calibrated.calibration_checksum)


_blas_lock, _blas_users = Lock(), list[Any]()
"""The limit that is in force, once for each thread that estimates at present."""


@contextmanager
def _on_one_blas_thread() -> Iterator[None]:
    """Run BLAS on one thread in the block. The number belongs to the process: the last of several users restores it."""
    with _blas_lock:
        _blas_users.append(_blas_users[0] if _blas_users else _blas_controller().limit(limits=1, user_api="blas"))
    try:
        yield
    finally:
        with _blas_lock:
            limit = _blas_users.pop()
            if not _blas_users:
                limit.restore_original_limits()


@cache
def _blas_controller() -> "ThreadpoolController":
    """Return the controller of the BLAS threads, cached because the search for the libraries takes longer than an estimate."""
    import scipy.linalg  # noqa: F401  (SciPy has a BLAS of its own, which is found only once it is loaded)
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()
