"""ninedtact ros2, foxglove and serve: a running sensor for other programs, over ROS 2, in Foxglove or as JSON lines."""

import json
from collections.abc import Iterator
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Annotated

import tyro

from ninedtact.cli.result_and_interrupt import (
    StopSignal,
    given_or_recorded_sensor,
    load_estimator_with_notices,
    load_sensor_with_notices,
    print_notice,
    stop_on_signal,
)
from ninedtact.cli.shared_options import (
    CameraOption,
    CameraOptions,
    FollowReferenceOption,
    ForceOption,
    ForceTorqueOption,
    LoopOption,
    NamedSensorsOrDemoTwinOption,
    NamedSourcesOption,
    PointsEveryOption,
    SecondsOption,
    SensorOrDemoTwinOption,
    ServerHostOption,
    SourceOption,
    parse_named_sources,
)
from ninedtact.design import SensorDesign
from ninedtact.errors import InputError
from ninedtact.force.estimator_loading import PHYSICS
from ninedtact.required_libraries import require_libraries
from ninedtact.source_addresses import is_twin_address, require_matching_force_source

if TYPE_CHECKING:
    from ninedtact.calibration.sensor_folder import SensorFolder
    from ninedtact.capture.wrench_source import WrenchSource
    from ninedtact.interop.dds import DdsParticipant
    from ninedtact.interop.ros2_sensor import SensorOnRos2
    from ninedtact.interop.ros2_topics_and_messages import QosProfile
    from ninedtact.live_sensor import LiveSensor

_DEMO_SENSOR = Path("out/demo/sensor")
"""Where `ninedtact demo` keeps the twin of the published design."""


@dataclass(frozen=True)
class SharedSensorOptions:
    """How a sensor is read that other programs share."""

    force: ForceOption = PHYSICS
    seconds: SecondsOption = None
    follow_reference: FollowReferenceOption = True
    camera: CameraOption = CameraOptions()
    loop: LoopOption = False

    @contextmanager
    def assemble(self, source: str, sensor: Path | None) -> "Iterator[tuple[SensorFolder, LiveSensor]]":
        """Yield a sensor's folder, and the sensor on its source with its estimator, not yet opened."""
        from ninedtact.live_sensor import assemble_live_sensor

        with _folder_or_demo_twin(sensor, source) as folder:
            yield (
                folder,
                assemble_live_sensor(
                    folder,
                    source,
                    settings=self.camera.settings(),
                    follow_reference=self.follow_reference,
                    loop=self.loop,
                    estimator=load_estimator_with_notices(self.force, folder),
                    notify=print_notice,
                ),
            )


SharedOptions = Annotated[SharedSensorOptions, tyro.conf.arg(name="")]


@dataclass(frozen=True)
class Ros2Command:
    """Publish a sensor on ROS 2 topics; ROS need not be installed. Ctrl-C ends it.

    Topics: image_raw, image_raw/compressed, camera_info, height, points, wrench_estimated, wrench_covariance, wrench_measured,
    reference_grey, warnings, status, each after the sensor's name, and /tf_static. The topic command takes take_reference,
    start_recording [NAME], stop_recording. wrench_measured is what --force-torque measures; of sim it is the true wrench. Several
    sensors are published under the names of their sources.
    """

    source: NamedSourcesOption
    sensor: NamedSensorsOrDemoTwinOption = ()
    name: str | None = None
    """Name of one sensor in topics and frames; its id, if not given."""
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
    shared: SharedOptions = SharedSensorOptions()

    def run(self) -> int:
        """Publish until Ctrl-C; where one of several sensors fails, the others end too."""
        require_libraries("ros2", "cyclonedds", "rosbags", "mcap")
        from ninedtact.interop.dds import DdsParticipant, parse_qos

        profiles = parse_qos(self.qos)
        named = parse_named_sources(self.source, self.sensor)
        if "" not in named and self.name is not None:
            raise InputError(
                expected="--name with a --source that has no name", got=f"{', '.join(named)}", remedy="drop --name"
            )
        if len(named) > 1 and self.force_torque is not None:
            raise InputError(
                expected="one --source with --force-torque", got="several", remedy="start one command for each"
            )
        for address, _ in named.values():
            require_matching_force_source(address, self.force_torque, is_twin_address)
        with ExitStack() as opened:
            participant = opened.enter_context(DdsParticipant(self.domain, self.interface))
            sensors = []
            for name, (address, path) in named.items():
                folder, live = opened.enter_context(self.shared.assemble(address, path))
                name = name or self.name or folder.id
                sensors.append(self._share(name, folder, live, participant, profiles))
            with stop_on_signal(self.shared.seconds) as until:
                _publish_together(sensors, until)
        for shared in sensors:
            print(f"{shared.messages.name}: stopped after {shared.published} readings")
        return 0

    def _share(
        self,
        name: str,
        folder: "SensorFolder",
        live: "LiveSensor",
        participant: "DdsParticipant",
        profiles: "dict[str, QosProfile]",
    ) -> "SensorOnRos2":
        """Return a sensor on ROS 2 under a name, not yet opened, and print its topics."""
        from ninedtact.interop.ros2_sensor import SensorOnRos2
        from ninedtact.interop.ros2_topics_and_messages import SensorMessages

        messages = SensorMessages(folder, name, self.points_every)
        measured, meaning = self._measured_wrench(folder, live)
        print(
            f"{live.sensor.source.name}: topics {messages.path('…')} in DDS domain {participant.domain}; camera_info differs "
            f"from the calibration by {messages.camera.residual_px:.2f} px (RMS); Ctrl-C ends",
            flush=True,
        )
        return SensorOnRos2(
            live.sensor,
            messages,
            participant,
            profiles,
            self.out,
            measured,
            meaning,
            notify=lambda sentence: print_notice(f"{name}: {sentence}"),
        )

    def _measured_wrench(self, folder: "SensorFolder", live: "LiveSensor") -> "tuple[WrenchSource | None, str]":
        """Return the source of the measured wrench, not yet opened, and what it measures where its name does not say so."""
        if self.force_torque is None:
            return None, ""
        if live.true_wrench is not None:
            from ninedtact.simulation.simulated_sources import TRUE_WRENCH_MEANING

            return live.true_wrench, TRUE_WRENCH_MEANING
        from ninedtact.capture.force_torque.wrench_source_from_address import untared_wrench_source_for

        return untared_wrench_source_for(self.force_torque, folder.record.design.force_torque, print_notice), ""


