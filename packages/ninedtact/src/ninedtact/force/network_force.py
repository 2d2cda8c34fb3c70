"""Force estimation with a trained network: a `ForceModel` as a `ForceEstimator`, with contact detection and warnings.

The network's wrench is scaled to the gel's shear modulus and moved to the skin's centre. Its Laplace scale becomes the standard
deviation; that of T_z contains at least the twist that no image shows (`hidden_twist`). Wrenches beyond the training's range, and
inputs unlike the training's, carry a warning.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from math import sqrt

import numpy as np
from jaxtyping import Float32, Float64
from numpy import ndarray as Array

from ninedtact.design import Gel
from ninedtact.errors import ForceEstimationError
from ninedtact.force.contact_detection import ContactTest, detect_contact
from ninedtact.force.estimator_and_scale import ForceEstimator, unknown_wrench_estimate, zero_wrench
from ninedtact.force.hidden_twist import hidden_torque_nm
from ninedtact.force.network_input import NetworkInputBuilder, SensorParameterInputs
from ninedtact.force.onnx_model import ForceModel, ModelCard, WrenchPrediction
from ninedtact.force.out_of_distribution import is_out_of_distribution
from ninedtact.quantities import EstimateWarning, Wrench, WrenchEstimate, diagonal_covariance
from ninedtact.reading import Reading

STD_PER_LAPLACE_SCALE = sqrt(2)
"""Standard deviation of a Laplace distribution over its scale."""

_RANGE_MARGIN = 0.05
"""Fraction of the training's range by which a wrench may exceed it without a warning."""


@dataclass
class NetworkForce(ForceEstimator):
    """A force model on a sensor with this gel. `SensorFolder.estimator` builds it.

    Raises `ForceEstimationError` where the model needs features of the sensor and none are given.
    """

    model: ForceModel
    gel: Gel = field(default_factory=Gel)
    """Its shear modulus scales the wrench."""
    contact_test: ContactTest = detect_contact
    features: SensorParameterInputs | None = None
    """Features of the sensor; models that need only the gel's thickness run without them."""
    calibration_checksum: str = ""

    def __post_init__(self) -> None:
        self.name, self.model_sha256 = self.model.card.name, self.model.sha256
        if self.features is None and self.model.card.input.channels.needs_sensor_features:
            raise ForceEstimationError(
                expected=f"the features of the sensor for the force model {self.name!r}, which was trained with them",
                got="none",
                remedy="use load_sensor(FOLDER).estimator(MODEL), or give features=sensor_features_of(shape, gel)",
            )
        self.input = NetworkInputBuilder(
            self.model.card.input, self.features or SensorParameterInputs(self.gel.thickness_mm)
        )
        self._no_contact_std: Float64[Array, 6] | None = None

    @property
    def notices(self) -> tuple[str, ...]:
        """The notices of the model's file."""
        return self.model.notices

    def estimate(self, reading: Reading) -> WrenchEstimate:
        """Return the wrench of the object on the skin, torques about the skin's centre; exactly zero where nothing touches."""
        self.require_own_reading(reading)
        if reading.image_warnings:
            return unknown_wrench_estimate(reading.stamp_ns, reading.image_warnings)
        if self.contact_test(reading):
            return self.estimate_contact(reading)
        return WrenchEstimate(
            zero_wrench(reading.frame.stamp_ns), diagonal_covariance(self.no_contact_std(reading)), touching=False
        )

    def estimate_contact(self, reading: Reading) -> WrenchEstimate:
        """Return the wrench of a reading in which contact is detected already."""
        inputs = self.input(reading)
        prediction = self.estimate_many(inputs[None])
        six = prediction.wrench[0]
        wrench = Wrench(six[:3], six[3:], stamp_ns=reading.frame.stamp_ns)
        warnings = tuple(prediction_warnings(inputs, six / self.relative_modulus, self.model.card))
        std = STD_PER_LAPLACE_SCALE * prediction.scale[0]
        std[5] = max(std[5], hidden_torque_nm(reading, six[2]))
        covariance = diagonal_covariance(std)
        return WrenchEstimate(wrench, covariance, touching=True, warnings=warnings)

    def estimate_many(self, inputs: Float32[Array, "n channels rows cols"]) -> WrenchPrediction:
        """Return wrenches about the skin's centre for this gel, and the scales of their Laplace distributions, without contact
        detection."""
        prediction = self.model(inputs)
        scaled = WrenchPrediction(prediction.wrench * self.relative_modulus, prediction.scale * self.relative_modulus)
        return move_prediction_to_skin_centre(scaled, self.model.card.about_mm)

    @property
    def relative_modulus(self) -> float:
        """The shear modulus of this gel over that of the model's."""
        return self.gel.shear_modulus_mpa / self.model.card.modulus_mpa

    def no_contact_std(self, reading: Reading) -> Float64[Array, "6"]:
        """Return the network's standard deviation where nothing touches, computed at the first call."""
        std = self._no_contact_std
        if std is None:
            flat = replace(reading.height, z_mm=np.zeros_like(reading.height.z_mm))
            inputs = self.input(replace(reading, height=flat, rectified=reading.reference))
            self._no_contact_std = std = STD_PER_LAPLACE_SCALE * self.estimate_many(inputs[None]).scale[0]
        return std.copy()

    def forget(self) -> None:
        """Forget the standard deviation without contact; readings are estimated one by one."""
        self._no_contact_std = None


def prediction_warnings(
    inputs: Float32[Array, "channels rows cols"], wrench: Float64[Array, "6"], card: ModelCard
) -> Iterator[EstimateWarning]:
    """Yield a warning where the wrench, or the input, is outside what the training covered."""
    if is_wrench_beyond_training(wrench, card):
        yield EstimateWarning.OUT_OF_RANGE
    if is_out_of_distribution(inputs, card.input.channels, card.input_ranges):
        yield EstimateWarning.UNLIKE_TRAINING


def is_wrench_beyond_training(wrench: Float64[Array, "6"], card: ModelCard) -> bool:
    """Return whether a wrench, for a gel of the model's modulus, lies outside the wrenches of the training and a margin."""
    low, high = np.array(card.wrench_min), np.array(card.wrench_max)
    margin = _RANGE_MARGIN * (high - low)
    return bool((wrench < low - margin).any() or (wrench > high + margin).any())


def move_prediction_to_skin_centre(
    prediction: WrenchPrediction, about_mm: tuple[float, float, float]
) -> WrenchPrediction:
    """Return predictions about a point with torques about the skin's centre; errors of the forces add to those of the torques."""
    if not any(about_mm):
        return prediction
    force_n, torque_nm = prediction.wrench[:, :3], prediction.wrench[:, 3:]
    arm_m = np.array(about_mm) / 1e3
    torque_nm = torque_nm + np.cross(arm_m, force_n)
    # τ_x gains arm_y F_z − arm_z F_y; the other axes follow cyclically.
    by_force = np.abs(np.cross(np.eye(3), arm_m))
    with np.errstate(invalid="ignore"):  # networks without scales have infinite ones, which stay infinite
        scale = np.hypot(prediction.scale[:, 3:], np.sqrt(prediction.scale[:, :3] ** 2 @ by_force**2))
    return WrenchPrediction(
        np.concatenate([force_n, torque_nm], 1), np.concatenate([prediction.scale[:, :3], scale], 1)
    )
