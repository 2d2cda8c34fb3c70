"""Reads a recording, whole or cut short: frames, wrenches, heights, labels, readings, and a summary of its content."""

import re
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from jaxtyping import Float32, Int64, UInt8
from mcap.records import Message
from numpy import ndarray as Array

from ninedtact.bounds import checks_arguments
from ninedtact.capture.frame_source import SourceIncomplete
from ninedtact.errors import FileFormatError, InputError
from ninedtact.quantities import Frame, Rectified, Wrench, WrenchEstimate
from ninedtact.reading import Reading, read_frame
from ninedtact.recording.attached_sensor import attached_sensor_files, read_folder_files
from ninedtact.recording.errors import RecordingUnreadable
from ninedtact.recording.mcap_file import McapFile, is_being_written
from ninedtact.recording.metadata import HEIGHT_STEP_16_BIT_MM, REPAIR_RECORD, choose_sensor_metadata
from ninedtact.recording.summary import PERIODIC_TOPICS, RecordingSummary, summarise_topic, usual_rate_hz
from ninedtact.recording.topics_and_messages import (
    LabelledSpan,
    PairLabel,
    RecordingEvent,
    RecordingEventKind,
    Topic,
    decode_estimate_warnings,
    decode_event,
    decode_height_map,
    decode_image,
    decode_label_spans,
    decode_labelled_span,
    decode_pair_label,
    decode_reference_grey,
    decode_wrench,
    decode_wrench_estimate,
    ros_name,
)
from ninedtact.recording.topics_of_other_programs import is_of_other_program, read_sensor_metadata
from ninedtact.shape.calibrated_shape import REFERENCE_FRAMES, CalibratedShape, DepthReader, FindReferenceFaults

if TYPE_CHECKING:
    from ninedtact.calibration.sensor_folder import SensorFolder

Decoded = TypeVar("Decoded")
SPANS_ATTACHMENT = "spans.json"
"""Name of the attached list of labelled spans that were edited after the recording; the last one counts."""


class RecordingCutShort(SourceIncomplete):
    """Raised, once, after the last image of a recording that has no end; what followed is missing."""


