"""ninedtact ros2, foxglove and serve: a running sensor for other programs, over ROS 2, in Foxglove or as JSON lines."""

import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from ninedtact._version import find_incompatible_library, installation_command
from ninedtact.cli.live import Live
from ninedtact.cli.record import (
    is_named,
    parse_named_sources,
    require_duration,
    run_commands_together,
    untared_wrench_source,
)
from ninedtact.cli.result_and_interrupt import (
    given_or_recorded_sensor,
    load_sensor_with_notices,
    print_notice,
    stop_on_signal,
)
from ninedtact.cli.sensor_page import InvalidLiveOption
from ninedtact.errors import MissingLibraryError
from ninedtact.force.estimator_loading import NONE, PHYSICS
from ninedtact.open_sensor import is_twin_address, require_matching_force_source
from ninedtact.recording.errors import RecordingRefused

if TYPE_CHECKING:
    from ninedtact.calibration.sensor_folder import SensorFolder
    from ninedtact.sensor import Sensor
    from ninedtact.studio.wrench_history import WrenchPoller

_TWIN_FOLDER = Path("out/demo")
"""Where `ninedtact demo` keeps the twin of the published design."""


class InteropLibrariesMissing(MissingLibraryError):
    """The libraries that speak to other programs are not installed, or in a version that was not tried."""


@dataclass(frozen=True)
class Ros2:
    """Publish a sensor on ROS 2 topics; ROS need not be installed. Ctrl-C ends it.

    Topics: image_raw, image_raw/compressed, camera_info, height, points, wrench_estimated, wrench_covariance, wrench_measured,
    reference_grey, warnings, status, each after the sensor's name, and /tf_static. The topic command takes take_reference,
    start_recording [NAME], stop_recording.
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
    force_torque: str | None = None
    """Force/torque sensor beside (bota:CONFIG, netft:HOST, onrobot:HOST, serial:PORT), published without a tare as wrench_measured;
    or sim with --source sim, the true wrench of the twin."""
    qos: Annotated[tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(metavar="TOPIC=PROFILE")] = ()
    """Quality of service of a topic: sensor_data, reliable (the default of all but status and reference_grey), or latched; such as
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
        require_matching_force_source(self.source[0], self.force_torque, is_twin_address)
        live = Live(
            self.source[:1],
            self.sensor[:1],
            force=self.force,
            follow_reference=self.follow_reference,
            automatic=self.automatic,
            loop=self.loop,
        )
        with (
            _sensor_to_share(live) as (folder, sensor, true),
            DdsParticipant(self.domain, self.interface) as participant,
        ):
            from ninedtact.interop.ros2_messages import SensorMessages

            messages = SensorMessages(folder, self.name or folder.id, self.points_every)
            measured, meaning = None, ""
            if self.force_torque is not None and true is not None:
                measured, meaning = true.source, true.history.meaning
            elif self.force_torque is not None:
                measured = untared_wrench_source(self.force_torque, folder)
            shared = SensorOnRos2(
                sensor,
                messages,
                participant,
                profiles,
                self.out,
                measured,
                meaning,
                notify=lambda sentence: print_notice(f"{messages.name}: {sentence}"),
            )
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
        if self.force_torque is not None:
            raise RecordingRefused("expected one --source with --force-torque, got several; start one command for each")
        named = parse_named_sources(self.source, self.sensor)
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
            outputs = run_commands_together(commands, lambda: until.requested)
        for name, output in outputs.items():
            print(f"{name}: {output.splitlines()[-1]}")
        return 0 if len(outputs) == len(named) else 1


