"""Reads a recording, complete or truncated: frames, wrenches, heights, labels, and a summary of its content."""

import json
import re
import struct
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from types import TracebackType
from typing import BinaryIO

import numpy as np
from jaxtyping import Float32, Float64, Int64
from mcap.exceptions import McapError
from mcap.records import Attachment, Metadata
from numpy import ndarray as Array

from ninedtact.capture.frame_source import CameraNotFound
from ninedtact.quantities import Frame, Wrench, WrenchEstimate
from ninedtact.reading import Reading
from ninedtact.recording.errors import RecordingUnreadable
from ninedtact.recording.mcap_index_recovery import (
    MESSAGE_POSITION,
    McapIndex,
    StoredMessage,
    complete_mcap_index,
    damage_error,
    index_mcap_records,
    open_record_content,
    parse_message_record,
    read_attachment,
    read_mcap_chunk,
)
from ninedtact.recording.metadata import METADATA_RECORD, REPAIR_RECORD, RecordingMetadata, parse_recording_metadata
from ninedtact.recording.summary import RecordingSummary, summarise_recording
from ninedtact.recording.topics_and_messages import (
    LabelledSpan,
    PairLabel,
    RecordingEvent,
    RecordingEventKind,
    Topic,
    decode_covariance,
    decode_estimate_warnings,
    decode_event,
    decode_height_map,
    decode_image,
    decode_labelled_span,
    decode_pair_label,
    decode_wrench,
    decode_wrench_estimate,
)

SENSOR_FOLDER, SEVERAL_FOLDERS = "sensor", "sensors"
"""First part of the names of the attachments that hold the sensor folder; among several sensors, their name is the second."""
SPANS_ATTACHMENT = "spans.json"
"""Name of the attached list of labelled spans that were edited after the recording; the last one counts."""


