"""What a force/torque sensor is to the rest of the package: opened, read sample by sample, and closed.

Like a camera it is stamped on arrival (monotonic clock). What it tells is the wrench that the object applies to the skin,
in the sensor frame: whoever wraps a device turns its signs and axes.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from types import TracebackType
from typing import TypeVar

from ninedtact.errors import NinedtactError
from ninedtact.quantities import Wrench

Opened = TypeVar("Opened", bound="WrenchSource")


class WrenchSensorLost(NinedtactError):
    """A force/torque sensor that had delivered samples stopped."""


class WrenchSource(ABC):
    """Anything that delivers wrenches. The constructor touches no device; opening is all or nothing."""

    name: str
    """What to call it in front of a person."""

    @abstractmethod
    def open(self) -> None:
        """Open, or raise and leave nothing open. Opening an open source does nothing."""

    @abstractmethod
    def read(self) -> Wrench:
        """Wait for the next sample.

        Raises `WrenchSensorLost` when the device stops, `SourceEnded` after the last sample of a recording and
        `SourceNotOpen` when it is not open.
        """

    @abstractmethod
    def close(self) -> None:
        """Release the device. Any thread may call it, any number of times."""

    def __enter__(self: Opened) -> Opened:
        self.open()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def __iter__(self) -> Iterator[Wrench]:
        """Yield samples for ever, or until the source raises."""
        while True:
            yield self.read()
