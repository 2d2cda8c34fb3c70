"""Recordings of `ninedtact collect`: raw images, rectified here with the sensor's folder that rides along."""

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from jaxtyping import Float32, UInt8
from numpy import ndarray as Array

from ninedtact.capture.image_and_video_files import natural_sort_key
from ninedtact.dataset.generation.pair import png
from ninedtact.dataset.rows import Fault, Item, LeftOut, Row, UntouchedImage
from ninedtact.dataset.sources.source import Part, Source, name_of
from ninedtact.errors import NinedtactError
from ninedtact.quantities import Frame
from ninedtact.recording.saved_pairs import ReferenceImages, SavedPair
from ninedtact.shape.calibrated import mean_rectified
from ninedtact.shape.rectification import Rectification

SUFFIX = ".mcap"
SensorReader = Callable[[Path], Rectification]
"""A sensor's folder → how its images are rectified. The room of calibrations, which knows, stands beside this one."""


@dataclass(frozen=True)
class EpisodePart(Part):
    """One recording."""

    file: Path
    name: str
    read_sensor: SensorReader
    sensor_folder: Path | None

    def items(self) -> Iterator[Item]:
        """Its saved pairs, and the untouched skin before each stretch of them."""
        try:
            yield from self.pairs()
        except NinedtactError as trouble:
            yield LeftOut(Fault.UNREADABLE, f"{self.source}/{self.name}", str(trouble))

    def pairs(self) -> Iterator[Item]:
        """The same; raises what reading does."""
        from ninedtact.recording.saved_pairs import read_saved_pairs

        rectify = self.rectification()
        told: set[str] = set()
        steps: Counter[str] = Counter()
        for pair in read_saved_pairs(self.file):
            if pair.untouched.id not in told:
                told.add(pair.untouched.id)
                yield untouched_image(pair.untouched, pair.sensor, rectify)
            yield self.row(pair, steps[pair.contact], rectify)
            steps[pair.contact] += 1

    def rectification(self) -> Rectification:
        """Of the sensor that was named, or that rides along; raises `RecordingUnreadable`, `SensorFolderDamaged`."""
        from ninedtact.recording.reader import restore_sensor_folder

        if self.sensor_folder is not None:
            return self.read_sensor(self.sensor_folder)
        with TemporaryDirectory() as folder:
            return self.read_sensor(restore_sensor_folder(self.file, Path(folder) / "sensor"))

    def row(self, pair: SavedPair, step: int, rectify: Rectification) -> Row:
        """One pair."""
        stamps = pair.wrench.stamp_ns, pair.time_ns
        return Row(
            id=f"{pair.contact}/{step:03d}",
            image=png(whole_levels(rectify(Frame(pair.image)).grey)),
            reference=pair.untouched.id,
            wrench=pair.wrench.about(np.zeros(3)).six.astype(np.float32),
            object=pair.object,
            contact=pair.contact,
            step=step,
            time_ns=pair.time_ns,
            sensor=pair.sensor,
            kind=pair.kind,
            source=self.source,
            mm_per_px=rectify.mm_per_px,
            gap_ms=(stamps[0] - stamps[1]) / 1e6 if all(stamps) else None,
        )


def untouched_image(skin: ReferenceImages, sensor: str, rectify: Rectification) -> UntouchedImage:
    """The mean of its images, as the live sensor takes it."""
    mean = mean_rectified([rectify(Frame(image)) for image in skin.images])
    return UntouchedImage(skin.id, png(whole_levels(mean.grey)), sensor)


def whole_levels(grey: Float32[Array, "rows cols"]) -> UInt8[Array, "rows cols"]:
    """As a file keeps them."""
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8)


@dataclass(frozen=True)
class EpisodesSource(Source):
    """One recording, or a folder of them."""

    read_sensor: SensorReader
    what = "recordings of 'ninedtact collect'"

    def files(self) -> list[Path]:
        """All recordings."""
        if self.path.is_file():
            return [self.path]
        found = (path for path in self.path.rglob(f"*{SUFFIX}") if not path.name.startswith("."))
        return sorted(found, key=lambda path: (natural_sort_key(path.relative_to(self.path)), path))

    def parts(self) -> list[Part]:
        """One for each recording."""
        return [
            EpisodePart(self.name, file, name_of(file, self.root), self.read_sensor, self.statements.sensor_folder)
            for file in self.files()
        ]
