"""Imports run one way: a package imports only the layers below its own, and each heavy library is imported by one package."""

import ast
import subprocess
import sys
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

import ninedtact

PACKAGES = Path(__file__).parents[1] / "packages"
SOURCES = {path.name: path for path in PACKAGES.glob("*/src/*") if (path / "__init__.py").is_file()}
"""The packages of the three distributions by their import names."""

LAYERS = {
    "ninedtact": [
        {"_version", "errors"},
        {
            "atomic_write",
            "bounds",
            "checked_reading",
            "csv_table",
            "limited_process",
            "page_template",
            "required_libraries",
            "robust_noise",
        },
        {"parallel_jobs"},
        {"design"},
        {"quantities"},
        {"mechanics", "capture"},
        {"shape"},
        {"reading"},
        {"force", "simulation", "tracking"},
        {"calibration", "stream_memory"},
        {"reference_images", "reference_frames"},
        {"recording", "sensor", "steady_light"},
        {"source_addresses", "rectified_images"},
        {"open_sensor", "live"},
        {"live_sensor"},
        {"studio"},
        {"interop"},
        {"cli"},
        {"__main__"},
    ],
    "ninedtact_train": [
        {"population"},
        {"batched"},
        {"collecting"},
        {"evaluation"},
        {"dataset"},
        {"training"},
        {"workflows", "environments"},
        {"cli"},
    ],
    "ninedtact_hardware": [],
}
"""The packages and files of each distribution, from the lowest layer to the highest; those of a layer do not import each other. The
hardware is one layer."""
BELOW = {"ninedtact": set(), "ninedtact_train": {"ninedtact"}, "ninedtact_hardware": {"ninedtact"}}
"""What a distribution may import of the others."""

HEAVY = {
    "torch": {"ninedtact_train.training", "ninedtact_train.batched", "ninedtact.mechanics", "ninedtact.simulation"},
    "lightning": {"ninedtact_train.training"},
    "onnx": {"ninedtact_train.training"},
    "onnxruntime": {"ninedtact.force.onnx_model"},
    "viser": {"ninedtact.studio"},
    "websockets": {"ninedtact.live", "ninedtact.studio", "ninedtact.interop"},
    "build123d": {"ninedtact_hardware"},
    "ezdxf": {"ninedtact_hardware.part_files"},
    "cyclonedds": {"ninedtact.interop"},
    "foxglove": {"ninedtact.interop"},
    "rerun": {"ninedtact.interop"},
    "mujoco": {"ninedtact.interop", "ninedtact_train.environments"},
    "gymnasium": {"ninedtact_train.environments"},
    "rosbags": {"ninedtact.recording", "ninedtact.interop"},
    "mcap": {"ninedtact.recording"},
    "bota_driver": {"ninedtact.capture"},
    "pynetft": {"ninedtact.capture"},
    "serial": {"ninedtact.capture"},
    "pyarrow": {"ninedtact_train", "ninedtact.interop"},
    # simulation: one press and a show of several as figures, beside what they are figures of.
    "matplotlib": {
        "ninedtact.shape",
        "ninedtact.calibration",
        "ninedtact.simulation",
        "ninedtact_train.training",
        "ninedtact_train.evaluation",
        "ninedtact_train.dataset",
        "ninedtact_hardware",
    },
    "jinja2": {"ninedtact.page_template"},
}


def module_name(path: Path) -> str:
    """`ninedtact.force.traction.observation` of a file."""
    (root,) = (root for root in SOURCES.values() if path.is_relative_to(root))
    return ".".join(path.relative_to(root.parent).with_suffix("").parts).removesuffix(".__init__")


def enclosing_packages(name: str) -> list[str]:
    """`ninedtact`, `ninedtact.force` and so on, down to the module itself."""
    parts = name.split(".")
    return [".".join(parts[: number + 1]) for number in range(len(parts))]


def layer(distribution: str, name: str) -> int:
    return next(level for level, packages in enumerate(LAYERS[distribution]) if name in packages)


@cache
def imported(path: Path) -> list[str]:
    """All that a file imports, wherever it does so, inside functions and under TYPE_CHECKING too."""
    found = []
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path} imports relatively; packages are named in full"
            found += [f"{node.module}.{alias.name}" for alias in node.names]
    return found


FILES = [path for root in SOURCES.values() for path in root.rglob("*.py") if path != root / "__init__.py"]


def is_below(own: str, here: str, name: str) -> bool:
    """Return whether a file in the package `here` of a distribution may import this name."""
    other, _, target = name.partition(".")
    first = target.split(".")[0]
    if other not in SOURCES or (other == own and first in ("", here, "__version__")):
        return True
    if other != own:
        return other in BELOW[own]
    if not LAYERS[own]:
        return True
    return layer(own, first) < layer(own, here)


def test_a_file_imports_only_the_distributions_and_layers_below() -> None:
    wrong = []
    for path in FILES:
        own, _, inside = module_name(path).partition(".")
        here = inside.split(".")[0]
        wrong += [f"{module_name(path)} imports {name}" for name in imported(path) if not is_below(own, here, name)]
    assert not wrong


def test_no_files_import_each_other_in_a_circle() -> None:
    modules = {module_name(path): path for path in FILES}
    graph = {}
    for name, path in modules.items():
        wanted = {one if one in modules else one.rpartition(".")[0] for one in imported(path)}
        graph[name] = (wanted & modules.keys()) - {name}
    tuple(TopologicalSorter(graph).static_order())  # raises CycleError, which names the files


def test_a_heavy_library_is_imported_by_its_package_only() -> None:
    wrong = []
    for path in FILES:
        for name in imported(path):
            home = HEAVY.get(name.split(".")[0])
            if home is not None and not set(enclosing_packages(module_name(path))) & home:
                wrong.append(f"{module_name(path)} imports {name}")
    assert not wrong


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
            "ninedtact.calibration.drift.diagnosis",
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
