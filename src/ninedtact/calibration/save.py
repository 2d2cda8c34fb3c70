"""A calibration → a sensor folder."""

from hashlib import sha256
from pathlib import Path

import cv2
import msgspec

from ninedtact.atomic_write import write_file_atomically
from ninedtact.calibration.certificate.html_page import certificate_html
from ninedtact.calibration.procedure import Calibration, CalibrationImages
from ninedtact.calibration.sensor_folder import RECORD, SensorFolder, new_sensor_folder, record_toml
from ninedtact.calibration.sensor_record import Image


def write_sensor(out: Path, calibration: Calibration) -> SensorFolder:
    """Write images, record and certificate, all or nothing; an older calibration of that name is replaced.

    Raises `SensorFolderRefused` where something else is in the way, `FileNotWritten` and `OSError` from the disk.
    """
    with new_sensor_folder(out) as folder:
        record = msgspec.structs.replace(calibration.record, images=write_images(folder, calibration.images))
        write_file_atomically(folder / RECORD, record_toml(record))
        write_file_atomically(folder / "certificate.html", certificate_html(calibration).encode())
    return SensorFolder(out, record)


def write_images(folder: Path, images: CalibrationImages) -> dict[str, Image]:
    """Store the four images losslessly, and what identifies them."""
    (folder / "images").mkdir()
    entries = {}
    for name, image in vars(images).items():
        content = cv2.imencode(".png", image)[1].tobytes()
        entries[name] = Image(f"images/{name}.png", sha256(content).hexdigest())
        write_file_atomically(folder / entries[name].file, content)
    return entries
