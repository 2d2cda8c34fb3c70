"""A calibrated sensor on disk: `sensor.toml`, `images/`, `certificate.html`."""

import tomllib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from pathlib import Path

import msgspec
import numpy as np
import tomli_w

from ninedtact.atomic_write import create_folder_atomically, list_foreign_files
from ninedtact.calibration.brightness import BgrImage
from ninedtact.calibration.sensor_record import SENSOR_FORMAT, LensModelTable, PinMapTable, PixelMapTable, SensorRecord
from ninedtact.errors import NinedtactError
from ninedtact.quantities import Frame
from ninedtact.shape.calibrated import CalibratedShape
from ninedtact.shape.lens import LensModel, Projection
from ninedtact.shape.pin_map import PinMap
from ninedtact.shape.rectification import Rectification, rectification

SENSOR_FILE = "sensor.toml"
SENSOR_FILES, SENSOR_SUBFOLDERS = (
    (SENSOR_FILE, "certificate.html", "rectification.npy", "force.toml"),
    ("images/", "upstream/"),
)
"""All that a sensor folder holds: this, its page, the map of one that was imported, what weighed presses told; the images, and
what was imported as it was."""
FARTHEST_PER_MM = 1e-4
"""Inverse distance below which lines of sight count as parallel."""


class SensorFolderDamaged(NinedtactError):
    """The folder is not a sensor, or something in it is missing, changed or from a newer program."""


class SensorFolderNotReplaceable(NinedtactError):
    """A sensor cannot be written there without overwriting something else."""


@dataclass(frozen=True)
class SensorFolder:
    """One sensor's folder, read and checked."""

    path: Path
    record: SensorRecord

    @property
    def id(self) -> str:
        """Name of the sensor."""
        return self.record.id

    @cached_property
    def shape(self) -> CalibratedShape:
        """The calibrated path from frame to height."""
        depth = self.record.depth
        return CalibratedShape(
            self.rectification,
            depth.curve,
            depth.noise_mm,
            self.sight_distance_mm,
            depth.smoothing,
            depth.loss,
            depth.deblurring,
        )

    @property
    def sight_distance_mm(self) -> float:
        """From where the skin is looked at: as the physics of its ball press has it, else as designed."""
        if self.record.depth.method != "physics" or self.record.twin is None:
            return self.record.design.camera.distance_mm
        nearness = self.record.twin.light.inverse_distance_per_mm
        return 1 / nearness if nearness > FARTHEST_PER_MM else float("inf")

    @cached_property
    def rectification(self) -> Rectification:
        """The lens on the grid; raises `SensorFolderDamaged`."""
        grid, lens = self.record.grid, self.record.lens
        raw_shape = (grid.raw_rows, grid.raw_cols)
        if isinstance(lens, PixelMapTable):
            source_px = _read_pixel_map(self.verified(lens.file, lens.sha256), self.record)
            return Rectification(source_px, grid.mm_per_px, raw_shape, grid.calibrated_area_mm)
        field_of_view = self.record.design.field_of_view
        return rectification(
            build_projection(lens, raw_shape), field_of_view, grid.mm_per_px, raw_shape, grid.calibrated_area_mm
        )

    def image(self, name: str, read: Callable[[Path], BgrImage]) -> Frame:
        """An image that the sensor was calibrated from (`board`, `ball_reference`, …), read by the given reader."""
        if name not in self.record.images:
            raise SensorFolderDamaged(
                f"expected {self.path} to hold the image {name!r}, got a sensor without it (imported?); calibrate again"
            )
        entry = self.record.images[name]
        return Frame(read(self.verified(entry.file, entry.sha256)))

    def verified(self, file: str, digest: str) -> Path:
        """Path of a file of the folder whose content is what was written."""
        path = self.path / file
        if not path.is_file():
            raise SensorFolderDamaged(
                f"expected {path}, got no such file; restore the sensor folder or calibrate again"
            )
        if sha256(path.read_bytes()).hexdigest() != digest:
            raise SensorFolderDamaged(
                f"expected {path} as it was calibrated with, got other content; restore the sensor folder or calibrate again"
            )
        return path