class Recording:
    """One recording, open for reading (`with`). One thread at a time.

    with Recording("press.mcap") as recording:
        print(recording.sensor, recording.duration_s, recording.topics, recording.dropped_count)
        for frame in recording.frames():
            print(frame.stamp_ns, frame.image.shape)
    """

    def __init__(self, path: Path | str) -> None:
        """Open the file and index its records; raises `CameraNotFound` or `RecordingUnreadable`.

        path: of a recording of several sensors, with the name of one of them: `grasp.mcap#left`.
        """
        self.path, name = _split_address(str(path))
        self._file = _open_file(self.path)
        self._chunk: tuple[int, bytes] = (-1, b"")
        try:
            self.index, self.all_metadata = _read_structure(self._file, str(self.path))
            self.metadata = _choose_metadata(self.all_metadata, name, self.path)
        except BaseException:
            self._file.close()
            raise

    @property
    def sensor(self) -> str:
        """Name of the tactile sensor, as in its sensor.toml."""
        return self.metadata.sensor

    @property
    def is_finished(self) -> bool:
        """Whether the file was closed properly; if not, what followed its last whole part is missing."""
        return self.index.finished

    @cached_property
    def is_repaired(self) -> bool:
        """Whether the file was cut short and completed later; what followed its last whole part is missing."""
        records = (Metadata.read(open_record_content(self._file, span)) for span in self.index.metadata)
        return any(record.name == REPAIR_RECORD for record in records)

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
    def _channels(self) -> dict[str, int]:
        return {channel.topic: number for number, channel in self.index.channels.items()}

    @cached_property
    def _time_span_ns(self) -> tuple[int, int]:
        stamps_ns = [stamps for topic in Topic if len(stamps := self.stamps_ns(topic))]
        if not stamps_ns:
            return 0, 0
        return int(min(map(np.min, stamps_ns))), int(max(map(np.max, stamps_ns)))

    def _path(self, topic: Topic) -> str:
        return topic.path(self.metadata.topic_name, self.metadata.images)

    def positions(self, topic: Topic) -> Array:
        """Return `MESSAGE_POSITION` of the messages of a topic, in the order of writing."""
        return self._positions_on(self._path(topic))

    def _positions_on(self, path: str) -> Array:
        parts = self.index.positions.get(self._channels.get(path, -1), [])
        return np.concatenate(parts) if parts else np.empty(0, MESSAGE_POSITION)

    def stamps_ns(self, topic: Topic) -> Int64[Array, " n"]:
        """Return the stamps of the messages of a topic, ns of the monotonic clock."""
        return np.asarray(self.positions(topic)["stamp_ns"])

    def message(self, position: np.void) -> StoredMessage:
        """Return the message at one `MESSAGE_POSITION`; raises `RecordingUnreadable` where the file is damaged."""
        number = int(position["chunk"])
        span = self.index.chunks[number]
        if self._chunk[0] != number:
            self._chunk = number, read_mcap_chunk(self._file, span, str(self.path)).data
        try:
            message = parse_message_record(self._chunk[1], int(position["offset"]))
        except (ValueError, IndexError, struct.error) as error:
            raise damage_error(str(self.path), span.end) from error
        if message.stamp_ns != position["stamp_ns"] or message.channel != position["channel"]:
            raise damage_error(str(self.path), span.end)
        return message

    def messages(self, topic: Topic) -> Iterator[StoredMessage]:
        """Yield the messages of a topic, undecoded, in the order of writing."""
        return map(self.message, self.positions(topic))

    def frame(self, position: np.void) -> Frame:
        """Return one frame as it was read, its stamp and index included; raises `RecordingUnreadable` where the file is damaged."""
        message = self.message(position)
        try:
            image = decode_image(message.data, self.metadata.images)
        except ValueError as error:
            raise damage_error(str(self.path), self.index.chunks[int(position["chunk"])].end) from error
        return Frame(image, message.stamp_ns, message.sequence)

    def frames(self, topic: Topic = Topic.IMAGES) -> Iterator[Frame]:
        """Yield all frames, or the reference images with `Topic.REFERENCE`."""
        return map(self.frame, self.positions(topic))

    def readings(self) -> Iterator[Reading]:
        """Yield what the recorded sensor measures in every frame: its calibration is applied to the images.

        The first ten frames are taken as reference images (no contact), unless the recording has its own (page, ROS, `collect`).
        Raises `RecordingUnreadable` where the recording carries no sensor folder.
        """
        from ninedtact.calibration.drift.diagnosis_and_reference_check import load_reference_image_checker
        from ninedtact.calibration.sensor_folder import load_sensor
        from ninedtact.recording.recorded_source import RecordedReferences
        from ninedtact.recording.recorder import ReadingComputer

        with TemporaryDirectory(prefix="ninedtact_") as folder:
            sensor = load_sensor(self.save_sensor_folder(Path(folder) / "sensor"))
            find_faults = load_reference_image_checker(sensor).find_faults
            references = RecordedReferences(self, sensor.shape, find_faults)
            computer = ReadingComputer(sensor.shape, find_faults)
            for frame in self.frames():
                computer.depth_reader = references.depth_reader_at(frame.stamp_ns) or computer.depth_reader
                yield from computer.readings(frame)

    def wrench(self, position: np.void) -> Wrench:
        """Return one wrench about the skin centre."""
        message = self.message(position)
        return decode_wrench(message.data, message.stamp_ns)

    def wrenches(self, topic: Topic = Topic.MEASURED) -> Iterator[Wrench]:
        """Yield all measured wrenches, or the estimated ones with `Topic.ESTIMATED`."""
        return map(self.wrench, self.positions(topic))

    def covariances(self) -> Iterator[Float64[Array, "6 6"]]:
        """Yield the covariance of every estimated wrench, in the order of `Wrench.six`, N and N·m."""
        return (decode_covariance(message.data) for message in self.messages(Topic.COVARIANCE))

    def warnings(self) -> Iterator[tuple[int, list[str]]]:
        """Yield the image index and the warnings of every image whose heights or estimate have any."""
        return ((message.sequence, decode_estimate_warnings(message.data)) for message in self.messages(Topic.WARNINGS))

    def estimates(self) -> Iterator[WrenchEstimate]:
        """Yield all estimated wrenches with their errors and warnings."""
        errors, warned = (
            {message.stamp_ns: message.data for message in self.messages(topic)}
            for topic in (Topic.COVARIANCE, Topic.WARNINGS)
        )
        for wrench in self.wrenches(Topic.ESTIMATED):
            yield decode_wrench_estimate(wrench, errors.get(wrench.stamp_ns), warned.get(wrench.stamp_ns))

    def heights(self) -> Iterator[tuple[int, Float32[Array, "rows cols"]]]:
        """Yield the image index and the heights in mm, NaN out of view."""
        step_mm = self.metadata.height_step_mm
        return (
            (message.sequence, decode_height_map(message.data, step_mm)) for message in self.messages(Topic.HEIGHTS)
        )

    def labels(self) -> Iterator[PairLabel]:
        """Yield the labels of all saved pairs, undone contacts included."""
        return (decode_pair_label(message.data, message.stamp_ns) for message in self.messages(Topic.LABELS))

    def kept_labels(self) -> list[PairLabel]:
        """Return the labels of all saved pairs, undone contacts excluded."""
        undone = {event.subject for event in self.events() if event.kind is RecordingEventKind.CONTACT_UNDONE}
        return [label for label in self.labels() if label.contact not in undone]

    def events(self) -> list[RecordingEvent]:
        """Return all events: everything that happened besides images and wrenches."""
        return [decode_event(message.data, message.stamp_ns) for message in self.messages(Topic.EVENTS)]

    def spans(self) -> list[LabelledSpan]:
        """Return the labelled spans in the order of their beginnings, as they were last edited; several sensors share them.

        Raises `RecordingUnreadable` where the list of them is damaged.
        """
        attached = [one for one in self.attachments() if one.name == SPANS_ATTACHMENT]
        try:
            if attached:
                spans = [LabelledSpan(**one) for one in json.loads(attached[-1].data)]
            else:
                paths = [Topic.SPANS.path(metadata.topic_name) for metadata in self.all_metadata]
                positions = np.concatenate([self._positions_on(path) for path in paths])
                spans = [decode_labelled_span(message.data) for message in map(self.message, positions)]
            return sorted(spans, key=lambda span: (span.begin_ns, span.end_ns))
        except (ValueError, TypeError) as error:
            raise RecordingUnreadable(
                f"expected the labelled spans of {self.path} as they were written, got: {error}; restore the file from a copy"
            ) from error

    def attachments(self) -> Iterator[Attachment]:
        """Yield the attached files with their names; raises `RecordingUnreadable` where one is damaged."""
        return (read_attachment(self._file, span, str(self.path)) for span in self.index.attachments)

    def save_sensor_folder(self, into: Path) -> Path:
        """Write the attached sensor folder; raises `RecordingUnreadable` where the recording carries none."""
        if self.write_sensor_files(into) == 0:
            raise RecordingUnreadable(
                f"expected {self.path} to carry its sensor's folder, got a recording without; name one with --sensor"
            )
        return into

    def write_sensor_files(self, into: Path) -> int:
        """Write the files of the attached sensor folder and return their number."""
        files = self.sensor_files()
        for name, content in files.items():
            path = into / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        return len(files)

    def sensor_files(self) -> dict[str, bytes]:
        """Return the content of the attached sensor folder's files by their paths in it; paths leading elsewhere are skipped."""
        folder, files = PurePosixPath(_attached_folder(self.metadata.name)).parts, {}
        for attachment in self.attachments():
            parts = PurePosixPath(attachment.name).parts
            if parts[: len(folder)] == folder and len(parts) > len(folder) and ".." not in parts:
                files[str(PurePosixPath(*parts[len(folder) :]))] = attachment.data
        return files

    def summary(self) -> RecordingSummary:
        """Return sensor, duration, topics with rates and gaps, drops, pairs and events."""
        return summarise_recording(self)

    def close(self) -> None:
        """Close the file of the recording."""
        self._file.close()

    def __enter__(self) -> "Recording":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()


