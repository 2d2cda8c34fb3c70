"""Fusion of network and physics: two wrench estimates from one image, combined on each axis by inverse variance.

Their errors differ: the network's come from how far the contact is from its training, the physics' from what its mechanics leave
out. An estimate that carries a warning weighs less. Where the two differ by more than their errors allow, the stated error grows to
cover the difference (Birge 1932), and beyond three standard deviations there is a warning (docs/force.md).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from numpy import ndarray as Array

from ninedtact.force.estimator_interface import ForceEstimator, zero_wrench
from ninedtact.force.network_force import NetworkForce
from ninedtact.force.traction.estimator import NO_CONTACT_STD, TractionForce
from ninedtact.quantities import EstimateWarning, Wrench, WrenchEstimate, independent_errors
from ninedtact.reading import Reading

Six = Float64[Array, "6"]

_WARNED_STD_FACTOR = 3.0
"""Factor on the standard deviation of an estimate that carries a warning."""
_DISAGREEMENT = 3.0
"""Difference of the two estimates, in standard deviations of it, beyond which there is a warning."""
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
        """Return the inverse-variance mean; its error is never below that of the more certain estimate.

        Averaging does not reduce the error that both estimates share, because they come from one image. Contact is detected once,
        for both; where the inversion then finds no region to act on, nothing touches either.
        """
        stamp_ns = reading.frame.stamp_ns
        if not self.network.contact_test(reading):
            self.physics.forget()
            std = np.minimum(self.network.no_contact_std(reading), NO_CONTACT_STD)
            return WrenchEstimate(zero_wrench(stamp_ns), independent_errors(std), touching=False)
        network, physics = self.network.estimate_contact(reading), self.physics.estimate(reading)
        if not physics.touching:
            return WrenchEstimate(zero_wrench(stamp_ns), physics.covariance, touching=False)
        return fuse_estimates(network, physics)

    def forget(self) -> None:
        """Forget the previous reading."""
        self.network.forget()
        self.physics.forget()


def fuse_estimates(network: WrenchEstimate, physics: WrenchEstimate) -> WrenchEstimate:
    """Return both estimates of one contact combined axis by axis, with the warnings of both and the traction of physics."""
    stds = [_weighing_std(network), _weighing_std(physics)]
    six = inverse_variance_mean(network.wrench.six, stds[0], physics.wrench.six, stds[1])
    difference = np.abs(network.wrench.six - physics.wrench.six) / np.maximum(np.hypot(*stds), _MIN_STD)
    std = np.minimum(*stds) * np.maximum(difference, 1.0)
    disagreement = (EstimateWarning.ESTIMATORS_DISAGREE,) if (difference > _DISAGREEMENT).any() else ()
    warnings = tuple(dict.fromkeys((*network.warnings, *physics.warnings, *disagreement)))
    wrench = Wrench(six[:3], six[3:], stamp_ns=physics.wrench.stamp_ns)
    return WrenchEstimate(wrench, independent_errors(std), True, warnings, physics.traction)


def _weighing_std(estimate: WrenchEstimate) -> Six:
    """Return the standard deviation of an estimate, larger where it carries a warning."""
    return estimate.std * (_WARNED_STD_FACTOR if estimate.warnings else 1.0)


def inverse_variance_mean(first: Six, first_std: Six, second: Six, second_std: Six) -> Six:
    """Return the mean weighted by inverse variance, axis by axis; an infinite standard deviation leaves the other estimate
    alone."""
    first_weight, second_weight = (1 / np.maximum(std, _MIN_STD) ** 2 for std in (first_std, second_std))
    share = first_weight / np.maximum(first_weight + second_weight, _MIN_STD)
    return share * first + (1 - share) * second
