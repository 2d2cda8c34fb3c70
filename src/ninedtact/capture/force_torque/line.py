"""What a driver has to do for `ForceTorqueSensor`: hold the line to one device and pass on what comes."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

from jaxtyping import Float64
from numpy import ndarray as Array

from ninedtact.capture.force_torque.refusals import WrenchUntrusted

LISTENED_S = 0.1
"""How long `receive` waits at most, so that closing never waits long."""


@dataclass(frozen=True)
class Sample:
    """One sample as the device gave it."""

    six: Float64[Array, "6"]
    """F_x, F_y, F_z in N and T_x, T_y, T_z in N·m: the load on the tool side, in the device's frame, about its origin."""
    stamp_ns: int
    """Arrival, monotonic clock."""
    number: int | None = None
    """The device's own count; None where it has none."""
    flaw: WrenchUntrusted | None = None
    """Why the sample must not be used, as far as the device knows."""


class Line(ABC):
    """The line to one device; used by one thread at a time."""

    name: str
    """What to call the device in front of a person: its address."""
    number_bits: int = 32
    """Width of `Sample.number`, which begins again at zero."""

    @abstractmethod
    def connect(self) -> None:
        """Open, or raise `WrenchSensorNotFound` or `ForceTorqueLibraryMissing` and leave nothing open."""

    @abstractmethod
    def receive(self) -> Sequence[Sample]:
        """What arrived since the last call, oldest first; waits `LISTENED_S` at most. Raises `WrenchSensorLost`."""

    @abstractmethod
    def disconnect(self) -> None:
        """Release the device."""
