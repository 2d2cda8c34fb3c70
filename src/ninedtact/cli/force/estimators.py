"""What a person names after --force: the physics of the gel, a force model, or nothing."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from ninedtact.errors import NinedtactError

if TYPE_CHECKING:
    from ninedtact.calibration.sensor_folder import SensorFolder
    from ninedtact.design import Gel
    from ninedtact.force.estimator import ForceEstimator
    from ninedtact.shape.calibrated_shape import CalibratedShape

BOTH, NETWORK, PHYSICS, NONE = "both", "network", "physics", "none"
ENDING, WEIGHTS = ".onnx", ".pt"


class GateMissing(NinedtactError):
    """An estimator was asked to answer without its gate, and cannot."""


class EstimatorUnknown(NinedtactError):
    """A word that names no estimator."""


def estimator_for(text: str, folder: "SensorFolder") -> "ForceEstimator":
    """The estimator on this sensor, as its weighed presses adapted it; raises `EstimatorUnknown`, `ModelUnusable`."""
    from ninedtact.force.force_scale import ScaledForceEstimator, read_force_scale

    plain = unadapted(text, folder)
    adaptation = read_force_scale(folder.path, plain.name)
    return ScaledForceEstimator(plain, adaptation) if adaptation.presses else plain


def unadapted(text: str, folder: "SensorFolder") -> "ForceEstimator":
    """The same, by the modulus that the design has."""
    return on_sensor(text, folder.shape, gel_of(folder))


def on_sensor(text: str, shape: "CalibratedShape", gel: "Gel") -> "ForceEstimator":
    """The estimator of a sensor that is calibrated so, with this gel."""
    if text == NONE:
        from ninedtact.force.estimator import NoForce

        return NoForce()
    if text == PHYSICS:
        from ninedtact.force.traction.estimator import build_traction_force

        return build_traction_force(shape, gel)
    if text.partition(":")[0] == BOTH:
        return together(Path(text.partition(":")[2] or shipped_model()), shape, gel)
    return from_file(shipped_model() if text == NETWORK else Path(text).expanduser(), shape, gel)


def shipped_model() -> Path:
    """Of this package."""
    from ninedtact.force.shipped import SHIPPED_MODEL

    return SHIPPED_MODEL


def together(model: Path, shape: "CalibratedShape", gel: "Gel") -> "ForceEstimator":
    """A network and physics."""
    from ninedtact.force.fusion import FusedForceEstimator
    from ninedtact.force.model_file import read_force_model
    from ninedtact.force.network_force import NetworkForce
    from ninedtact.force.network_input import sensor_features_of
    from ninedtact.force.traction.estimator import build_traction_force

    network = NetworkForce(read_force_model(model.expanduser()), gel, traits=sensor_features_of(shape, gel))
    return FusedForceEstimator(network, build_traction_force(shape, gel))


def ungated(estimator: "ForceEstimator") -> "ForceEstimator":
    """A network that is asked about untouched skin too; raises `GateMissing`."""
    from ninedtact.force.network_force import NetworkForce

    if not isinstance(estimator, NetworkForce):
        raise GateMissing(
            f"expected a force model to ask without its gate, got {estimator.name!r}; drop --ungated, or give --force MODEL.onnx"
        )
    return replace(estimator, contact_test=lambda _: True)


def from_file(path: Path, shape: "CalibratedShape", gel: "Gel") -> "ForceEstimator":
    """The network in a file; raises `EstimatorUnknown`, `ModelUnusable`, `WeightsUnusable`."""
    if path.suffix.lower() == ENDING:
        from ninedtact.force.model_file import read_force_model
        from ninedtact.force.network_force import NetworkForce
        from ninedtact.force.network_input import sensor_features_of

        return NetworkForce(read_force_model(path), gel, traits=sensor_features_of(shape, gel))
    if path.suffix.lower() == WEIGHTS:
        from ninedtact.force.original_network import read_original_network

        return read_original_network(path)
    raise EstimatorUnknown(
        f"expected --force {BOTH}, {NETWORK}, {PHYSICS}, {NONE}, a force model (*{ENDING}) or the original's weights (*{WEIGHTS}), "
        f"got '{path}'; name one of these"
    )


def gel_of(folder: "SensorFolder") -> "Gel":
    """As the image of its ball press shows it, else as designed."""
    return folder.record.design.gel if folder.record.twin is None else folder.record.twin.gel