def _publish_together(sensors: "list[SensorOnRos2]", until: StopSignal) -> None:
    """Publish sensors in a thread each until all have ended, or one fails, whose error is raised when the others have ended."""
    over = Event()
    with ThreadPoolExecutor(len(sensors)) as executor:
        running = [executor.submit(one.run, lambda: until.now or over.is_set()) for one in sensors]
        try:
            wait(running, return_when=FIRST_EXCEPTION)
        finally:
            over.set()
    for one in running:
        one.result()


@dataclass(frozen=True)
class FoxgloveCommand:
    """Show a sensor in Foxglove: camera, heights, 3D surface, wrench with errors, warnings. Ctrl-C ends it.

    In Foxglove choose "Open connection", "Foxglove WebSocket" and the printed address, and import the layout that --layout writes.
    """

    source: SourceOption
    sensor: SensorOrDemoTwinOption = None
    layout: Path | None = None
    """Write the layout for this sensor into this new file (.json), for "Import from file" in Foxglove."""
    points_every: PointsEveryOption = 3
    host: ServerHostOption = "127.0.0.1"
    port: int = 8765
    """Port; 0 takes any free port."""
    allow_origin: Annotated[tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(metavar="URL")] = ()
    """Website (http://NAME:PORT) whose pages may connect besides app.foxglove.dev; file:// for desktop programs that state it."""
    shared: SharedOptions = SharedSensorOptions()

    def run(self) -> int:
        """Serve until Ctrl-C."""
        require_libraries("foxglove", "foxglove", "websockets", "rosbags")
        from ninedtact.atomic_write import require_new_file, write_file_atomically
        from ninedtact.interop.foxglove import FoxgloveServer, foxglove_layout
        from ninedtact.interop.ros2_topics_and_messages import SensorMessages
        from ninedtact.interop.sensor_sharing import watch_sensor
        from ninedtact.recording.topics_and_messages import ros_name

        require_new_file(self.layout, "--layout")
        served = 0
        with (
            self.shared.assemble(self.source, self.sensor) as (folder, live),
            FoxgloveServer(
                SensorMessages(folder, folder.id, self.points_every), self.host, self.port, self.allow_origin
            ) as server,
            stop_on_signal(self.shared.seconds) as until,
        ):
            if self.layout is not None:
                write_file_atomically(self.layout, json.dumps(foxglove_layout(ros_name(folder.id)), indent=2).encode())
            print(f"{live.sensor.source.name}: {server.guard.websocket_address(server.port)}; Ctrl-C ends", flush=True)
            for moment in watch_sensor(live.sensor, lambda: until.now, print_notice):
                server.publish(moment)
                served += moment.new_reading is not None
        print(f"stopped after {served} readings")
        return 0


@dataclass(frozen=True)
class ServeCommand:
    """Serve readings to programs in any language: JSON lines over TCP, and over WebSocket for browsers. Ctrl-C ends it.

    docs/streaming.md has clients in Python, C++ and JavaScript. A slow client misses readings; it never delays the sensor.
    """

    source: SourceOption
    sensor: SensorOrDemoTwinOption = None
    host: ServerHostOption = "127.0.0.1"
    port: int = 8765
    """Port of WebSocket; 0 takes any free port."""
    tcp_port: int = 8766
    """Port of plain TCP; 0 takes any free port."""
    allow_origin: Annotated[tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(metavar="URL")] = ()
    """Website (http://NAME:PORT) whose pages may read the stream in a browser."""
    shared: SharedOptions = SharedSensorOptions()

    def run(self) -> int:
        """Serve until Ctrl-C."""
        require_libraries("stream", "websockets")
        from ninedtact.interop.reading_stream import ReadingServer

        with (
            self.shared.assemble(self.source, self.sensor) as (folder, live),
            ReadingServer(folder.id, self.host, self.port, self.tcp_port, self.allow_origin) as server,
            stop_on_signal(self.shared.seconds) as until,
        ):
            websocket = server.guard.websocket_address(server.port)
            addresses = {"websocket": websocket, "tcp": server.tcp_address, "token": server.guard.token}
            print(f"{live.sensor.source.name}: {json.dumps(addresses)}; Ctrl-C ends", flush=True)
            served = server.serve(live.sensor, lambda: until.now, print_notice)
        print(f"stopped after {served} readings")
        return 0


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
