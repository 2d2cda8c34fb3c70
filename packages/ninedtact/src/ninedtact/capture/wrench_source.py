"""The `WrenchSource` interface of every force/torque sensor: it is opened, read and closed; its errors.

Like a camera, it stamps each sample on arrival (monotonic clock). A sample is the wrench that the object applies to the skin,
in the sensor frame; the wrappers of `force_torque.wrench_source_from_address` convert the axes and signs of a device.
"""

from abc import abstractmethod
from collections.abc import Iterator

from ninedtact.capture.frame_source import Openable, SourceWrapper
from ninedtact.errors import DeviceError
from ninedtact.quantities import Wrench


class WrenchSensorLost(DeviceError):
    """A force/torque sensor that had delivered samples stopped."""


class WrenchSampleRejected(DeviceError):
    """One sample that must not be used. The source stays open, and the next read continues with the next sample."""


class WrenchSaturated(WrenchSampleRejected):
    """The load is beyond what the device can measure."""


class WrenchFrozen(WrenchSampleRejected):
    """The device repeats one sample."""


class WrenchJumped(WrenchSampleRejected):
    """The reading changed faster than any load does."""


class WrenchFaulty(WrenchSampleRejected):
    """The device itself marks this sample as wrong, or it is not a number."""


class WrenchSource(Openable):
    """Anything that delivers wrenches."""

    @abstractmethod
    def read(self) -> Wrench:
        """Wait for the next sample and return it.

        Raises `WrenchSensorLost` when the device stops, `SourceEnded` after the last sample of a recording and
        `SourceNotOpen` when the source is not open.
        """

    def __iter__(self) -> Iterator[Wrench]:
        """Yield samples until the source raises."""
        while True:
            yield self.read()


class WrenchSourceWrapper(SourceWrapper[WrenchSource], WrenchSource):
    """A wrench source that changes or checks the samples of another."""
