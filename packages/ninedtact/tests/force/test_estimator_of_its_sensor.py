"""An estimator knows the calibration that it was made for, and refuses readings of any other; one of no sensor takes all."""

import pickle
from dataclasses import replace
from pathlib import Path

import msgspec
import pytest
from linear_model import a_card, linear_model

from ninedtact import Reading, Sensor, SensorFolder, load_sensor, source_for
from ninedtact.errors import InputError
from ninedtact.force.estimator_and_scale import ForceEstimator
from ninedtact.force.network_force import NetworkForce
from ninedtact.force.onnx_model import read_force_model
from ninedtact.reading import read_frame
from ninedtact.reference_images import ReferenceImages


def reading_of(folder: SensorFolder) -> Reading:
    frame = folder.stored_image("ball")
    return read_frame(frame, folder.shape, folder.shape.depth_reader(folder.stored_image("ball_reference")))


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("model") / "linear.onnx"
    path.write_bytes(linear_model(a_card()).SerializeToString())
    return path


@pytest.fixture(scope="module")
def others(physical_sensor: SensorFolder) -> list[SensorFolder]:
    """The same sensor with another lens, another curve and another gel."""
    record = physical_sensor.record
    assert record.depth is not None and record.twin is not None
    changes = (
        {"lens": msgspec.structs.replace(record.lens, centre=(0.51, 0.5))},
        {"depth": msgspec.structs.replace(record.depth, noise_mm=2 * record.depth.noise_mm)},
        {"twin": msgspec.structs.replace(record.twin, gel=replace(record.twin.gel, shear_modulus_mpa=0.1))},
    )
    return [SensorFolder(physical_sensor.path, msgspec.structs.replace(record, **each)) for each in changes]


@pytest.mark.parametrize("with_force_scale", [True, False])
@pytest.mark.parametrize("force", ["physics", "model"])
def test_readings_of_another_calibration_are_refused(
    physical_sensor: SensorFolder, others: list[SensorFolder], model: Path, force: str, with_force_scale: bool
) -> None:
    spec = str(model) if force == "model" else force
    own = reading_of(physical_sensor)
    estimator: ForceEstimator = physical_sensor.estimator(spec, with_force_scale)
    expected = estimator.estimate(own).wrench.six
    again = reading_of(load_sensor(physical_sensor.path))
    for same in (again, pickle.loads(pickle.dumps(own)), replace(own, calibration_checksum="")):
        estimator.forget()
        assert estimator.estimate(same).wrench.six == pytest.approx(expected)
    for other in others:
        with pytest.raises(InputError, match="reading of the sensor that this estimator was made for"):
            estimator.estimate(reading_of(other))
        with pytest.raises(InputError, match="one of another sensor or calibration"):
            other.estimator(spec, with_force_scale).add_force(own)


def test_a_model_of_no_sensor_estimates_any(
    physical_sensor: SensorFolder, others: list[SensorFolder], model: Path
) -> None:
    population = NetworkForce(read_force_model(model))
    for folder in (physical_sensor, *others):
        assert population.estimate(reading_of(folder)).touching


def test_a_sensor_with_the_estimator_of_another_is_refused(
    physical_sensor: SensorFolder, others: list[SensorFolder]
) -> None:
    references = ReferenceImages(
        given=physical_sensor.shape.depth_reader(physical_sensor.stored_image("ball_reference"))
    )
    source = source_for("sim", sensor=physical_sensor)
    with (
        Sensor(source, physical_sensor.shape, references, others[0].estimator()) as sensor,
        pytest.raises(InputError, match="take shape and estimator from one"),
    ):
        sensor.read()
