"""ninedtact live: show a sensor live in the browser. ninedtact play: a recording there, with its time on a slider."""

from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from ninedtact.cli.record import is_named, parse_named_sources
from ninedtact.cli.result_and_interrupt import given_or_recorded_sensor, print_notice, stop_on_signal
from ninedtact.cli.sensor_page import (
    InvalidLiveOption,
    PageSensor,
    PageSettings,
    installed_exporters,
    require_display_rate,
    require_page_library,
    require_rerun,
    serve_sensor_page,
    twin_sensor_and_true_wrench,
)
from ninedtact.force.estimator_loading import NONE
from ninedtact.open_sensor import (
    RECORDING_SUFFIX,
    SIMULATED,
    is_recording_address,
    load_recorded_reference,
    source_in_real_time,
)
from ninedtact.recording.errors import RecordingUnreadable, require_recording_libraries

if TYPE_CHECKING:
    from ninedtact.calibration.sensor_folder import SensorFolder
    from ninedtact.capture.frame_source import FrameSource
    from ninedtact.sensor import Sensor
    from ninedtact.shape.calibrated_shape import CalibratedShape
    from ninedtact.shape.depth import DepthReader
    from ninedtact.simulation.press_sequence import PressSequence
    from ninedtact.studio.wrench_history import WrenchPoller

MAX_SENSORS = 4
"""Number of sensors that one page has room for."""


