"""ninedtact doctor: the cameras of this machine, their true frame rate, versions, and optional parts that are missing."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from ninedtact._version import installation_command
from ninedtact.cli.result_and_interrupt import StepLine
from ninedtact.cli.shared_options import JsonOption

if TYPE_CHECKING:
    from ninedtact.capture.camera_check import CameraCheck

EXTRAS = {
    "studio": (
        ("viser", "websockets", "rosbags", "mcap", "trimesh"),
        "the live page: demo, live, play, calibrate --page",
    ),
    "force": (("onnxruntime",), "force by a network: --force corrected or a model (.onnx)"),
    "recording": (("rosbags", "mcap"), "recordings: record, collect, info, export"),
    "force-torque": (("bota_driver", "pynetft", "serial"), "force/torque sensors: Bota, ATI and OnRobot, serial"),
    "datasets": (("ninedtact_train", "loky", "pyarrow"), "data sets: collect, dataset, simulate dataset, evaluate"),
    "ros2": (("cyclonedds", "rosbags", "mcap"), "ROS 2 topics without ROS: ninedtact ros2"),
    "stream": (("websockets",), "readings for programs in any language: ninedtact serve"),
    "foxglove": (("foxglove", "websockets", "rosbags"), "a sensor in Foxglove: ninedtact foxglove"),
    "rerun": (("rerun", "rosbags", "mcap"), "recordings and sensors in Rerun: export --to rerun, live --rerun"),
    "mujoco": (("mujoco",), "touch in MuJoCo scenes: ninedtact.interop.mujoco"),
    "environments": (
        ("ninedtact_train", "mujoco", "gymnasium"),
        "Gymnasium environments: ninedtact_train.environments",
    ),
    "train": (
        ("ninedtact_train", "torch", "lightning", "onnx", "onnxruntime", "onnxscript", "tensorboard"),
        "training force models: train",
    ),
    "objects": (("trimesh", "thingi10k"), "mesh files as objects of the twin"),
    "hardware": (
        ("ninedtact_hardware", "build123d", "ezdxf"),
        "parts, moulds, drawings, circuit board: hardware",
    ),
    "raspberry-pi": (("picamera2",), "a camera on a Raspberry Pi's ribbon cable"),
    "cluster": (("dask", "distributed"), "work on Dask clusters: --cluster"),
}
"""The modules of each extra, and what it brings."""


@dataclass(frozen=True)
class _OptionalPart:
    """An optional part of the package, and how to install it."""

    name: str
    what_for: str
    installed: bool
    lacking: list[str]
    """Modules that are not installed."""
    get_it: str


@dataclass(frozen=True)
class _DoctorReport:
    """What the doctor found on this machine."""

    versions: dict[str, str]
    cameras: "list[CameraCheck]"
    extras: list[_OptionalPart]


@dataclass(frozen=True)
class Doctor:
    """List cameras, measure their true frame rate, and report what is missing and how to install it."""

    source: str | None = None
    """Examine this source instead of all cameras: 0, /dev/video0, URL, FILE or FOLDER. Files are read to their end,
    which shows whether images are missing or damaged."""
    json: JsonOption = False

    def run(self) -> int:
        """Print the report; return 1 where the source that was named cannot be read to its end."""
        report = _DoctorReport(_software_versions(), self._check_cameras(), _optional_parts())
        print(_to_json(report) if self.json else _to_text(report))
        failed = self.source is not None and report.cameras[0].trouble is not None
        return 1 if failed else 0

    def _check_cameras(self) -> "list[CameraCheck]":
        from ninedtact.capture.camera_check import check_camera
        from ninedtact.capture.source_from_address import camera_or_file_source
        from ninedtact.capture.uvc_camera import list_cameras
        from ninedtact.source_addresses import source_for

        with StepLine() as line:
            if self.source is not None:
                line.show(f"examining {self.source}; files are read to their end")
                return [check_camera(source_for(self.source))]
            line.show("measuring the frame rate of every camera")
            return [
                check_camera(camera_or_file_source(camera.path), ", ".join((camera.name, *camera.usb_addresses)))
                for camera in list_cameras()
            ]


def _software_versions() -> dict[str, str]:
    import platform
    from importlib.metadata import version

    import cv2
    import numpy as np

    return {
        "ninedtact": version("ninedtact"),
        "python": platform.python_version(),
        "opencv": cv2.__version__,
        "numpy": np.__version__,
        "system": f"{platform.system()} {platform.machine()}",
    }


def _optional_parts() -> list[_OptionalPart]:
    from importlib.util import find_spec

    found = []
    for name, (modules, what_for) in EXTRAS.items():
        lacking = [module for module in modules if find_spec(module) is None]
        found.append(_OptionalPart(name, what_for, not lacking, lacking, installation_command(name)))
    return found


def _to_json(report: _DoctorReport) -> str:
    import json
    from dataclasses import asdict

    return json.dumps(asdict(report), indent=2)


def _to_text(report: _DoctorReport) -> str:
    none = ["  none found: plug one in, or name a stream, video or folder with --source"]
    lines = [", ".join(f"{name} {number}" for name, number in report.versions.items()), "", "cameras"]
    lines += [line for camera in report.cameras for line in camera_lines(camera)] or none
    lines += ["", "optional parts"]
    for extra in report.extras:
        state = "ready" if extra.installed else "missing"
        lines.append(f"  {extra.name:<14}{state:<9}{extra.what_for}")
        if not extra.installed:
            lines.append(f"  {'':<14}no {' and no '.join(extra.lacking)}: {extra.get_it}")
    return "\n".join(lines)


def camera_lines(camera: "CameraCheck") -> list[str]:
    """Return the lines of one camera: its name, what it delivers, and what to do about it."""
    lines = [f"  {camera.name}" + (f" ({camera.model})" if camera.model else "")]
    if camera.size_px is not None:
        lines.append(f"    {camera.size_px[0]} x {camera.size_px[1]} pixels, {_rate_text(camera)}")
    if camera.settings is not None:
        from ninedtact.capture.camera_check import describe_camera_settings

        lines.append(f"    {describe_camera_settings(camera.settings)}")
    lines += [f"    {sentence}" for sentence in camera.advice]
    if camera.trouble is not None:
        lines.append(f"    {camera.trouble}")
    return lines


def _rate_text(camera: "CameraCheck") -> str:
    if camera.rate is None:
        return f"a recording at {camera.recorded_hz:g} images per second"
    duplicates = f"{camera.rate.duplicates} of {camera.rate.frames} twice" if camera.rate.duplicates else "none twice"
    return f"{camera.rate.true_hz:.1f} images per second, ± {camera.rate.jitter_ms:.1f} ms, {duplicates}"
