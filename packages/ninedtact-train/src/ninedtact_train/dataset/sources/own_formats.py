"""Sources of pairs in this software's own formats.

Recordings of `ninedtact collect` hold raw images, which are rectified here with the sensor folder that is attached to the
recording. An existing data set, built or generated, holds rectified images, which are copied byte by byte.
"""

from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32
from numpy import ndarray as Array

from ninedtact.calibration.sensor_folder import load_sensor
from ninedtact.capture.frame_source import SourceIncomplete
from ninedtact.capture.strict_image_reading import encode_png
from ninedtact.errors import InputError, NinedtactError
from ninedtact.quantities import NO_OBJECT, Frame
from ninedtact.shape.calibrated_shape import mean_rectified_image
from ninedtact.shape.lens_and_rectification import Rectification
from ninedtact_train.collecting.collected_pairs import RecordedPair, TareReferenceImages, read_recorded_pairs
from ninedtact_train.dataset.fault_report import PairFault, PairFinding
from ninedtact_train.dataset.folder import (
    REFERENCES_FILE,
    SENSOR_FOLDERS,
    find_pair_files,
    find_sensor_folders,
    read_dataset_settings,
    read_sensor_parameters,
)
from ninedtact_train.dataset.parquet_files import (
    StoredImageUnreadable,
    decode_stored_image,
    decode_stored_wrench,
    iterate_rows,
    stored_image_bytes,
)
from ninedtact_train.dataset.schema import DatasetRow, ReferenceImage, SourceItem
from ninedtact_train.dataset.sources.source import Source, find_files_with_suffix

RECORDING_SUFFIX = ".mcap"


@dataclass(frozen=True)
class RecordingsSource(Source):
    """A source of the pairs collected in one recording, or in a folder of recordings."""

    description = "recordings of 'ninedtact collect'"

    def files(self) -> list[Path]:
        """Return the files of all recordings."""
        return find_files_with_suffix(self.path, RECORDING_SUFFIX)

    def sensor_folders(self) -> Iterator[tuple[str, dict[str, bytes], Path]]:
        """Yield the sensor of each recording with its attached folder, or with the one that was given in its place."""
        from ninedtact.recording.attached_sensor import read_folder_files
        from ninedtact.recording.reader import Recording

        given = self.conventions.sensor
        for file in self.files():
            with suppress(NinedtactError), Recording(file) as recording:  # one that cannot be read is in the report
                files = recording.sensor_files() if given is None else read_folder_files(given)
                yield recording.sensor, files, file

    def items(self, part: Path) -> Iterator[SourceItem]:
        """Yield the saved pairs and, before each stretch of them, their reference image; last, what is wrong with the file."""
        try:
            yield from self._pairs(part)
        except SourceIncomplete as error:
            yield PairFinding(PairFault.MISSING_END, self.name_of(part), str(error))
        except NinedtactError as error:
            yield PairFinding(PairFault.UNREADABLE, self.name_of(part), str(error))

    def _pairs(self, file: Path) -> Iterator[SourceItem]:
        rectify = self._load_rectification(file)
        known: set[str] = set()
        steps: Counter[str] = Counter()
        for pair in read_recorded_pairs(file):
            if pair.reference.id not in known:
                known.add(pair.reference.id)
                yield _mean_reference(pair.reference, pair.sensor, rectify)
            yield self._make_row(pair, steps[pair.contact], rectify)
            steps[pair.contact] += 1

    def _load_rectification(self, file: Path) -> Rectification:
        """Return the rectification of the given or attached sensor folder.

        Raises `RecordingUnreadable`, `SensorFolderDamaged`, and `InputError` where the given folder is that of another sensor.
        """
        from ninedtact.recording.reader import Recording

        with Recording(file) as recording:
            if self.conventions.sensor is None:
                with recording.unpacked_sensor() as own:
                    return own.rectification
            given = load_sensor(self.conventions.sensor)
            if recording.sensor_files() and recording.sensor != given.id:
                raise InputError(
                    expected=f"the sensor folder of {recording.sensor!r}, which took these images",
                    got=f"that of {given.id!r}",
                    remedy="build the recordings of one sensor at a time, or without --sensor",
                )
            return given.rectification

    def _make_row(self, pair: RecordedPair, step: int, rectify: Rectification) -> DatasetRow:
        stamps_ns = pair.wrench.stamp_ns, pair.time_ns
        return DatasetRow(
            id=f"{pair.contact}/{step:03d}",
            image=_encode_grey_levels(rectify(Frame(pair.image)).grey),
            reference_id=pair.reference.id,
            wrench=pair.wrench.about_skin_centre().six.astype(np.float32),
            object=pair.object,
            contact_id=pair.contact,
            step=step,
            time_ns=pair.time_ns,
            sensor=pair.sensor,
            kind=pair.kind,
            source=self.name,
            mm_per_px=rectify.mm_per_px,
            wrench_delay_ms=(stamps_ns[0] - stamps_ns[1]) / 1e6 if all(stamps_ns) else None,
        )


