"""`ninedtact train`: from a data set's folder to a model that answers live as it was trained; what it says of bad data."""

import json
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest

from ninedtact.calibration.procedure import Calibration, CalibrationImages
from ninedtact.calibration.save import save_sensor
from ninedtact.calibration.sensor_folder import SENSOR_FILE, SensorFolder, load_sensor
from ninedtact.cli import main
from ninedtact.design import Gel
from ninedtact.errors import CalibrationError, NinedtactError
from ninedtact.force.brightness_channels import to_whole_grey_levels
from ninedtact.force.estimator_and_scale import ForceScale, write_force_scale
from ninedtact.force.estimator_loading import build_estimator
from ninedtact.force.network_input import (
    InputChannels,
    NetworkInputBuilder,
    NetworkInputSettings,
    SensorParameterInputs,
    stack_height_channels,
)
from ninedtact.force.onnx_model import read_force_model
from ninedtact.quantities import Frame
from ninedtact.reading import Reading
from ninedtact_train.dataset.calibrated_readings import DatasetSensorCalibration, iterate_rows_with_references
from ninedtact_train.dataset.folder import find_pair_files
from ninedtact_train.dataset.height_cache import load_height_pairs
from ninedtact_train.dataset.parquet_files import write_pair_file, write_reference_images_file
from ninedtact_train.dataset.schema import DatasetRow, ReferenceImage
from ninedtact_train.population.sensor_population import sample_sensor
from ninedtact_train.training.settings import DEFAULT_TRAINING
from ninedtact_train.workflows.dataset_calibrations import load_dataset_sensors
from ninedtact_train.workflows.dataset_evaluation import DatasetEvaluationSettings, predict_dataset
from ninedtact_train.workflows.dataset_training import match_input_width_to_dataset, read_training_examples

MM_PER_PX = 0.0522
PAIRS = 12
GRID = NetworkInputSettings(InputChannels.HEIGHTS_AND_GEL, 16, 24, 1.0)
ON_CPU = ("--accelerator", "cpu")


