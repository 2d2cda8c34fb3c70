"""ninedtact live: show a sensor live in the browser. ninedtact play: a recording there, with its time on a slider."""

from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from time import monotonic_ns
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from ninedtact.cli.result_and_interrupt import named_sensor_with_notices, print_notice
from ninedtact.errors import InputError, MissingLibraryError
from ninedtact.force.estimator_loading import NONE
from ninedtact.open_sensor import RECORDING_SUFFIX, SIMULATED, is_recording, live_source_for, recorded_reference
from ninedtact.recording.errors import RecordingLibrariesMissing, RecordingUnreadable, require_recording_libraries

if TYPE_CHECKING:
    from ninedtact.calibration.sensor_folder import SensorFolder
    from ninedtact.capture.frame_source import FrameSource
    from ninedtact.quantities import Frame
    from ninedtact.reading import Reading
    from ninedtact.sensor import Sensor
    from ninedtact.shape.calibrated_shape import CalibratedShape
    from ninedtact.simulation.press_simulation import PressSimulation
    from ninedtact.simulation.simulated_sources import DemoSources
    from ninedtact.studio.displayed_reading import PageController
    from ninedtact.studio.socket_guard import SocketGuard
    from ninedtact.studio.viewer import PanelFactory
    from ninedtact.studio.wrench_poller import WrenchHistory, WrenchPoller

_MAX_DISPLAY_HZ = 120.0


class PageLibraryMissing(MissingLibraryError):
    """The library that serves the page is not installed."""


class RerunMissing(MissingLibraryError):
    """The library of Rerun is not installed."""


class InvalidLiveOption(InputError):
    """An option has a value that the page cannot have."""


@dataclass(frozen=True)
class Live:
    """Show a sensor live in the browser: camera image, heights, 3D surface, wrench, rates. Ctrl-C ends it."""

    source: str
    """Camera (0, /dev/video0, usb:1-2, csi:0), stream (http://…, rtsp://…), recording, video file or folder of images; or sim,
    the twin of the sensor, pressed by several objects in turn, with its true wrench."""
    sensor: Path | None = None
    """Sensor folder that `ninedtact calibrate` wrote. A recording (.mcap) brings its own."""
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
    display_hz: float = 15.0
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
        with named_sensor_with_notices(self.sensor, self.source) as folder:
            sensor, wrenches, pressed = self.sensor_and_wrenches(folder)
            settings = PageSettings(
                self.out, self.display_hz, self.host, self.port, self.force, self.allow_origin, rerun=self.rerun
            )
            with suppress(KeyboardInterrupt):
                serve_sensor_page(folder, sensor, wrenches, settings, ends=self.source == SIMULATED, pressed=pressed)
        print(f"stopped after {sensor.frames_read} images")
        return 0

    def sensor_and_wrenches(
        self, folder: "SensorFolder"
    ) -> "tuple[Sensor, list[WrenchPoller], PressSimulation | None]":
        """Return the sensor on its source, not yet opened, and for a twin the source of its true wrench and its simulation."""
        from ninedtact.calibration.drift.diagnosis_and_reference_check import load_reference_check
        from ninedtact.reference_following import following_settings_for

        check, pressed = load_reference_check(folder), None
        if self.source == SIMULATED:
            from ninedtact.calibration.twin.sensor_twin import build_sensor_twin
            from ninedtact.simulation.simulated_sources import demo_sources

            shown, references = demo_sources(build_sensor_twin(folder)), check.read_images(self.reference)
            (sensor, wrenches), pressed = page_sources_of_twin(folder.shape, shown, references), shown.simulation
        else:
            sensor, wrenches = self.sensor_at_source(folder.shape, check.read_images(self.reference)), []
        sensor.find_reference_faults = check.find_faults
        sensor.following = following_settings_for(sensor.source) if self.follow_reference else None
        return sensor, wrenches, pressed

    def sensor_at_source(self, shape: "CalibratedShape", references: "Sequence[Frame]") -> "Sensor":
        """Return the sensor on a camera or a recording, not yet opened."""
        from ninedtact.capture.frame_pacing import LatestFrameSource
        from ninedtact.capture.reconnecting import ReconnectingFrameSource
        from ninedtact.sensor import Sensor

        source = ReconnectingFrameSource(
            self.named_source(),
            on_lost=lambda loss: print_notice(f"{loss}; waiting for it"),
            on_back=lambda: print_notice("it is back"),
        )
        depth_reader = shape.depth_reader(*references) if references else None
        if depth_reader is None and is_recording(self.source):
            depth_reader = recorded_reference(self.source, shape)
        return Sensor(LatestFrameSource(source), shape, depth_reader=depth_reader)

    def named_source(self) -> "FrameSource":
        """Return the source, which repeats if --loop is given."""
        from ninedtact.capture.frame_pacing import RepeatingSource
        from ninedtact.capture.frame_source import DEFAULT_CAMERA, FIXED_EXPOSURE

        source = live_source_for(self.source, DEFAULT_CAMERA if self.automatic else FIXED_EXPOSURE)
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
        if not is_recording(str(self.recording)):
            raise RecordingUnreadable(
                f"expected a recording ({RECORDING_SUFFIX}), got {self.recording}; check the path"
            )
        with named_sensor_with_notices(self.sensor, str(self.recording)) as folder, suppress(KeyboardInterrupt):
            self.serve(folder)
        return 0

    def serve(self, folder: "SensorFolder") -> None:
        """Serve the recording; raises what reading it raises, before anything is served."""
        from ninedtact.recording.recorded_source import RecordedSource
        from ninedtact.sensor import Sensor
        from ninedtact.studio.displayed_reading import PageController
        from ninedtact.studio.page_and_server import SensorPage, find_default_port, page_server
        from ninedtact.studio.recording_player import recorded_wrench_columns
        from ninedtact.studio.recordings_panel import RecordingDesk, RecordingsPanel
        from ninedtact.studio.scene_3d import gel_block_under_skin
        from ninedtact.studio.sensor_poller import SensorPoller
        from ninedtact.studio.socket_guard import SocketGuard

        columns = recorded_wrench_columns(self.recording, folder.shape)
        guard = SocketGuard.for_host(self.host, self.allow_origin)
        port = find_default_port(self.host) if self.port is None else self.port
        with page_server(self.host, port, guard) as server:
            # The sensor of this poller is never opened: every viewer is shown a moment of the recording in its place.
            idle = SensorPoller(Sensor(RecordedSource(self.recording), folder.shape))
            controller = PageController(idle, self.out, columns)
            controller.recheck_s = 0.0
            block = gel_block_under_skin(folder.shape, folder.record.design.gel)
            desk = RecordingDesk(server, folder, opens=self.recording)
            page = SensorPage(server, controller, block, folder.id, None, [partial(RecordingsPanel, desk=desk)])
            print(
                f"{self.recording}: open {guard.page_address(server.get_port())} in a browser; Ctrl-C ends", flush=True
            )
            controller.run(page, self.display_hz)


