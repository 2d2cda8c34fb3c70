"""Saving a sensor folder: `sensor.toml`, the four calibration images and the certificate, either completely or not at all."""

import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields
from hashlib import sha256
from itertools import chain, count
from pathlib import Path

import cv2
import msgspec
import tomli_w

from ninedtact.atomic_write import (
    create_folder_atomically,
    list_foreign_files,
    refuse_working_directory,
    write_file_atomically,
)
from ninedtact.bounds import checks_arguments
from ninedtact.calibration.certificate.checks import has_failed_checks
from ninedtact.calibration.certificate.html_page import render_certificate_html, replace_force_section
from ninedtact.calibration.original_9dtact.folder_format import ORIGINAL_FILES
from ninedtact.calibration.procedure import Calibration, CalibrationImages
from ninedtact.calibration.sensor_folder import SENSOR_FILE, SensorFolder, SensorFolderDamaged, load_sensor
from ninedtact.calibration.sensor_toml_schema import (
    SensorTomlRecord,
    StoredCalibrationImage,
    sensor_record_checksum,
    sensor_record_tables,
)
from ninedtact.checked_reading import CHECKSUM_KEY
from ninedtact.errors import OutputError
from ninedtact.quantities import BgrImage

CERTIFICATE_FILE = "certificate.html"
IMAGE_FOLDER = "images"
PIXEL_MAP_FILE = "rectification.npy"
ORIGINAL_FOLDER = "original_9dtact"
"""Folder in an imported sensor that keeps the original project's files as they were."""
_KNOWN_LOADS = f"{SENSOR_FILE}, known_loads"
_MEASURED_LATER = {
    _KNOWN_LOADS: ("the force calibration with known loads", "ninedtact adapt"),
    "force.toml": ("the factors of force models from known loads", "ninedtact adapt"),
    "camera.toml": ("the delay of the camera", "ninedtact camera-delay"),
}
"""What is measured after a calibration, by its file in the folder, or its table there (`calibration.force_calibration`,
`force.estimator_and_scale`, `capture.camera_delay`), and the command that measures it."""


class SensorFolderNotReplaceable(OutputError):
    """A sensor cannot be written there without overwriting something else."""


@checks_arguments
def save_sensor(out: Path | str, calibration: Calibration) -> SensorFolder:
    """Write a calibration as a sensor folder, all or nothing; an older sensor folder at `out` is replaced.

    A calibration whose checks failed replaces only one whose checks failed as well. Otherwise the older one stays, and the failed
    one is written beside it, to `OUT_failed`; the returned folder has that path. Raises `SensorFolderNotReplaceable` where
    something else is in the way, `FileNotWritten` and `OSError` from the disk.

    >>> folder = ninedtact.save_sensor(Path("my_sensor"), ninedtact.calibrate(images))
    """
    final = _choose_folder(Path(out), calibration.record)
    with create_sensor_folder(final) as folder:
        if calibration.imported is not None:
            _copy_imported_files(folder, calibration.imported)
        record = msgspec.structs.replace(calibration.record, images=_save_images(folder, calibration.images))
        write_file_atomically(folder / SENSOR_FILE, to_sensor_toml(record))
        write_file_atomically(folder / CERTIFICATE_FILE, render_certificate_html(calibration).encode())
    return SensorFolder(final, record)


def save_known_loads(folder: SensorFolder) -> Path:
    """Write a sensor's file and the force section of its certificate after a calibration with known loads; return the file.

    Raises `FileNotWritten` and `OSError` from the disk.
    """
    write_file_atomically(folder.path / SENSOR_FILE, to_sensor_toml(folder.record))
    certificate = folder.path / CERTIFICATE_FILE
    if certificate.is_file():
        page = replace_force_section(certificate.read_text(encoding="utf-8"), folder.record)
        write_file_atomically(certificate, page.encode())
    return folder.path / SENSOR_FILE


def failed_calibration_notices(out: Path, saved: SensorFolder) -> list[str]:
    """Return a sentence where `save_sensor` has kept the older sensor at `out` and written a failed calibration beside it."""
    if saved.path == out:
        return []
    return [f"the new calibration failed its checks and is saved in {saved.path}; {out} keeps the older calibration"]


def _choose_folder(out: Path, record: SensorTomlRecord) -> Path:
    """Return the folder to which a calibration is written: `out`, or one beside it where a failed one would replace a better one.

    The one beside it is named `OUT_failed`, with a number where that holds anything but a failed calibration. Raises
    `SensorFolderNotReplaceable` where `out` cannot be replaced at all.
    """
    require_replaceable_sensor_folder(out)
    if not has_failed_checks(record.certificate):
        return out
    endings = chain(["_failed"], (f"_failed_{number}" for number in count(2)))
    beside = (out.with_name(out.name + ending) for ending in endings)
    return next(folder for folder in chain([out], beside) if _has_nothing_better(folder))


