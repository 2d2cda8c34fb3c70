"""ninedtact doctor: the cameras of this machine, their true frame rate, versions, and optional parts that are missing."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import arg

from ninedtact._version import installation_command
from ninedtact.cli.result_and_interrupt import StepLine, print_result
from ninedtact.cli.shared_options import JsonOption, SizeOption, parse_image_size

if TYPE_CHECKING:
    from ninedtact.capture.camera_check import CameraCheck

EXTRAS = {
    "studio": (
        ("viser", "websockets", "rosbags", "mcap", "trimesh"),
        "the live page: demo, live, play, calibrate --page",
    ),
    "force": (("onnxruntime",), "force by a network: --force MODEL.onnx"),
    "recording": (("rosbags", "mcap"), "recordings: record, collect, info, export"),
    "force-torque": (("bota_driver", "pynetft", "serial"), "force/torque sensors: Bota, ATI and OnRobot, serial"),
    "datasets": (("ninedtact_train", "loky", "pyarrow"), "data sets: collect, dataset, simulate dataset, evaluate"),
    "ros2": (("cyclonedds", "rosbags", "mcap"), "ROS 2 topics without ROS: ninedtact ros2"),
    "stream": (("websockets",), "readings for programs in any language: ninedtact serve"),
    "foxglove": (("foxglove", "websockets", "rosbags"), "a sensor in Foxglove: ninedtact foxglove"),
    "rerun": (("rerun", "rosbags", "mcap"), "recordings in Rerun: export --to rerun"),
    "mujoco": (("mujoco",), "touch in MuJoCo scenes: ninedtact.interop.mujoco"),
    "environments": (
        ("ninedtact_train", "mujoco", "gymnasium"),
        "Gymnasium environments: ninedtact_train.environments",
    ),
    "train": (
        ("ninedtact_train", "torch", "lightning", "onnx", "onnxruntime", "onnxscript", "tensorboard"),
        "training force models: train",
    ),
    "objects": (("trimesh",), "mesh files as objects of the twin"),
    "hardware": (
        ("ninedtact_hardware", "build123d", "ezdxf"),
        "parts, moulds, drawings, circuit board: hardware",
    ),
    "raspberry-pi": (("picamera2",), "a camera on a Raspberry Pi's ribbon cable"),
    "cluster": (("dask", "distributed"), "work on Dask clusters: --cluster"),
}
"""The modules of each extra, and what it brings."""


@dataclass(frozen=True)
class DoctorCommand:
    """List cameras, measure their true frame rate, and report what is missing and how to install it."""

    source: str | None = None
    """Examine this source instead of all cameras: 0, /dev/video0, URL, FILE or FOLDER. Files are read to their end,
    which shows whether images are missing or damaged."""
    size: SizeOption = None
    pixel_format: Annotated[str | None, arg(metavar="MJPG|YUYV|…")] = None
    """Pixel format in which the rate is measured. Without it, and without --size, the mode that the camera is in."""
    json: JsonOption = False

    def run(self) -> int:
        """Print the report; return 1 where the source that was named cannot be read to its end."""
        versions, cameras, extras = _software_versions(), self._check_cameras(), list(_optional_parts())
        found = {"versions": versions, "cameras": list(map(asdict, cameras)), "extras": extras}
        print_result(self.json, found, _report_lines(versions, cameras, extras))
        return int(self.source is not None and cameras[0].trouble is not None)

    def _check_cameras(self) -> "list[CameraCheck]":
        from ninedtact.capture.camera_check import check_camera
        from ninedtact.capture.frame_source import CameraSettings
        from ninedtact.capture.source_from_address import camera_or_file_source
        from ninedtact.capture.uvc_camera import list_cameras
        from ninedtact.source_addresses import source_for

        size_px = None if self.size is None else parse_image_size(self.size)
        settings = CameraSettings(size_px=size_px, pixel_format=self.pixel_format)

        with StepLine() as line:
            if self.source is not None:
                line.show(f"examining {self.source}; files are read to their end")
                return [check_camera(source_for(self.source, settings))]
            line.show("measuring the frame rate of every camera")
            return [
                check_camera(
                    camera_or_file_source(camera.path, settings), ", ".join((camera.name, *camera.usb_addresses))
                )
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


def _optional_parts() -> Iterator[dict[str, Any]]:
    from importlib.util import find_spec

    for name, (modules, what_for) in EXTRAS.items():
        lacking = [module for module in modules if find_spec(module) is None]
        install = installation_command(name)
        yield {"name": name, "what_for": what_for, "installed": not lacking, "lacking": lacking, "get_it": install}


def _report_lines(
    versions: dict[str, str], cameras: "list[CameraCheck]", extras: list[dict[str, Any]]
) -> Iterator[str]:
    yield ", ".join(f"{name} {number}" for name, number in versions.items())
    yield from ("", "cameras")
    for camera in cameras:
        yield from camera_lines(camera)
    if not cameras:
        yield "  none found: plug one in, or name a stream, video or folder with --source"
    yield from ("", "optional parts")
    for extra in extras:
        yield f"  {extra['name']:<14}{'ready' if extra['installed'] else 'missing':<9}{extra['what_for']}"
        if extra["lacking"]:
            yield f"  {'':<14}no {' and no '.join(extra['lacking'])}: {extra['get_it']}"


def camera_lines(camera: "CameraCheck") -> list[str]:
    """Return the lines of one camera: its name, what it delivers, and what to do about it."""
    lines = [f"  {camera.name}" + (f" ({camera.model})" if camera.model else "")]
    if camera.size_px is not None:
        lines.append(f"    {camera.size_px[0]} x {camera.size_px[1]} pixels, {_rate_text(camera)}")
    if camera.settings is not None:
        from ninedtact.capture.camera_check import describe_camera_settings

        lines.append(f"    {describe_camera_settings(camera.settings)}")
    lines += [f"    {sizes}" for sizes in _mode_lines(camera)]
    lines += [f"    {sentence}" for sentence in camera.advice]
    if camera.trouble is not None:
        lines.append(f"    {camera.trouble}")
    return lines


def _mode_lines(camera: "CameraCheck") -> Iterator[str]:
    """Yield a line for each pixel format: the sizes that it has, with the largest rate of each."""
    for pixel_format in dict.fromkeys(mode.pixel_format for mode in camera.modes):
        modes = [mode for mode in camera.modes if mode.pixel_format == pixel_format]
        sizes = (
            f"{mode.size_px[0]}x{mode.size_px[1]}" + (f" at {max(mode.rates_hz):g}" if mode.rates_hz else "")
            for mode in modes
        )
        yield f"{pixel_format}: {', '.join(sizes)}"


def _rate_text(camera: "CameraCheck") -> str:
    if camera.rate is None:
        return f"a recording at {camera.recorded_hz:g} images per second"
    duplicates = f"{camera.rate.duplicates} of {camera.rate.frames} twice" if camera.rate.duplicates else "none twice"
    return f"{camera.rate.true_hz:.1f} images per second, ± {camera.rate.jitter_ms:.1f} ms, {duplicates}"
