"""The course of a whole recording: indentation and path of the object, computed once for all viewers that play it.

Both are computed from the first image on, in a thread with a file of its own, beside the playing, and are there as far as that has
come. The thread ends when the last viewer has closed the recording.
"""

from collections.abc import Iterator
from pathlib import Path
from threading import Event, Lock, Thread

import cv2
import numpy as np
from jaxtyping import Float64
from numpy import ndarray as Array

from ninedtact.errors import NinedtactError
from ninedtact.live.sensor_poller import HISTORY_S, NS_PER_S
from ninedtact.reading import Reading
from ninedtact.shape.surface import max_indentation_mm
from ninedtact.studio.followed_object import FollowedObject, ObjectFollower
from ninedtact.studio.recorded_readings import RecordedReadings

CURVE_IMAGES = 600
"""Largest number of images of which the indentation is computed for the curve."""
FOLLOWED_IMAGES = 6000
"""Number of images from the first through which the object is followed at most: 100 s at 60 Hz."""
_NOT_FOLLOWED = FollowedObject()


class RecordedCourse:
    """Indentation and path of one sensor of a recording, as far as they have been computed. Safe from all threads."""

    def __init__(self, readings: RecordedReadings) -> None:
        """readings: opened anew by the thread; those given here are not read."""
        self.followed_until_ns = 0
        """Stamp of the last image into which the object has been followed."""
        self._readings, self.viewers, self._closing = readings, 1, Event()
        self._curve, self._followed = list[tuple[int, float]](), dict[int, FollowedObject]()
        name = f"measure {readings.recording.path.name}"
        self._thread = Thread(target=self._measure_and_follow, name=name, daemon=True)
        self._thread.start()

    def followed(self, stamp_ns: int) -> FollowedObject:
        """Return path, turn and slip of the object in the image of a stamp; nothing where they are not known yet."""
        return self._followed.get(stamp_ns, _NOT_FOLLOWED)

    def history_until(self, stamp_ns: int) -> Float64[Array, "2 n"]:
        """Return seconds before a stamp and indentations in mm, as far as they have been computed."""
        curve = np.array(tuple(self._curve), np.float64).reshape(-1, 2)
        seconds = (curve[:, 0] - stamp_ns) / NS_PER_S
        inside = (seconds <= 0) & (seconds > -HISTORY_S)
        return np.stack([seconds[inside], curve[inside, 1]])

    def close(self) -> None:
        """Leave the course to the other viewers, or end it."""
        with _COURSES_LOCK:
            self.viewers -= 1
            if self.viewers > 0:
                return
            _COURSES.pop(_key(self._readings), None)
        self._closing.set()
        self._thread.join()

    def _measure_and_follow(self) -> None:
        try:
            with self._readings.opened_anew() as readings:
                self._measure(readings)
                self._follow(readings)
        except (NinedtactError, OSError, cv2.error):
            return  # both end before the damage, which is described where the image itself is shown

    def _measure(self, readings: RecordedReadings) -> None:
        every = -(-len(readings) // CURVE_IMAGES)
        for reading in self._readings_until_closed(readings, range(0, len(readings), every)):
            self._curve.append((reading.stamp_ns, max_indentation_mm(reading.height)))

    def _follow(self, readings: RecordedReadings) -> None:
        follower = ObjectFollower(is_wanted=True)
        for reading in self._readings_until_closed(readings, range(min(len(readings), FOLLOWED_IMAGES))):
            follower.add(reading)
            self._followed[reading.stamp_ns] = follower.at(reading.stamp_ns)
            self.followed_until_ns = reading.stamp_ns

    def _readings_until_closed(self, readings: RecordedReadings, numbers: range) -> Iterator[Reading]:
        """Yield the readings of these numbers; none any more after `close`."""
        for number in numbers:
            if self._closing.is_set():
                return
            yield readings.reading(number)


_COURSES_LOCK, _COURSES = Lock(), dict[tuple[Path, int, int, int], RecordedCourse]()
"""The courses of all recordings that are open."""


def open_course(readings: RecordedReadings) -> RecordedCourse:
    """Return the course of a recording, which other viewers may have opened before; close it."""
    with _COURSES_LOCK:
        course = _COURSES.get(_key(readings))
        if course is None:
            course = _COURSES[_key(readings)] = RecordedCourse(readings)
        else:
            course.viewers += 1
        return course


def _key(readings: RecordedReadings) -> tuple[Path, int, int, int]:
    """Return what tells recordings apart, also one that replaced another of its name."""
    stamps_ns = readings.stamps_ns
    return readings.path, len(stamps_ns), int(stamps_ns[0]), int(stamps_ns[-1])
