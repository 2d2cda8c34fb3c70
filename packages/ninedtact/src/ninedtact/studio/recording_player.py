"""A recording on the page: its readings one by one, and the player that makes one consistent moment of each.

    file ──RecordedReadings──▶ Reading ──RecordedSensor──▶ SensorMoment ──RecordingPlayer──▶ PageMoment ──▶ one ViewerPage

Each viewer has a player of its own, which keeps the time; a `RecordedSensor` is one sensor of the recording. Image, heights,
wrenches and curves of a moment are those of one stamp of the recording, which is "now" of the curves. Curve and path of the object
are those of the `RecordedCourse`, which all viewers share.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import reduce
from operator import or_
from pathlib import Path
from threading import RLock
from time import monotonic

import cv2
import numpy as np

from ninedtact.errors import InputError, NinedtactError
from ninedtact.live.sensor_poller import NS_PER_S, SensorPhase, SensorSnapshot
from ninedtact.live.wrench_history import WrenchHistory, WrenchSourceSnapshot, WrenchWithUncertainty
from ninedtact.quantities import WrenchEstimate
from ninedtact.recording.labels_and_whole_copy import edit_labelled_spans
from ninedtact.recording.topics_and_messages import (
    LabelledSpan,
)
from ninedtact.shape.calibrated_shape import CalibratedShape
from ninedtact.shape.coloured_height_map import ColourScale
from ninedtact.studio.followed_object import FollowedObject
from ninedtact.studio.page_controller import SILENT_AFTER_MS, PageMoment, SensorMoment, SensorStatusMessage
from ninedtact.studio.reading_view import ReadingView
from ninedtact.studio.recorded_course import open_course
from ninedtact.studio.recorded_readings import RecordedReadings

SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0)


class RecordedSensor:
    """One sensor of a recording that is played: its image at a time, with the wrenches and the curve of the indentation until then.

    Used by one thread at a time, that of its player.
    """

    def __init__(
        self, path: Path, shape: CalibratedShape, scale: ColourScale, sources: Sequence[WrenchHistory] = ()
    ) -> None:
        """path: of the recording, with several sensors `grasp.mcap#left`. sources: the columns of wrenches that the page has.
        Raises what `RecordedReadings` raises."""
        self.path, self.shape, self._scale = path, shape, scale
        self.readings = RecordedReadings(path, shape)
        forces = self.readings.recording.metadata.force_torque
        self._histories: list[WrenchHistory] = []
        for one in sources:
            meaning = "as recorded" if one.states_errors or not forces else f"as recorded: {forces}"
            said = self.readings.recording.metadata.estimate_notices if one.states_errors else ""
            notices = (said,) if said else ()
            history = WrenchHistory(one.name, meaning, notices, states_errors=one.states_errors, keeps_all=True)
            self.readings.fill(history)
            self._histories.append(history)
        self.trouble = ""
        """Why the image at the present time cannot be shown; empty where it can."""
        self._number = -1
        self._view: ReadingView | None = None
        self.course = open_course(self.readings)

    def seek(self, at_ns: int, repetition: int = 0) -> None:
        """Take the newest image at a stamp; where it is damaged, the last whole one stays and `trouble` says so.

        repetition: of several images with this stamp, how many are passed over.
        """
        stamps_ns = self.readings.stamps_ns
        first, end = (int(np.searchsorted(stamps_ns, at_ns, side=side)) for side in ("left", "right"))
        number = max(min(first + repetition, end - 1), 0)
        if number == self._number:
            return
        self._number, self.trouble = number, ""
        try:
            self._view = ReadingView(self.readings.reading(number), self._scale)
        except (NinedtactError, OSError, cv2.error) as trouble:
            self.trouble = str(trouble)

    def moment(self, at_ns: int, at_s: float, state: str, shown_hz: float) -> SensorMoment:
        """Return the image that `seek` took with what belongs to it. state: of the player, said in the status with the time."""
        reading = None if self._view is None else self._view.reading
        heard_ns, rate_hz = int(self.readings.stamps_ns[self._number]), self.readings.hz
        history = self.course.history_until(at_ns)
        snapshot = SensorSnapshot(SensorPhase.RECORDED, reading, heard_ns, rate_hz, rate_hz, history)
        wrenches = tuple(self._wrenches_at(at_ns, None if reading is None else reading.force))
        if self.trouble:
            status = SensorStatusMessage("lost", self.trouble)
        elif abs(at_ns - heard_ns) > SILENT_AFTER_MS * 1e6:
            status = SensorStatusMessage("lost", f"recorded, {at_s:.2f} s; this sensor has no image at this time")
        else:
            warnings = () if reading is None else (*reading.reference_warnings, *reading.image_warnings)
            light = () if reading is None else reading.light_sentences
            status = SensorStatusMessage("warned" if warnings else "held", "; ".join((state, *warnings, *light)))
        followed = FollowedObject() if reading is None else self.course.followed(reading.stamp_ns)
        name = self.readings.recording.metadata.name
        return SensorMoment(status, snapshot, self._view, wrenches, shown_hz, name, followed)

    def readings_within(self, span: LabelledSpan | None) -> tuple[RecordedReadings, range]:
        """Return the readings of this sensor anew, to be closed by whoever asks, and the numbers of those in a span, or of all."""
        readings = self.readings.opened_anew()
        begin_ns, end_ns = readings.stamps_ns[[0, -1]] if span is None else (span.begin_ns - 1000, span.end_ns + 1000)
        inside = np.flatnonzero((readings.stamps_ns >= begin_ns) & (readings.stamps_ns <= end_ns))
        return readings, range(int(inside[0]), int(inside[-1]) + 1) if len(inside) else range(0)

    def close(self) -> None:
        """Close the file; the sensor is not used afterwards."""
        self.course.close()
        self.readings.close()

    def _wrenches_at(self, stamp_ns: int, estimate: WrenchEstimate | None) -> Iterator[WrenchSourceSnapshot]:
        """Yield the wrenches of the recording in the columns of the page; the estimate is that of the image itself.

        Another wrench is the nearest one. One that is farther away than `SILENT_AFTER_MS` is not of this moment.
        """
        for history in self._histories:
            found = history.snapshot(stamp_ns, stamp_ns)
            if history.states_errors:
                sample = None if estimate is None else WrenchWithUncertainty.of_estimate(estimate)
            else:
                near = found.sample
                is_far = near is None or abs(near.wrench.stamp_ns - stamp_ns) > SILENT_AFTER_MS * 1e6
                sample = None if is_far else near
            yield replace(found, sample=sample)


class RecordingPlayer:
    """Plays one recording to one viewer: at any speed, one image forwards or backwards, from any time. Safe from all threads.

    Its time has the images of all sensors of the recording.
    """

    def __init__(self, sensors: Sequence[RecordedSensor]) -> None:
        """sensors: all of one recording; they are closed with the player."""
        self.sensors = tuple(sensors)
        self._recording = self.sensors[0].readings.recording
        self.path = self._recording.path
        counts = [Counter(one.readings.stamps_ns.tolist()) for one in self.sensors]
        most = reduce(or_, counts)  # of images with one stamp, those of the sensor that has most of them
        self._stamps_ns = np.array(sorted(most.elements()), np.int64)
        self._times_s = (self._stamps_ns - self._stamps_ns[0]) / NS_PER_S
        self.spans = self._recording.spans()
        """The labelled spans of the file, in the order of their beginnings, as of the last edit by this player."""
        self.number = 0
        """Number of the newest image that is shown, from 0."""
        self.speed, self._at_s = 1.0, 0.0
        self.is_playing = False
        """Whether time goes on."""
        self._lock, self._ticked_at = RLock(), monotonic()

    def __len__(self) -> int:
        return len(self._times_s)

    @property
    def duration_s(self) -> float:
        """Seconds from the first image to the last."""
        return float(self._times_s[-1])

    @property
    def at_s(self) -> float:
        """Time of the newest image that is shown, in seconds after the first."""
        return float(self._times_s[self.number])

    def toggle_play(self) -> None:
        """Let time go on, or stop it; at the end it begins again."""
        with self._lock:
            self._advance()
            self.is_playing = not self.is_playing
            if self.is_playing and self.number == len(self) - 1:
                self.number, self._at_s = 0, 0.0

    def seek(self, at_s: float) -> None:
        """Stop at the image nearest to a time, within the recording."""
        self._stop_at(int(np.abs(self._times_s - at_s).argmin()))

    def step(self, images: int) -> None:
        """Stop, and go so many images forwards or backwards."""
        with self._lock:
            self._stop_at(min(max(self.number + images, 0), len(self) - 1))

    def add_span(self, begin_s: float, end_s: float, label: str) -> None:
        """Label a span of time and keep it in the file; raises `InputError`, `FileNotWritten`, `RecordingUnreadable`."""
        if not label.strip() or not 0 <= begin_s <= end_s:
            raise InputError(
                expected="a label and an end after its beginning",
                got=f"'{label}' from {begin_s:.2f} to {end_s:.2f} s",
                remedy="name it and mark both ends",
            )
        first_ns = int(self._stamps_ns[0])
        begin_ns, end_ns = (first_ns + round(at_s * NS_PER_S) for at_s in (begin_s, end_s))
        added = LabelledSpan(begin_ns, end_ns, label.strip())
        self.spans = edit_labelled_spans(self.path, lambda spans: [*spans, added])

    def remove_span(self, span: LabelledSpan) -> None:
        """Remove a label from the file; raises what `add_span` raises."""
        self.spans = edit_labelled_spans(self.path, lambda spans: [one for one in spans if one != span])

    def span_s(self, span: LabelledSpan) -> tuple[float, float]:
        """Return beginning and end of a span in seconds after the first image."""
        first_ns = int(self._stamps_ns[0])
        return (span.begin_ns - first_ns) / NS_PER_S, (span.end_ns - first_ns) / NS_PER_S

    def moment(self, newest: PageMoment) -> PageMoment:
        """Return the moment at the present time; at a damaged image the time stops."""
        with self._lock:
            self._advance()
            at_ns, at_s = int(self._stamps_ns[self.number]), self.at_s
            repetition = self.number - int(np.searchsorted(self._stamps_ns, at_ns))
            for one in self.sensors:
                one.seek(at_ns, repetition)
            self.is_playing = self.is_playing and not any(one.trouble for one in self.sensors)
            state = f"playing at {self.speed:g} ×" if self.is_playing else "paused"
            state = f"recorded, {at_s:.2f} of {self.duration_s:.2f} s, {state}"
            shown_hz = newest.sensors[0].shown_hz
            return replace(newest, sensors=tuple(one.moment(at_ns, at_s, state, shown_hz) for one in self.sensors))

    def close(self) -> None:
        """Close the files; the player is not used afterwards."""
        with self._lock:
            for one in self.sensors:
                one.close()

    def _stop_at(self, number: int) -> None:
        with self._lock:
            self.is_playing, self.number, self._at_s = False, number, float(self._times_s[number])

    def _advance(self) -> None:
        now = monotonic()
        if self.is_playing:
            self._at_s = min(self._at_s + (now - self._ticked_at) * self.speed, self.duration_s)
            self.is_playing = self._at_s < self.duration_s
            self.number = max(self.number, int(np.searchsorted(self._times_s, self._at_s + 1e-6, side="right")) - 1)
        self._ticked_at = now
