"""ninedtact ros2 and ninedtact serve: a running sensor for other programs, over ROS 2 or as JSON lines."""

import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from ninedtact.cli.live import Live
from ninedtact.cli.record import is_named, named_sensors, require_duration, run_together
from ninedtact.cli.result_and_interrupt import (
    load_sensor_with_notices,
    named_sensor_with_notices,
    print_notice,
    stop_on_signal,
)
from ninedtact.errors import MissingLibraryError
from ninedtact.force.estimator_loading import NONE, PHYSICS
from ninedtact.open_sensor import is_simulated
from ninedtact.recording.errors import RecordingRefused

if TYPE_CHECKING:
    from ninedtact.calibration.sensor_folder import SensorFolder
    from ninedtact.sensor import Sensor

_TWIN_FOLDER = Path("out/demo")
"""Where `ninedtact demo` keeps the twin of the published design."""


class InteropLibrariesMissing(MissingLibraryError):
    """The libraries that speak to other programs are not installed."""


@dataclass(frozen=True)
class Ros2:
    """Publish a sensor on ROS 2 topics; ROS need not be installed. Ctrl-C ends it.

    Topics: image_raw, image_raw/compressed, camera_info, height, points, wrench_estimated, wrench_covariance, warnings, status,
    each after the sensor's name, and /tf_static. The topic command takes take_reference, start_recording [NAME], stop_recording.
    """

    source: tuple[str, ...]
    """Camera (0, /dev/video0, usb:1-2, csi:0), stream, video, folder or recording; or sim, the twin of the sensor. Several
    with a name each, such as left=usb:1-2 right=usb:1-3, are published at once, under these names."""
    sensor: tuple[str, ...] = ()
    """Sensor folder that `ninedtact calibrate` wrote. A recording brings its own; sim without one is the twin of the demo. For
    several sources, one for each name: left=FOLDER right=FOLDER."""
    name: str | None = None
    """Name of the sensor in topics and frames; its id, if not given."""
    force: str = PHYSICS
    """Estimator of force and torque: physics, corrected, a force model (.onnx), or none."""
    qos: Annotated[tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(metavar="TOPIC=PROFILE")] = ()
    """Quality of service of a topic: sensor_data, reliable (the default of all but status), or latched; such as
    points=sensor_data."""
    points_every: int = 3
    """Publish the points of every so many rows and columns of the height map."""
    domain: int | None = None
    """Number of the DDS domain; that of ROS_DOMAIN_ID, or 0, if not given."""
    interface: str | None = None
    """Network interface, such as lo for this computer alone. Without it, CYCLONEDDS_URI or DDS decides; everybody on that
    network can then read the topics and send commands."""
    out: Path = Path("recordings")
    """Folder for recordings that the topic command starts."""
    seconds: float | None = None
    """Duration; without it, until Ctrl-C or the end of the source."""
    follow_reference: bool = True
    """Let the reference image of a live source follow slow changes of light and gel while nothing touches."""
    automatic: bool = False
    """Keep automatic exposure and white balance on, for a camera that cannot switch them off."""
    loop: bool = False
    """Repeat a recording."""

    def run(self) -> int:
        """Publish until Ctrl-C; the exit code."""
        _require_libraries("ros2", "cyclonedds", "rosbags", "mcap")
        from ninedtact.interop.dds import DdsParticipant, InvalidRos2Option, parse_qos
        from ninedtact.interop.ros2_sensor import SensorOnRos2

        require_duration(self.seconds)
        profiles = parse_qos(self.qos)
        if self.points_every < 1:
            raise InvalidRos2Option(f"expected --points-every of 1 or more, got {self.points_every}; drop it")
        if len(self.source) != 1 or is_named(self.source[0]):
            return self._run_several()
        if len(self.sensor) > 1:
            raise RecordingRefused(f"expected one --sensor with one --source, got {len(self.sensor)}; drop the others")
        live = Live(
            self.source[:1],
            self.sensor[:1],
            force=self.force,
            follow_reference=self.follow_reference,
            automatic=self.automatic,
            loop=self.loop,
        )
        with _sensor_to_share(live) as (folder, sensor), DdsParticipant(self.domain, self.interface) as participant:
            from ninedtact.interop.ros2_messages import SensorMessages

            messages = SensorMessages(folder, self.name or folder.id, self.points_every)
            shared = SensorOnRos2(sensor, messages, participant, profiles, self.out)
            residual_px = messages.camera.residual_px
            print(
                f"{sensor.source.name}: topics {messages.path('…')} in DDS domain {participant.domain}; camera_info differs from "
                f"the calibration by {residual_px:.2f} px (RMS); Ctrl-C ends",
                flush=True,
            )
            with stop_on_signal(self.seconds) as until:
                shared.run(lambda: until.now)
        print(f"stopped after {shared.published} readings")
        return 0

    def _run_several(self) -> int:
        """Publish every named source in a process of its own; where one fails, the others are ended too. Returns 1 then."""
        named = named_sensors(self.source, self.sensor)
        common: dict[str, object] = {"--force": self.force, "--points-every": self.points_every, "--out": self.out}
        common |= {"--domain": self.domain, "--interface": self.interface, "--seconds": self.seconds}
        options = [f"{key}={value}" for key, value in common.items() if value is not None]
        options += [f"--qos={choice}" for choice in self.qos]
        options += ["--no-follow-reference"] * (not self.follow_reference) + ["--automatic"] * self.automatic
        options += ["--loop"] * self.loop
        start = [sys.executable, "-m", "ninedtact", "ros2", *options]
        commands = {
            name: [*start, f"--name={name}", f"--source={address}"]
            + ([f"--sensor={sensor}"] if sensor is not None else [])
            for name, (address, sensor) in named.items()
        }
        for name, (address, _) in named.items():
            print(f"{name}: topics /{name}/… of {address}; Ctrl-C ends", flush=True)
        with stop_on_signal() as until:
            outputs = run_together(commands, lambda: until.requested)
        for name, output in outputs.items():
            print(f"{name}: {output.splitlines()[-1]}")
        return 0 if len(outputs) == len(named) else 1


