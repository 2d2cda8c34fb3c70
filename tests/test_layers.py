"""Imports run one way: a package imports only the layers below its own, and each heavy library is imported by one package."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import ninedtact

PACKAGE = Path(ninedtact.__file__).parent

LAYERS = [
    {"_version", "errors", "atomic_write", "checked_reading", "field_bounds"},
    {"parallel_jobs"},
    {"quantities", "design"},
    {"mechanics", "capture", "shape"},
    {"reading"},
    {"force", "simulation"},
    {"calibration", "reference_images"},
    {"recording", "sensor"},
    {"dataset", "open_sensor"},
    {"studio", "hardware", "workflows"},
    {"interop"},
    {"cli"},
    {"__main__"},
]
EXCEPTIONS = {("calibration", "simulation.gel_brightness")}
"""The ball fit is the twin's forward model."""

SHARED_WITHIN_A_LAYER = {("design", "errors"), ("atomic_write", "errors")}

HEAVY = {
    "torch": {"force.networks", "force.training", "force.original_network", "mechanics", "simulation"},
    "lightning": {"force.training"},
    "onnx": {"force.training"},
    "onnxruntime": {"force.onnx_model"},
    "viser": {"studio"},
    "websockets": {"studio", "interop"},
    "build123d": {
        "hardware.parts",
        "hardware.sensor_assembly",
        "hardware.part_and_assembly_images",
        "hardware.drawings",
        "hardware.fabrication_guide",
        "hardware.export",
    },
    "ezdxf": {"hardware.export"},
    "shapely": {"hardware.led_board"},
    "cyclonedds": {"interop"},
    "foxglove": {"interop"},
    "rerun": {"interop"},
    "mujoco": {"interop"},
    "gymnasium": {"interop"},
    "rosbags": {"recording", "interop"},
    "mcap": {"recording"},
    "bota_driver": {"capture"},
    "pynetft": {"capture"},
    "serial": {"capture"},
    # simulation: one press and a show of several as figures, beside what they are figures of.
    "matplotlib": {"shape", "calibration", "simulation", "force", "hardware"},
    "jinja2": {"calibration", "force", "hardware", "studio"},
}


def package_of(path: Path) -> str:
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def enclosing_packages(path: Path) -> list[str]:
    """`force`, `force.networks` and so on, down to the module itself."""
    parts = path.relative_to(PACKAGE).with_suffix("").parts
    return [".".join(parts[: number + 1]) for number in range(len(parts))]


def layer(name: str) -> int:
    return next(level for level, packages in enumerate(LAYERS) if name in packages)


def imported(path: Path) -> list[str]:
    found = []
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path} imports relatively; packages are named in full"
            found += [f"{node.module}.{alias.name}" for alias in node.names]
    return found


FILES = [path for path in PACKAGE.rglob("*.py") if path != PACKAGE / "__init__.py"]


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_a_package_imports_only_the_layers_below(path: Path) -> None:
    here = package_of(path)
    for name in imported(path):
        if not name.startswith("ninedtact."):
            continue
        target = name.split(".")[1]
        if target == here or (here, target) in SHARED_WITHIN_A_LAYER or target == "__version__":
            continue
        if any(here == a and name.startswith(f"ninedtact.{b}") for a, b in EXCEPTIONS):
            continue
        assert layer(target) < layer(here), f"{path} ({here}) imports {name}"


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_a_heavy_library_is_imported_by_its_package_only(path: Path) -> None:
    for name in imported(path):
        home = HEAVY.get(name.split(".")[0])
        assert home is None or set(enclosing_packages(path)) & home, f"{path} imports {name}"


ALL_HEAVY = (
    "cv2",
    "scipy",
    "torch",
    "viser",
    "matplotlib",
    "build123d",
    "OCP",
    "ezdxf",
    "rosbags",
    "cyclonedds",
    "websockets",
    "mujoco",
    "gymnasium",
)


@pytest.mark.parametrize(
    ("statement", "heavy"),
    [
        ("import ninedtact", ALL_HEAVY),
        ("import ninedtact.cli", ALL_HEAVY),
        (
            "import ninedtact.sensor, ninedtact.force.traction.estimator, ninedtact.calibration.sensor_folder, "
            "ninedtact.calibration.drift.diagnosis_and_reference_check",
            ("scipy.optimize", "scipy.interpolate", "scipy.ndimage", "scipy.signal", "matplotlib"),
        ),
    ],
    ids=["package", "command line", "one estimate"],
)
def test_start_is_light(statement: str, heavy: tuple[str, ...]) -> None:
    check = f"{statement}; import sys; print(*[name for name in {heavy} if name in sys.modules])"
    loaded = subprocess.run([sys.executable, "-c", check], capture_output=True, text=True, check=True)
    assert loaded.stdout.strip() == ""


def test_every_public_name_can_be_imported() -> None:
    for name in ninedtact.__all__:
        value = getattr(ninedtact, name)
        assert getattr(value, "__name__", name) == name
