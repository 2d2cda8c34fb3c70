"""Whether the reference image of a session belongs to the calibrated sensor, checked once before anything is measured against it.

Heights and forces are changes since the reference image. A reference image of another sensor, a mirrored one or one that was taken
while something touched the gel makes all of them wrong without a sign of it. Slow changes of light and small motions of the camera
do not count here: a new reference image takes them up, and `ninedtact check` reports them.
"""

import numpy as np

from ninedtact.calibration.brightness import BgrImage
from ninedtact.calibration.drift.diagnosis import DriftDiagnosis, diagnose_drift
from ninedtact.calibration.drift.drift_measurement import load_calibrated_reference, measure_drift
from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.capture.strict_image_reading import average_images
from ninedtact.errors import InputError

_DISQUALIFYING: frozenset[DriftDiagnosis] = frozenset(("something touches the gel", "another skin"))
_CALIBRATION_REFERENCES = frozenset(("board_reference", "ball_reference"))


class ReferenceImplausible(InputError):
    """A reference image does not show the calibrated sensor without contact."""


def find_reference_faults(folder: SensorFolder, *images: BgrImage) -> tuple[str, ...]:
    """Return why the mean of raw images (rows, cols, 3) cannot be the reference image of a sensor; empty where it can be.

    A sensor folder without its calibration images (an imported one) has nothing to compare with. Raises `ImageUnusable` for dark or
    overexposed images, and `ImageSizeWrong`.
    """
    if not folder.record.images.keys() >= _CALIBRATION_REFERENCES:
        return ()
    drift = measure_drift(load_calibrated_reference(folder), average_images([np.asarray(image) for image in images]))
    findings = diagnose_drift(drift)
    return tuple(
        f"{finding.diagnosis}: {finding.sentence}"
        for finding in findings
        if finding.diagnosis in _DISQUALIFYING or drift.flipped is not None
    )


def require_reference_of_sensor(folder: SensorFolder, *images: BgrImage) -> None:
    """Raise `ReferenceImplausible` for images that cannot be the reference image of a sensor, and what `find_reference_faults`
    raises."""
    for fault in find_reference_faults(folder, *images):
        raise ReferenceImplausible(
            f"expected a reference image of {folder.path} without contact, got one with a fault; {fault}"
        )
