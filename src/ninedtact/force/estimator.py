"""What an estimator of force is to the rest of the package: asked about one reading, it answers with a wrench and its error."""

from abc import ABC, abstractmethod

import numpy as np

from ninedtact.quantities import Wrench, WrenchEstimate
from ninedtact.reading import Reading


class ForceEstimator(ABC):
    """Reads the wrench out of a reading. It may remember the last ones to be quicker; `forget` makes it start anew."""

    name: str
    """What to call it in front of a person."""

    @abstractmethod
    def estimate(self, reading: Reading) -> WrenchEstimate:
        """The wrench of the object on the skin about the skin's centre, zero exactly where nothing touches."""

    @abstractmethod
    def forget(self) -> None:
        """The next reading does not follow on the last."""


class NoForce(ForceEstimator):
    """The estimator of a sensor without one: answers like the others, and knows nothing."""

    name = "no force"

    def estimate(self, reading: Reading) -> WrenchEstimate:
        """Zero, with an error without end: touched or not is all that it says."""
        return WrenchEstimate(zero_wrench(reading.frame.stamp_ns), np.full(6, np.inf), touching=False)

    def forget(self) -> None:
        """Nothing was remembered."""


def zero_wrench(stamp_ns: int = 0) -> Wrench:
    """The wrench of nothing, exactly zero."""
    return Wrench(np.zeros(3), np.zeros(3), stamp_ns=stamp_ns)