def image_of(load_n: float, seed: int, size: tuple[int, int] = (460, 345)) -> np.ndarray:
    """A dark disc somewhere, the darker the harder."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[: size[1], : size[0]]
    at = rng.uniform(0.3, 0.7, 2) * size
    change = -8 * load_n * np.exp(-((x - at[0]) ** 2 + (y - at[1]) ** 2) / (0.1 * size[0]) ** 2)
    return np.clip(140 + change + rng.normal(0, 0.7, x.shape), 0, 255).astype(np.uint8)


def reading_of(sensor: SensorFolder, load_n: float, seed: int) -> Reading:
    """The reading of such an image by the live path."""
    reader = sensor.shape.reader_against(to_whole_grey_levels(image_of(0, 99), MM_PER_PX))
    image = to_whole_grey_levels(image_of(load_n, seed), MM_PER_PX)
    return Reading(Frame(np.zeros((1, 1, 3), np.uint8)), image, reader(image), reference=reader.reference)


def png(image: np.ndarray) -> bytes:
    return cv2.imencode(".png", image)[1].tobytes()


def data_set(
    folder: Path, pairs: int = PAIRS, objects: int = 3, size: tuple[int, int] = (460, 345), bad: bool = False
) -> Path:
    """Two files of presses by some objects on two sensors."""
    (folder / "data").mkdir(parents=True)
    write_reference_images_file(
        folder / "references.parquet",
        [ReferenceImage(f"{name}/0", png(image_of(0, 99, size)), name) for name in "ab"],
    )
    rows = [row_of(number, objects, size) for number in range(pairs)]
    if bad:
        rows[3].wrench[2] = np.nan
    for part in range(2):
        write_pair_file(folder / "data" / f"train-0000{part}-of-00002.parquet", rows[part::2])
    return folder


def row_of(number: int, objects: int, size: tuple[int, int]) -> DatasetRow:
    load, sensor = 0.5 + number / 4, "ab"[number // 2 % 2]
    wrench = np.array([0.1 * load, -0.05 * load, -load, 0.001 * number, 0.002 * load, 0.0001 * load], np.float32)
    return DatasetRow(
        *(f"{number:03d}", png(image_of(load, number, size)), f"{sensor}/0", wrench, f"thing_{number % objects}"),
        *(f"c{number}", 0, None, sensor, "rule", "made by hand", MM_PER_PX),
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return data_set(tmp_path_factory.mktemp("train") / "pairs")


@pytest.fixture(scope="module")
def sensors(tmp_path_factory: pytest.TempPathFactory, twin_sensor: SensorFolder) -> Path:
    """Both as the twin is calibrated."""
    place = tmp_path_factory.mktemp("sensors")
    for name in "ab":
        shutil.copytree(twin_sensor.path, place / name)
    return place


@pytest.fixture(scope="module")
def calibrated(folder: Path, sensors: Path) -> dict[str, DatasetSensorCalibration]:
    return load_dataset_sensors(folder, sensors, 1, progress=False).by_name


@pytest.fixture(scope="module")
def physics_sensors(tmp_path_factory: pytest.TempPathFactory, sensor_a: SensorFolder) -> Path:
    """Both as a real sensor was calibrated by the method `physics`."""
    place = tmp_path_factory.mktemp("physics_sensors")
    for name in "ab":
        shutil.copytree(sensor_a.path, place / name)
    return place


def test_heights_are_those_of_the_live_path(
    folder: Path, calibrated: dict[str, DatasetSensorCalibration], twin_sensor: SensorFolder
) -> None:
    pairs = load_height_pairs(folder, calibrated, GRID.grid)
    assert sorted(pairs.ids.tolist()) == [f"{number:03d}" for number in range(PAIRS)]
    row = pairs.ids.tolist().index("005")
    height = reading_of(twin_sensor, 0.5 + 5 / 4, 5).height
    live = NetworkInputBuilder(GRID, SensorParameterInputs(2.2)).of_height(height)
    kept = stack_height_channels(pairs.z_mm[row].astype(np.float32), SensorParameterInputs(2.2).row, GRID.channels)
    np.testing.assert_allclose(kept, live, atol=1e-3)
    assert pairs.wrenches[row, 2] == np.float32(-1.75) and pairs.objects[row] == "thing_2" and pairs.sensors[row] == "a"


def test_an_image_of_unknown_scale_has_that_of_its_calibration(
    folder: Path, calibrated: dict[str, DatasetSensorCalibration], twin_sensor: SensorFolder
) -> None:
    (group, *_) = iterate_rows_with_references(find_pair_files(folder))
    unknown = replace(group, rows=[{**group.rows[0], "mm_per_px": None}])
    (pair,) = unknown.readings(calibrated)
    assert pair.reading.height.mm_per_px == twin_sensor.rectification.mm_per_px != 24 / 460


def test_a_sensor_folder_that_a_killed_process_left_is_none(folder: Path, sensors: Path, tmp_path: Path) -> None:
    given = shutil.copytree(sensors, tmp_path / "sensors")
    shutil.copytree(given / "a", given / ".b.1a2b3c4d.partial")
    assert set(load_dataset_sensors(folder, given, 1, progress=False).by_name) == {"a", "b"}


def test_an_image_that_no_press_can_cause_is_reported_and_its_predictions_can_be_read_again(
    folder: Path, physics_sensors: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    dark = tmp_path / "pairs"
    shutil.copytree(folder, dark, ignore=shutil.ignore_patterns("cache"))
    rows = [row_of(number, 3, (460, 345)) for number in range(PAIRS)]
    rows[5] = replace(rows[5], image=png(np.zeros((345, 460), np.uint8)))
    for part in range(2):
        write_pair_file(dark / "data" / f"train-0000{part}-of-00002.parquet", rows[part::2])
    given = ["--data", str(dark), "--sensors", str(physics_sensors), "--workers", "1"]
    assert main(["evaluate", *given, "--out", str(tmp_path / "out"), "--json"]) == 0
    printed = capsys.readouterr()
    assert "nothing is estimated from 1 of 12 images" in printed.err
    assert None not in json.loads(printed.out)["coverage"]["90"]
    read = ["--predictions", str(tmp_path / "out" / "predictions.csv"), "--predictions-about-mm", "0", "0", "0"]
    assert main(["evaluate", *read, "--trust-units", "--json"]) == 0
    kept = json.loads(capsys.readouterr().out)
    assert {**kept, "files": {}} == {**json.loads(printed.out), "files": {}}


def test_a_real_sensor_is_evaluated_with_its_force_calibration(
    folder: Path, physics_sensors: Path, tmp_path: Path
) -> None:
    adapted = shutil.copytree(physics_sensors, tmp_path / "sensors")
    sensor = load_sensor(adapted / "a")
    physics = build_estimator("physics", sensor.shape, sensor.gel)
    for name in "ab":
        write_force_scale(adapted / name, physics, ForceScale(factor=1.5, error=0.02, presses=4))
    plain, scaled = (
        predict_dataset(folder, DatasetEvaluationSettings(sensors=place, every=2), workers=1)
        for place in (physics_sensors, adapted)
    )
    assert plain.predicted[:, 2].min() < -0.05 and plain.std is not None and scaled.std is not None
    np.testing.assert_allclose(scaled.predicted, 1.5 * plain.predicted)
    pressed = plain.predicted[:, 2] < -0.05
    assert (scaled.std[pressed, 2] < 1.5 * plain.std[pressed, 2]).all(), "25 % of each force is unknown without it"


def test_the_input_is_as_wide_as_the_design_of_a_real_sensor(
    folder: Path, calibrated_a: Calibration, tmp_path: Path
) -> None:
    design = calibrated_a.record.design
    wide = replace(design, sensing_area=replace(design.sensing_area, width_mm=27.0))
    record = msgspec.structs.replace(calibrated_a.record, design=wide)
    save_sensor(tmp_path / "a", replace(calibrated_a, record=record))
    assert match_input_width_to_dataset(DEFAULT_TRAINING, folder, tmp_path).input.mm_per_px == pytest.approx(0.3375)
    assert match_input_width_to_dataset(DEFAULT_TRAINING, folder) == DEFAULT_TRAINING


@pytest.mark.parametrize("channels", [InputChannels.HEIGHTS_AND_SENSOR, InputChannels.DEFORMATION])
def test_a_model_of_a_real_sensor_returns_the_forces_that_were_measured(
    channels: InputChannels, folder: Path, sensors: Path, tmp_path: Path
) -> None:
    """A model multiplies by the modulus of the sensor's folder, whatever it is."""
    stiff, pairs = tmp_path / "sensors", tmp_path / "pairs"
    shutil.copytree(sensors, stiff)
    shutil.copytree(folder, pairs)  # which gets a cache of other calibrations
    settings = stiff / "b" / "sensor.toml"
    settings.write_text(settings.read_text().replace("shear_modulus_mpa = 0.093", "shear_modulus_mpa = 0.186"))
    moduli = {name: load_sensor(stiff / name).gel.shear_modulus_mpa for name in "ab"}
    assert moduli == {"a": 0.093, "b": 0.186}
    examples, ids = read_training_examples(pairs, replace(GRID, channels=channels), stiff)
    for wrench, name, of in zip(examples.wrench, ids, examples.sensors, strict=True):
        measured = row_of(int(name), 3, (8, 8)).wrench
        np.testing.assert_allclose(wrench * moduli[of] / Gel().shear_modulus_mpa, measured, rtol=1e-6)


