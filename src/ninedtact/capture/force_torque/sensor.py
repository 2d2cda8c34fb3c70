"""What a driver has to do for `ForceTorqueSensor`: hold the line to one device and pass on what comes.

A device's own clock and count: arrival stamps without the transport's jitter, and the numbers that never arrived.

A force/torque sensor: a thread listens on its line, so that every sample is stamped when it arrives.
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
from ninedtact.capture.wrench_source import (
    WrenchFaulty,
    WrenchSampleRejected,
    WrenchSensorLost,
    WrenchSensorNotFound,
    WrenchSource,
)
from ninedtact.quantities import Wrench

RECEIVE_TIMEOUT_S = 0.1
"""How long `receive` waits at most, so that closing never waits long."""


@dataclass(frozen=True)
class ForceTorqueSample:
    """One sample as the device gave it."""

    six: Float64[Array, "6"]
    """F_x, F_y, F_z in N and T_x, T_y, T_z in N·m: the load on the tool side, in the device's frame, about its origin."""
    stamp_ns: int
    """Arrival, monotonic clock."""
    number: int | None = None
    """The device's own count; None where it has none."""
    flaw: WrenchSampleRejected | None = None
    """Why the sample must not be used, as far as the device knows."""


class ForceTorqueDriver(ABC):
    """The line to one device; used by one thread at a time."""

    name: str
    """What to call the device in front of a person: its address."""
    number_bits: int = 32
    """Width of `Sample.number`, which begins again at zero."""

    @abstractmethod
    def connect(self) -> None:
        """Open, or raise `WrenchSensorNotFound` or `ForceTorqueLibraryMissing` and leave nothing open."""

    @abstractmethod
    def receive(self) -> Sequence[ForceTorqueSample]:
        """What arrived since the last call, oldest first; waits `RECEIVE_TIMEOUT_S` at most. Raises `WrenchSensorLost`."""

    @abstractmethod
    def disconnect(self) -> None:
        """Release the device."""


LEAK = 0.01
"""How far the device's clock may be off and still be followed: a cheap ceramic resonator is within 0.5 %."""
NS_PER_US = 1000


def counter_step(before: int, after: int, bits: int) -> int:
    """From one value of a counter that wraps to another; negative where it went back by less than half its width."""
    forward = (after - before) % (1 << bits)
    return forward - (1 << bits) if forward >> (bits - 1) else forward


class DeviceClock:
    """Arrival times, spaced as the device's clock spaces them.

    Operating systems and USB adapters deliver several samples at once (16 ms of them is common), and a thread may wake
    late; both make arrivals late, never early. So the offset between the two clocks is the least that was seen lately.
    Stamps are never after the arrival, and grow.
    """

    def __init__(self, bits: int = 32) -> None:
        self._bits = bits
        self._last_us: int | None = None
        self._device_ns = self._offset_ns = self._last_stamp_ns = 0

    def stamp_ns(self, device_us: int, arrived_ns: int) -> int:
        """When a sample with this device time would have arrived without delay, monotonic clock."""
        passed_ns = 0 if self._last_us is None else counter_step(self._last_us, device_us, self._bits) * NS_PER_US
        self._device_ns += passed_ns
        late_ns = arrived_ns - self._device_ns
        restarted = self._last_us is None or passed_ns < 0
        self._offset_ns = late_ns if restarted else min(self._offset_ns + int(LEAK * passed_ns), late_ns)
        self._last_us = device_us
        self._last_stamp_ns = max(self._device_ns + self._offset_ns, self._last_stamp_ns + 1)
        return self._last_stamp_ns


class SampleCounter:
    """Counts the numbers that a device gave to samples that never arrived."""

    def __init__(self, bits: int) -> None:
        self._bits = bits
        self._last: int | None = None

    def missed(self, number: int) -> int:
        """How many are missing between the last one and this; none when the device began to count anew."""
        passed = 1 if self._last is None else counter_step(self._last, number, self._bits)
        self._last = number
        return max(passed - 1, 0)


