"""The sensor thread of the live page: reads as fast as images arrive and keeps the newest reading; the page never delays it.

Its rates and its history of the indentation cover the last seconds, including readings that the page did not show.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from threading import Event, Lock, Thread

import numpy as np
from jaxtyping import Float64
from numpy import ndarray as Array

from ninedtact.capture.frame_pacing import LatestFrameSource, NoRecentFrame
from ninedtact.capture.frame_source import SourceEnded
from ninedtact.errors import CameraError
from ninedtact.reading import Reading
from ninedtact.sensor import Sensor
from ninedtact.shape.calibrated_shape import ReferenceUnusable
from ninedtact.shape.surface import max_indentation_mm

NS_PER_S = 1e9
HISTORY_S = 20.0
RATE_OVER_S = 2.0
"""Time over which rates are measured: long enough for a steady rate, short enough to show a camera that slows down."""


class RateMeter:
    """Measures the events per second over the last two seconds."""

    def __init__(self) -> None:
        self._ticks: deque[tuple[int, int]] = deque()
        """Time and number of each event; the number counts all events from the first."""

    def tick(self, at_ns: int, number: int) -> None:
        """Add an event, unless it has been added; numbers may skip events that were not seen."""
        if not self._ticks or number > self._ticks[-1][1]:
            self._ticks.append((at_ns, number))
        self._forget(at_ns)

    def hz(self, now_ns: int) -> float:
        """Return the rate, 0 with fewer than two recent events."""
        self._forget(now_ns)
        if len(self._ticks) < 2:
            return 0.0
        (first_ns, first), (last_ns, last) = self._ticks[0], self._ticks[-1]
        return (last - first) / max((last_ns - first_ns) / NS_PER_S, 1e-9)

    def _forget(self, now_ns: int) -> None:
        while self._ticks and now_ns - self._ticks[0][0] > RATE_OVER_S * NS_PER_S:
            self._ticks.popleft()


class SensorPhase(Enum):
    """The state of the sensor thread."""

    REFERENCE = "taking the reference"
    READING = "reading"
    ENDED = "at the end of a recording"
    FAILED = "failed"
    RECORDED = "a moment of a recording, which this viewer plays"


@dataclass(frozen=True)
class SensorSnapshot:
    """The state of the sensor thread at one moment."""

    phase: SensorPhase
    reading: Reading | None
    """The newest reading; None before the first."""
    heard_ns: int
    """Stamp of the newest reading; while a reference is taken, of the newest image; before any, of the opening."""
    delivered_hz: float
    """Images per second that the source delivered, read or not."""
    read_hz: float
    history: Float64[Array, "2 n"]
    """Seconds before now (before the end of a recording that has ended), and maximum indentations in mm."""
    trouble: BaseException | None = None
    """Why the sensor thread has failed, why it refused the reference images, or why no image arrives."""
    arrived_ns: int = 0
    """Stamp of the newest image that the source delivered, read or not; 0 before the first."""
    may_be_unplugged: bool = True
    """Whether the images come from a camera or a stream, and not from this computer: a simulation, a recording or a video."""

    @property
    def trouble_sentence(self) -> str:
        """Why there are no readings, and what to do; empty where there is no reason."""
        again = "; trying again" if isinstance(self.trouble, ReferenceUnusable) else ""
        return "" if self.trouble is None else f"{self.trouble}{again}"

    def phase_text(self, now_ns: int) -> str:
        """Return the phase in words, or for how long no images have arrived."""
        if isinstance(self.trouble, NoRecentFrame):
            return f"no images for {(now_ns - self.heard_ns) / NS_PER_S:.0f} s"
        return self.phase.value


class SensorPoller:
    """Reads a sensor in its own thread while it is open (`with`); its source should be a `LatestFrameSource`.

    If the sensor has no depth reader, its first images become the reference. `on_reading` is called in the sensor thread with
    every reading, also with those that the page does not show; a reading that it returns takes the place of this one.
    """

    def __init__(
        self,
        sensor: Sensor,
        on_reading: Callable[[Reading], Reading | None] = lambda reading: None,
    ) -> None:
        self.sensor, self._on_reading = sensor, on_reading
        self._phase = SensorPhase.READING
        self._trouble: BaseException | None = None
        self._reading: Reading | None = None
        self._history, self._delivered, self._read = np.zeros((2, 0)), RateMeter(), RateMeter()
        """history: stamps in ns and maximum indentations in mm of the readings of the last `HISTORY_S` seconds."""
        self._lock = Lock()
        self._closing, self._reference_wanted = Event(), Event()
        self.changed = Event()
        """Set with every reading and state; whoever waits for several sensors shares one between them."""
        self._thread = Thread(target=self._run, name=f"read {sensor.source.name}", daemon=True)

    def snapshot(self, now_ns: int) -> SensorSnapshot:
        """Return the newest state; never waits for the sensor."""
        source = self.sensor.source
        arrival = source.newest_frame if isinstance(source, LatestFrameSource) else None
        with self._lock:
            if arrival is not None:  # on a slow computer, readings are too rare to count by
                self._delivered.tick(arrival.stamp_ns, arrival.index)
            until_ns = self._heard_ns if self._phase is SensorPhase.ENDED else now_ns
            return SensorSnapshot(
                self._phase,
                self._reading,
                self._heard_ns,
                self._delivered.hz(now_ns),
                self._read.hz(now_ns),
                np.stack([(self._history[0] - until_ns) / NS_PER_S, self._history[1]]),
                self._trouble,
                0 if arrival is None else arrival.stamp_ns,
                source.is_live and not source.is_simulated,
            )

    def wait_for_change(self, timeout_s: float) -> None:
        """Wait for the next reading or state, or until the time is over; for one waiting thread."""
        self.changed.wait(timeout_s)
        self.changed.clear()

    def take_reference(self) -> None:
        """Make the next images the reference. Returns at once; the sensor thread retries until it succeeds."""
        self._reference_wanted.set()

    def __enter__(self) -> "SensorPoller":
        """Open the sensor, raising what its source raises, and start reading."""
        self.sensor.open(take_reference=False)
        if self.sensor.current_depth_reader is None:
            self.take_reference()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._closing.set()
        self.sensor.close()
        self._thread.join()

    @property
    def _heard_ns(self) -> int:
        # An image that has arrived but is not yet a reading must not make the previous reading look new.
        if self._reading is None or self._phase is SensorPhase.REFERENCE:
            return self.sensor.last_frame_ns
        return self._reading.frame.stamp_ns

    def _run(self) -> None:
        try:
            while not self._closing.is_set():
                self._step()
        except SourceEnded as end:
            self._note(*self._after(end))
        except BaseException as trouble:  # the page shows it
            if not self._closing.is_set():
                self._note(SensorPhase.FAILED, trouble)

    def _step(self) -> None:
        try:
            if self._reference_wanted.is_set():
                self._take_reference()
            self._keep(self.sensor.read())
        except NoRecentFrame as trouble:
            # `heard_ns` says since when, `arrived_ns` whether the computer is too slow.
            self._note(self._phase, trouble)
        except ReferenceUnusable as refusal:
            self._note(SensorPhase.REFERENCE, refusal)

    def _take_reference(self) -> None:
        self._note(SensorPhase.REFERENCE, self._trouble)
        self.sensor.take_reference()
        self._reference_wanted.clear()

    def _keep(self, reading: Reading) -> None:
        reading = self._on_reading(reading) or reading
        deepest_mm, arrived_ns = max_indentation_mm(reading.height), reading.frame.stamp_ns
        with self._lock:
            self._phase, self._trouble, self._reading = SensorPhase.READING, None, reading
            self._delivered.tick(arrived_ns, reading.frame.index)
            self._read.tick(arrived_ns, self.sensor.frames_read)
            recent = self._history[:, arrived_ns - self._history[0] <= HISTORY_S * NS_PER_S]
            self._history = np.column_stack([recent, (arrived_ns, deepest_mm)])
        self.changed.set()

    def _after(self, end: SourceEnded) -> tuple[SensorPhase, BaseException | None]:
        if self._reading is not None:
            return SensorPhase.ENDED, None
        source, wanted = self.sensor.source, self.sensor.reference_frames
        images = self.sensor.frames_read + (source.dropped if isinstance(source, LatestFrameSource) else 0)
        return SensorPhase.FAILED, CameraError(
            expected=f"{source.name} to begin with {wanted} reference images (no contact) and then to continue",
            got=f"{images} images in all",
            remedy="record longer, or give reference images, as with --reference of live",
        )

    def _note(self, phase: SensorPhase, trouble: BaseException | None) -> None:
        with self._lock:
            self._phase, self._trouble = phase, trouble
        self.changed.set()
