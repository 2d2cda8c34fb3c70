"""Every benchmark starts, measures a little and prints its table: what is not started rots."""

import importlib
import os
import sys
from collections.abc import Iterator
from pathlib import Path

import jaxtyping
import pytest

from ninedtact.calibration.procedure import Calibration

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"
SHARED = {
    "ball_in_layer",
    "figures",
    "live_page",
    "neo_hookean",
    "original",
    "real_images",
    "real_sensor_twins",
    "turns",
}
"""Modules that benchmarks share."""
OF_EXTRAS = {"mujoco_speed": "mujoco"}
"""Benchmarks of doors to other programs, and what they need; `make test-interop` installs it."""
NAMES = sorted({path.stem for path in BENCHMARKS.glob("*.py")} - SHARED)


@pytest.fixture(scope="module", autouse=True)
def measured_as_users_run(calibrated_a: Calibration) -> Iterator[None]:
    """Let no types be checked meanwhile: times of benchmarks are those of users. Sensor A is calibrated for all tests at once."""
    before = jaxtyping.config.jaxtyping_disable
    jaxtyping.config.update("jaxtyping_disable", True)
    real_images = importlib.import_module("real_images")
    calibrate = real_images.calibrated
    of_tests = {("sensor_a", "physics"): calibrated_a}
    real_images.calibrated = lambda name, method: of_tests.get((name, method)) or calibrate(name, method)
    yield
    jaxtyping.config.update("jaxtyping_disable", before)


@pytest.mark.parametrize("name", NAMES)
def test_a_benchmark_prints_its_table(
    name: str, real_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    if name in OF_EXTRAS:
        pytest.importorskip(OF_EXTRAS[name])
    if name == "fe_presses" and not (real_data.parent / "fe/presses.npz").is_file():
        pytest.skip("expected presses of finite elements beside the real images, got none")
    monkeypatch.setenv("NINEDTACT_REAL_DATA", str(real_data))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(sys.path))
    monkeypatch.chdir(tmp_path)
    benchmark = getattr(importlib.import_module(name), name)
    try:
        benchmark(quick=True)
    except SystemExit as end:
        assert not end.code, end.code
    printed = capfd.readouterr().out
    assert len(printed.splitlines()) >= 2 and any(character.isdigit() for character in printed)
