"""A force/torque sensor: a thread listens on its line, so that every sample is stamped when it arrives."""

import time
from collections import deque
from threading import Condition, Event, Lock, Thread

import numpy as np

from ninedtact.capture.force_torque.device_clock import Numbering
from ninedtact.capture.force_torque.line import Line, Sample
from ninedtact.capture.force_torque.refusals import WrenchFaulty, WrenchSensorNotFound
from ninedtact.capture.source import SourceNotOpen
from ninedtact.capture.wrench_source import WrenchSensorLost, WrenchSource
from ninedtact.quantities import Wrench

KEPT_NS = 500_000_000
"""A reader that is slower than this misses the oldest samples and is never given older ones."""
SAYS_GOODBYE_S = 1.0


class ForceTorqueSensor(WrenchSource):
    """A device, sample by sample: its load on the tool side, in its own frame about its own origin.

    `read` raises `WrenchUntrusted` for a sample that the device itself calls bad, and goes on with the next one when called
    again; `WrenchSensorLost` after `silence_s` without any.
    """

    def __init__(self, line: Line, silence_s: float = 1.0) -> None:
        self.name = line.name
        self.dropped = 0
        """Samples that never arrived, by the device's own count, and those that nobody read in time."""
        self._line, self._silence_s = line, silence_s
        self._opening, self._news = Lock(), Condition()
        self._waiting: deque[Sample] = deque()
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
            self._numbering = Numbering(self._line.number_bits)
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

    def _take(self, sample: Sample) -> None:
        with self._news:
            if sample.number is not None:
                self.dropped += self._numbering.missed(sample.number)
            self._waiting.append(sample)
            while sample.stamp_ns - self._waiting[0].stamp_ns > KEPT_NS:
                self._waiting.popleft()
                self.dropped += 1
            self._news.notify_all()
