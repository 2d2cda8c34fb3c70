"""Network and physics together: two readings of one image, each axis weighed by how sure each of them is.

They err in different ways: the network by the likeness of its training, physics by what its mechanics leave out. What both say is
better than either on most axes (docs/force.md).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from numpy import ndarray as Array

from ninedtact.force.estimator import ForceEstimator, zero_wrench
from ninedtact.force.network_force import NetworkForce
from ninedtact.force.traction.estimator import TractionForce
from ninedtact.quantities import Wrench, WrenchEstimate
from ninedtact.reading import Reading

Six = Float64[Array, "6"]
LEAST = 1e-12
"""So that nothing is divided by zero."""


@dataclass
class FusedForceEstimator(ForceEstimator):
    """Both estimators on one sensor; tractions are those of physics."""

    network: NetworkForce
    physics: TractionForce

    def __post_init__(self) -> None:
        self.name = f"{self.network.name} and physics"

    def estimate(self, reading: Reading) -> WrenchEstimate:
        """Means by inverse variance, the error of the surer one: what both read wrong in an image, no mean takes away."""
        learnt, read = self.network.estimate(reading), self.physics.estimate(reading)
        if not (learnt.touching and read.touching):
            error = np.minimum(learnt.error, read.error)
            return WrenchEstimate(zero_wrench(reading.frame.stamp_ns), error, touching=False)
        six = inverse_variance_mean(learnt.wrench.six, learnt.error, read.wrench.six, read.error)
        wrench = Wrench(six[:3], six[3:], stamp_ns=reading.frame.stamp_ns)
        warnings = tuple(dict.fromkeys((*learnt.warnings, *read.warnings)))
        return WrenchEstimate(wrench, np.minimum(learnt.error, read.error), True, warnings, read.traction)

    def forget(self) -> None:
        """Begin anew."""
        self.network.forget()
        self.physics.forget()


def inverse_variance_mean(one: Six, its_error: Six, other: Six, others_error: Six) -> Six:
    """Weighed by inverse variance, axis by axis; an infinite error leaves the other estimate alone."""
    weight, others = (1 / np.maximum(error, LEAST) ** 2 for error in (its_error, others_error))
    share = weight / np.maximum(weight + others, LEAST)
    return share * one + (1 - share) * other
