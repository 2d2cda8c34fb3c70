"""A sensor's folder → the calibration that its own images give, by any method."""

from ninedtact.calibration.ball.fit import Method
from ninedtact.calibration.flow import Calibration, CalibrationImages, CalibrationSettings, LensKind, calibrate
from ninedtact.calibration.record import PinTable
from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.capture.images import read_image


def calibrated_again(folder: SensorFolder, method: Method) -> Calibration:
    """Calibrate from the stored images, with the stored design, lens and mounting.

    Raises `SensorFolderDamaged` where images are missing (imported sensors have none), and what `calibrate` raises.
    """
    names = CalibrationImages.__dataclass_fields__
    images = CalibrationImages(**{name: folder.image(name, read_image).image for name in names})
    record = folder.record
    lens: LensKind = "paper" if isinstance(record.lens, PinTable) else "lens"
    settings = CalibrationSettings(lens, record.grid.mounting_deg, method, record.depth.smoothing)
    return calibrate(images, record.design, settings, record.id)