@dataclass(frozen=True)
class Foxglove:
    """Show a sensor in Foxglove: camera, heights, 3D surface, wrench with errors, warnings. Ctrl-C ends it.

    In Foxglove choose "Open connection", "Foxglove WebSocket" and the printed address, and import the layout that --layout writes.
    """

    source: str
    """Camera (0, /dev/video0, usb:1-2, csi:0), stream, video, folder or recording; or sim, the twin of the sensor."""
    sensor: Path | None = None
    """Sensor folder that `ninedtact calibrate` wrote. A recording brings its own; sim without one is the twin of the demo."""
    force: str = PHYSICS
    """Estimator of force and torque: physics, corrected, a force model (.onnx), or none."""
    layout: Path | None = None
    """Write the layout for this sensor into this new file (.json), for "Import from file" in Foxglove."""
    points_every: int = 3
    """Send the points of every so many rows and columns of the height map."""
    host: str = "127.0.0.1"
    """Address to listen on: of this computer alone, or one at which others on the network reach it (0.0.0.0: all of them). The
    printed address then contains a random token."""
    port: int = 8765
    """Port; 0 takes any free port."""
    allow_origin: Annotated[tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(metavar="URL")] = ()
    """Website (http://NAME:PORT) whose pages may connect besides app.foxglove.dev; file:// for desktop programs that state it."""
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
        _require_libraries("foxglove", "foxglove", "websockets", "rosbags")
        from ninedtact.atomic_write import write_file_atomically
        from ninedtact.interop.foxglove import FoxgloveMessages, FoxgloveServer, foxglove_layout
        from ninedtact.interop.reading_broadcast import publish_readings

        require_duration(self.seconds)
        if self.points_every < 1:
            raise InvalidLiveOption(f"expected --points-every of 1 or more, got {self.points_every}; drop it")
        if self.layout is not None and self.layout.exists():
            raise InvalidLiveOption(f"expected --layout to name a new file, got {self.layout}; choose another name")
        with _sensor_to_share(_live_settings(self)) as (folder, sensor, _):
            messages = FoxgloveMessages(folder, self.points_every)
            with (
                FoxgloveServer(messages, self.host, self.port, self.allow_origin) as server,
                stop_on_signal(self.seconds) as until,
            ):
                if self.layout is not None:
                    write_file_atomically(self.layout, json.dumps(foxglove_layout(messages.name), indent=2).encode())
                print(f"{sensor.source.name}: {server.address}; Ctrl-C ends", flush=True)
                served = publish_readings(server.publish, sensor, lambda: until.now, print_notice)
        print(f"stopped after {served} readings")
        return 0


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
        from ninedtact.interop.reading_broadcast import publish_readings
        from ninedtact.interop.reading_stream import ReadingServer

        require_duration(self.seconds)
        live = _live_settings(self)
        with (
            _sensor_to_share(live) as (folder, sensor, _),
            ReadingServer(folder.id, self.host, self.port, self.tcp_port, self.allow_origin) as server,
            stop_on_signal(self.seconds) as until,
        ):
            addresses = {"websocket": server.websocket_address, "tcp": server.tcp_address, "token": server.guard.token}
            print(f"{sensor.source.name}: {json.dumps(addresses)}; Ctrl-C ends", flush=True)
            served = publish_readings(server.publish, sensor, lambda: until.now, print_notice)
        print(f"stopped after {served} readings")
        return 0


def _live_settings(command: Foxglove | Serve) -> Live:
    """Return how the source of a command is opened."""
    return Live(
        (command.source,),
        () if command.sensor is None else (str(command.sensor),),
        force=command.force,
        follow_reference=command.follow_reference,
        automatic=command.automatic,
        loop=command.loop,
    )


def _require_libraries(extra: str, *names: str) -> None:
    """Raise `InteropLibrariesMissing` where the libraries of an extra are not installed, or in another version than declared."""
    absent = [name for name in names if find_spec(name) is None]
    if absent:
        raise InteropLibrariesMissing(
            f"expected {' and '.join(names)}, which this command needs, got no {' and no '.join(absent)}; run "
            f"{installation_command(extra)}"
        )
    if other := find_incompatible_library(extra):
        raise InteropLibrariesMissing(f"{other}; run {installation_command(extra)}")


@contextmanager
def _sensor_to_share(live: Live) -> "Iterator[tuple[SensorFolder, Sensor, WrenchPoller | None]]":
    """Yield a sensor's folder, the sensor on its source with its estimator, and a twin's true wrench; neither is open yet."""
    source, path = live.parse_named_sources()[""]
    with _folder_or_demo_twin(path, source) as folder:
        sensor, wrenches, _ = live.sensor_and_wrenches(folder)
        if live.force != NONE:
            from ninedtact.force.estimator_loading import load_estimator

            sensor.estimator = load_estimator(live.force, folder)
            for notice in sensor.estimator.notices:
                print_notice(notice)
        yield folder, sensor, wrenches[0] if wrenches else None


@contextmanager
def _folder_or_demo_twin(sensor: Path | None, source: str) -> "Iterator[SensorFolder]":
    """Yield the named sensor folder, or for sim without one that of the demo, which is calibrated where there is none yet."""
    if sensor is not None or not is_twin_address(source):
        with given_or_recorded_sensor(sensor, source) as folder:
            yield folder
        return
    from ninedtact.cli.demo import Demo

    path = _TWIN_FOLDER / "sensor"
    _TWIN_FOLDER.mkdir(parents=True, exist_ok=True)
    yield load_sensor_with_notices(path) if path.exists() else Demo(out=_TWIN_FOLDER).calibrate_twin()