@dataclass(frozen=True)
class Serve:
    """Serve readings to programs in any language: JSON lines over TCP, and over WebSocket for browsers. Ctrl-C ends it.

    docs/streaming.md has clients in Python, C++ and JavaScript. A slow client misses readings; it never delays the sensor.
    """

    source: str
    """Camera (0, /dev/video0, usb:1-2, csi:0), stream, video, folder or recording; or sim, the twin of the sensor."""
    sensor: Path | None = None
    """Sensor folder that `ninedtact calibrate` wrote. A recording brings its own; sim without one is the twin of the demo."""
    force: str = PHYSICS
    """Estimator of force and torque: physics, corrected, a force model (.onnx), or none."""
    host: str = "127.0.0.1"
    """Address to listen on: of this computer alone, or one at which others on the network reach it (0.0.0.0: all of them). Then
    clients must send the random token that is printed."""
    port: int = 8765
    """Port of WebSocket; 0 takes any free port."""
    tcp_port: int = 8766
    """Port of plain TCP; 0 takes any free port."""
    allow_origin: Annotated[tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(metavar="URL")] = ()
    """Website (http://NAME:PORT) whose pages may read the stream in a browser."""
    seconds: float | None = None
    """Duration; without it, until Ctrl-C or the end of the source."""
    follow_reference: bool = True
    """Let the reference image of a live source follow slow changes of light and gel while nothing touches."""
    automatic: bool = False
    """Keep automatic exposure and white balance on, for a camera that cannot switch them off."""
    loop: bool = False
    """Repeat a recording."""

    def run(self) -> int:
        """Serve until Ctrl-C."""
        _require_libraries("stream", "websockets")
        from ninedtact.interop.reading_stream import ReadingServer, serve_sensor

        require_duration(self.seconds)
        live = Live(
            (self.source,),
            () if self.sensor is None else (str(self.sensor),),
            force=self.force,
            follow_reference=self.follow_reference,
            automatic=self.automatic,
            loop=self.loop,
        )
        with (
            _sensor_to_share(live) as (folder, sensor),
            ReadingServer(folder.id, self.host, self.port, self.tcp_port, self.allow_origin) as server,
            stop_on_signal(self.seconds) as until,
        ):
            addresses = {"websocket": server.websocket_address, "tcp": server.tcp_address, "token": server.guard.token}
            print(f"{sensor.source.name}: {json.dumps(addresses)}; Ctrl-C ends", flush=True)
            served = serve_sensor(server, sensor, lambda: until.now)
        print(f"stopped after {served} readings")
        return 0


def _require_libraries(extra: str, *names: str) -> None:
    """Raise `InteropLibrariesMissing` where the libraries of an extra are not installed."""
    absent = [name for name in names if find_spec(name) is None]
    if absent:
        raise InteropLibrariesMissing(
            f"expected {' and '.join(names)}, which this command needs, got no {' and no '.join(absent)}; run "
            f"pip install 'ninedtact[{extra}]'"
        )


@contextmanager
def _sensor_to_share(live: Live) -> "Iterator[tuple[SensorFolder, Sensor]]":
    """Yield the folder of a sensor and the sensor on its source with its estimator, not yet opened."""
    source, path = live.named_sensors()[""]
    with _folder_or_demo_twin(path, source) as folder:
        sensor = live.sensor_and_wrenches(folder)[0]
        if live.force != NONE:
            from ninedtact.force.estimator_loading import load_estimator

            sensor.estimator = load_estimator(live.force, folder)
            for notice in sensor.estimator.notices:
                print_notice(notice)
        yield folder, sensor


@contextmanager
def _folder_or_demo_twin(sensor: Path | None, source: str) -> "Iterator[SensorFolder]":
    """Yield the named sensor folder, or for sim without one that of the demo, which is calibrated where there is none yet."""
    if sensor is not None or not is_simulated(source):
        with named_sensor_with_notices(sensor, source) as folder:
            yield folder
        return
    from ninedtact.cli.demo import Demo

    path = _TWIN_FOLDER / "sensor"
    _TWIN_FOLDER.mkdir(parents=True, exist_ok=True)
    yield load_sensor_with_notices(path) if path.exists() else Demo(out=_TWIN_FOLDER).calibrate_twin()