def sensor_folder_attachments(folder: Path, name: str = "") -> dict[str, bytes]:
    """Return the content of the files of a sensor folder by the names that they have in a recording.

    name: of the sensor among several.
    """
    return {f"{_attached_folder(name)}/{file}": content for file, content in read_folder_files(folder).items()}


def _attached_folder(name: str) -> str:
    return f"{SEVERAL_FOLDERS}/{name}" if name else SENSOR_FOLDER


def recorded_sensor_addresses(path: Path | str) -> list[str]:
    """Return how `Recording` opens each sensor of a recording: its path alone, or with several sensors `grasp.mcap#left`.

    A path that names a sensor already is returned as it is. Raises what `Recording` raises.
    """
    plain, name = _split_address(str(path))
    if name:
        return [str(path)]
    with _open_file(plain) as file:
        names = [metadata.name for metadata in _read_structure(file, str(plain))[1]]
    return [f"{plain}#{name}" if name else str(plain) for name in names]


def _split_address(text: str) -> tuple[Path, str]:
    """Return the path of a recording and the name of one of its sensors, which is empty where none is named."""
    match = None if Path(text).exists() else re.fullmatch(r"(.*)#(\w+)", text, re.DOTALL)
    return (Path(text), "") if match is None else (Path(match[1]), match[2])


