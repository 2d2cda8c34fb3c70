"""Force by physics, corrected by a network that was trained on what physics lacks.

    reading ──physics──▶ tractions, wrench ──network──▶ correction of the wrench, and its error

The network receives heights, the tractions that physics found and the features of the sensor. Its correction counts fully where
its input is like the training's, fades at the margin of the training's ranges and vanishes beyond them: there the answer is that of
physics, with a wider error and a warning.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from numpy import ndarray as Array

from ninedtact.force.estimator_and_scale import ForceEstimator
from ninedtact.force.network_force import (
    STD_PER_LAPLACE_SCALE,
    is_wrench_beyond_training,
    move_prediction_to_skin_centre,
)
from ninedtact.force.network_input import NetworkInputBuilder, SensorFeatures
from ninedtact.force.onnx_model import ForceModel
from ninedtact.force.out_of_distribution import training_range_membership
from ninedtact.force.traction.estimator import TractionForce
from ninedtact.quantities import EstimateWarning, Wrench, WrenchEstimate
from ninedtact.reading import Reading

Six = Float64[Array, "6"]

_MAX_CORRECTION_STDS = 4.0
"""Largest correction, in standard deviations of physics."""
_UNCORRECTED_STD_FACTOR = 1.5
"""Factor on the standard deviation of physics where no correction is known."""


@dataclass
class NetworkCorrectedForce(ForceEstimator):
    """Physics and the network that corrects it, on one sensor; the tractions are those of physics."""

    physics: TractionForce
    model: ForceModel
    """A model with the channels `InputChannels.PHYSICS`."""
    features: SensorFeatures

    def __post_init__(self) -> None:
        self.name, self.model_sha256 = f"physics corrected by {self.model.card.name}", self.model.sha256
        self.input = NetworkInputBuilder(self.model.card.input, self.features)

    @property
    def notices(self) -> tuple[str, ...]:
        """The notices of physics and of the model's file."""
        return (*self.physics.notices, *self.model.notices)

    def estimate(self, reading: Reading) -> WrenchEstimate:
        """Return the corrected wrench about the skin's centre; exactly zero where nothing touches."""
        physics = self.physics.estimate(reading)
        if not physics.touching or physics.traction is None:
            return physics
        trust, correction, std = self._correction(reading, physics)
        return apply_network_correction(physics, correction, std, trust)

    def forget(self) -> None:
        """Forget the previous reading."""
        self.physics.forget()

    def _correction(self, reading: Reading, physics: WrenchEstimate) -> tuple[float, Six, Six]:
        """Return how far the network is to be trusted (0 to 1), its correction of the wrench about the skin's centre, and the
        standard deviation of this correction."""
        assert physics.traction is not None
        card, modulus_mpa = self.model.card, self.physics.gel.shear_modulus_mpa
        inputs = self.input.of_physics(reading.height, physics.traction, modulus_mpa)
        prediction = move_prediction_to_skin_centre(self.model(inputs[None]), card.about_mm)
        unit = modulus_mpa / card.modulus_mpa
        is_foreign = EstimateWarning.NOT_CONVERGED in physics.warnings or is_wrench_beyond_training(
            physics.wrench.six / unit, card
        )
        trust = 0.0 if is_foreign else training_range_membership(inputs, card.input.channels, card.input_ranges)
        return trust, prediction.wrench[0] * unit, STD_PER_LAPLACE_SCALE * prediction.scale[0] * unit


def apply_network_correction(
    physics: WrenchEstimate, correction: Six, correction_std: Six, trust: float
) -> WrenchEstimate:
    """Return the estimate of physics with a correction of this standard deviation.

    trust: one where the input is like the training's, zero where the answer is that of physics. The errors of the axes are
    correlated as those of physics are. Where a network states no error (infinite), that of physics stays.
    """
    corrected_std = np.where(np.isfinite(correction_std), correction_std, physics.std)
    limit = _MAX_CORRECTION_STDS * physics.std
    six = physics.wrench.six + trust * np.clip(correction, -limit, limit)
    variance = trust * corrected_std**2 + (1 - trust) * (_UNCORRECTED_STD_FACTOR * physics.std) ** 2
    factor = np.sqrt(variance) / np.maximum(physics.std, np.finfo(float).tiny)
    unlike = () if trust else (EstimateWarning.UNLIKE_TRAINING,)
    return WrenchEstimate(
        Wrench(six[:3], six[3:], physics.wrench.about_mm, physics.wrench.stamp_ns),
        physics.covariance * np.outer(factor, factor),
        touching=True,
        warnings=(*physics.warnings, *unlike),
        traction=physics.traction,
    )
