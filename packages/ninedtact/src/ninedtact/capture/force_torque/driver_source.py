"""A force/torque sensor as a wrench source, and the `ForceTorqueDriver` interface that a device implements.

A background thread receives from the driver, so that every sample is stamped when it arrives. `DeviceClock` removes the
jitter of the transport from these stamps.
"""

import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from threading import Condition, Event, Lock, Thread

import numpy as np
from jaxtyping import Float64
from numpy import ndarray as Array

from ninedtact.capture.frame_source import SourceNotOpen
from ninedtact.capture.wrench_source import WrenchFaulty, WrenchSaturated, WrenchSensorLost, WrenchSource
from ninedtact.errors import DeviceError
from ninedtact.quantities import Wrench

RECEIVE_TIMEOUT_S = 0.1
"""Longest wait of `receive`, which also limits the wait when a source is closed."""
_BUFFERED_NS = 500_000_000
"""Age up to which samples are kept for a reader. A slower reader misses the oldest samples and never gets older ones."""
_CLOSE_TIMEOUT_S = 1.0
_CLOCK_RATE_TOLERANCE = 0.01
"""Largest error in the rate of a device clock that is still followed: a cheap ceramic resonator is within 0.5 %."""
_NS_PER_US = 1000


@dataclass(frozen=True)
class ForceTorqueSample:
    """One sample as the device delivered it."""

    six: Float64[Array, "6"]
    """F_x, F_y, F_z in N and T_x, T_y, T_z in N·m: the load on the tool side, in the frame of the device, about its origin."""
    stamp_ns: int
    """Time of arrival on the monotonic clock."""
    number: int | None = None
    """The number that the device gave the sample; None where it gives none."""
    is_saturated: bool = False
    """Whether the device reports a load beyond its range."""
    fault: str = ""
    """Why else the sample must not be used, as far as the device reports it, and what to do: words that follow "got"."""


class ForceTorqueDriver(ABC):
    """The connection to one device; used by one thread at a time."""

    name: str
    """The name of the device in messages: its address."""
    number_bits: int = 32
    """Width of `ForceTorqueSample.number`, which wraps to zero."""

    @abstractmethod
    def connect(self) -> None:
        """Open the device, or raise `DeviceError` or `MissingLibraryError` and leave nothing open."""

    @abstractmethod
    def receive(self) -> Sequence[ForceTorqueSample]:
        """Return what arrived since the last call, oldest first; waits `RECEIVE_TIMEOUT_S` at most.

        Raises `WrenchSensorLost`.
        """

    @abstractmethod
    def disconnect(self) -> None:
        """Release the device after use."""


def counter_step(before: int, after: int, bits: int) -> int:
    """Return the step from one value of a wrapping counter to another; negative for a step back by less than half its width."""
    forward = (after - before) % (1 << bits)
    return forward - (1 << bits) if forward >> (bits - 1) else forward


class DeviceClock:
    """Arrival times, spaced as the clock of the device spaces them.

    Operating systems and USB adapters deliver several samples at once (16 ms of them is common), and a thread may wake
    late; both make arrivals late, never early. So the offset between the two clocks is the smallest one that was observed
    recently. Stamps are never after the arrival, and increase.
    """

    def __init__(self, bits: int = 32) -> None:
        self._bits = bits
        self._last_us: int | None = None
        self._device_ns = self._offset_ns = self._last_stamp_ns = 0

    def stamp_ns(self, device_us: int, arrived_ns: int) -> int:
        """Return the arrival time that a sample with this device time would have had without delay, on the monotonic clock."""
        passed_ns = 0 if self._last_us is None else counter_step(self._last_us, device_us, self._bits) * _NS_PER_US
        self._device_ns += passed_ns
        late_ns = arrived_ns - self._device_ns
        restarted = self._last_us is None or passed_ns < 0
        drifted_ns = self._offset_ns + int(_CLOCK_RATE_TOLERANCE * passed_ns)
        self._offset_ns = late_ns if restarted else min(drifted_ns, late_ns)
        self._last_us = device_us
        self._last_stamp_ns = max(self._device_ns + self._offset_ns, self._last_stamp_ns + 1)
        return self._last_stamp_ns


