"""A calibration → a sensor folder."""

from hashlib import sha256
from pathlib import Path

import cv2
import msgspec

from ninedtact.atomic_write import write_file_atomically
from ninedtact.calibration.certificate.html_page import render_certificate_html
from ninedtact.calibration.procedure import Calibration, CalibrationImages
from ninedtact.calibration.sensor_folder import SENSOR_FILE, SensorFolder, create_sensor_folder, to_sensor_toml
from ninedtact.calibration.sensor_record import StoredImage


def save_sensor(out: Path, calibration: Calibration) -> SensorFolder:
    """Write images, record and certificate, all or nothing; an older calibration of that name is replaced.

    Raises `SensorFolderRefused` where something else is in the way, `FileNotWritten` and `OSError` from the disk.
    """
    with create_sensor_folder(out) as folder:
        record = msgspec.structs.replace(calibration.record, images=_save_images(folder, calibration.images))
        write_file_atomically(folder / SENSOR_FILE, to_sensor_toml(record))
        write_file_atomically(folder / "certificate.html", render_certificate_html(calibration).encode())
    return SensorFolder(out, record)


def _save_images(folder: Path, images: CalibrationImages) -> dict[str, StoredImage]:
    """Store the four images losslessly, and what identifies them."""
    (folder / "images").mkdir()
    entries = {}
    for name, image in vars(images).items():
        content = cv2.imencode(".png", image)[1].tobytes()
        entries[name] = StoredImage(f"images/{name}.png", sha256(content).hexdigest())
        write_file_atomically(folder / entries[name].file, content)
    return entries
