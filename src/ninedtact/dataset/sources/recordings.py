"""Recordings of `ninedtact collect`: raw images, rectified here with the sensor folder that is attached to the recording."""

from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from jaxtyping import Float32
from numpy import ndarray as Array

from ninedtact.calibration.sensor_folder import load_sensor
from ninedtact.dataset.quality_report import PairFault
from ninedtact.dataset.schema import DatasetRow, ReferenceImage, RejectedItem, SourceItem
from ninedtact.dataset.sources.source import Source, SourcePart, find_source_files, relative_name
from ninedtact.dataset.stored_images import encode_png
from ninedtact.errors import NinedtactError
from ninedtact.quantities import Frame
from ninedtact.recording.saved_pairs import SavedPair, TareReferenceImages
from ninedtact.shape.calibrated_shape import mean_rectified_image
from ninedtact.shape.rectification import Rectification

RECORDING_SUFFIX = ".mcap"


@dataclass(frozen=True)
class _RecordingPart(SourcePart):
    """One recording."""

    file: Path
    name: str
    sensor_folder: Path | None
    """Sensor folder that replaces the attached one."""

    def items(self) -> Iterator[SourceItem]:
        """Yield the saved pairs and, before each stretch of them, their reference image."""
        try:
            yield from self._pairs()
        except NinedtactError as error:
            yield RejectedItem(PairFault.UNREADABLE, f"{self.source}/{self.name}", str(error))

    def _pairs(self) -> Iterator[SourceItem]:
        """Yield the saved pairs and their reference images; raises what reading raises."""
        from ninedtact.recording.saved_pairs import read_saved_pairs

        rectify = self._load_rectification()
        known: set[str] = set()
        steps: Counter[str] = Counter()
        for pair in read_saved_pairs(self.file):
            if pair.reference.id not in known:
                known.add(pair.reference.id)
                yield _mean_reference(pair.reference, pair.sensor, rectify)
            yield self._make_row(pair, steps[pair.contact], rectify)
            steps[pair.contact] += 1

    def _load_rectification(self) -> Rectification:
        """Return the rectification of the given or attached sensor folder; raises `RecordingUnreadable`, `SensorFolderDamaged`."""
        from ninedtact.recording.reader import extract_sensor_folder

        if self.sensor_folder is not None:
            return load_sensor(self.sensor_folder).rectification
        with TemporaryDirectory() as folder:
            return load_sensor(extract_sensor_folder(self.file, Path(folder) / "sensor")).rectification

    def _make_row(self, pair: SavedPair, step: int, rectify: Rectification) -> DatasetRow:
        stamps_ns = pair.wrench.stamp_ns, pair.time_ns
        return DatasetRow(
            id=f"{pair.contact}/{step:03d}",
            image=_encode_grey_levels(rectify(Frame(pair.image)).grey),
            reference_id=pair.reference.id,
            wrench=pair.wrench.about(np.zeros(3)).six.astype(np.float32),
            object=pair.object,
            contact_id=pair.contact,
            step=step,
            time_ns=pair.time_ns,
            sensor=pair.sensor,
            kind=pair.kind,
            source=self.source,
            mm_per_px=rectify.mm_per_px,
            wrench_delay_ms=(stamps_ns[0] - stamps_ns[1]) / 1e6 if all(stamps_ns) else None,
        )


def _mean_reference(references: TareReferenceImages, sensor: str, rectify: Rectification) -> ReferenceImage:
    """Return the mean of the reference images, as the live sensor computes it."""
    mean = mean_rectified_image([rectify(Frame(image)) for image in references.images])
    return ReferenceImage(references.id, _encode_grey_levels(mean.grey), sensor)


def _encode_grey_levels(grey: Float32[Array, "rows cols"]) -> bytes:
    """Return a grey image, rounded to whole levels, as a PNG file."""
    return encode_png(np.clip(np.rint(grey), 0, 255).astype(np.uint8))


@dataclass(frozen=True)
class RecordingsSource(Source):
    """One recording, or a folder of recordings."""

    description = "recordings of 'ninedtact collect'"

    def files(self) -> list[Path]:
        """Return the files of all recordings."""
        return find_source_files(self.path, RECORDING_SUFFIX)

    def sensor_folders(self) -> Iterator[tuple[str, dict[str, bytes]]]:
        """Yield the sensor of each recording with its attached folder, or with the one that was given in its place."""
        from ninedtact.recording.reader import Recording, read_folder

        given = self.conventions.sensor_folder
        for file in self.files():
            with suppress(NinedtactError), Recording(file) as recording:  # one that cannot be read is in the report
                yield recording.sensor, recording.sensor_files() if given is None else read_folder(given)

    def parts(self) -> list[SourcePart]:
        """Return one part for each recording."""
        folder = self.conventions.sensor_folder
        return [_RecordingPart(self.name, file, relative_name(file, self.root), folder) for file in self.files()]