def load_sensor(folder: Path | str) -> SensorFolder:
    """Read and check a sensor folder; raises `SensorFolderDamaged`."""
    path = Path(folder)
    try:
        text = (path / SENSOR_FILE).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as trouble:
        raise SensorFolderDamaged(
            f"expected a sensor folder with a readable {SENSOR_FILE}, got {path} ({trouble}); give the folder that "
            "'ninedtact calibrate --out' wrote"
        ) from trouble
    return SensorFolder(path, _parse_record(path / SENSOR_FILE, text))


def _parse_record(path: Path, text: str) -> SensorRecord:
    """The record in a file's text, every field checked."""
    try:
        table = tomllib.loads(text)
        _require_current_format(path, table)
        return msgspec.convert(table, SensorRecord)
    except (tomllib.TOMLDecodeError, msgspec.ValidationError, RecursionError) as trouble:
        raise _make_damaged_error(path, trouble) from trouble
    except NinedtactError as trouble:
        if isinstance(trouble, SensorFolderDamaged):
            raise
        raise _make_damaged_error(path, trouble) from trouble


def _make_damaged_error(path: Path, trouble: Exception) -> SensorFolderDamaged:
    """The refusal of a record that cannot be understood."""
    return SensorFolderDamaged(
        f"expected {path} as the program wrote it, got: {trouble}; restore the sensor folder or calibrate again"
    )


def _require_current_format(path: Path, table: dict[str, object]) -> None:
    """Refuse a file from a newer program."""
    version = table.get("format")
    if isinstance(version, int) and version > SENSOR_FORMAT:
        raise SensorFolderDamaged(
            f"expected {path} in format {SENSOR_FORMAT} or older, got format {version} from a newer ninedtact; update ninedtact"
        )


def build_projection(lens: LensModelTable | PinMapTable, raw_shape: tuple[int, int]) -> Projection:
    """The lens that a table describes."""
    if isinstance(lens, LensModelTable):
        return LensModel(lens.homography, lens.centre, lens.radial, lens.tangential, raw_shape)
    return PinMap(np.array(lens.points_mm), np.array(lens.points_px))


def _read_pixel_map(path: Path, record: SensorRecord) -> np.ndarray:
    """A stored rectification, float32 (rows, cols, 2)."""
    view = record.design.field_of_view
    source_px = np.load(path, allow_pickle=False)
    if source_px.shape != (view.rows, view.cols, 2):
        raise SensorFolderDamaged(
            f"expected {path} of shape {(view.rows, view.cols, 2)}, got {source_px.shape}; restore the sensor folder"
        )
    return np.asarray(source_px, np.float32)


def to_sensor_toml(record: SensorRecord) -> bytes:
    """The record as the text of `sensor.toml`."""
    return tomli_w.dumps(msgspec.to_builtins(record, builtin_types=(type(record.created),))).encode()


@contextmanager
def create_sensor_folder(out: Path | str) -> Iterator[Path]:
    """A folder to fill, which takes the place of `out` when the block ends well; a sensor that was there is replaced."""
    final = Path(out)
    require_replaceable_folder(final)
    with create_folder_atomically(final) as partial:
        yield partial


def require_replaceable_folder(final: Path) -> None:
    """Only an empty folder, or a sensor with nothing else in it, is replaced."""
    is_sensor = (final / SENSOR_FILE).is_file()
    if strange := list_foreign_files(final, lambda file: is_sensor and _is_sensor_file(file)):
        raise SensorFolderNotReplaceable(
            f"expected to write a new or empty folder, or a sensor folder, got {final} with other content ({strange[0]}); move "
            "that away, or choose another name"
        )


def _is_sensor_file(file: str) -> bool:
    """Whether a sensor folder's file is one that this program writes there."""
    return file in SENSOR_FILES or file.startswith(SENSOR_SUBFOLDERS)
