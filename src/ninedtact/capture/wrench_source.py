"""What a force/torque sensor is to the rest of the package: opened, read sample by sample, and closed.

Like a camera it is stamped on arrival (monotonic clock). What it tells is the wrench that the object applies to the skin,
in the sensor frame: whoever wraps a device turns its signs and axes.
"""

from abc import abstractmethod
from collections.abc import Iterator

from ninedtact.capture.openable import Openable
from ninedtact.errors import NinedtactError
from ninedtact.quantities import Wrench


class WrenchSensorLost(NinedtactError):
    """A force/torque sensor that had delivered samples stopped."""


class WrenchSource(Openable):
    """Anything that delivers wrenches."""

    @abstractmethod
    def read(self) -> Wrench:
        """Wait for the next sample.

        Raises `WrenchSensorLost` when the device stops, `SourceEnded` after the last sample of a recording and
        `SourceNotOpen` when it is not open.
        """

    def __iter__(self) -> Iterator[Wrench]:
        """Yield samples for ever, or until the source raises."""
        while True:
            yield self.read()
