"""The options that several commands share.

The options are the fields of the commands' dataclasses. One that several commands have is a type here, which brings its help. The
packages that give a choice its meaning are loaded when a command runs.
"""

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from msgspec import Meta
from tyro.conf import UseAppendAction, arg

from ninedtact.design import SensorDesign
from ninedtact.errors import InputError

if TYPE_CHECKING:
    from ninedtact.capture.frame_source import CameraSettings
    from ninedtact.live.socket_guard import SocketGuard


_SOURCE = (
    "Camera (0, /dev/video0, usb:1-2, csi:0), stream (http://…, rtsp://…), video, folder of images or recording (.mcap); or sim, "
    "the twin of the sensor, pressed by several objects in turn."
)
_SENSOR = "Sensor folder that `ninedtact calibrate` wrote."
_RECORDED_SENSOR = f"{_SENSOR} A recording brings its own."
_EACH_NAMED = " For several sources, one for each name: left=FOLDER right=FOLDER."
_OR_DEMO_TWIN = " Without one, sim is the twin of the demo."
SourceOption = Annotated[str, arg(help=_SOURCE)]
NamedSourcesOption = Annotated[
    tuple[str, ...], arg(help=f"{_SOURCE} Several at once have a name each, such as left=usb:1-2 right=usb:1-3.")
]
SensorOption = Annotated[Path, arg(help=_SENSOR)]
RecordedSensorOption = Annotated[Path | None, arg(help=_RECORDED_SENSOR)]
SensorOrDemoTwinOption = Annotated[Path | None, arg(help=_RECORDED_SENSOR + _OR_DEMO_TWIN)]
NamedSensorsOption = Annotated[tuple[str, ...], arg(help=_RECORDED_SENSOR + _EACH_NAMED)]
NamedSensorsOrDemoTwinOption = Annotated[tuple[str, ...], arg(help=_RECORDED_SENSOR + _OR_DEMO_TWIN + _EACH_NAMED)]
_REFERENCE = "Reference image (no contact) of the same session; given more than once, the images are averaged."
ReferenceOption = Annotated[UseAppendAction[tuple[Path, ...]], arg(help=_REFERENCE)]
ReferenceOrFirstOption = Annotated[
    UseAppendAction[tuple[Path, ...]],
    arg(help=f"{_REFERENCE} Without any, the first images of the source are the reference."),
]
ForceTorqueOption = Annotated[
    str | None,
    arg(
        help="Force/torque sensor (bota:CONFIG, netft:HOST, onrobot:HOST, serial:PORT), whose wrench is measured without a tare; "
        "or sim with --source sim."
    ),
]
CameraDelayOption = Annotated[
    float | Literal["saved"],
    arg(
        metavar="MS|saved",
        help="How long before its stamp an image shows the skin; saved: as `ninedtact camera-delay` kept it in the sensor folder.",
    ),
]
ForceOption = Annotated[str, arg(help="Estimator of force and torque: physics, a force model (.onnx), or none.")]
SizeOption = Annotated[
    str | None,
    arg(
        metavar="COLSxROWS",
        help="Size of the camera's images, such as 1280x800; `ninedtact doctor` lists those that it has.",
    ),
]
FollowReferenceOption = Annotated[
    bool,
    arg(help="Let the reference image of a live source follow slow changes of light and gel while nothing touches."),
]
LoopOption = Annotated[bool, arg(help="Repeat a recording, video or folder of images when it ends.")]
AboveZero = Annotated[float, Meta(gt=0, le=1e9)]
SecondsOption = Annotated[AboveZero | None, arg(help="Duration; without it, until Ctrl-C or the end of the source.")]
DisplayRateOption = Annotated[
    Annotated[float, Meta(gt=0, le=120)],
    arg(help="Largest number of readings shown per second; the sensor is read at its own rate."),
]
_ON_NETWORK = "of this computer alone, or one at which others on the network reach it (0.0.0.0: all of them)."
ServerHostOption = Annotated[
    str, arg(help=f"Address to listen on: {_ON_NETWORK} Then clients need the random token that is printed.")
]
PointsEveryOption = Annotated[
    Annotated[int, Meta(ge=1)], arg(help="Send the points of every so many rows and columns of the height map.")
]
WorkersOption = Annotated[int, arg(help="Number of processes; one for each core.")]
ClusterOption = Annotated[
    str | None,
    arg(
        metavar="HOST:PORT",
        help="Run on the workers of the Dask cluster with this scheduler in place of processes here (docs: clusters).",
    ),
]
JsonOption = Annotated[bool, arg(help="Print the result as one JSON object.")]
DesignFileOption = Annotated[Path | None, arg(name="design")]
"""`--design sensor.toml`: what differs from the published sensor. Its help is that of the field, which says what it is for."""