@dataclass(frozen=True)
class Live:
    """Show sensors live in the browser: camera image, heights, 3D surface, wrench, rates. Ctrl-C ends it."""

    source: tuple[str, ...]
    """Camera (0, /dev/video0, usb:1-2, csi:0), stream (http://…, rtsp://…), recording, video file or folder of images; or sim,
    the twin of the sensor, pressed by several objects in turn, with its true wrench. Several with a name each, such as
    left=usb:1-2 right=usb:1-3, are shown on one page, with the grip force of each two in their order."""
    sensor: tuple[str, ...] = ()
    """Sensor folder that `ninedtact calibrate` wrote. A recording (.mcap) brings its own. For several sources, one for each name:
    left=FOLDER right=FOLDER."""
    reference: tyro.conf.UseAppendAction[tuple[Path, ...]] = ()
    """Reference image (no contact) of this session; several are averaged. Without any, the first images of the
    source are the reference."""
    force: str = NONE
    """Estimator of force and torque: physics, corrected, a force model (.onnx), or none."""
    out: Path = Path("readings")
    """Folder for the readings that are saved from the page."""
    follow_reference: bool = True
    """Let the reference image of a live source follow slow changes of light and gel while nothing touches."""
    automatic: bool = False
    """Keep automatic exposure and white balance on, for a camera that cannot switch them off; heights then drift."""
    loop: bool = False
    """Repeat a recording. Without this option, its last image stays."""
    display_hz: float = 30.0
    """Largest number of readings shown per second; the sensor is read at its own rate."""
    host: str = "127.0.0.1"
    """Address of the page: of this computer alone, or one at which others on the network reach it (0.0.0.0: all of them). Then only
    who has the printed address, which contains a random token, can see the page and press its buttons."""
    port: int | None = None
    """Port of the page; without it 8080, or the next free one. 0 takes any free port."""
    allow_origin: Annotated[tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(metavar="URL")] = ()
    """Website (http://NAME:PORT) that may use the page besides the page itself: the address of a proxy or tunnel to it."""
    rerun: bool = False
    """Also send readings to the Rerun viewer that runs on this computer; `rerun` starts it."""

    def run(self) -> int:
        """Serve the page until Ctrl-C."""
        require_page_library()
        require_display_rate(self.display_hz)
        if self.rerun:
            require_rerun()
        named = self.parse_named_sources()
        with ExitStack() as opened:
            parts = []
            for name, (address, path) in named.items():
                folder = opened.enter_context(given_or_recorded_sensor(path, address))
                parts.append(PageSensor(folder, *self.sensor_and_wrenches(folder, name), name))
            settings = PageSettings(
                self.out, self.display_hz, self.host, self.port, self.force, self.allow_origin, rerun=self.rerun
            )
            ends = all(address == SIMULATED for address, _ in named.values())
            with suppress(KeyboardInterrupt):
                serve_sensor_page(parts, settings, ends)
        counts = [f"{part.sensor.frames_read} images" + f" of {part.name}" * bool(part.name) for part in parts]
        print(f"stopped after {', '.join(counts)}")
        return 0

    def parse_named_sources(self) -> dict[str, tuple[str, Path | None]]:
        """Return address and sensor folder of all sources by their names; a single one needs none.

        Raises `RecordingRefused` for missing or repeated names, and `InvalidLiveOption`.
        """
        if len(self.source) == 1 and not is_named(self.source[0]):
            if len(self.sensor) > 1:
                raise InvalidLiveOption(
                    f"expected one --sensor with one --source, got {len(self.sensor)}; drop the others"
                )
            return {"": (self.source[0], Path(self.sensor[0]).expanduser() if self.sensor else None)}
        named = parse_named_sources(self.source, self.sensor)
        if len(named) > MAX_SENSORS:
            raise InvalidLiveOption(f"expected at most {MAX_SENSORS} sources on one page, got {len(named)}; drop some")
        if self.reference:
            raise InvalidLiveOption(
                f"expected no --reference with named sources, got {self.reference[0]}; drop it: the first images of each are its "
                "reference"
            )
        return named

    def sensor_and_wrenches(
        self, folder: "SensorFolder", name: str = ""
    ) -> "tuple[Sensor, list[WrenchPoller], PressSequence | None]":
        """Return the sensor on its source, not yet opened, and for a twin the source of its true wrench and its simulation.

        name: of the sensor among several.
        """
        from ninedtact.calibration.drift.diagnosis_and_reference_check import load_reference_image_checker
        from ninedtact.reference_images import following_settings_for

        check, pressed, source = load_reference_image_checker(folder), None, self.parse_named_sources()[name][0]
        references = check.read_images(self.reference)
        if source == SIMULATED:
            from ninedtact.calibration.twin.sensor_twin import build_twin_from_folder
            from ninedtact.simulation.simulated_sources import demo_sources

            twin = build_twin_from_folder(folder).with_noise_of(name)
            shown = demo_sources(twin)
            (sensor, wrenches), pressed = twin_sensor_and_true_wrench(folder.shape, shown, references), shown.simulation
        else:
            given = folder.shape.depth_reader(*references) if references else None
            if given is None and is_recording_address(source):
                given = load_recorded_reference(source, folder, check)
            sensor, wrenches = self.sensor_at_source(source, folder.shape, given, name), []
        sensor.references.find_faults = check.find_faults
        sensor.references.following = following_settings_for(sensor.source) if self.follow_reference else None
        return sensor, wrenches, pressed

    def sensor_at_source(
        self, address: str, shape: "CalibratedShape", given: "DepthReader | None", name: str
    ) -> "Sensor":
        """Return the sensor on a camera or a recording, not yet opened."""
        from ninedtact.capture.frame_pacing import LatestFrameSource
        from ninedtact.capture.reconnecting import ReconnectingFrameSource
        from ninedtact.reference_images import ReferenceImages
        from ninedtact.sensor import Sensor

        of = f"{name}: " if name else ""
        source = ReconnectingFrameSource(
            self.source_at(address),
            on_lost=lambda loss: print_notice(f"{of}{loss}; waiting for it"),
            on_back=lambda: print_notice(f"{of}it is back"),
        )
        return Sensor(LatestFrameSource(source), shape, ReferenceImages(given))

    def source_at(self, address: str) -> "FrameSource":
        """Return the source at an address, which repeats if --loop is given."""
        from ninedtact.capture.frame_pacing import RepeatingSource
        from ninedtact.capture.frame_source import DEFAULT_CAMERA, FIXED_EXPOSURE

        source = source_in_real_time(address, DEFAULT_CAMERA if self.automatic else FIXED_EXPOSURE)
        return RepeatingSource(source) if self.loop else source