def _has_nothing_better(folder: Path) -> bool:
    """Return whether a failed calibration may be written to a folder, which is new or empty, or holds one that failed as well.

    A calibration that cannot be read, as one of an older format, may be a good one.
    """
    try:
        require_replaceable_sensor_folder(folder)
        return not (folder / SENSOR_FILE).exists() or has_failed_checks(load_sensor(folder).record.certificate)
    except (SensorFolderNotReplaceable, SensorFolderDamaged):
        return False


def _copy_imported_files(folder: Path, imported: SensorFolder) -> None:
    """Copy the rectification of an imported sensor, and the original project's files where they were kept."""
    shutil.copyfile(imported.path / PIXEL_MAP_FILE, folder / PIXEL_MAP_FILE)
    if (imported.path / ORIGINAL_FOLDER).is_dir():
        shutil.copytree(imported.path / ORIGINAL_FOLDER, folder / ORIGINAL_FOLDER)


def _save_images(folder: Path, images: CalibrationImages) -> dict[str, StoredCalibrationImage]:
    """Store the images losslessly; return their paths in the folder and their hashes."""
    (folder / IMAGE_FOLDER).mkdir()
    entries = {}
    for name, image in vars(images).items():
        if image is None:
            continue
        content = _encode_png(image)
        entries[name] = StoredCalibrationImage(f"{IMAGE_FOLDER}/{name}.png", sha256(content).hexdigest())
        write_file_atomically(folder / entries[name].file, content)
    return entries


def save_images_beside(out: Path, images: Mapping[str, BgrImage]) -> Path:
    """Write calibration images by their names into a new folder beside a sensor folder, and return that folder.

    It is named `OUT_images`, with a number where that is taken. Raises `FileNotWritten` and `OSError` from the disk.
    """
    name = f"{out.name}_{IMAGE_FOLDER}"
    names = chain([name], (f"{name}_{number}" for number in count(2)))
    folder = next(each for each in map(out.with_name, names) if not each.exists())
    with create_folder_atomically(folder) as partial:
        for name, image in images.items():
            write_file_atomically(partial / f"{name}.png", _encode_png(image))
    return folder


def _encode_png(image: BgrImage) -> bytes:
    return cv2.imencode(".png", image)[1].tobytes()


def to_sensor_toml(record: SensorTomlRecord) -> bytes:
    """Return the record as the text of `sensor.toml`, with the checksum of its numbers."""
    return tomli_w.dumps({CHECKSUM_KEY: sensor_record_checksum(record), **sensor_record_tables(record)}).encode()


def list_later_measurements(folder: Path) -> frozenset[str]:
    """Return the files of a sensor folder that were measured after its calibration, and that a new calibration removes."""
    files = {file for file in _MEASURED_LATER if (folder / file).is_file()}
    return frozenset(files | ({_KNOWN_LOADS} if _knows_loads(folder) else set()))


def _knows_loads(folder: Path) -> bool:
    """Return whether a folder holds a sensor whose gel was calibrated with known loads."""
    try:
        return load_sensor(folder).record.known_loads is not None
    except SensorFolderDamaged:
        return False


def removal_notices(folder: Path, before: frozenset[str]) -> list[str]:
    """Return a sentence for each file of `list_later_measurements` that was in a sensor folder before and is not there now."""
    removed = sorted(before - list_later_measurements(folder))
    return [
        f"{meaning} ({folder / file}) was removed with the older calibration, to which it belonged; run '{command}' again"
        for file, (meaning, command) in ((file, _MEASURED_LATER[file]) for file in removed)
    ]


@contextmanager
def create_sensor_folder(out: Path | str) -> Iterator[Path]:
    """Yield a folder to fill, which takes the place of `out` when the block ends without an error.

    A sensor that was at `out` is replaced; raises `SensorFolderNotReplaceable` where anything else is.
    """
    final = Path(out)
    require_replaceable_sensor_folder(final)
    with create_folder_atomically(final) as partial:
        yield partial


def require_replaceable_sensor_folder(final: Path) -> None:
    """Raise `SensorFolderNotReplaceable` unless the folder is new, empty, or a sensor folder with nothing else in it, and
    `FileNotWritten` for the working directory and the folders above it."""
    refuse_working_directory(final)
    is_sensor = (final / SENSOR_FILE).is_file()
    if foreign := list_foreign_files(final, lambda file: is_sensor and _is_sensor_file(file)):
        raise SensorFolderNotReplaceable(
            expected="to write a new or empty folder, or a sensor folder",
            got=f"{final} with other content ({foreign[0]})",
            remedy="move that away, or choose another name",
        )


def _is_sensor_file(file: str) -> bool:
    """Return whether a path within a sensor folder is one that this program writes there."""
    images = (f"{IMAGE_FOLDER}/{field.name}.png" for field in fields(CalibrationImages))
    originals = (f"{ORIGINAL_FOLDER}/{original}" for original in ORIGINAL_FILES)
    return file in (SENSOR_FILE, CERTIFICATE_FILE, PIXEL_MAP_FILE, *_MEASURED_LATER, *images, *originals)
