"""A sensor's folder → the calibration that its own pictures give, by any method."""

from ninedtact.calibration.ball.fit import Method
from ninedtact.calibration.flow import Calibration, CalibrationPictures, CalibrationSettings, LensKind, calibrate
from ninedtact.calibration.record import PinTable
from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.capture.pictures import read_picture


def calibrated_again(folder: SensorFolder, method: Method) -> Calibration:
    """Calibrate from the stored pictures, with the stored design, lens and mounting.

    Raises `SensorFolderDamaged` where pictures are missing (imported sensors have none), and what `calibrate` raises.
    """
    names = CalibrationPictures.__dataclass_fields__
    pictures = CalibrationPictures(**{name: folder.picture(name, read_picture).image for name in names})
    record = folder.record
    lens: LensKind = "paper" if isinstance(record.lens, PinTable) else "lens"
    settings = CalibrationSettings(lens, record.grid.mounting_deg, method, record.depth.smoothing)
    return calibrate(pictures, record.design, settings, record.id)