@dataclass(frozen=True)
class Play:
    """Show a recording in the browser: its time on a slider, frame by frame, at any speed; labels, and exports. Ctrl-C ends it."""

    recording: Annotated[Path, tyro.conf.Positional]
    """Recording (.mcap) of `ninedtact record`, of `collect`, or of the live page."""
    sensor: Path | None = None
    """Sensor folder to measure the images with, in place of the one that the recording carries."""
    out: Path = Path("readings")
    """Folder for what is exported from the page."""
    display_hz: float = 30.0
    """Largest number of images shown per second."""
    host: str = "127.0.0.1"
    """Address of the page; with another one than this computer's own, the printed address contains a random token."""
    port: int | None = None
    """Port of the page; without it 8080, or the next free one. 0 takes any free port."""
    allow_origin: Annotated[tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(metavar="URL")] = ()
    """Website (http://NAME:PORT) that may use the page besides the page itself: the address of a proxy or tunnel to it."""

    def run(self) -> int:
        """Serve the page until Ctrl-C."""
        require_page_library()
        require_recording_libraries()
        require_display_rate(self.display_hz)
        if not is_recording_address(str(self.recording)):
            raise RecordingUnreadable(
                f"expected a recording ({RECORDING_SUFFIX}), got {self.recording}; check the path"
            )
        from ninedtact.recording.reader import recorded_sensor_addresses

        with ExitStack() as opened:
            folders = {
                address: opened.enter_context(given_or_recorded_sensor(self.sensor, address))
                for address in recorded_sensor_addresses(self.recording)
            }
            with suppress(KeyboardInterrupt):
                self.serve(folders)
        return 0

    def serve(self, folders: "dict[str, SensorFolder]") -> None:
        """Serve the recording of these sensors; raises what reading it raises, before anything is served."""
        from ninedtact.recording.recorded_source import RecordedFrameSource
        from ninedtact.sensor import Sensor
        from ninedtact.studio.page_and_server import SensorPage, page_server
        from ninedtact.studio.page_controller import DisplayedSensor, PageController
        from ninedtact.studio.recording_player import empty_wrench_histories
        from ninedtact.studio.recordings_panel import RecordingsPanel, RecordingsPanelContext
        from ninedtact.studio.scene_3d import gel_block_under_skin
        from ninedtact.studio.sensor_poller import SensorPoller
        from ninedtact.studio.socket_guard import SocketGuard

        columns = {address: empty_wrench_histories(Path(address), one.shape) for address, one in folders.items()}
        folder, shapes = next(iter(folders.values())), {address: one.shape for address, one in folders.items()}
        guard = SocketGuard.for_host(self.host, self.allow_origin)
        with page_server(self.host, self.port, guard) as server:
            # These sensors are never opened: every viewer is shown a moment of the recording in their place.
            sensors = [
                DisplayedSensor(
                    SensorPoller(Sensor(RecordedFrameSource(address), shape)),
                    columns[address],
                    name=address.partition("#")[2],
                )
                for address, shape in shapes.items()
            ]
            controller = PageController(sensors, self.out, recheck_s=0.0)
            block = gel_block_under_skin(folder.shape, folder.record.design.gel)
            context = RecordingsPanelContext(server, folder, None, self.recording, shapes, installed_exporters())
            title = folder.id if len(folders) == 1 else self.recording.stem
            page = SensorPage(server, controller, block, title, [partial(RecordingsPanel, context=context)])
            print(
                f"{self.recording}: open {guard.page_address(server.get_port())} in a browser; Ctrl-C ends", flush=True
            )
            with stop_on_signal() as stop:
                controller.run(page, self.display_hz, lambda: stop.now)
