"""The interface of every force estimator: a reading goes in; a wrench, its standard deviation and warnings come out."""

from abc import ABC, abstractmethod

import numpy as np

from ninedtact.quantities import EstimateWarning, Wrench, WrenchEstimate
from ninedtact.reading import Reading


class ForceEstimator(ABC):
    """Estimates the wrench of readings. It may start from the previous reading to be quicker; `forget` makes it start anew."""

    name: str
    """The name that is displayed, and the key of the force scale in a sensor folder."""
    model_sha256: str = ""
    """SHA-256 of the file of its network, which tells two models of one name apart; empty for estimators without a network."""

    @property
    def notices(self) -> tuple[str, ...]:
        """Sentences that a person must know of every estimate."""
        return ()

    @abstractmethod
    def estimate(self, reading: Reading) -> WrenchEstimate:
        """Return the wrench of the object on the skin, torques about the skin's centre; exactly zero where nothing touches.

        For an image that cannot be a press on this sensor it is the `unknown_wrench_estimate` with the warnings of the reading.
        """

    def add_force(self, reading: Reading) -> Reading:
        """Return the reading with its wrench."""
        return reading.with_force(self.estimate(reading))

    @abstractmethod
    def forget(self) -> None:
        """Forget the previous reading, so that the next one is estimated independently of it."""


class NoForceEstimator(ForceEstimator):
    """The estimator of a sensor without one: its readings have no wrench, and its estimate is zero with an infinite standard
    deviation."""

    name = "no force"

    def add_force(self, reading: Reading) -> Reading:
        """Return the reading as it is."""
        return reading

    def estimate(self, reading: Reading) -> WrenchEstimate:
        """Return a wrench of zero with an infinite standard deviation."""
        return unknown_wrench_estimate(reading.frame.stamp_ns)

    def forget(self) -> None:
        """Do nothing: no reading is remembered."""


def unknown_wrench_estimate(stamp_ns: int, warnings: tuple[EstimateWarning, ...] = ()) -> WrenchEstimate:
    """Return the estimate where nothing is known: a wrench of zero with an infinite standard deviation."""
    return WrenchEstimate(zero_wrench(stamp_ns), np.diag(np.full(6, np.inf)), touching=False, warnings=warnings)


def zero_wrench(stamp_ns: int = 0) -> Wrench:
    """Return a wrench of exactly zero, that of no contact."""
    return Wrench(np.zeros(3), np.zeros(3), stamp_ns=stamp_ns)