def _choose_metadata(found: tuple[RecordingMetadata, ...], name: str, path: Path) -> RecordingMetadata:
    """Return the metadata of the sensor that is named, or of the only one; raises `RecordingUnreadable`."""
    chosen = [one for one in found if one.name == name or (not name and len(found) == 1)]
    if not chosen:
        names = ", ".join(one.name for one in found if one.name)
        has = f"one of the sensors {names} of {path}" if names else f"no name of a sensor with {path}, which holds one"
        remedy = f"name it as {path}#{found[0].name}" if names else "drop it"
        raise RecordingUnreadable(f"expected {has}, got {f'{name!r}' if name else 'none'}; {remedy}")
    return chosen[0]


def read_folder_files(folder: Path) -> dict[str, bytes]:
    """Return the content of all files of a folder by their paths in it."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def extract_sensor_folder(recording: Path | str, into: Path) -> Path:
    """Write the sensor folder that a recording carries; raises `RecordingUnreadable` where it carries none."""
    with Recording(recording) as opened:
        return opened.save_sensor_folder(into)


def _open_file(path: Path) -> BinaryIO:
    """Open the file; raises `CameraNotFound` where there is none, and `RecordingUnreadable`."""
    if not path.exists():
        raise CameraNotFound(f"expected a recording at {path}, got no such file; check the path")
    if not path.is_file():
        kind = "a folder" if path.is_dir() else "a pipe or device"
        raise CameraNotFound(
            f"expected a recording at {path}, got {kind}; give a file, because it is read more than once"
        )
    try:
        return path.open("rb")
    except OSError as error:
        raise RecordingUnreadable(f"expected to read {path}, got: {error.strerror}; check its permissions") from error


def _read_structure(file: BinaryIO, name: str) -> tuple[McapIndex, tuple[RecordingMetadata, ...]]:
    """Return the index of a file, and the metadata of every sensor in it; raises `RecordingUnreadable`."""
    try:
        index = index_mcap_records(file, name)
        metadata = _read_metadata(index, file, name)
        complete_mcap_index(index, file, name)
    except (McapError, ValueError, IndexError, MemoryError, struct.error) as error:
        raise RecordingUnreadable(
            f"expected a recording in {name}, got a damaged file ({error}); restore it from a copy"
        ) from error
    return index, metadata


def _read_metadata(index: McapIndex, file: BinaryIO, name: str) -> tuple[RecordingMetadata, ...]:
    records = [Metadata.read(open_record_content(file, span)) for span in index.metadata]
    found = [parse_recording_metadata(one.metadata, name) for one in records if one.name == METADATA_RECORD]
    if len({one.name for one in found}) < len(found):
        raise ValueError("two sensors of the same name")
    if found:
        return tuple(found)
    raise RecordingUnreadable(
        f"expected a recording of ninedtact in {name}, got an MCAP file of another program, or one that was cut short "
        "before it began; record with 'ninedtact record'"
    )
