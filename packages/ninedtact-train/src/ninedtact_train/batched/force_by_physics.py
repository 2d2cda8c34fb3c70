"""Many images of one calibrated sensor at once → their wrenches by physics, with errors, as torch tensors on the images' device.

Each wrench is what the sensor's own estimator (`TractionForce`) computes from that image alone, to 1e-3 of the load, so that a
policy is trained on what the real sensor will estimate. Images that cannot be a press on this sensor are not recognised here.
"""

from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Bool, Float64, UInt8

from ninedtact.errors import InputError
from ninedtact.force.contact_detection import FAINT_PRESSURE
from ninedtact.force.estimator_and_scale import SHEAR_COMPONENTS, ForceEstimator, ScaledForceEstimator
from ninedtact.force.hidden_twist import hidden_torque_share
from ninedtact.force.traction.estimator import LARGEST_PRESSURE, NO_CONTACT_STD, TractionForce
from ninedtact.force.traction.observation import BrightnessObservationModel, cell_grid_over_image
from ninedtact_train.batched.contact_cells import BatchedObservation, BatchedObserver, widened
from ninedtact_train.batched.depth_reading import BatchedDepthReader, Fields
from ninedtact_train.batched.traction_inversion import BatchedInversionResult, BatchedTractionInversion

Sixes = Float64[torch.Tensor, "batch 6"]

_IMAGES_AT_ONCE = 512
"""Images that are estimated together: enough to fill a GPU, and few enough for its memory."""


@dataclass(frozen=True)
class BatchedEstimates:
    """Heights and wrenches of many images."""

    heights_mm: Fields
    """Signed heights on the rectified grid."""
    wrenches: Sixes
    """Force in N and torque in N·m about the skin's centre; exactly zero where nothing touches."""
    covariance: Float64[torch.Tensor, "batch 6 6"]
    touching: Bool[torch.Tensor, " batch"]
    doubtful: Bool[torch.Tensor, " batch"]
    """Whether the sensor would give the estimate with a warning: out of range, partly unseen or not converged."""

    @property
    def std(self) -> Sixes:
        """One standard deviation of each component of the wrenches."""
        return self.covariance.diagonal(0, 1, 2).sqrt()


