"""A calibration → a sensor folder."""

from hashlib import sha256
from pathlib import Path

import cv2
import msgspec

from ninedtact.calibration.certificate.page import certificate_html
from ninedtact.calibration.flow import Calibration, CalibrationPictures
from ninedtact.calibration.record import Picture
from ninedtact.calibration.sensor_folder import RECORD, SensorFolder, new_sensor_folder, record_toml
from ninedtact.whole_file import write_whole


def write_sensor(out: Path, calibration: Calibration) -> SensorFolder:
    """Write pictures, record and certificate, all or nothing; an older calibration of that name is replaced.

    Raises `SensorFolderRefused` where something else is in the way, `FileNotWritten` and `OSError` from the disk.
    """
    with new_sensor_folder(out) as folder:
        record = msgspec.structs.replace(calibration.record, pictures=write_pictures(folder, calibration.pictures))
        write_whole(folder / RECORD, record_toml(record))
        write_whole(folder / "certificate.html", certificate_html(calibration).encode())
    return SensorFolder(out, record)


def write_pictures(folder: Path, pictures: CalibrationPictures) -> dict[str, Picture]:
    """Store the four pictures losslessly, and what identifies them."""
    (folder / "pictures").mkdir()
    entries = {}
    for name, image in vars(pictures).items():
        content = cv2.imencode(".png", image)[1].tobytes()
        entries[name] = Picture(f"pictures/{name}.png", sha256(content).hexdigest())
        write_whole(folder / entries[name].file, content)
    return entries
