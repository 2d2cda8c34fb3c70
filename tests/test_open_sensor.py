"""`ninedtact.open`: the program of the README on a sensor's twin, and what it refuses."""

import doctest
import re
from pathlib import Path
from shutil import copytree

import numpy as np
import pytest

import ninedtact
from ninedtact import SensorFolder
from ninedtact.recording.errors import SensorNotGiven

README = Path(__file__).parents[1] / "README.md"


@pytest.fixture(scope="module")
def physical_sensor(tmp_path_factory: pytest.TempPathFactory) -> SensorFolder:
    """The default twin calibrated by physics, so that it has a twin and an estimator of its own."""
    from ninedtact.simulation.calibration_images import simulate_calibration_images

    images = ninedtact.CalibrationImages(**vars(simulate_calibration_images(ninedtact.default_twin())))
    folder = tmp_path_factory.mktemp("physical") / "my_sensor"
    return ninedtact.save_sensor(folder, ninedtact.calibrate(images, sensor_id="my_sensor"))


def test_the_twin_opens_with_force_and_starts_without_contact(physical_sensor: SensorFolder) -> None:
    with ninedtact.open(physical_sensor.path, source="sim", force="physics") as sensor:
        first = sensor.read()
        assert first.wrench is not None and not first.wrench.force_n.any()
        deepest = max((sensor.read() for _ in range(40)), key=lambda reading: reading.max_indentation_mm)
    assert deepest.wrench is not None and deepest.wrench_std is not None
    assert deepest.max_indentation_mm > 0.2 and deepest.wrench.force_n[2] < -0.1
    assert np.isfinite(deepest.wrench_std).all() and deepest.contact_area_mm2 > 0


def test_the_program_of_the_readme_runs_as_printed(
    physical_sensor: SensorFolder, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    program = re.search(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)
    assert program is not None
    code = program[1].replace('source="0"', 'source="sim"')
    assert code != program[1] and len(code.strip().splitlines()) <= 5
    # The loop never ends on a camera; here it ends after three readings.
    code = code.replace("for reading in sensor:", "for _, reading in zip(range(3), sensor):")
    monkeypatch.chdir(physical_sensor.path.parent)
    exec(compile(code, "README.md", "exec"), {})
    assert len(capsys.readouterr().out.splitlines()) == 3


def test_every_example_of_the_public_names_runs_as_printed(
    physical_sensor: SensorFolder, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    copytree(physical_sensor.path, tmp_path / "my_sensor")
    monkeypatch.chdir(tmp_path)
    given = {"ninedtact": ninedtact, "np": np, "Path": Path}
    finder, runner = doctest.DocTestFinder(recurse=False), doctest.DocTestRunner()
    elsewhere = {"load_dataset", "save_sensor", "NinedtactError"}  # with their data sets, images and errors
    names = [name for name in ninedtact.__all__ if name not in elsewhere and not name.startswith("__")]
    found = [
        test
        for name in names
        for test in finder.find(getattr(ninedtact, name), name, globs=dict(given))
        if test.examples
    ]
    assert len(found) >= 10
    for test in found:
        assert runner.run(test).failed == 0, test.name


def test_a_source_without_a_sensor_is_refused_unless_it_is_a_recording() -> None:
    with pytest.raises(SensorNotGiven, match="expected --sensor with --source 0"):
        ninedtact.open(source="0")


def test_sim_is_a_source_like_any_other() -> None:
    with ninedtact.source_for("sim") as camera:
        assert camera.read().image.shape == (480, 640, 3)


def test_without_force_there_is_no_wrench(physical_sensor: SensorFolder) -> None:
    with ninedtact.open(physical_sensor, source="sim", force="none") as sensor:
        assert sensor.read().wrench is None