def _mean_reference(references: TareReferenceImages, sensor: str, rectify: Rectification) -> ReferenceImage:
    mean = mean_rectified_image([rectify(Frame(image)) for image in references.images])
    return ReferenceImage(references.id, _encode_grey_levels(mean.grey), sensor)


def _encode_grey_levels(grey: Float32[Array, "rows cols"]) -> bytes:
    """Return a grey image, rounded to whole levels, as a PNG file."""
    return encode_png(np.clip(np.rint(grey), 0, 255).astype(np.uint8))


@dataclass(frozen=True)
class ExistingDatasetSource(Source):
    """A source of the pairs of another data set in the current format."""

    several: bool = False
    """Whether the name of the source must precede the ids, because there are several sources."""
    description = "a data set in these columns"

    def statement_lines(self) -> Iterator[str]:
        """Yield the seeds of a generated data set."""
        settings = self._settings
        if "objects_seed" in settings:
            seeds = f"seed {settings.get('seed')}, objects' seed {self._objects_seed}"
            yield f"generated by ninedtact {settings.get('ninedtact')}, {seeds}"

    def files(self) -> list[Path]:
        """Return the files of pairs and of reference images."""
        return [*self.parts(), self.path / REFERENCES_FILE]

    def parts(self) -> list[Path]:
        """Return the files of pairs."""
        return find_pair_files(self.path)

    def items(self, part: Path) -> Iterator[SourceItem]:
        """Yield the reference images that the rows of a file name, then its rows."""
        wanted = {row["reference_id"] for row in iterate_rows(part, ["reference_id"])}
        for row in iterate_rows(self.path / REFERENCES_FILE):
            if row["reference_id"] in wanted:
                name = self._make_unique(row["reference_id"])
                yield ReferenceImage(name, stored_image_bytes(row["image"]) or b"", row["sensor"] or "")
        yield from map(self._read_row, iterate_rows(part))

    def _read_row(self, row: dict[str, Any]) -> DatasetRow | PairFinding:
        row_id, content, reference_id = (
            self._make_unique(row["id"]),
            stored_image_bytes(row["image"]),
            row["reference_id"],
        )
        try:
            decode_stored_image(content)
        except StoredImageUnreadable as error:
            fault = PairFault.UNREADABLE if content else PairFault.MISSING_IMAGE
            return PairFinding(fault, row_id, f"image: {error}")
        return DatasetRow(
            id=row_id,
            image=content or b"",
            reference_id=None if reference_id is None else self._make_unique(reference_id),
            wrench=decode_stored_wrench(row["wrench"]),
            object=self._object_name(row["object"] or NO_OBJECT),
            contact_id=self._make_unique(row["contact_id"] or row["id"]),
            step=row["step"] or 0,
            time_ns=row["time_ns"],
            sensor=row["sensor"] or self.name,
            kind=row["kind"] or "rule",
            source=self._make_unique(row["source"]) if row["source"] else self.name,
            mm_per_px=row["mm_per_px"],
            wrench_delay_ms=row["wrench_delay_ms"],
        )

    def _make_unique(self, own: str) -> str:
        return f"{self.name}/{own}" if self.several else own

    def _object_name(self, name: str) -> str:
        """Return a name that identifies one shape: a name and a seed of generated objects are one."""
        return name if name == NO_OBJECT or not self._objects_seed else f"{name}@{self._objects_seed}"

    def sensor_folders(self) -> Iterator[tuple[str, dict[str, bytes], Path]]:
        """Yield each sensor that was calibrated with the files of its folder."""
        from ninedtact.recording.attached_sensor import read_folder_files

        for folder in find_sensor_folders(self.path / SENSOR_FOLDERS):
            yield folder.name, read_folder_files(folder), folder

    def simulated_sensors(self) -> list[dict[str, Any]]:
        """Return all parameters of its simulated sensors; raises `FileFormatError`."""
        return read_sensor_parameters(self.path)

    @cached_property
    def _settings(self) -> dict[str, Any]:
        return read_dataset_settings(self.path)

    @property
    def _objects_seed(self) -> int:
        """Seed of the generated objects; zero in a data set that was not generated."""
        seed = self._settings.get("objects_seed", 0)
        return seed if isinstance(seed, int) else 0