@dataclass(frozen=True)
class PageSettings:
    """Address, rate, output folder and force estimator of a page."""

    out: Path
    """Folder for the readings that are saved from the page."""
    display_hz: float
    host: str
    port: int | None
    """Port of the page; None takes the default one or the next that is free."""
    force: str = NONE
    """Specification of the force estimator."""
    allow_origin: tuple[str, ...] = ()
    """Websites that may use the page besides the page itself."""
    guard: "SocketGuard | None" = None
    """The rules by which requests are accepted; None takes those of the host and the allowed websites."""
    rerun: bool = False
    """Whether readings are also sent to the Rerun viewer on this computer."""


def serve_sensor_page(
    folder: "SensorFolder",
    sensor: "Sensor",
    wrenches: "list[WrenchPoller]",
    settings: PageSettings,
    ends: bool = True,
    pressed: "PressSimulation | None" = None,
) -> None:
    """Serve the page of a sensor until Ctrl-C, or with `ends` until the last round of its twin has ended.

    pressed: the simulation of a twin, which is then pressed by hand on the page.
    """
    from ninedtact.studio.displayed_reading import PageController
    from ninedtact.studio.page_and_server import SensorPage, find_default_port, page_server
    from ninedtact.studio.press_control import PressControl
    from ninedtact.studio.scene_3d import gel_block_under_skin
    from ninedtact.studio.sensor_poller import SensorPhase, SensorPoller
    from ninedtact.studio.socket_guard import SocketGuard

    with ExitStack() as opened:
        guard = settings.guard or SocketGuard.for_host(settings.host, settings.allow_origin)
        port = find_default_port(settings.host) if settings.port is None else settings.port
        server = opened.enter_context(page_server(settings.host, port, guard))
        estimates = _estimate_history(sensor, settings.force, folder)
        histories = [*(poller.history for poller in wrenches), *estimates]

        def keep_estimate(reading: "Reading") -> None:
            for history in estimates:
                if reading.force is not None:
                    history.add_estimate(reading.force)

        def keep_reading(reading: "Reading") -> None:
            for listener in tuple(listeners):
                listener(reading)

        listeners: list[Callable[[Reading], None]] = [keep_estimate]
        if settings.rerun:
            from ninedtact.interop.rerun import RerunViewer

            listeners.append(opened.enter_context(RerunViewer(folder.id)).show)
        loop = opened.enter_context(SensorPoller(sensor, keep_reading))
        for poller in wrenches:
            opened.enter_context(poller)
        press = None if pressed is None else PressControl(pressed)
        controller = PageController(loop, settings.out, histories, press_at=None if press is None else press.press_at)
        block = gel_block_under_skin(folder.shape, folder.record.design.gel)
        panels = recordings_panels(opened, server, folder, controller, sensor.source.name, listeners)
        page = SensorPage(server, controller, block, folder.id, press, panels)
        print(
            f"{sensor.source.name}: open {guard.page_address(server.get_port())} in a browser; Ctrl-C ends", flush=True
        )
        is_over = lambda: ends and loop.snapshot(monotonic_ns()).phase is SensorPhase.ENDED  # noqa: E731
        controller.run(page, settings.display_hz, is_over)


