"""Loading of the force estimator that `--force` names: physics, physics with a network that corrects it, a force model, or none.

A name or a path and a calibrated sensor folder go in; a `ForceEstimator` with the folder's force scale comes out. The libraries
that an estimator needs are imported when it is built.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from ninedtact.errors import ForceEstimationError, InputError, MissingLibraryError

if TYPE_CHECKING:
    from ninedtact.design import Gel
    from ninedtact.force.estimator_interface import ForceEstimator
    from ninedtact.shape.calibrated_shape import CalibratedShape

CORRECTED, PHYSICS, NONE = "corrected", "physics", "none"
_MODEL_SUFFIX, _WEIGHTS_SUFFIX = ".onnx", ".pt"


class ContactDetectionMissing(ForceEstimationError):
    """Contact detection cannot be switched off, because the estimator has no separate contact detection."""


class EstimatorUnknown(InputError):
    """A text names no estimator."""


@runtime_checkable
class CalibratedSensorFolder(Protocol):
    """The part of a sensor folder (`ninedtact.calibration.sensor_folder.SensorFolder`) that an estimator needs."""

    @property
    def path(self) -> Path:
        """Path of the sensor folder."""

    @property
    def shape(self) -> "CalibratedShape":
        """The calibration of image and height."""

    @property
    def gel(self) -> "Gel":
        """The calibrated gel, or the designed one where it was not calibrated."""

    @property
    def completion_command(self) -> str:
        """The command that adds the fit of gel and light where it is missing."""


def load_estimator(spec: str, folder: CalibratedSensorFolder) -> "ForceEstimator":
    """Return the estimator of a calibrated sensor with the force scale of its folder.

    Where the folder has none, the spread of the gel's modulus is part of the stated errors.

    spec: `physics`, `corrected` (physics, corrected by the shipped model), `none`, or the path of a force model (.onnx) or of the
    original project's weights (.pt). Raises `EstimatorUnknown`, `ForceModelUnusable`, `OriginalWeightsUnusable`, and
    `TractionImpossible` for a sensor that was imported or calibrated without scattering of light.

    >>> estimator = ninedtact.load_estimator("physics", ninedtact.load_sensor("my_sensor"))
    >>> estimator.name
    'force by physics'
    """
    from ninedtact.force.known_load_scale import apply_sensor_force_scale

    estimator = load_unscaled_estimator(spec, folder)
    if spec == NONE:
        return estimator
    return apply_sensor_force_scale(estimator, folder.path)


def load_unscaled_estimator(spec: str, folder: CalibratedSensorFolder) -> "ForceEstimator":
    """Return the estimator of a calibrated sensor without its force scale; raises as `load_estimator`."""
    if spec in (PHYSICS, CORRECTED) and folder.shape.deblurring is None:
        from ninedtact.force.traction.observation import TractionImpossible

        raise TractionImpossible(
            f"expected {folder.path} to be calibrated for force by physics, got a calibration that does not know how the gel "
            f"scatters light (imported, or of another method than 'physics'); run: {folder.completion_command}"
        )
    return build_estimator(spec, folder.shape, folder.gel)


def build_estimator(spec: str, shape: "CalibratedShape", gel: "Gel") -> "ForceEstimator":
    """Return the estimator for this calibration and this gel, without a force scale; raises as `load_estimator`."""
    if spec == NONE:
        from ninedtact.force.estimator_interface import NoForceEstimator

        return NoForceEstimator()
    if spec == PHYSICS:
        from ninedtact.force.traction.estimator import build_traction_force

        return build_traction_force(shape, gel)
    return _build_network_estimator(_shipped_model() if spec == CORRECTED else Path(spec).expanduser(), shape, gel)


def model_file_of_spec(spec: str) -> Path | None:
    """Return the path of the model file that an estimator's name is, None for the built-in estimators."""
    return None if spec in (CORRECTED, PHYSICS, NONE) else Path(spec).expanduser()


def without_contact_detection(estimator: "ForceEstimator") -> "ForceEstimator":
    """Return a network's estimator that also estimates where no contact is detected; raises `ContactDetectionMissing`."""
    from ninedtact.force.network_force import NetworkForce

    if not isinstance(estimator, NetworkForce):
        raise ContactDetectionMissing(
            f"expected a force model to run without contact detection, got {estimator.name!r}; drop "
            "--without-contact-detection, or give --force MODEL.onnx"
        )
    return replace(estimator, contact_test=lambda _: True)


def _shipped_model() -> Path:
    """Return the path of the model that the package ships."""
    from ninedtact.force.onnx_model import SHIPPED_MODEL

    return SHIPPED_MODEL


def _build_network_estimator(path: Path, shape: "CalibratedShape", gel: "Gel") -> "ForceEstimator":
    """Return the estimator of a force model or of the original project's weights; raises `EstimatorUnknown`."""
    if path.suffix.lower() == _MODEL_SUFFIX:
        return _build_model_estimator(path, shape, gel)
    if path.suffix.lower() == _WEIGHTS_SUFFIX:
        from ninedtact._version import find_entry_point, installation_command

        found = find_entry_point("force_models", _WEIGHTS_SUFFIX)
        if found is None:
            raise MissingLibraryError(
                "expected ninedtact-train, which reads the original project's weights, got none; run "
                f"{installation_command('train')}"
            )
        reader: Callable[[Path], ForceEstimator] = found.load()
        return reader(path)
    raise EstimatorUnknown(
        f"expected --force {CORRECTED}, {PHYSICS}, {NONE}, a force model (*{_MODEL_SUFFIX}) or the original project's weights "
        f"(*{_WEIGHTS_SUFFIX}), got '{path}'; name one of these"
    )


def _build_model_estimator(path: Path, shape: "CalibratedShape", gel: "Gel") -> "ForceEstimator":
    """Return the estimator of a force model: one that corrects physics, or one that estimates the wrench alone."""
    from ninedtact.force.network_input import sensor_features_of
    from ninedtact.force.onnx_model import read_force_model

    model, features = read_force_model(path), sensor_features_of(shape, gel)
    if model.card.input.channels.of_physics:
        from ninedtact.force.corrected_force import NetworkCorrectedForce
        from ninedtact.force.traction.estimator import build_traction_force

        return NetworkCorrectedForce(build_traction_force(shape, gel), model, features)
    from ninedtact.force.network_force import NetworkForce

    return NetworkForce(model, gel, features=features)
