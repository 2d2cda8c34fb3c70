"""Building of the force estimator that `--force` names: physics, a force model, or none.

A name or a path, a calibration and a gel go in; a `ForceEstimator` comes out. `SensorFolder.estimator` adds the force scale of a
sensor. The libraries that an estimator needs are imported when it is built.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from ninedtact.errors import ForceEstimationError, InputError, MissingLibraryError

if TYPE_CHECKING:
    from ninedtact.design import Gel
    from ninedtact.force.estimator_and_scale import ForceEstimator
    from ninedtact.shape.calibrated_shape import CalibratedShape

PHYSICS, NONE = "physics", "none"
_MODEL_SUFFIX, _WEIGHTS_SUFFIX = ".onnx", ".pt"


def build_estimator(spec: str, shape: "CalibratedShape", gel: "Gel") -> "ForceEstimator":
    """Return the estimator for this calibration and this gel, without the force scale of a sensor folder. It refuses readings of
    another calibration.

    spec: `physics`, `none`, or the path of a force model (.onnx) or of the original project's weights (.pt). Raises `InputError`,
    `ForceModelUnusable`, `FileFormatError`, and `ForceEstimationError` for a calibration that does not know how the gel scatters
    light.
    """
    if spec == NONE:
        from ninedtact.force.estimator_and_scale import NoForceEstimator

        return NoForceEstimator()
    if spec == PHYSICS:
        from ninedtact.force.traction.estimator import build_traction_force

        return build_traction_force(shape, gel)
    path = Path(spec).expanduser()
    if path.suffix.lower() == _MODEL_SUFFIX:
        from ninedtact.force.network_force import NetworkForce
        from ninedtact.force.network_input import sensor_features_of
        from ninedtact.force.onnx_model import read_force_model

        return NetworkForce(
            read_force_model(path),
            gel,
            features=sensor_features_of(shape, gel),
            calibration_checksum=shape.calibration_checksum,
        )
    if path.suffix.lower() == _WEIGHTS_SUFFIX:
        estimator = _read_original_weights(path)
        estimator.calibration_checksum = shape.calibration_checksum
        return estimator
    raise InputError(
        expected=f"--force {PHYSICS}, {NONE}, a force model (*{_MODEL_SUFFIX}) or the original project's weights "
        f"(*{_WEIGHTS_SUFFIX})",
        got=f"'{path}'",
        remedy="name one of these",
    )


def model_file_of_spec(spec: str) -> Path | None:
    """Return the path of the model file that an estimator's name is, None for the built-in estimators."""
    return None if spec in (PHYSICS, NONE) else Path(spec).expanduser()


def without_contact_detection(estimator: "ForceEstimator") -> "ForceEstimator":
    """Return a network's estimator that also estimates where no contact is detected; raises `ForceEstimationError`."""
    from ninedtact.force.network_force import NetworkForce

    if not isinstance(estimator, NetworkForce):
        raise ForceEstimationError(
            expected="a force model to run without contact detection",
            got=f"{estimator.name!r}",
            remedy="drop --without-contact-detection, or give --force MODEL.onnx",
        )
    return replace(estimator, contact_test=lambda _: True)


def _read_original_weights(path: Path) -> "ForceEstimator":
    """Return the estimator of the original project's weights; raises `MissingLibraryError` without ninedtact-train."""
    from ninedtact._version import find_entry_point, installation_command

    found = find_entry_point("force_models", _WEIGHTS_SUFFIX)
    if found is None:
        raise MissingLibraryError(
            expected="ninedtact-train, which reads the original project's weights",
            got="none",
            remedy=f"run {installation_command('train')}",
        )
    reader: Callable[[Path], ForceEstimator] = found.load()
    return reader(path)
