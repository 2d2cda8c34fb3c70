"""A recording with the samples of a force/torque sensor as `FreePressing`, from which `ninedtact adapt` learns."""

from contextlib import suppress
from pathlib import Path

import numpy as np

from ninedtact.calibration.drift.reference_check import load_reference_image_checker, reference_image_error
from ninedtact.calibration.free_pressing.pressing import (
    ForceTorqueSamples,
    FreePressing,
    find_stuck_samples,
)
from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.capture.force_torque.wrench_source_from_address import DeviceFrameWrenchSource
from ninedtact.capture.frame_source import SourceEnded
from ninedtact.design import ForceTorqueMount
from ninedtact.errors import InputError
from ninedtact.quantities import Wrench
from ninedtact.reading import Reading, read_frame
from ninedtact.recording.errors import RecordingUnreadable
from ninedtact.recording.reader import RecordedReferences, Recording
from ninedtact.recording.recorded_source import RecordedWrenchSource
from ninedtact.recording.topics_and_messages import Topic

_MOST_IMAGES, _MOST_IMAGES_PER_S = 400, 6.0
"""Images that are estimated: enough for each contact, few enough for half a minute."""


class RecordedPressing(FreePressing):
    """Free pressing in a recording, open until `close` (`with`).

    with RecordedPressing("press.mcap", sensor) as pressing:
        calibrate_force(sensor, pressing=pressing)
    """

    def __init__(self, path: Path | str, sensor: SensorFolder) -> None:
        """Open a recording of this sensor and read its samples.

        Raises what `Recording` raises, `InputError` for one of another sensor or without samples, and `PressingUnusable`.
        """
        self.name = str(path)
        self._recording = Recording(path)
        try:
            self._require_of(sensor)
            positions = self._recording.positions(Topic.IMAGES)
            seconds = (positions["stamp_ns"][-1] - positions["stamp_ns"][0]) / 1e9
            count = int(min(len(positions), _MOST_IMAGES, max(2.0, seconds * _MOST_IMAGES_PER_S)))
            self._positions = positions[np.unique(np.linspace(0, len(positions) - 1, count).astype(int))]
            self.stamps_ns = np.asarray(self._positions["stamp_ns"], np.int64)
            self.mount = self._recorded_mount(sensor)
            self.samples, self.notices = self._read_samples()
            self._references: tuple[SensorFolder, RecordedReferences] | None = None
            self.read(0, sensor)
        except BaseException:
            self.close()
            raise

    def read(self, number: int, sensor: SensorFolder) -> Reading:
        """Return the reading of one of the images; raises `InputError` for reference images that cannot be those of the sensor."""
        frame = self._recording.frame(self._positions[number])
        if self._references is None or self._references[0] is not sensor:
            check = load_reference_image_checker(sensor)
            self._references = sensor, RecordedReferences(self._recording, sensor.shape, check.find_faults)
        depth_reader = self._references[1].held_or_first_at(frame.stamp_ns)
        if depth_reader.reference_faults:
            images = f"the reference images of {self.name}"
            raise reference_image_error(images, sensor.id, depth_reader.reference_faults[0])
        return read_frame(frame, sensor.shape, depth_reader)

    def close(self) -> None:
        """Close the recording."""
        self._recording.close()

    def __enter__(self) -> "RecordedPressing":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _require_of(self, sensor: SensorFolder) -> None:
        """Raise `InputError` for a recording of another sensor, or without images and samples."""
        recording = self._recording
        if not recording.is_named_after(sensor):
            raise InputError(
                expected=f"a recording of sensor {sensor.id}",
                got=f"{self.name} of sensor {recording.sensor}",
                remedy="name the folder of the recorded sensor, or another recording",
            )
        for topic, missing, remedy in (
            (Topic.IMAGES, "images", "take another recording"),
            (Topic.MEASURED, "samples of a force/torque sensor", "record with --force-torque"),
        ):
            if len(recording.positions(topic)) < 2:
                raise RecordingUnreadable(expected=f"{missing} in {self.name}", got="none", remedy=remedy)

    def _recorded_mount(self, sensor: SensorFolder) -> ForceTorqueMount:
        """Return where the device was when the recording was made, by the sensor folder in it."""
        if not self._recording.sensor_files():
            return sensor.record.design.force_torque
        with self._recording.unpacked_sensor() as recorded:
            return recorded.record.design.force_torque

    def _read_samples(self) -> tuple[ForceTorqueSamples, tuple[str, ...]]:
        """Return all samples in the frame of the device, and what is wrong with them; raises `PressingUnusable`."""
        wrenches: list[Wrench] = []
        with DeviceFrameWrenchSource(RecordedWrenchSource(self.name), self.mount) as source, suppress(SourceEnded):
            wrenches.extend(wrench for wrench in source if np.isfinite(wrench.six).all())
        stamps_ns = np.array([wrench.stamp_ns for wrench in wrenches])
        order = np.argsort(stamps_ns, kind="stable")
        six = np.array([wrench.six for wrench in wrenches])[order]
        at_s = (stamps_ns[order] - self.stamps_ns[0]) / 1e9
        usable, notices = find_stuck_samples(at_s, six)
        if not self._recording.is_finished:
            notices = (f"{self.name} was cut short; what is there is used", *notices)
        return ForceTorqueSamples(at_s, six, usable), notices
