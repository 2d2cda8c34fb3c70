"""One connection to each sensor: a thread reads it, and the cameras and the robot that name it take the newest reading."""

import os
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from threading import Condition, Lock, Thread

from lerobot.utils.errors import DeviceNotConnectedError

import ninedtact
from ninedtact.errors import NinedtactError
from ninedtact.tracking import ContactTracker, TrackedContacts

FIRST_READING_S = 10.0
"""Longest wait for the first reading after the reference image has been taken."""

_streams: "dict[tuple[str, str], SensorStream]" = {}
_streams_lock = Lock()


@dataclass(frozen=True)
class NumberedReading:
    """A reading with its place in the stream."""

    number: int
    reading: ninedtact.Reading
    arrived_s: float
    """Time of `time.monotonic` at which it was computed."""
    tracked: TrackedContacts | None = None
    """What touches, where some user of the stream asked for it."""


class SensorStream:
    """The newest reading of a sensor. It is opened for its first user and closed after its last."""

    def __init__(self, sensor_folder: str, source: str, fps: int | None) -> None:
        settings = replace(ninedtact.FIXED_EXPOSURE, rate_hz=None if fps is None else float(fps))
        self.folder = ninedtact.load_sensor(sensor_folder)
        self.sensor = ninedtact.open(self.folder, source, force="none", settings=settings)
        self.fps, self.force, self.users = fps, "none", 0
        self.tracker: ContactTracker | None = None
        """Follows what touches; None while no user asks for it."""
        self._latest: NumberedReading | None = None
        self._error: BaseException | None = None
        self._changed = Condition()
        self._closing = False
        self._thread = Thread(target=self._read_until_closed, name=f"ninedtact {sensor_folder}", daemon=True)

    def start(self) -> None:
        """Open the sensor, which takes the reference image, and begin to read."""
        self.sensor.open()
        self._thread.start()

    def use_force(self, force: str) -> None:
        """Estimate the wrench of every reading from now on; raises ValueError where another estimator runs."""
        if self.force not in ("none", force):
            raise ValueError(f"expected one estimator of force for a sensor, got {self.force} and {force}; name one")
        if self.force == "none":
            self.sensor.estimator, self.force = self.folder.estimator(force), force

    def close(self) -> None:
        """End the thread and close the sensor."""
        self._closing = True
        if self._thread.is_alive():
            self._thread.join(timeout=5.0)
        self.sensor.close()

    @property
    def latest(self) -> NumberedReading | None:
        """The newest reading; None before the first."""
        return self._latest

    @property
    def newest_number(self) -> int:
        """The number of the newest reading; −1 before the first."""
        return -1 if self._latest is None else self._latest.number

    def wait_for(self, accepts: Callable[[NumberedReading], bool], timeout_s: float) -> NumberedReading:
        """Return the newest reading once it is accepted.

        Raises `TimeoutError`, and `DeviceNotConnectedError` when the sensor is lost.
        """
        deadline_s = time.monotonic() + timeout_s
        with self._changed:
            while self._latest is None or not accepts(self._latest):
                if self._error is not None:
                    raise DeviceNotConnectedError(str(self._error)) from self._error
                if not self._changed.wait(max(deadline_s - time.monotonic(), 0.0)) and time.monotonic() >= deadline_s:
                    raise TimeoutError(
                        f"expected a reading of {self.sensor.source.name} within {timeout_s:g} s, got none"
                    )
            return self._latest

    def _read_until_closed(self) -> None:
        try:
            while not self._closing:
                reading = self.sensor.read()
                tracked = None if self.tracker is None else self.tracker.update(reading)
                reading = reading if tracked is None else tracked.reading
                with self._changed:
                    self._latest = NumberedReading(self.newest_number + 1, reading, time.monotonic(), tracked)
                    self._changed.notify_all()
        except Exception as error:  # whatever ends the thread is raised again where readings are waited for
            with self._changed:
                self._error = error
                self._changed.notify_all()


def connect_stream(
    sensor_folder: str, source: str, fps: int | None = None, force: str | None = None, tracking: bool = False
) -> SensorStream:
    """Return the stream of a sensor, opened where it is not; raises `ConnectionError` with ninedtact's sentence."""
    key = os.path.realpath(sensor_folder), source
    with _streams_lock:
        stream = _streams.get(key)
        if stream is not None and None not in (fps, stream.fps) and fps != stream.fps:
            raise ValueError(
                f"expected one fps for {source}, got {stream.fps} and {fps}; cameras of one sensor share it"
            )
        try:
            stream = stream or SensorStream(sensor_folder, source, fps)
            if force is not None:
                stream.use_force(force)
            if tracking and stream.tracker is None:
                stream.tracker = ContactTracker()
            if not stream.users:
                stream.start()
        except NinedtactError as error:
            raise ConnectionError(str(error)) from error
        stream.users += 1
        _streams[key] = stream
    return stream


def release_stream(stream: SensorStream) -> None:
    """Give a stream back, and close it after its last user."""
    with _streams_lock:
        stream.users -= 1
        if stream.users:
            return
        for key in [key for key, known in _streams.items() if known is stream]:
            del _streams[key]
    stream.close()
