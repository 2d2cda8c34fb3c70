"""The wrench by learning: a trained network as an estimator."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from math import sqrt

import numpy as np
from jaxtyping import Float32, Float64
from numpy import ndarray as Array

from ninedtact.design import Gel
from ninedtact.force.contact_detection import ContactTest, detect_contact
from ninedtact.force.estimator import ForceEstimator, zero_wrench
from ninedtact.force.model_file import ForceModel, ModelCard, WrenchPrediction
from ninedtact.force.network_input import NetworkInputBuilder, SensorFeatures
from ninedtact.force.out_of_distribution import is_out_of_distribution
from ninedtact.quantities import EstimateWarning, Wrench, WrenchEstimate
from ninedtact.reading import Reading

STD_PER_LAPLACE_SCALE = sqrt(2)
"""Of a Laplace distribution."""
BEYOND = 0.05
"""A wrench may exceed training's by this part of its range before it is doubted."""


@dataclass
class NetworkForce(ForceEstimator):
    """A force model on a sensor with this gel; one reading at a time, or many inputs at once."""

    model: ForceModel
    gel: Gel = field(default_factory=Gel)
    """Its modulus scales the wrench."""
    contact_test: ContactTest = detect_contact
    traits: SensorFeatures | None = None
    """Of the sensor, for networks that ask; usual ones where nothing but the gel is known."""

    def __post_init__(self) -> None:
        self.name = self.model.card.name
        self.input = NetworkInputBuilder(self.model.card.input, self.traits or SensorFeatures(self.gel.thickness_mm))
        self.error_untouched: Float64[Array, 6] | None = None

    def estimate(self, reading: Reading) -> WrenchEstimate:
        """The wrench of the object on the skin about the skin's centre, zero exactly where nothing touches."""
        if not self.contact_test(reading):
            return WrenchEstimate(zero_wrench(reading.frame.stamp_ns), self.error_of_nothing(reading), touching=False)
        seen = self.input(reading)
        found = self.estimate_many(seen[None])
        wrench = Wrench(found.wrench[0, :3], found.wrench[0, 3:], stamp_ns=reading.frame.stamp_ns)
        warnings = tuple(prediction_warnings(seen, found.wrench[0] / self.stiffer, self.model.card))
        return WrenchEstimate(wrench, STD_PER_LAPLACE_SCALE * found.scale[0], touching=True, warnings=warnings)

    def estimate_many(self, inputs: Float32[Array, "n channels rows cols"]) -> WrenchPrediction:
        """Without the gate: wrenches about the skin's centre, for this gel, and the scales of their Laplace distributions."""
        found = self.model(inputs)
        scaled = WrenchPrediction(found.wrench * self.stiffer, found.scale * self.stiffer)
        return move_prediction_to_skin_centre(scaled, self.model.card.about_mm)

    @property
    def stiffer(self) -> float:
        """This gel's modulus over that of the model's."""
        return self.gel.shear_modulus_mpa / self.model.card.modulus_mpa

    def error_of_nothing(self, reading: Reading) -> Float64[Array, "6"]:
        """What the network claims where nothing touches, asked once."""
        if self.error_untouched is None:
            flat = replace(reading.height, z_mm=np.zeros_like(reading.height.z_mm))
            rectified = reading.rectified if reading.reference is None else reading.reference
            seen = self.input(replace(reading, height=flat, rectified=rectified))
            self.error_untouched = STD_PER_LAPLACE_SCALE * self.estimate_many(seen[None]).scale[0]
        return self.error_untouched.copy()

    def forget(self) -> None:
        """Readings are answered one by one: nothing else was remembered."""
        self.error_untouched = None


def prediction_warnings(
    seen: Float32[Array, "channels rows cols"], wrench: Float64[Array, "6"], card: ModelCard
) -> Iterator[EstimateWarning]:
    """Whether training knew such wrenches and such images."""
    low, high = np.array(card.lowest), np.array(card.highest)
    margin = BEYOND * (high - low)
    if (wrench < low - margin).any() or (wrench > high + margin).any():
        yield EstimateWarning.OUT_OF_RANGE
    if is_out_of_distribution(seen, card.input.channels, card.likeness):
        yield EstimateWarning.UNLIKE_TRAINING


def move_prediction_to_skin_centre(found: WrenchPrediction, about_mm: tuple[float, float, float]) -> WrenchPrediction:
    """The same with torques about the skin's centre; the errors of forces add to theirs."""
    if not any(about_mm):
        return found
    arm_m = np.array(about_mm) / 1e3
    torque = found.wrench[:, 3:] + np.cross(arm_m, found.wrench[:, :3])
    # τ_x gains arm_y F_z − arm_z F_y, and so on round.
    by_force = np.abs(np.cross(np.eye(3), arm_m))
    with np.errstate(invalid="ignore"):  # where no scale is told it is infinite, and stays so
        scale = np.hypot(found.scale[:, 3:], np.sqrt(found.scale[:, :3] ** 2 @ by_force**2))
    return WrenchPrediction(
        np.concatenate([found.wrench[:, :3], torque], 1), np.concatenate([found.scale[:, :3], scale], 1)
    )