def recordings_panels(
    opened: ExitStack,
    server: Any,
    folder: "SensorFolder",
    controller: "PageController",
    source: str,
    listeners: "list[Callable[[Reading], None]]",
) -> "list[PanelFactory]":
    """Return the panel that records, whose recorder is added to the listeners; none, and a notice, without its libraries."""
    try:
        require_recording_libraries()
    except RecordingLibrariesMissing as missing:
        print_notice(f"the page cannot record; {missing}")
        return []
    from ninedtact.studio.page_recorder import PageRecorder
    from ninedtact.studio.recordings_panel import RecordingDesk, RecordingsPanel

    recorder = PageRecorder(folder, source, controller.wrenches, controller.out, controller.quota)
    opened.callback(recorder.stop)
    listeners.append(recorder.keep)
    return [partial(RecordingsPanel, desk=RecordingDesk(server, folder, recorder))]


def page_sources_of_twin(
    shape: "CalibratedShape", shown: "DemoSources", references: "Sequence[Frame]" = ()
) -> "tuple[Sensor, list[WrenchPoller]]":
    """Return a sensor on the simulated camera, and a poller of the true wrench."""
    from ninedtact.capture.frame_pacing import LatestFrameSource
    from ninedtact.sensor import Sensor
    from ninedtact.simulation.simulated_sources import TRUE_WRENCH_MEANING
    from ninedtact.studio.wrench_poller import WrenchPoller

    depth = shape.depth_reader(*(references or shown.reference_frames))
    return Sensor(LatestFrameSource(shown.camera), shape, depth_reader=depth), [
        WrenchPoller(shown.force_torque, "true", TRUE_WRENCH_MEANING)
    ]


def _estimate_history(sensor: "Sensor", force: str, folder: "SensorFolder") -> "list[WrenchHistory]":
    """Give the sensor its estimator, and return the history of its estimates, still empty; no history for --force none."""
    if force == NONE:
        return []
    from ninedtact.force.estimator_loading import load_estimator
    from ninedtact.studio.wrench_poller import WrenchHistory

    sensor.estimator = estimator = load_estimator(force, folder)
    meaning = f"what {estimator.name} reads from the image alone, ± one standard deviation"
    return [WrenchHistory("estimated", meaning, estimator.notices, states_errors=True)]


def require_display_rate(display_hz: float) -> None:
    """Refuse a display rate of zero, or one above the rate of screens."""
    if not 0 < display_hz <= _MAX_DISPLAY_HZ:
        raise InvalidLiveOption(
            f"expected --display-hz above 0 and at most {_MAX_DISPLAY_HZ:g}, got {display_hz:g}; drop it"
        )


def require_rerun() -> None:
    """Refuse what needs Rerun without it; raises `RerunMissing`."""
    if find_spec("rerun") is None:
        raise RerunMissing("expected rerun-sdk, got no such package; run pip install 'ninedtact[rerun]' (740 MB)")


def require_page_library() -> None:
    """Refuse to start without viser; raises `PageLibraryMissing`."""
    if find_spec("viser") is None:
        raise PageLibraryMissing(
            "expected viser, which serves the live page, got no such package; run pip install 'ninedtact[studio]'"
        )
