"""Sensors side by side: what is equal is not said to differ, what differs is, and what a sensor lacks is a dash."""

import json
import shutil
from pathlib import Path

import pytest

from ninedtact.calibration.sensor_comparison import Measured, SensorComparison, compare_sensors
from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.cli import main


def measured(comparison: SensorComparison, name: str) -> tuple[Measured | None, ...]:
    """The figures of the one quantity whose name begins so."""
    (found,) = (row.measured for row in comparison.quantities if row.name.startswith(name))
    return found


def test_a_sensor_differs_in_nothing_from_its_copy(physical_sensor: SensorFolder, tmp_path: Path) -> None:
    copy = shutil.copytree(physical_sensor.path, tmp_path / "copy")
    comparison = compare_sensors([physical_sensor.path, copy])
    assert not any(row.differs for row in comparison.quantities)
    assert all(len(set(row.measured)) == 1 for row in comparison.quantities)
    assert len(set(comparison.names)) == 2


def test_a_twin_without_a_fit_lacks_what_only_physics_tells(
    physical_sensor: SensorFolder, twin_sensor: SensorFolder, sensor_a: SensorFolder
) -> None:
    comparison = compare_sensors([physical_sensor.path, twin_sensor.path, sensor_a.path])
    _, lacking, _ = measured(comparison, "shear modulus")
    assert lacking is None
    same, also, real = measured(comparison, "scale")
    assert same is not None and also is not None and real is not None
    assert same.value == pytest.approx(also.value, rel=0.02)
    assert next(row.name for row in comparison.quantities if row.differs) == "scale"  # sensor A has another lens
    load, _, _ = measured(comparison, "load of a ball")
    assert load is not None and load.value > 0 and load.std is not None and load.std > 0.1 * load.value


def test_the_command_prints_a_table_and_writes_a_page(
    physical_sensor: SensorFolder, sensor_a: SensorFolder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page, folders = tmp_path / "both.html", [str(physical_sensor.path), str(sensor_a.path)]
    assert main(["compare", *folders, "--out", str(page)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert physical_sensor.id in lines[0] and sensor_a.id in lines[0]
    assert "* scale" in lines[1] and "±" in lines[1]
    text = page.read_text()
    assert text.count("data:image/png;base64,") == 3 and "scale (µm per pixel)" in text
    assert main(["compare", *folders, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert [one["folder"] for one in found["sensors"]] == folders
    assert found["quantities"][0]["differs"] is True


@pytest.mark.parametrize("name", [r"$\frac$", "dr\udcfcck"])
def test_sensors_may_lie_in_folders_of_any_name(
    name: str, sensor_a: SensorFolder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As a formula, or a name that is not UTF-8; sensors of one name are told apart by their folders."""
    other = shutil.copytree(sensor_a.path, tmp_path / name)
    assert main(["compare", str(sensor_a.path), str(other), "--out", str(tmp_path / "both.html")]) == 0
    assert name.replace("\udcfc", r"\udcfc") in capsys.readouterr().out.splitlines()[0]


@pytest.mark.parametrize("given", ["none", "one", "twice"])
def test_fewer_than_two_sensors_are_one_sentence(
    given: str, sensor_a: SensorFolder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folders = {"none": [], "one": [sensor_a.path], "twice": [sensor_a.path, sensor_a.path / ".." / sensor_a.path.name]}
    assert main(["compare", *map(str, folders[given]), "--out", str(tmp_path / "page.html")]) in (1, 2)
    assert len(capsys.readouterr().err.splitlines()) == 1 or given == "none"
    assert not (tmp_path / "page.html").exists()
