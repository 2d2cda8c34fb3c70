"""The sensor thread: reads as fast as images come and keeps the newest; whoever looks never holds it up."""

from dataclasses import dataclass
from enum import Enum
from threading import Event, Lock, Thread
from types import TracebackType

from jaxtyping import Float64
from numpy import ndarray as Array

from ninedtact.capture.frame_source import SourceEnded
from ninedtact.capture.latest_frame import NoRecentFrame
from ninedtact.errors import NinedtactError
from ninedtact.reading import Reading
from ninedtact.sensor import Sensor
from ninedtact.shape.calibrated import ReferenceUnusable
from ninedtact.shape.measures import max_indentation_mm
from ninedtact.studio.history import History, Rate


class RecordingTooShort(NinedtactError):
    """A recording ended before the untouched skin was known."""


class Phase(Enum):
    """What the sensor thread is at."""

    REFERENCE = "taking the untouched skin"
    READING = "reading"
    ENDED = "at the end of a recording"
    FAILED = "given up"


@dataclass(frozen=True)
class Moment:
    """What the sensor thread knows at one moment."""

    phase: Phase
    reading: Reading | None
    """The newest; None before the first."""
    heard_ns: int
    """Stamp of the newest reading; while a reference is taken, of the newest image; before any, of the opening."""
    delivered_hz: float
    """Images per second that the source delivered, read or not."""
    read_hz: float
    history: Float64[Array, "2 n"]
    """Seconds before now (before the end of a recording that has ended), and the deepest indentation in mm then."""
    trouble: BaseException | None = None
    """Why the sensor thread has given up, or refused the untouched skin."""


class SensorLoop:
    """Reads a sensor in a thread of its own while it is open (`with`); its source should be a `Freshest`.

    Without a depth reader in the sensor, the first images are the untouched skin.
    """

    def __init__(self, sensor: Sensor) -> None:
        self.sensor = sensor
        self._phase = Phase.READING
        self._trouble: BaseException | None = None
        self._reading: Reading | None = None
        self._history, self._delivered, self._read = History(), Rate(), Rate()
        self._lock = Lock()
        self._closing, self._reference_wanted = Event(), Event()
        self._thread = Thread(target=self._run, name=f"read {sensor.source.name}", daemon=True)

    def moment(self, now_ns: int) -> Moment:
        """The newest of everything; never waits for the sensor."""
        with self._lock:
            until_ns = self._heard_ns if self._phase is Phase.ENDED else now_ns
            return Moment(
                self._phase,
                self._reading,
                self._heard_ns,
                self._delivered.hz(now_ns),
                self._read.hz(now_ns),
                self._history.until(until_ns),
                self._trouble,
            )

    def take_reference(self) -> None:
        """Take the skin of the next images for untouched. Returns at once; it is tried until it succeeds."""
        self._reference_wanted.set()

    def __enter__(self) -> "SensorLoop":
        """Open the sensor, raising what its source raises, and start reading."""
        self.sensor.open(take_reference=False)
        if self.sensor.depth_reader is None:
            self.take_reference()
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._closing.set()
        self.sensor.close()
        self._thread.join()

    @property
    def _heard_ns(self) -> int:
        # An image that has come but is not yet a reading must not make the reading before it look new.
        if self._reading is None or self._phase is Phase.REFERENCE:
            return self.sensor.last_frame_ns
        return self._reading.frame.stamp_ns

    def _run(self) -> None:
        try:
            while not self._closing.is_set():
                self._step()
        except SourceEnded as end:
            self._note(*self._after(end))
        except BaseException as trouble:  # whoever asks for a moment is who can tell a person
            if not self._closing.is_set():
                self._note(Phase.FAILED, trouble)

    def _step(self) -> None:
        try:
            if self._reference_wanted.is_set():
                self._take_reference()
            self._keep(self.sensor.read())
        except NoRecentFrame:
            pass  # `heard_ns` says since when
        except ReferenceUnusable as refusal:
            self._note(Phase.REFERENCE, refusal)

    def _take_reference(self) -> None:
        self._note(Phase.REFERENCE, self._trouble)
        self.sensor.take_reference()
        self._reference_wanted.clear()

    def _keep(self, reading: Reading) -> None:
        deepest_mm, arrived_ns = max_indentation_mm(reading.height), reading.frame.stamp_ns
        with self._lock:
            self._phase, self._trouble, self._reading = Phase.READING, None, reading
            self._delivered.tick(arrived_ns, reading.frame.index)
            self._read.tick(arrived_ns, self.sensor.frames_read)
            self._history.add(arrived_ns, deepest_mm)

    def _after(self, end: SourceEnded) -> tuple[Phase, BaseException | None]:
        if self._reading is not None:
            return Phase.ENDED, None
        source, wanted = self.sensor.source.name, self.sensor.reference_frames
        return Phase.FAILED, RecordingTooShort(
            f"expected {source} to begin with {wanted} images of the untouched skin and go on, got "
            f"{self.sensor.frames_read} images in all; give images of the untouched skin with --reference"
        )

    def _note(self, phase: Phase, trouble: BaseException | None) -> None:
        with self._lock:
            self._phase, self._trouble = phase, trouble
