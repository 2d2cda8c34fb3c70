"""ninedtact ros2, foxglove and serve: a running sensor for other programs, over ROS 2, in Foxglove or as JSON lines."""

import json
import signal
import subprocess
import sys
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from time import monotonic, sleep
from typing import TYPE_CHECKING, Annotated

import tyro

from ninedtact._version import find_incompatible_library, installation_command
from ninedtact.cli.result_and_interrupt import (
    given_or_recorded_sensor,
    load_estimator_with_notices,
    load_sensor_with_notices,
    print_notice,
    stop_on_signal,
)
from ninedtact.cli.shared_options import (
    AutomaticOption,
    FollowReferenceOption,
    ForceOption,
    ForceTorqueOption,
    InvalidLiveOption,
    LoopOption,
    NamedSensorsOrDemoTwinOption,
    NamedSourcesOption,
    PointsEveryOption,
    SecondsOption,
    SensorOrDemoTwinOption,
    ServerHostOption,
    SourceOption,
    camera_settings,
    parse_named_sources,
    require_duration,
    require_points_every,
)
from ninedtact.design import SensorDesign
from ninedtact.errors import MissingLibraryError
from ninedtact.force.estimator_loading import PHYSICS
from ninedtact.open_sensor import is_twin_address, require_matching_force_source
from ninedtact.recording.errors import RecordingRefused

if TYPE_CHECKING:
    from ninedtact.calibration.sensor_folder import SensorFolder
    from ninedtact.capture.wrench_source import WrenchSource
    from ninedtact.open_sensor import LiveSensor

_POLL_S = 0.05
_END_S = 5.0
"""Time that a process has to end after each signal, where the command that started it cannot go on."""
_DEMO_SENSOR = Path("out/demo/sensor")
"""Where `ninedtact demo` keeps the twin of the published design."""


class InteropLibrariesMissing(MissingLibraryError):
    """The libraries that speak to other programs are not installed, or in a version that was not tried."""


@dataclass(frozen=True)
class Ros2:
    """Publish a sensor on ROS 2 topics; ROS need not be installed. Ctrl-C ends it.

    Topics: image_raw, image_raw/compressed, camera_info, height, points, wrench_estimated, wrench_covariance, wrench_measured,
    reference_grey, warnings, status, each after the sensor's name, and /tf_static. The topic command takes take_reference,
    start_recording [NAME], stop_recording. wrench_measured is what --force-torque measures; of sim it is the true wrench. Several
    sensors are published under the names of their sources.
    """

    source: NamedSourcesOption
    sensor: NamedSensorsOrDemoTwinOption = ()
    name: str | None = None
    """Name of the sensor in topics and frames; its id, if not given."""
    force: ForceOption = PHYSICS
    force_torque: ForceTorqueOption = None
    qos: Annotated[tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(metavar="TOPIC=PROFILE")] = ()
    """Quality of service of a topic: sensor_data, reliable (the default of all but status and reference_grey), or latched; such as
    points=sensor_data."""
    points_every: PointsEveryOption = 3
    domain: int | None = None
    """Number of the DDS domain; that of ROS_DOMAIN_ID, or 0, if not given."""
    interface: str | None = None
    """Network interface, such as lo for this computer alone. Without it, CYCLONEDDS_URI or DDS decides; everybody on that
    network can then read the topics and send commands."""
    out: Path = Path("recordings")
    """Folder for recordings that the topic command starts."""
    seconds: SecondsOption = None
    follow_reference: FollowReferenceOption = True
    automatic: AutomaticOption = False
    loop: LoopOption = False

    def run(self) -> int:
        """Publish until Ctrl-C; the exit code."""
        _require_libraries("ros2", "cyclonedds", "rosbags", "mcap")
        from ninedtact.interop.dds import DdsParticipant, parse_qos
        from ninedtact.interop.ros2_sensor import SensorOnRos2

        require_duration(self.seconds)
        profiles = parse_qos(self.qos)
        require_points_every(self.points_every)
        named = parse_named_sources(self.source, self.sensor)
        if "" not in named:
            return self._run_several(named)
        address, path = named[""]
        require_matching_force_source(address, self.force_torque, is_twin_address)
        with (
            _assemble_shared_sensor(self, address, path) as (folder, live),
            DdsParticipant(self.domain, self.interface) as participant,
        ):
            from ninedtact.interop.ros2_topics_and_messages import SensorMessages

            messages = SensorMessages(folder, self.name or folder.id, self.points_every)
            measured, meaning = self._measured_wrench(folder, live)
            shared = SensorOnRos2(
                live.sensor,
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
                f"{live.sensor.source.name}: topics {messages.path('…')} in DDS domain {participant.domain}; camera_info differs "
                f"from the calibration by {residual_px:.2f} px (RMS); Ctrl-C ends",
                flush=True,
            )
            with stop_on_signal(self.seconds) as until:
                shared.run(lambda: until.now)
        print(f"stopped after {shared.published} readings")
        return 0

    def _measured_wrench(self, folder: "SensorFolder", live: "LiveSensor") -> "tuple[WrenchSource | None, str]":
        """Return the source of the measured wrench, not yet opened, and what it measures where its name does not say so."""
        if self.force_torque is None:
            return None, ""
        if live.true_wrench is not None:
            from ninedtact.simulation.simulated_sources import TRUE_WRENCH_MEANING

            return live.true_wrench, TRUE_WRENCH_MEANING
        from ninedtact.capture.force_torque.wrench_source_from_address import untared_wrench_source_for

        return untared_wrench_source_for(self.force_torque, folder.record.design.force_torque, print_notice), ""

    def _run_several(self, named: dict[str, tuple[str, Path | None]]) -> int:
        """Publish every named source in a process of its own; where one fails, the others are ended too. Returns 1 then."""
        if self.force_torque is not None:
            raise RecordingRefused("expected one --source with --force-torque, got several; start one command for each")
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