KEPT_NS = 500_000_000
"""A reader that is slower than this misses the oldest samples and is never given older ones."""
SAYS_GOODBYE_S = 1.0


class ForceTorqueSensor(WrenchSource):
    """A device, sample by sample: its load on the tool side, in its own frame about its own origin.

    `read` raises `WrenchUntrusted` for a sample that the device itself calls bad, and goes on with the next one when called
    again; `WrenchSensorLost` after `silence_s` without any.
    """

    def __init__(self, line: ForceTorqueDriver, silence_s: float = 1.0) -> None:
        self.name = line.name
        self.dropped = 0
        """Samples that never arrived, by the device's own count, and those that nobody read in time."""
        self._line, self._silence_s = line, silence_s
        self._opening, self._news = Lock(), Condition()
        self._waiting: deque[ForceTorqueSample] = deque()
        self._trouble: BaseException | None = None
        self._thread: Thread | None = None
        self._closing = Event()

    def open(self) -> None:
        """Connect and see one sample; raises `WrenchSensorNotFound` or `ForceTorqueLibraryMissing`."""
        with self._opening:
            if self._thread is not None:
                return
            self._line.connect()
            self._waiting.clear()
            self.dropped, self._trouble, self._closing = 0, None, Event()
            self._numbering = SampleCounter(self._line.number_bits)
            self._thread = Thread(target=self._listen, args=(self._closing,), name=f"listen {self.name}", daemon=True)
            self._thread.start()
            try:
                with self._news:
                    self._wait_for_news()
            except WrenchSensorLost as silence:
                self._release()
                raise WrenchSensorNotFound(str(silence)) from silence
            except BaseException:
                self._release()
                raise

    def read(self) -> Wrench:
        """The next sample; raises `WrenchUntrusted`, `WrenchSensorLost` or `SourceNotOpen`."""
        with self._news:
            self._wait_for_news()
            sample = self._waiting.popleft()
        if sample.flaw is not None:
            raise sample.flaw
        if not np.isfinite(sample.six).all():
            raise WrenchFaulty(f"expected six numbers from {self.name}, got {sample.six.tolist()}; check the device")
        return Wrench(sample.six[:3].copy(), sample.six[3:].copy(), stamp_ns=sample.stamp_ns)

    def close(self) -> None:
        """Hang up; a read that waits raises `SourceNotOpen`."""
        self._closing.set()
        with self._opening:
            self._release()

    def _release(self) -> None:
        thread, self._thread = self._thread, None
        self._closing.set()
        with self._news:
            self._news.notify_all()
        if thread is not None:
            thread.join(SAYS_GOODBYE_S)
            self._line.disconnect()

    def _wait_for_news(self) -> None:
        """Until there is a sample; `_news` is held."""
        give_up_at = time.monotonic() + self._silence_s
        while True:
            if self._thread is None or self._closing.is_set():
                raise SourceNotOpen(self.name)
            if self._waiting:
                return
            if self._trouble is not None:
                raise self._trouble.with_traceback(None)
            if time.monotonic() >= give_up_at:
                raise self._lost()
            self._news.wait(give_up_at - time.monotonic())

    def _lost(self) -> WrenchSensorLost:
        return WrenchSensorLost(
            f"expected a sample from {self.name}, got none for {self._silence_s:g} s; check its power and its cable"
        )

    def _listen(self, closing: Event) -> None:
        try:
            while not closing.is_set():
                for sample in self._line.receive():
                    self._take(sample)
        except BaseException as trouble:  # the reader's thread is where it can be handled
            with self._news:
                self._trouble = trouble
                self._news.notify_all()

    def _take(self, sample: ForceTorqueSample) -> None:
        with self._news:
            if sample.number is not None:
                self.dropped += self._numbering.missed(sample.number)
            self._waiting.append(sample)
            while sample.stamp_ns - self._waiting[0].stamp_ns > KEPT_NS:
                self._waiting.popleft()
                self.dropped += 1
            self._news.notify_all()