@dataclass(frozen=True)
class BatchedPhysics:
    """Estimates force by physics against one reference image.

    >>> reader = BatchedDepthReader(folder.shape.rectify, folder.shape.depth_reader(reference), "cuda")
    >>> physics = BatchedPhysics(reader, folder.estimator("physics"))
    >>> physics(batch.images(press)).wrenches.shape
    torch.Size([1024, 6])
    """

    reader: BatchedDepthReader
    estimator: ForceEstimator
    """The estimator by physics of a calibrated sensor; any other raises `InputError`."""
    gpu_schedule: bool | None = None
    """As in `BatchedTractionInversion`. None: true where the device is a GPU."""

    def __post_init__(self) -> None:
        scaled = self.estimator
        if not isinstance(scaled, ScaledForceEstimator) or not isinstance(scaled.estimator, TractionForce):
            raise InputError(
                expected="the estimator by physics of a calibrated sensor",
                got=f"{self.estimator.name!r}",
                remedy="give folder.estimator('physics')",
            )

    def __call__(self, images: UInt8[torch.Tensor, "batch raw_rows raw_cols"]) -> BatchedEstimates:
        """Return the estimates of grey images; raises `InputError` as `BatchedDepthReader.require_own` does."""
        self.reader.require_own(images)
        parts = [self._estimate(part) for part in torch.split(images, _IMAGES_AT_ONCE)]
        names = [field.name for field in fields(BatchedEstimates)]
        return BatchedEstimates(*(torch.cat([getattr(part, name) for part in parts]) for name in names))

    def _estimate(self, images: UInt8[torch.Tensor, "batch raw_rows raw_cols"]) -> BatchedEstimates:
        grey = self.reader.rectified(images)
        heights_mm = self.reader.heights_mm(grey)
        observation = self._observer(grey, heights_mm)
        result = self._inversion.invert(observation)
        pressed = result.tractions[:, 0].flatten(1).any(1)
        six, covariance = self._wrenches(result)
        no_contact = torch.as_tensor(np.diag(NO_CONTACT_STD**2), device=six.device)
        covariance = torch.where(pressed[:, None, None], covariance, no_contact)
        return BatchedEstimates(
            heights_mm, *self._scaled(six, covariance), pressed, pressed & self._doubtful(observation, result)
        )

    def _wrenches(self, result: BatchedInversionResult) -> tuple[Sixes, Float64[torch.Tensor, "batch 6 6"]]:
        """Return the wrenches in N and N·m about the skin's centre (`Traction.wrench`), and their covariance."""
        cells, mpa = self._inversion.inversion.forward.cells, self._physics.gel.shear_modulus_mpa
        tractions = (result.tractions * result.stiffening[:, None] * mpa).double()
        pressure, along_x, along_y = (tractions * cells.pitch_mm**2).unbind(1)
        x, y, z = *self._coordinates_mm, result.height_mm
        wrench_per_cell = (
            along_x,
            along_y,
            -pressure,
            (-pressure * y - along_y * z) / 1e3,
            (along_x * z + pressure * x) / 1e3,
            (along_y * x - along_x * y) / 1e3,
        )
        six = torch.stack([part.sum((1, 2)) for part in wrench_per_cell], 1)
        linear = mpa * result.tractions[:, 0].sum((1, 2)).double()
        stiffening = pressure.sum((1, 2)) / cells.pitch_mm**2 / linear.clamp(min=1e-12)
        if not self._physics.gel.finite_strain:
            stiffening = torch.ones_like(stiffening)
        return six, self._covariance(result, six, stiffening.clamp(min=1))

    def _covariance(
        self, result: BatchedInversionResult, six: Sixes, stiffening: Float64[torch.Tensor, " batch"]
    ) -> Float64[torch.Tensor, "batch 6 6"]:
        """Return `UncertaintyModel.wrench_covariance` of each contact."""
        model, mpa, pressure = (
            self._physics.uncertainty,
            self._physics.gel.shear_modulus_mpa,
            result.tractions[:, 0].double(),
        )
        unresolved = model.unresolved_error(_count_peaks(pressure), self._inversion.inversion.forward).clamp(max=1)
        gyration_mm, roundness = self._extent(pressure)
        lever_nm = six[:, 2].abs() * gyration_mm / 1e3
        structure_nm = unresolved * model.torque_arm * lever_nm
        twist_nm = hidden_torque_share(roundness) * lever_nm
        zero = torch.zeros_like(lever_nm)
        torques = structure_nm**2, structure_nm**2, structure_nm**2 + twist_nm**2
        variances = model.relative_variance(unresolved, stiffening)[:, None] * six**2
        variances = variances + torch.stack([zero, zero, zero, *torques], 1)
        return result.covariance * (mpa * stiffening)[:, None, None] ** 2 + torch.diag_embed(variances)

    def _extent(self, pressure: Float64[torch.Tensor, "batch rows cols"]) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the radius of gyration and the roundness (`PressureRmsRadii`) of each contact."""
        share = pressure / pressure.sum((1, 2), keepdim=True).clamp(min=1e-30)
        x, y = (mm - (share * mm).sum((1, 2), keepdim=True) for mm in self._coordinates_mm)
        across = (share * x * y).sum((1, 2))
        along_x, along_y = (share * x * x).sum((1, 2)), (share * y * y).sum((1, 2))
        mean, half = (along_x + along_y) / 2, torch.hypot((along_x - along_y) / 2, across)
        short, long = (mean - half).clamp(min=0), mean + half
        return mean.sqrt(), short / long.clamp(min=1e-30)

    def _scaled(
        self, six: Sixes, covariance: Float64[torch.Tensor, "batch 6 6"]
    ) -> tuple[Sixes, Float64[torch.Tensor, "batch 6 6"]]:
        """Return the wrenches and their covariance, scaled by the sensor's `ForceScale`."""
        assert isinstance(self.estimator, ScaledForceEstimator)
        scale, device = self.estimator.adaptation, six.device
        sheared = torch.as_tensor(SHEAR_COMPONENTS, device=device)
        factors = scale.factor * torch.where(sheared, scale.shear_factor, 1.0).double()
        six, shear = factors * six, factors * six * sheared
        covariance = factors[:, None] * factors * covariance + scale.error**2 * six[:, :, None] * six[:, None]
        return six, covariance + scale.shear_error**2 * shear[:, :, None] * shear[:, None]

    def _doubtful(
        self, observation: BatchedObservation, result: BatchedInversionResult
    ) -> Bool[torch.Tensor, " batch"]:
        """Return which estimates are out of range, partly unseen or not converged."""
        pressure, physics = result.tractions[:, 0], self._physics
        too_thin = (-result.thickness_change_mm > physics.max_known_thinning_mm) & (pressure > 0)
        stiffened = pressure * result.stiffening
        faint = FAINT_PRESSURE * stiffened.amax((1, 2), keepdim=True)
        unseen = (stiffened > faint) & (widened(1 - observation.in_view) > 0)
        too_strong = pressure.amax((1, 2)) > LARGEST_PRESSURE
        not_converged = result.newton_decrement > physics.solver.max_trusted_decrement
        return (too_thin | unseen).flatten(1).any(1) | too_strong | not_converged

    @property
    def _physics(self) -> TractionForce:
        assert isinstance(self.estimator, ScaledForceEstimator) and isinstance(self.estimator.estimator, TractionForce)
        return self.estimator.estimator

    @property
    def _model(self) -> BrightnessObservationModel:
        assert isinstance(self._physics.observation_model, BrightnessObservationModel)
        return self._physics.observation_model

    @cached_property
    def _observer(self) -> BatchedObserver:
        cells = self._inversion.inversion.forward.cells
        return BatchedObserver(self.reader, self._model, cells, self._physics.contact_region)

    @cached_property
    def _inversion(self) -> BatchedTractionInversion:
        reference, physics = self.reader.reader.reference, self._physics
        cells = cell_grid_over_image(reference.grey.shape, reference.mm_per_px, physics.gel.thickness_mm)
        device = self.reader.device
        on_gpu = torch.device(device).type == "cuda" if self.gpu_schedule is None else self.gpu_schedule
        return BatchedTractionInversion(physics.build_inversion(cells), self._model.local_error, device, on_gpu)

    @cached_property
    def _coordinates_mm(self) -> tuple[torch.Tensor, torch.Tensor]:
        x, y = self._inversion.inversion.forward.cells.coordinates_mm
        return torch.as_tensor(x, device=self.reader.device), torch.as_tensor(y, device=self.reader.device)


def _count_peaks(pressure: Float64[torch.Tensor, "batch rows cols"]) -> Float64[torch.Tensor, " batch"]:
    """Return the number of Gaussian peaks of each pressure, as `UncertaintyModel` counts them."""
    square = pressure.square().sum((1, 2))
    differences = sum(pressure.diff(dim=axis).square().sum((1, 2)) for axis in (1, 2))
    total = pressure.sum((1, 2))
    return (total**2 * differences / (4 * torch.pi * square**2).clamp(min=1e-30)).clamp(min=1)
