"""What a force/torque sensor is to the rest of the package: opened, read sample by sample, and closed.

Like a camera it is stamped on arrival (monotonic clock). What it tells is the wrench that the object applies to the skin,
in the sensor frame: whoever wraps a device turns its signs and axes.

What goes wrong with a force/torque sensor, beside its loss (`WrenchSensorLost`).
"""

from abc import abstractmethod
from collections.abc import Iterator

from ninedtact.capture.frame_source import Openable
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


class WrenchSensorNotFound(NinedtactError):
    """No force/torque sensor could be opened there."""


class ForceTorqueLibraryMissing(NinedtactError):
    """The library that speaks with this device is not installed."""

    def __init__(self, name: str, package: str) -> None:
        super().__init__(
            f"expected {package} for {name}, got no such package; run pip install 'ninedtact[force-torque]'"
        )


class WrenchSampleRejected(NinedtactError):
    """One sample that must not be used. The source stays open, and the next read goes on with the next sample."""


class WrenchSaturated(WrenchSampleRejected):
    """The load is beyond what the device can measure."""


class WrenchFrozen(WrenchSampleRejected):
    """The device repeats one sample."""


class WrenchJumped(WrenchSampleRejected):
    """The reading leapt as no load does."""


class WrenchFaulty(WrenchSampleRejected):
    """The device itself says that this sample is wrong, or it is not a number."""
