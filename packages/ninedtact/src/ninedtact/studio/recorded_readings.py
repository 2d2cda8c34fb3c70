"""The readings of a recording one by one: its images, read again, with the heights and wrenches that it has.

Heights that are stored are shown as stored; the others are computed against the reference image that the recording has, or against
its first ten images.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Int64
from numpy import ndarray as Array

from ninedtact.live.wrench_history import UNKNOWN_STD, WrenchHistory, WrenchWithUncertainty
from ninedtact.reading import Reading, read_frame
from ninedtact.recording.errors import RecordingUnreadable
from ninedtact.recording.reader import RecordedReferences, Recording
from ninedtact.recording.summary import usual_rate_hz
from ninedtact.recording.topics_and_messages import Topic
from ninedtact.shape.calibrated_shape import CalibratedShape
from ninedtact.simulation.simulated_sources import TRUE_WRENCH_MEANING


class RecordedReadings:
    """Reads the readings of a recording by their number: computed again from the images, with the heights and estimates that are
    stored. One thread at a time; close it."""

    def __init__(self, path: Path, shape: CalibratedShape) -> None:
        """Open a recording; raises `RecordingUnreadable`, also where it has no image."""
        self.path, self.recording, self._shape = path, Recording(path), shape
        positions = self.recording.positions(Topic.IMAGES)
        self._images = positions[np.argsort(positions["stamp_ns"], kind="stable")]
        if len(self._images) == 0:
            self.recording.close()
            raise RecordingUnreadable(expected=f"images in {path}", got="none", remedy="take another recording")
        self.stamps_ns: Int64[Array, " n"] = np.asarray(self._images["stamp_ns"])
        self._references = RecordedReferences(self.recording, shape)

    def __len__(self) -> int:
        return len(self._images)

    def opened_anew(self) -> "RecordedReadings":
        """Return the same readings for another thread, which closes them."""
        return RecordedReadings(self.path, self._shape)

    @property
    def hz(self) -> float:
        """The usual rate of the images."""
        return usual_rate_hz(self.stamps_ns)

    def reading(self, number: int) -> Reading:
        """Return a reading; raises `RecordingUnreadable`, `FileFormatError`, `ReferenceUnusable`."""
        frame = self.recording.frame(self._images[number])
        reading = read_frame(frame, self._shape, self._references.held_or_first_at(frame.stamp_ns, 1))
        stored = self.recording.message_of_image(Topic.HEIGHTS, frame)
        if stored is not None:
            z_mm = self.recording.decode_heights(stored)
            self._require_size(z_mm.shape)
            computed = reading.height
            reading = replace(reading, height=replace(computed, z_mm=np.where(np.isnan(z_mm), computed.z_mm, z_mm)))
        estimated = self.recording.message_of_image(Topic.ESTIMATED, frame)
        return reading if estimated is None else reading.with_force(self.recording.estimate(estimated))

    def fill(self, history: WrenchHistory) -> None:
        """Add all wrenches of the recording that belong to a history of estimates, or of measured wrenches."""
        topic = Topic.ESTIMATED if history.states_errors else Topic.MEASURED
        positions = self.recording.positions(topic)
        for position in positions[np.argsort(positions["stamp_ns"], kind="stable")]:
            if history.states_errors:
                history.add_estimate(self.recording.estimate(self.recording.file.message(position)))
            else:
                history.add(WrenchWithUncertainty(self.recording.wrench(position), UNKNOWN_STD))

    def close(self) -> None:
        """Close the file."""
        self.recording.close()

    def __enter__(self) -> "RecordedReadings":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _require_size(self, size: tuple[int, ...]) -> None:
        wanted = self._shape.rectify.height_source.shape
        if size != wanted:
            raise RecordingUnreadable(
                expected=f"heights of {wanted[1]} x {wanted[0]} pixels in {self.recording.path}, as the sensor has",
                got=f"{size[1]} x {size[0]}",
                remedy="name the recorded sensor with --sensor, or leave it out",
            )


def empty_wrench_histories(path: Path, shape: CalibratedShape) -> list[WrenchHistory]:
    """Return an empty history for each source of wrenches in a recording; raises what `RecordedReadings` raises."""
    with RecordedReadings(path, shape) as readings:
        readings.reading(0)
        recording = readings.recording
        columns = []
        if len(recording.positions(Topic.MEASURED)):
            forces = recording.metadata.force_torque
            columns.append(WrenchHistory("true" if forces == TRUE_WRENCH_MEANING else "measured", forces))
        if len(recording.positions(Topic.ESTIMATED)):
            columns.append(WrenchHistory("estimated", "as recorded, ± one standard deviation", states_errors=True))
        return columns