def test_a_reading_that_was_stopped_goes_on_and_a_damaged_cache_is_computed_again(
    folder: Path, calibrated: dict[str, DatasetSensorCalibration], tmp_path: Path
) -> None:
    whole = load_height_pairs(folder, calibrated, GRID.grid, tmp_path)
    first, second = sorted(tmp_path.glob("heights-*/*.npy"))
    read_at_ns = first.stat().st_mtime_ns
    second.unlink()
    again = load_height_pairs(folder, calibrated, GRID.grid, tmp_path)
    assert second.is_file() and first.stat().st_mtime_ns == read_at_ns
    np.testing.assert_array_equal(again.z_mm, whole.z_mm)
    for cached in (first, second):
        cached.write_bytes(cached.read_bytes()[:-200])
    np.testing.assert_array_equal(whole.z_mm, load_height_pairs(folder, calibrated, GRID.grid, tmp_path).z_mm)


def told(capsys: pytest.CaptureFixture[str], arguments: Sequence[str]) -> str:
    assert main(["train", *arguments, *ON_CPU]) == 1
    sentence = capsys.readouterr().err.strip().splitlines()[-1]
    assert sentence.startswith("ninedtact: expected")
    return sentence


def test_trained_from_the_command_line(
    folder: Path, sensors: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    size = ("--size", "24", "16", "--epochs", "1", "--batch", "4")
    options = ["--data", str(folder), "--sensors", str(sensors), "--out", str(out), *size, "--name", "little"]
    assert main(["train", *options, *ON_CPU, "--held-out", "object", "--json"]) == 0
    printed = capsys.readouterr()
    assert "of 12 pairs, 8 are trained on and 4 are held out to choose the best epoch\n" in printed.err
    found = json.loads(printed.out)
    assert found["model"] == str(out / "model.onnx") and (found["pairs"], found["held_out"]["pairs"]) == (8, 4)
    card = read_force_model(out / "model.onnx").card
    assert (card.name, card.network) == ("little", "moments")
    assert (card.input.channels, card.input.rows, card.input.mm_per_px) == (InputChannels.HEIGHTS_AND_SENSOR, 16, 1.0)
    assert "seed: 1 instead of 0" in told(capsys, [*options, "--held-out", "object", "--seed", "1"])
    assert (
        main(["train", *options, *ON_CPU]) == 1
    )  # sensors and objects are held out by default, so that other pairs are trained on
    refused = capsys.readouterr().err
    assert "4 are trained on and 2 are held out to choose the best epoch; left out are 6 whose sensor or" in refused


def test_what_cannot_be_learnt_from_is_refused_in_a_sentence(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = ["--out", str(tmp_path / "out")]
    images = ["--channels", "deformation", "--size", "32", "24"]
    assert "give --sensors" in told(capsys, ["--data", str(folder), *out])
    one = data_set(tmp_path / "one", pairs=8, objects=1, size=(32, 24))
    assert "different objects" in told(capsys, ["--data", str(one), *out, *images])
    bad = data_set(tmp_path / "bad", pairs=8, size=(32, 24), bad=True)
    assert "1 not finite" in told(capsys, ["--data", str(bad), *out, *images])
    assert "Parquet" in told(capsys, ["--data", str(tmp_path / "none"), *out, *images])
    given = ["--data", str(folder), *out, "--sensors", str(tmp_path)]
    assert "multiples of 4" in told(capsys, [*given, "--size", "30", "20"])
    for fraction in ("nan", "-0.1", "1"):
        assert "held_out_fraction above 0 and below 1" in told(capsys, [*given, "--held-out-fraction", fraction])
    assert not (tmp_path / "out").exists()


def test_edited_calibrations_and_those_of_another_sensor_are_told(
    folder: Path, physics_sensors: Path, real_images: dict[str, CalibrationImages], tmp_path: Path
) -> None:
    data, given = shutil.copytree(folder, tmp_path / "data"), shutil.copytree(physics_sensors, tmp_path / "given")
    rectify = load_sensor(given / "a").rectification
    shown = {"a": real_images["a"].board_reference, "b": real_images["i"].ball_reference}
    greys = {name: np.rint(rectify(Frame(image)).grey).astype(np.uint8) for name, image in shown.items()}
    references = [ReferenceImage(f"{name}/0", png(grey), name) for name, grey in greys.items()]
    write_reference_images_file(data / "references.parquet", references)
    (of_b,) = load_dataset_sensors(data, given, 1, progress=False).notices
    assert of_b.startswith(
        f"the reference images of b in {data} are not of the sensor in {given / 'b'}; another sensor's"
    )
    path = given / "a" / SENSOR_FILE
    path.write_text(path.read_text().replace("radius_mm = 4.0", "radius_mm = 5.0"))
    for channels in (InputChannels.HEIGHTS_AND_GEL, InputChannels.DEFORMATION):
        told: list[str] = []
        read_training_examples(data, replace(GRID, channels=channels), given, notify=told.append)
        assert told[1:] == [of_b] and told[0].startswith(f"{path} was edited or damaged")


def test_images_that_no_calibration_fits_are_refused(
    calibrated: dict[str, DatasetSensorCalibration], tmp_path: Path
) -> None:
    small = data_set(tmp_path / "small", pairs=4, size=(64, 48))
    with pytest.raises(CalibrationError, match="460 x 345, as sensor 'a'"):
        load_height_pairs(small, calibrated, GRID.grid)
    with pytest.raises(CalibrationError, match="'b'"):
        load_height_pairs(small, {"a": calibrated["a"]}, GRID.grid)


def test_pairs_of_a_twin_that_could_not_be_calibrated_are_left_out(
    folder: Path, calibrated: dict[str, DatasetSensorCalibration], tmp_path: Path
) -> None:
    whole = load_height_pairs(folder, calibrated, GRID.grid)
    some = load_height_pairs(folder, {"a": calibrated["a"]}, GRID.grid, tmp_path / "cache", left_out=["b"])
    of_a = whole.sensors == "a"
    assert 0 < of_a.sum() < len(of_a) and (some.sensors == "a").all()
    np.testing.assert_array_equal(some.z_mm, whole.z_mm[of_a])
    np.testing.assert_array_equal(some.wrenches, whole.wrenches[of_a])


def test_a_twin_that_no_calibration_is_possible_of_is_told_and_not_tried_again(
    twin_sensor: SensorFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tried: list[str] = []

    def refuse(images: object, design: object, *, sensor_id: str) -> None:
        tried.append(sensor_id)
        raise NinedtactError("expected a ball, got none; press one")

    monkeypatch.setattr("ninedtact_train.workflows.dataset_calibrations.calibrate", refuse)
    twins = [replace(sample_sensor(0), name=name).to_json_dict() for name in ("one", "two")]
    (tmp_path / "sensors.json").write_text(json.dumps(twins))
    shutil.copytree(twin_sensor.path, tmp_path / "sensors" / "two")
    for _ in range(2):
        found = load_dataset_sensors(tmp_path, None, 1, progress=False)
    assert tried == ["one"] and list(found.by_name) == ["two"]
    assert found.notices == (
        "pairs of one are left out, it could not be calibrated: expected a ball, got none; press one",
    )


def test_missing_files_are_refused_before_torch_is_imported(tmp_path: Path) -> None:
    words = ["train", "--data", str(tmp_path), "--out", str(tmp_path / "model")]
    program = f"""
import sys
from ninedtact.cli import main
print(main({words}), main({words} + ["--split", "nowhere"]), "torch" in sys.modules)
"""
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert ran.stdout.split() == ["1", "1", "False"]
    assert "expected a data set, got" in ran.stderr and "expected a split in nowhere, got" in ran.stderr