def run_commands_together(commands: dict[str, list[str]], should_stop: Callable[[], bool]) -> dict[str, str]:
    """Run commands at once and return the output of those that succeed; a failure, or `should_stop`, ends the others properly.

    None of them runs any more when this returns or raises.
    """
    # In sessions of their own, so that Ctrl-C reaches this process alone, which passes it on once.
    running: dict[str, subprocess.Popen[str]] = {}
    try:
        for name, command in commands.items():
            running[name] = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True)
        is_ending = False
        while any(process.poll() is None for process in running.values()):
            if not is_ending and (should_stop() or any(process.poll() for process in running.values())):
                is_ending = True
                for process in running.values():
                    process.send_signal(signal.SIGINT)
            sleep(_POLL_S)
        outputs = {name: process.communicate()[0] for name, process in running.items()}
    finally:
        _end_processes(list(running.values()))
    return {name: output for name, output in outputs.items() if running[name].returncode == 0}


def _end_processes(processes: Collection[subprocess.Popen[str]]) -> None:
    """Interrupt the processes that still run; terminate, then kill, those that do not end in time."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
        until = monotonic() + _END_S
        for process in processes:
            process.send_signal(number)  # does nothing to one that has ended
        while any(process.poll() is None for process in processes) and monotonic() < until:
            sleep(_POLL_S)


@dataclass(frozen=True)
class Foxglove:
    """Show a sensor in Foxglove: camera, heights, 3D surface, wrench with errors, warnings. Ctrl-C ends it.

    In Foxglove choose "Open connection", "Foxglove WebSocket" and the printed address, and import the layout that --layout writes.
    """

    source: SourceOption
    sensor: SensorOrDemoTwinOption = None
    force: ForceOption = PHYSICS
    layout: Path | None = None
    """Write the layout for this sensor into this new file (.json), for "Import from file" in Foxglove."""
    points_every: PointsEveryOption = 3
    host: ServerHostOption = "127.0.0.1"
    port: int = 8765
    """Port; 0 takes any free port."""
    allow_origin: Annotated[tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(metavar="URL")] = ()
    """Website (http://NAME:PORT) whose pages may connect besides app.foxglove.dev; file:// for desktop programs that state it."""
    seconds: SecondsOption = None
    follow_reference: FollowReferenceOption = True
    automatic: AutomaticOption = False
    loop: LoopOption = False

    def run(self) -> int:
        """Serve until Ctrl-C."""
        _require_libraries("foxglove", "foxglove", "websockets", "rosbags")
        from ninedtact.atomic_write import write_file_atomically
        from ninedtact.interop.foxglove import FoxgloveMessages, FoxgloveServer, foxglove_layout
        from ninedtact.interop.reading_broadcast import publish_readings

        require_duration(self.seconds)
        require_points_every(self.points_every)
        if self.layout is not None and self.layout.exists():
            raise InvalidLiveOption(f"expected --layout to name a new file, got {self.layout}; choose another name")
        with _assemble_shared_sensor(self, self.source, self.sensor) as (folder, live):
            messages = FoxgloveMessages(folder, self.points_every)
            with (
                FoxgloveServer(messages, self.host, self.port, self.allow_origin) as server,
                stop_on_signal(self.seconds) as until,
            ):
                if self.layout is not None:
                    write_file_atomically(self.layout, json.dumps(foxglove_layout(messages.name), indent=2).encode())
                print(f"{live.sensor.source.name}: {server.address}; Ctrl-C ends", flush=True)
                served = publish_readings(server.publish, live.sensor, lambda: until.now, print_notice)
        print(f"stopped after {served} readings")
        return 0


@dataclass(frozen=True)
class Serve:
    """Serve readings to programs in any language: JSON lines over TCP, and over WebSocket for browsers. Ctrl-C ends it.

    docs/streaming.md has clients in Python, C++ and JavaScript. A slow client misses readings; it never delays the sensor.
    """

    source: SourceOption
    sensor: SensorOrDemoTwinOption = None
    force: ForceOption = PHYSICS
    host: ServerHostOption = "127.0.0.1"
    port: int = 8765
    """Port of WebSocket; 0 takes any free port."""
    tcp_port: int = 8766
    """Port of plain TCP; 0 takes any free port."""
    allow_origin: Annotated[tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(metavar="URL")] = ()
    """Website (http://NAME:PORT) whose pages may read the stream in a browser."""
    seconds: SecondsOption = None
    follow_reference: FollowReferenceOption = True
    automatic: AutomaticOption = False
    loop: LoopOption = False

    def run(self) -> int:
        """Serve until Ctrl-C."""
        _require_libraries("stream", "websockets")
        from ninedtact.interop.reading_broadcast import publish_readings
        from ninedtact.interop.reading_stream import ReadingServer

        require_duration(self.seconds)
        with (
            _assemble_shared_sensor(self, self.source, self.sensor) as (folder, live),
            ReadingServer(folder.id, self.host, self.port, self.tcp_port, self.allow_origin) as server,
            stop_on_signal(self.seconds) as until,
        ):
            addresses = {"websocket": server.websocket_address, "tcp": server.tcp_address, "token": server.guard.token}
            print(f"{live.sensor.source.name}: {json.dumps(addresses)}; Ctrl-C ends", flush=True)
            served = publish_readings(server.publish, live.sensor, lambda: until.now, print_notice)
        print(f"stopped after {served} readings")
        return 0


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
def _assemble_shared_sensor(
    command: Ros2 | Foxglove | Serve, source: str, sensor: Path | None
) -> "Iterator[tuple[SensorFolder, LiveSensor]]":
    """Yield a sensor's folder, and the sensor on its source with its estimator, not yet opened."""
    from ninedtact.open_sensor import assemble_live_sensor

    with _folder_or_demo_twin(sensor, source) as folder:
        yield (
            folder,
            assemble_live_sensor(
                folder,
                source,
                settings=camera_settings(command.automatic),
                follow_reference=command.follow_reference,
                loop=command.loop,
                estimator=load_estimator_with_notices(command.force, folder),
                notify=print_notice,
            ),
        )


@contextmanager
def _folder_or_demo_twin(sensor: Path | None, source: str) -> "Iterator[SensorFolder]":
    """Yield the named sensor folder, or for sim without one that of the demo, which is calibrated where there is none yet."""
    if sensor is not None or not is_twin_address(source):
        with given_or_recorded_sensor(sensor, source) as folder:
            yield folder
        return
    if _DEMO_SENSOR.exists():
        yield load_sensor_with_notices(_DEMO_SENSOR)
        return
    from ninedtact.cli.demo import calibrate_twin_as_sensor
    from ninedtact.simulation.twin import twin_from_design

    _DEMO_SENSOR.parent.mkdir(parents=True, exist_ok=True)
    published = SensorDesign()
    yield calibrate_twin_as_sensor(twin_from_design(published), published, _DEMO_SENSOR)