@dataclass(frozen=True)
class PageAddressOptions:
    """Where a page is served, and who may use it."""

    host: Annotated[
        str,
        arg(
            help=f"Address of the page: {_ON_NETWORK} Then only who has the printed address, which contains a random token, can "
            "see the page and press its buttons."
        ),
    ] = "127.0.0.1"
    port: int | None = None
    """Port of the page; without it 8080, or the next free one. 0 takes any free port."""
    allow_origin: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="URL")] = ()
    """Website (http://NAME:PORT) that may use the page besides the page itself: the address of a proxy or tunnel to it."""

    def new_guard(self) -> "SocketGuard":
        """Return the guard of the page's server; raises `InputError`."""
        from ninedtact.live.socket_guard import SocketGuard

        return SocketGuard.for_host(self.host, self.allow_origin)


@dataclass(frozen=True)
class CameraOptions:
    """How a camera on this computer is set."""

    automatic: bool = False
    """Keep what the camera regulates by itself (exposure, white balance, focus, gain), where it cannot be switched off. Depths then
    drift."""
    pixel_format: Annotated[str | None, arg(metavar="MJPG|YUYV|…")] = None
    """Pixel format of the camera. Without it the camera's own, or motion JPEG where USB is too slow for uncompressed images."""

    def settings(self, size: str | None = None) -> "CameraSettings":
        """Return the settings of a camera; size: COLSxROWS, without which it is the sensor's, or 640x480. Raises `InputError`."""
        from ninedtact.capture.frame_source import DEFAULT_CAMERA, FIXED_EXPOSURE

        settings = DEFAULT_CAMERA if self.automatic else FIXED_EXPOSURE
        size_px = settings.size_px if size is None else parse_image_size(size)
        return replace(settings, size_px=size_px, pixel_format=self.pixel_format)


CameraOption = Annotated[CameraOptions, arg(name="")]


def parse_image_size(text: str) -> tuple[int, int]:
    """Return columns and rows of a size such as 1280x800; raises `InputError`."""
    match = re.fullmatch(r"([1-9]\d{1,4})[xX×]([1-9]\d{1,4})", text)
    if match is None:
        raise InputError(expected="--size as COLSxROWS, such as 1280x800", got=f"'{text}'", remedy="correct it")
    return int(match[1]), int(match[2])


PageAddressOption = Annotated[PageAddressOptions, arg(name="")]


_NAMED_ADDRESS = re.compile(r"(?P<name>[A-Za-z][A-Za-z0-9_]*)=(?P<address>.+)")
"""One of several sources or sensors, such as left=usb:1-2."""


def parse_named_sources(source: tuple[str, ...], sensor: tuple[str, ...]) -> dict[str, tuple[str, Path | None]]:
    """Return address and sensor folder of all sources by their names; a single one may do without, and has the empty name here.

    Raises `InputError`.
    """
    if len(source) == 1 and _NAMED_ADDRESS.match(source[0]) is None:
        if len(sensor) > 1:
            raise InputError(expected="one --sensor with one --source", got=f"{len(sensor)}", remedy="drop the others")
        return {"": (source[0], Path(sensor[0]).expanduser() if sensor else None)}
    sources, sensors = _split_named("--source", source), _split_named("--sensor", sensor)
    if strangers := sensors.keys() - sources.keys():
        raise InputError(
            expected=f"--sensor for {', '.join(sources)}",
            got=f"one for {min(strangers)}",
            remedy="name it as its source",
        )
    folders = {name: Path(path).expanduser() for name, path in sensors.items()}
    return {name: (address, folders.get(name)) for name, address in sources.items()}


def _split_named(option: str, named: tuple[str, ...]) -> dict[str, str]:
    """Return what an option names, such as left=usb:1-2, by the names."""
    found: dict[str, str] = {}
    for text in named:
        match = _NAMED_ADDRESS.match(text)
        if match is None or match["name"] in found:
            raise InputError(
                expected=f"{option} with a name of its own for each of several, such as left=usb:1-2",
                got=f"{text}",
                remedy="name each",
            )
        found[match["name"]] = match["address"]
    return found


def read_design_or_default(path: Path | None) -> SensorDesign:
    """The design in the file, or that of the published sensor; raises what `read_design_file` raises."""
    if path is None:
        return SensorDesign()
    from ninedtact.design import read_design_file

    return read_design_file(path)


def refuse_design_beside_sensor(sensor: Path | None, design: Path | None) -> None:
    """Refuse a calibrated sensor, whose folder has its design, beside a design file; raises `InputError`."""
    if sensor is not None and design is not None:
        raise InputError(
            expected="--sensor or --design", got=f"both ({sensor} has its own design)", remedy="drop one of them"
        )