class DriverWrenchSource(WrenchSource):
    """A force/torque device that is read sample by sample: the load on its tool side, in its own frame about its own origin.

    `read` raises `WrenchSampleRejected` for a sample that the device itself marks as bad, and continues with the next one when
    called again; it raises `WrenchSensorLost` after `silence_s` without any sample.
    """

    def __init__(self, driver: ForceTorqueDriver, silence_s: float = 1.0) -> None:
        self.name = driver.name
        self.dropped = 0
        """Samples that never arrived, by the count of the device, and those that nobody read in time."""
        self._driver, self._silence_s = driver, silence_s
        self._opening, self._changed = Lock(), Condition()
        self._waiting: deque[ForceTorqueSample] = deque()
        self._error: BaseException | None = None
        self._thread: Thread | None = None
        self._closing = Event()

    def open(self) -> None:
        """Connect and receive one sample; raises `DeviceError` or `MissingLibraryError`."""
        with self._opening:
            if self._thread is not None:
                return
            self._driver.connect()
            self._waiting.clear()
            self.dropped, self._error, self._closing = 0, None, Event()
            self._last_number: int | None = None
            self._thread = Thread(target=self._listen, args=(self._closing,), name=f"listen {self.name}", daemon=True)
            self._thread.start()
            try:
                with self._changed:
                    self._wait_for_sample()
            except WrenchSensorLost as silence:
                self._release()
                raise DeviceError(str(silence)) from silence
            except BaseException:
                self._release()
                raise

    def read(self) -> Wrench:
        """Return the next sample; raises `WrenchSampleRejected`, `WrenchSensorLost` or `SourceNotOpen`."""
        with self._changed:
            self._wait_for_sample()
            sample = self._waiting.popleft()
        if sample.is_saturated:
            raise WrenchSaturated(
                expected=f"a load that {self.name} can measure", got="its mark of saturation", remedy="press less"
            )
        if sample.fault:
            got, _, remedy = sample.fault.partition("; ")
            raise WrenchFaulty(
                expected=f"a usable sample from {self.name}", got=got, remedy=remedy or "check the device"
            )
        if not np.isfinite(sample.six).all():
            raise WrenchFaulty(
                expected=f"six numbers from {self.name}", got=f"{sample.six.tolist()}", remedy="check the device"
            )
        return Wrench(sample.six[:3].copy(), sample.six[3:].copy(), stamp_ns=sample.stamp_ns)

    def close(self) -> None:
        """Disconnect; a read that waits raises `SourceNotOpen`."""
        self._closing.set()
        with self._opening:
            self._release()

    def _release(self) -> None:
        thread, self._thread = self._thread, None
        self._closing.set()
        with self._changed:
            self._changed.notify_all()
        if thread is not None:
            thread.join(_CLOSE_TIMEOUT_S)
            self._driver.disconnect()

    def _wait_for_sample(self) -> None:
        """Return when a sample waits; `_changed` must be held."""
        give_up_at = time.monotonic() + self._silence_s
        while True:
            if self._thread is None or self._closing.is_set():
                raise SourceNotOpen(self.name)
            if self._waiting:
                return
            if self._error is not None:
                raise self._error.with_traceback(None)
            if time.monotonic() >= give_up_at:
                raise WrenchSensorLost(
                    expected=f"a sample from {self.name}",
                    got=f"none for {self._silence_s:g} s",
                    remedy="check its power and its cable",
                )
            self._changed.wait(give_up_at - time.monotonic())

    def _listen(self, closing: Event) -> None:
        try:
            while not closing.is_set():
                for sample in self._driver.receive():
                    self._store(sample)
        except BaseException as error:  # handed to the thread that reads
            with self._changed:
                self._error = error
                self._changed.notify_all()

    def _store(self, sample: ForceTorqueSample) -> None:
        with self._changed:
            if sample.number is not None and self._last_number is not None:
                # A step back is a device that began to count anew.
                self.dropped += max(counter_step(self._last_number, sample.number, self._driver.number_bits) - 1, 0)
            self._last_number = self._last_number if sample.number is None else sample.number
            self._waiting.append(sample)
            while sample.stamp_ns - self._waiting[0].stamp_ns > _BUFFERED_NS:
                self._waiting.popleft()
                self.dropped += 1
            self._changed.notify_all()
