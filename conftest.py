"""What all tests share. Shapes and types of annotated functions are checked while the tests run, as tests/type_checker.py says."""

import gc
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

# Two workers with two threads each hinder each other: the tests of calibration take half as long again. Libraries read this when
# they are first imported.
for _library in ("OPENBLAS", "OMP"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")

import jaxtyping  # noqa: E402

from type_checker import begin_test, check_calls  # noqa: E402

_PACKAGES = Path(__file__).parent / "packages"
if not os.environ.get("JAXTYPING_DISABLE"):
    jaxtyped = jaxtyping.jaxtyped
    jaxtyping.jaxtyped = lambda *context, **kinds: check_calls(**kinds) if kinds else jaxtyped(*context)  # type: ignore[assignment]
    jaxtyping.install_import_hook(
        sorted(
            f"{path.parent.name}.{path.stem}" for path in _PACKAGES.glob("*/src/*/*") if not path.stem.startswith("__")
        ),
        "type_checker.checked",
    )

import cloudpickle  # type: ignore[import-untyped]  # noqa: E402
import pytest  # noqa: E402 - the hook comes before anything that may import the package
from filelock import FileLock  # noqa: E402
from hypothesis import HealthCheck, settings  # noqa: E402

from ninedtact.calibration.procedure import Calibration, CalibrationImages, CalibrationSettings, calibrate  # noqa: E402
from ninedtact.calibration.save import save_sensor  # noqa: E402
from ninedtact.calibration.sensor_folder import SensorFolder, load_sensor  # noqa: E402
from ninedtact.capture.shared_video_capture import silence_video_libraries  # noqa: E402
from ninedtact.capture.strict_image_reading import read_image  # noqa: E402
from ninedtact.simulation.calibration_images import simulate_calibration_images  # noqa: E402
from ninedtact.simulation.twin import default_twin  # noqa: E402

_LONGEST_FILES = (
    "test_benchmarks.py",
    "test_types.py",
    "test_model_journey.py",
    "test_force_calibration_page.py",
    "test_force_journeys.py",
    "test_pressing_by_hand.py",
    "test_second_press.py",
    "test_examples.py",
    "test_twin_fit.py",
    "test_docs.py",
    "test_free_pressing.py",
    "test_board.py",
    "test_export.py",
    "test_damaged_files.py",
    "test_files_of_strangers.py",
    "test_train_command.py",
    "test_journeys.py",
    "test_twin_journeys.py",
    "test_sensor_folder.py",
    "test_live_page.py",
    "test_page_guard.py",
    "test_sensor_group.py",
    "test_calibration_page.py",
    "test_recording_journeys.py",
    "test_objects.py",
    "test_board_press.py",
    "test_drift.py",
    "test_output.py",
    "test_sources.py",
    "test_ball.py",
    "test_calibration_session.py",
    "test_rules.py",
    "test_recordings_on_page.py",
    "test_open_sensor.py",
)
"""Files that take ten seconds or more. They begin first, so that no worker is left with one at the end."""


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Begin with the longest files, and run a test in a real browser once more where it fails.

    On a busy computer a browser may take longer than its patience. The summary counts such tests as rerun, so that one that needs
    it often is seen.
    """
    begin_at = {name: number for number, name in enumerate(_LONGEST_FILES)}
    items.sort(key=lambda item: begin_at.get(item.path.name, len(begin_at)))
    if config.pluginmanager.hasplugin("rerunfailures"):
        for item in items:
            if "browser" in getattr(item, "fixturenames", ()):
                item.add_marker(pytest.mark.flaky(reruns=1))


def pytest_runtest_setup() -> None:
    begin_test()


@contextmanager
def _type_checks_off() -> Iterator[None]:
    before = jaxtyping.config.jaxtyping_disable
    jaxtyping.config.update("jaxtyping_disable", True)
    try:
        yield
    finally:
        jaxtyping.config.update("jaxtyping_disable", before)


@pytest.fixture
def without_type_checks() -> Iterator[None]:
    """Let a test give what the types exclude, which the check of types would refuse before the library does."""
    with _type_checks_off():
        yield


def pytest_collection_finish() -> None:
    """Spare what was imported and collected the search for garbage, which passes over all of it again and again."""
    gc.collect()
    gc.freeze()


# A busy computer may take any time for an example.
settings.register_profile("any time", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("any time")

# FFmpeg asks once, at its first video, how loud it may be: tests that write videos would ask for it before the sources do.
silence_video_libraries()
REAL_DATA = "NINEDTACT_REAL_DATA"
PRESSES = ("board_reference", "board", "ball_reference", "ball")


@pytest.fixture(scope="session")
def real_data() -> Path:
    """Folder of real images, `sensor_a/board.png` and so on; tests that need it are skipped without it."""
    default = Path(__file__).parents[1] / "shared" / "real"
    folder = Path(os.environ.get(REAL_DATA, default))
    if not (folder / "sensor_a" / "board.png").is_file():
        pytest.skip(f"expected real images in {folder}, got none; set {REAL_DATA} to the folder that holds sensor_a")
    return folder


@pytest.fixture(scope="session")
def real_images(real_data: Path) -> dict[str, CalibrationImages]:
    """The four images of each real sensor, by its letter."""
    return {
        letter: CalibrationImages(
            **{name: read_image(real_data / f"sensor_{letter}" / f"{name}.png") for name in PRESSES}
        )
        for letter in "aij"
    }


@pytest.fixture(scope="session")
def calibrated_a(real_images: dict[str, CalibrationImages], tmp_path_factory: pytest.TempPathFactory) -> Calibration:
    """Sensor A calibrated with the defaults."""
    return _calibrated_once(tmp_path_factory, "calibrated_a", lambda: calibrate(real_images["a"]))[0]


@pytest.fixture(scope="session")
def sensor_a(calibrated_a: Calibration, tmp_path_factory: pytest.TempPathFactory) -> SensorFolder:
    """Sensor A as it was calibrated; a test that changes its folder copies it."""
    return load_sensor(_calibrated_once(tmp_path_factory, "calibrated_a", lambda: calibrated_a)[1])


@pytest.fixture(scope="session")
def calibrated_twin(tmp_path_factory: pytest.TempPathFactory) -> Calibration:
    """The default twin, calibrated from its own four images, by the method that is done soonest."""

    def calibrated() -> Calibration:
        images = CalibrationImages(**vars(simulate_calibration_images(default_twin())))
        return calibrate(images, settings=CalibrationSettings(method="ratio"), sensor_id="twin")

    return _calibrated_once(tmp_path_factory, "calibrated_twin", calibrated)[0]


@pytest.fixture(scope="session")
def twin_sensor(calibrated_twin: Calibration, tmp_path_factory: pytest.TempPathFactory) -> SensorFolder:
    """The twin as it was calibrated; a test that changes its folder copies it."""
    return load_sensor(_calibrated_once(tmp_path_factory, "calibrated_twin", lambda: calibrated_twin)[1])


@pytest.fixture(scope="session")
def physical_sensor(tmp_path_factory: pytest.TempPathFactory) -> SensorFolder:
    """The default twin calibrated by physics, so that it has a twin and an estimator; a test that changes its folder copies it."""

    def calibrated() -> Calibration:
        images = CalibrationImages(**vars(simulate_calibration_images(default_twin(), frames=4)))
        return calibrate(images, sensor_id="my_sensor")

    return load_sensor(_calibrated_once(tmp_path_factory, "my_sensor", calibrated)[1])


def _calibrated_once(
    factory: pytest.TempPathFactory, name: str, make: Callable[[], Calibration]
) -> tuple[Calibration, Path]:
    """Return a calibration that the first worker to ask for it makes for all of them, and the sensor folder it is saved in."""
    runs_in_worker = "PYTEST_XDIST_WORKER" in os.environ
    shared = (factory.getbasetemp().parent if runs_in_worker else factory.getbasetemp()) / "calibrations"
    shared.mkdir(exist_ok=True)
    kept, folder = shared / f"{name}.pickle", shared / name
    with FileLock(shared / f"{name}.lock"):
        if not kept.exists():
            with _type_checks_off():  # which a calibration would take half as long again with; it has tests of its own
                save_sensor(folder, made := make())
            kept.write_bytes(cloudpickle.dumps(made))
            return made, folder
    return cloudpickle.loads(kept.read_bytes()), folder