@checks_arguments
class Recording:
    """One recording, open for reading (`with`). One thread at a time.

    with Recording("press.mcap") as recording:
        print(recording.sensor, recording.duration_s, recording.topics, recording.dropped_count)
        for frame in recording.frames():
            print(frame.stamp_ns, frame.image.shape)
    """

    def __init__(self, path: Path | str, sensor: Path | str | None = None) -> None:
        """Open the file and find its messages; raises `CameraError`, `RecordingUnreadable`, and `SensorFolderDamaged`.

        path: of a recording of several sensors, with the name of one of them: `grasp.mcap#left`. sensor: a sensor folder in place
        of the one that the recording carries; those that other programs wrote from our topics carry none.
        """
        self.path, name = _split_address(str(path))
        self.file = McapFile(self.path)
        self._sensor_folder = None if sensor is None else Path(sensor)
        self.is_of_other_program = is_of_other_program(self.file)
        """Whether another program wrote the file, which kept neither metadata nor the numbers of images."""
        try:
            self.all_metadata = read_sensor_metadata(self.file)
            if self._sensor_folder is not None:
                name = name or self._name_of(self._sensor_folder)
            self.metadata = choose_sensor_metadata(self.all_metadata, name, self.path)
        except BaseException:
            self.close()
            raise

    @property
    def sensor(self) -> str:
        """Name of the tactile sensor, as in its sensor.toml."""
        return self.metadata.sensor

    def is_named_after(self, sensor: "SensorFolder") -> bool:
        """Return whether the recorded sensor has the name of this one, of which topics keep letters and digits."""
        return self.sensor == (ros_name(sensor.id) if self.is_of_other_program else sensor.id)

    def _name_of(self, folder: Path) -> str:
        """Return the name among several sensors that another program kept of the sensor of a folder; empty where there is none."""
        from ninedtact.calibration.sensor_folder import load_sensor

        name = ros_name(load_sensor(folder).id)
        return name if self.is_of_other_program and name in {one.name for one in self.all_metadata} else ""

    @property
    def is_finished(self) -> bool:
        """Whether the file was closed properly; if not, what followed its last whole part is missing."""
        return self.file.is_finished

    @property
    def is_repaired(self) -> bool:
        """Whether this is the whole copy of a file that was cut short; what followed its last whole part is missing."""
        return any(record.name == REPAIR_RECORD for record in self.file.metadata)

    @property
    def is_being_written(self) -> bool:
        """Whether a program of this computer still writes the file."""
        return not self.is_finished and is_being_written(self.path)

    @property
    def topics(self) -> list[str]:
        """Full names of the topics that hold messages, such as `/my_sensor/image_raw`."""
        return [self._path(topic) for topic in Topic if len(self.positions(topic))]

    @property
    def began_ns(self) -> int:
        """Monotonic stamp of the first message."""
        return self._time_span_ns[0]

    @cached_property
    def duration_s(self) -> float:
        """Seconds from the first message to the last."""
        first_ns, last_ns = self._time_span_ns
        return (last_ns - first_ns) / 1e9

    @cached_property
    def dropped_count(self) -> int:
        """Images that the source counted and that were not written."""
        return sum(int(event.subject) for event in self.events() if event.kind is RecordingEventKind.DROPPED)

    @cached_property
    def _time_span_ns(self) -> tuple[int, int]:
        stamps_ns = [stamps for topic in Topic if len(stamps := self.stamps_ns(topic))]
        if not stamps_ns:
            return 0, 0
        return int(min(map(np.min, stamps_ns))), int(max(map(np.max, stamps_ns)))

    def positions(self, topic: Topic) -> Array:
        """Return `MESSAGE_POSITION` of the messages of a topic, in the order of writing."""
        return self.file.positions(self._path(topic))

    def stamps_ns(self, topic: Topic) -> Int64[Array, " n"]:
        """Return the stamps of the messages of a topic, ns of the monotonic clock."""
        return np.asarray(self.positions(topic)["stamp_ns"])

    def messages(self, topic: Topic) -> Iterator[Message]:
        """Yield the messages of a topic, undecoded, in the order of writing."""
        return map(self.file.message, self.positions(topic))

    def message_of_image(self, topic: Topic, image: Frame | Message) -> Message | None:
        """Return the message of a topic with the stamp and the number of an image; None where the image has none.

        Another program received the messages of an image one after the other and kept no numbers: the nearest one is taken.
        """
        stamp_ns, index = (
            (image.stamp_ns, image.index) if isinstance(image, Frame) else (image.log_time, image.sequence)
        )
        positions = self.positions(topic)
        if self.is_of_other_program and len(positions):
            away_ns = np.abs(positions["stamp_ns"] - stamp_ns)
            nearest = int(away_ns.argmin())
            within_ns = 0.5e9 / usual_rate_hz(self.stamps_ns(Topic.IMAGES))
            return self.file.message(positions[nearest]) if away_ns[nearest] <= within_ns else None
        messages = map(self.file.message, positions[positions["stamp_ns"] == stamp_ns])
        return next((message for message in messages if message.sequence == index), None)

    def decode(self, message: Message, decode: Callable[..., Decoded], *arguments: Any) -> Decoded:
        """Return what the data of a message hold; raises `RecordingUnreadable` where they cannot be decoded."""
        try:
            return decode(message.data, *arguments)
        except Exception as error:  # rosbags, msgspec, NumPy and Pillow raise errors of their own
            reason = (error.got if isinstance(error, FileFormatError) else str(error)).splitlines() or [""]
            raise RecordingUnreadable(
                expected=f"{self.path} as it was recorded",
                got=f"a message at {message.log_time} ns that cannot be read ({reason[0][:120]})",
                remedy="restore the file from a copy",
            ) from error

    def frame(self, position: np.void) -> Frame:
        """Return one frame as it was read, its stamp and index included.

        Raises `RecordingUnreadable` where the file is damaged, and for an image of another size than the first one.
        """
        message = self.file.message(position)
        image = self._decode_image(message)
        first = self._image_shapes.get(int(position["channel"]), image.shape)
        if image.shape != first:
            raise RecordingUnreadable(
                expected=f"images of {first[1]} x {first[0]} pixels in {self.path}, as the first one",
                got=f"{image.shape[1]} x {image.shape[0]}",
                remedy="restore the file from a copy",
            )
        images = self.positions(Topic.IMAGES)
        if self._has_numbers or position["channel"] != images["channel"][0]:
            return Frame(image, message.log_time, message.sequence)
        return Frame(image, message.log_time, int(np.flatnonzero(images == position)[0]))

    def image_index(self, message: Message) -> int:
        """Return the number of the image that a message belongs to; the place of the nearest one where the file has no numbers."""
        if self._has_numbers:
            return message.sequence
        return int(np.abs(self.stamps_ns(Topic.IMAGES) - message.log_time).argmin())

    @cached_property
    def _has_numbers(self) -> bool:
        """Whether images are numbered, which other programs need not do."""
        first_two = [self.file.message(one).sequence for one in self.positions(Topic.IMAGES)[:2]]
        return not self.is_of_other_program or len(set(first_two)) == 2

    @cached_property
    def _image_shapes(self) -> dict[int, tuple[int, ...]]:
        """Shapes of the first image of each topic of images, by its channel."""
        firsts = [positions[0] for topic in (Topic.IMAGES, Topic.REFERENCE) if len(positions := self.positions(topic))]
        return {int(one["channel"]): self._decode_image(self.file.message(one)).shape for one in firsts}

    def _decode_image(self, message: Message) -> UInt8[Array, "rows cols 3"]:
        return self.decode(message, decode_image, self.metadata.images, self.is_of_other_program)

    def frames(self, topic: Topic = Topic.IMAGES) -> Iterator[Frame]:
        """Yield all frames, or the reference images with `Topic.REFERENCE`."""
        return map(self.frame, self.positions(topic))

    def readings(self) -> Iterator[Reading]:
        """Yield what the recorded sensor measures in every frame: its calibration is applied to the images.

        The first ten frames are taken as reference images (no contact), unless the recording has its own (page, ROS, `collect`).
        Raises `RecordingUnreadable` where the recording carries no sensor folder, and `InputError` where it has neither
        reference images nor ten frames.
        """
        from ninedtact.calibration.drift.reference_check import load_reference_image_checker

        with self.unpacked_sensor() as sensor:
            references = RecordedReferences(self, sensor.shape, load_reference_image_checker(sensor).find_faults)
            for frame in self.frames():
                yield read_frame(frame, sensor.shape, references.held_or_first_at(frame.stamp_ns))

    def wrench(self, position: np.void) -> Wrench:
        """Return one wrench about the skin centre."""
        message = self.file.message(position)
        return self.decode(message, decode_wrench, message.log_time)

    def wrenches(self, topic: Topic = Topic.MEASURED) -> Iterator[Wrench]:
        """Yield all measured wrenches, or the estimated ones with `Topic.ESTIMATED`."""
        return map(self.wrench, self.positions(topic))

    def warnings(self) -> Iterator[tuple[int, list[str]]]:
        """Yield the image index and the warnings of every image whose heights or estimate have any."""
        return (
            (self.image_index(message), self.decode(message, decode_estimate_warnings))
            for message in self.messages(Topic.WARNINGS)
        )

    def estimates(self) -> Iterator[WrenchEstimate]:
        """Yield all estimated wrenches with their errors and warnings."""
        return map(self.estimate, self.messages(Topic.ESTIMATED))

    def estimate(self, message: Message) -> WrenchEstimate:
        """Return the estimate of one message on `Topic.ESTIMATED` with its errors and warnings."""
        others = (self.message_of_image(topic, message) for topic in (Topic.COVARIANCE, Topic.WARNINGS))
        errors, warned = (None if other is None else other.data for other in others)

        def decode_all(data: bytes) -> WrenchEstimate:
            return decode_wrench_estimate(decode_wrench(data, message.log_time), errors, warned)

        return self.decode(message, decode_all)

    def heights(self) -> Iterator[tuple[int, Float32[Array, "rows cols"]]]:
        """Yield the image index and the heights in mm, NaN out of view."""
        return ((self.image_index(message), self.decode_heights(message)) for message in self.messages(Topic.HEIGHTS))

    def decode_heights(self, message: Message) -> Float32[Array, "rows cols"]:
        """Return the heights of a message in mm, NaN out of view."""
        step_mm = HEIGHT_STEP_16_BIT_MM if self.is_of_other_program else self.metadata.height_step_mm
        return self.decode(message, decode_height_map, step_mm)

    def labels(self) -> Iterator[PairLabel]:
        """Yield the labels of all saved pairs, undone contacts included."""
        return (self.decode(one, decode_pair_label, one.log_time) for one in self.messages(Topic.LABELS))

    def kept_labels(self) -> list[PairLabel]:
        """Return the labels of all saved pairs, undone contacts excluded."""
        undone = {event.subject for event in self.events() if event.kind is RecordingEventKind.CONTACT_UNDONE}
        return [label for label in self.labels() if label.contact not in undone]

    def events(self) -> list[RecordingEvent]:
        """Return all events: everything that happened besides images and wrenches."""
        return [self.decode(one, decode_event, one.log_time) for one in self.messages(Topic.EVENTS)]

    def spans(self) -> list[LabelledSpan]:
        """Return the labelled spans in the order of their beginnings, as they were last edited; several sensors share them.

        Raises `RecordingUnreadable` where the list of them is damaged.
        """
        attached = [one for one in self.file.attachments() if one.name == SPANS_ATTACHMENT]
        try:
            if attached:
                spans = decode_label_spans(attached[-1].data)
            else:
                paths = [Topic.SPANS.path(metadata.topic_name) for metadata in self.all_metadata]
                positions = np.concatenate([self.file.positions(path) for path in paths])
                spans = [self.decode(one, decode_labelled_span) for one in map(self.file.message, positions)]
            return sorted(spans, key=lambda span: (span.begin_ns, span.end_ns))
        except (ValueError, RecursionError) as error:
            raise RecordingUnreadable(
                expected=f"the labelled spans of {self.path} as they were written",
                got=str(error),
                remedy="restore the file from a copy",
            ) from error

    def save_sensor_folder(self, into: Path) -> Path:
        """Write the sensor folder, the given or the attached one; raises `RecordingUnreadable` where there is none."""
        files = self.sensor_files()
        if not files:
            raise RecordingUnreadable(
                expected=f"{self.path} to carry its sensor's folder",
                got="a recording without",
                remedy="name one with --sensor",
            )
        for name, content in files.items():
            path = into / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        return into

    @contextmanager
    def unpacked_sensor(self) -> Iterator["SensorFolder"]:
        """Load the sensor folder, whose files are deleted at the end of the block.

        Raises what `save_sensor_folder` raises, and `SensorFolderDamaged`.
        """
        from ninedtact.calibration.sensor_folder import load_sensor

        with TemporaryDirectory(prefix="ninedtact_") as folder:
            yield load_sensor(self.save_sensor_folder(Path(folder) / "sensor"))

    def sensor_files(self) -> dict[str, bytes]:
        """Return the content of the sensor folder's files, the given or the attached one, by their paths in it."""
        if self._sensor_folder is not None:
            return read_folder_files(self._sensor_folder)
        return attached_sensor_files(self.file.attachments(), self.metadata.name)

    @cached_property
    def calibration_checksum(self) -> str:
        """`SensorFolder.calibration_checksum` of the sensor folder; empty where there is none, or none that can be read."""
        from ninedtact.calibration.sensor_folder import SENSOR_FILE, checksum_of_sensor_toml

        text = self.sensor_files().get(SENSOR_FILE)
        return "" if text is None else checksum_of_sensor_toml(text)

    def summary(self) -> RecordingSummary:
        """Return sensor, duration, topics with rates and gaps, drops, pairs and events."""
        metadata = self.metadata
        began = datetime.fromtimestamp(metadata.wall_ns(self.began_ns) / 1e9, UTC)
        return RecordingSummary(
            sensor=metadata.sensor,
            calibration_checksum=self.calibration_checksum,
            name=metadata.name,
            source=metadata.source,
            force_torque=metadata.force_torque,
            purpose=metadata.purpose,
            id=metadata.id,
            began=began.isoformat(timespec="milliseconds"),
            seconds=self.duration_s,
            finished=self.is_finished,
            repaired=self.is_repaired,
            dropped=self.dropped_count,
            height_step_mm=metadata.height_step_mm,
            camera_delay_ms=metadata.camera_delay_ms,
            topics=[
                summarise_topic(
                    self._path(topic),
                    topic.message_type(metadata.images),
                    self.stamps_ns(topic),
                    topic in PERIODIC_TOPICS and (topic is not Topic.IMAGES or metadata.purpose == "record"),
                )
                for topic in Topic
                if len(self.positions(topic))
            ],
            pairs=dict(Counter(label.kind for label in self.kept_labels())),
            events=dict(Counter(event.kind.value for event in self.events())),
            spans=self.spans(),
        )

    def missing_end_error(self, seconds: float | None = None, pairs: int | None = None) -> RecordingCutShort:
        """Return the error for the end that an unfinished recording lacks.

        seconds: duration of what is there, where it is not that of this sensor. pairs: number of training pairs in it, where they
        are read.
        """
        if self.is_being_written:
            state, remedy = "that is still being written", "read it again after its end"
        else:
            state, remedy = "that was cut short, so that the rest is missing", "copy it again whole"
        counted = "" if pairs is None else f" and {pairs} {'pair' if pairs == 1 else 'pairs'}"
        seconds = self.duration_s if seconds is None else seconds
        return RecordingCutShort(
            f"expected all of {self.path}, got {seconds:.1f} s{counted} of a recording {state}; use what was read, or {remedy}"
        )

    def _path(self, topic: Topic) -> str:
        return topic.path(self.metadata.topic_name, self.metadata.images)

    def close(self) -> None:
        """Close the file of the recording."""
        self.file.close()

    def __enter__(self) -> "Recording":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class RecordedReferences:
    """The reference images of a recording: rectified ones (live page, ROS), or raw ones (`collect`), of which those with one index
    belong together. Each holds from its stamp on, the first one before it, too."""

    def __init__(
        self,
        recording: Recording,
        shape: CalibratedShape,
        find_faults: FindReferenceFaults = lambda _: (),
        rectified_faults: tuple[str, ...] = (),
    ) -> None:
        """rectified_faults: why images that were recorded rectified cannot be reference images of the calibrated sensor."""
        self.recording, self._shape = recording, shape
        self._find_faults, self._rectified_faults = find_faults, rectified_faults
        kinds = (Topic.REFERENCE_GREY, Topic.REFERENCE)
        self._topic = next((topic for topic in kinds if len(recording.positions(topic))), None)
        self._positions = recording.positions(self._topic or Topic.REFERENCE)
        self._last: tuple[int, DepthReader] | None = None

    def depth_reader_at(self, stamp_ns: int) -> DepthReader | None:
        """Return a depth reader for the reference image that held at a stamp, the same object until it changes; None without one.

        Raises what reading a recording raises, and `RecordingUnreadable` where the image is not that of the sensor.
        """
        if self._topic is None:
            return None
        number = max(int(np.searchsorted(self._positions["stamp_ns"], stamp_ns, side="right")) - 1, 0)
        if self._last is None or self._last[0] != number:
            self._last = number, self._read(number)
        return self._last[1]

    def held_or_first_at(self, stamp_ns: int, fewest: int = REFERENCE_FRAMES) -> DepthReader:
        """Return a depth reader for the reference image that held at a stamp, or for the first ten images of one without any.

        Raises what `depth_reader_at` raises, and `InputError` where the recording has neither, nor the fewest images to begin with.
        """
        if self._topic is None and len(self.recording.positions(Topic.IMAGES)) < fewest:
            raise InputError(
                expected=(
                    f"reference images in {self.recording.path}, or at least {fewest} images of which the "
                    "first are taken as such"
                ),
                got=f"{len(self.recording.positions(Topic.IMAGES))} images alone",
                remedy="record longer",
            )
        return self.depth_reader_at(stamp_ns) or self._reader_of_first_images

    @cached_property
    def _reader_of_first_images(self) -> DepthReader:
        positions = self.recording.positions(Topic.IMAGES)
        first = positions[np.argsort(positions["stamp_ns"], kind="stable")[:REFERENCE_FRAMES]]
        return self._shape.depth_reader(*map(self.recording.frame, first), find_faults=self._find_faults)

    def _frames_at(self, number: int) -> list[Frame]:
        frames = {number: self.recording.frame(self._positions[number])}
        for numbers in (range(number - 1, -1, -1), range(number + 1, len(self._positions))):
            for other in numbers:
                frame = self.recording.frame(self._positions[other])
                if frame.index != frames[number].index:
                    break
                frames[other] = frame
        return [frames[other] for other in sorted(frames)]

    def _read(self, number: int) -> DepthReader:
        if self._topic is not Topic.REFERENCE_GREY:
            return self._shape.depth_reader(*self._frames_at(number), find_faults=self._find_faults)
        message, wanted = self.recording.file.message(self._positions[number]), self._shape.rectify.height_source.shape
        grey = self.recording.decode(message, decode_reference_grey)
        if grey.shape != wanted:
            raise RecordingUnreadable(
                expected=f"a reference image of {wanted[1]} x {wanted[0]} pixels in {self.recording.path}, as the sensor has",
                got=f"{grey.shape[1]} x {grey.shape[0]}",
                remedy="name the recorded sensor, or none",
            )
        reference = Rectified(grey, self._shape.rectify.mm_per_px, message.log_time)
        return self._shape.reader_against(reference, self._rectified_faults)


def recorded_sensor_addresses(path: Path | str) -> list[str]:
    """Return how `Recording` opens each sensor of a recording: its path alone, or with several sensors `grasp.mcap#left`.

    A path that names a sensor already is returned as it is. Raises what `Recording` raises.
    """
    plain, name = _split_address(str(path))
    if name:
        return [str(path)]
    with closing(McapFile(plain)) as file:
        names = [metadata.name for metadata in read_sensor_metadata(file)]
    return [f"{plain}#{name}" if name else str(plain) for name in names]


def _split_address(text: str) -> tuple[Path, str]:
    """Return the path of a recording and the name of one of its sensors, which is empty where none is named."""
    match = None if Path(text).exists() else re.fullmatch(r"(.*)#(\w+)", text, re.DOTALL)
    return (Path(text), "") if match is None else (Path(match[1]), match[2])
