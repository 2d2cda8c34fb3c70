"""Fusion of network and physics: two wrench estimates from one image, combined on each axis by inverse variance.

Their errors differ: the network's come from how far the contact is from its training, the physics' from what its mechanics leave
out. The combination is better than either on most axes (docs/force.md).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from numpy import ndarray as Array

from ninedtact.force.estimator_interface import ForceEstimator, zero_wrench
from ninedtact.force.network_force import NetworkForce
from ninedtact.force.traction.estimator import NO_CONTACT_STD, TractionForce
from ninedtact.quantities import Wrench, WrenchEstimate
from ninedtact.reading import Reading

Six = Float64[Array, "6"]

_MIN_STD = 1e-12
"""Smallest standard deviation and weight, which keeps divisions finite."""


@dataclass
class FusedForceEstimator(ForceEstimator):
    """Both estimators on one sensor; the tractions are those of physics."""

    network: NetworkForce
    physics: TractionForce

    def __post_init__(self) -> None:
        self.name = f"{self.network.name} and physics"

    def estimate(self, reading: Reading) -> WrenchEstimate:
        """Return the inverse-variance mean, with the standard deviation of the more certain estimate on each axis.

        Averaging does not reduce the error that both estimates share, because they come from one image. Contact is detected once,
        for both; where the inversion then finds no region to act on, nothing touches either.
        """
        stamp_ns = reading.frame.stamp_ns
        if not self.network.contact_test(reading):
            self.physics.forget()
            std = np.minimum(self.network.no_contact_std(reading), NO_CONTACT_STD)
            return WrenchEstimate(zero_wrench(stamp_ns), std, touching=False)
        network, physics = self.network.estimate_contact(reading), self.physics.estimate(reading)
        std = np.minimum(network.std, physics.std)
        if not physics.touching:
            return WrenchEstimate(zero_wrench(stamp_ns), std, touching=False)
        six = inverse_variance_mean(network.wrench.six, network.std, physics.wrench.six, physics.std)
        warnings = tuple(dict.fromkeys((*network.warnings, *physics.warnings)))
        return WrenchEstimate(Wrench(six[:3], six[3:], stamp_ns=stamp_ns), std, True, warnings, physics.traction)

    def forget(self) -> None:
        """Forget the previous reading."""
        self.network.forget()
        self.physics.forget()


def inverse_variance_mean(first: Six, first_std: Six, second: Six, second_std: Six) -> Six:
    """Return the mean weighted by inverse variance, axis by axis; an infinite standard deviation leaves the other estimate
    alone."""
    first_weight, second_weight = (1 / np.maximum(std, _MIN_STD) ** 2 for std in (first_std, second_std))
    share = first_weight / np.maximum(first_weight + second_weight, _MIN_STD)
    return share * first + (1 - share) * second
