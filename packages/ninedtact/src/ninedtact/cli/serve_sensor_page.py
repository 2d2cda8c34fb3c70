"""The page of sensors on their sources, as `live`, `demo` and the guided calibrations serve it."""

import os
import sys
import webbrowser
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from time import monotonic_ns
from typing import TYPE_CHECKING

from ninedtact._version import find_incompatible_library, installation_command
from ninedtact.cli.result_and_interrupt import print_notice, stop_on_signal
from ninedtact.errors import InputError, MissingLibraryError
from ninedtact.force.estimator_loading import NONE
from ninedtact.recording.errors import require_recording_libraries

if TYPE_CHECKING:
    from ninedtact.calibration.sensor_folder import SensorFolder
    from ninedtact.live.socket_guard import SocketGuard
    from ninedtact.live.wrench_history import WrenchHistory, WrenchPoller
    from ninedtact.live_sensor import LiveSensor
    from ninedtact.quantities import Frame
    from ninedtact.reading import Reading
    from ninedtact.sensor import Sensor
    from ninedtact.shape.calibrated_shape import CalibratedShape
    from ninedtact.simulation.press_sequence import PressSequence
    from ninedtact.simulation.simulated_sources import DemoSources
    from ninedtact.studio.page_controller import PageController
    from ninedtact.studio.viewer import PanelFactory

_MAX_DISPLAY_HZ = 120.0


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
    opens_browser: bool = False
    """Whether the page is opened in a browser, where a person sits at a terminal on a computer with a screen."""


@dataclass(frozen=True)
class PageSensor:
    """A sensor of a page, on its source and not yet opened."""

    folder: "SensorFolder"
    sensor: "Sensor"
    wrenches: "list[WrenchPoller]"
    pressed: "PressSequence | None" = None
    """The simulation of a twin, which is then pressed by hand on the page."""
    name: str = ""
    """Name among several sensors."""


def page_sensor(folder: "SensorFolder", live: "LiveSensor", name: str = "") -> PageSensor:
    """Return a sensor that is read in real time as a part of a page, with the true wrench of a twin; name: among several."""
    from ninedtact.live.wrench_history import WrenchPoller
    from ninedtact.simulation.simulated_sources import TRUE_WRENCH_MEANING

    true = live.true_wrench
    wrenches = [] if true is None else [WrenchPoller(true, "true", TRUE_WRENCH_MEANING)]
    return PageSensor(folder, live.sensor, wrenches, live.simulation, name)


def serve_sensor_page(parts: Sequence[PageSensor], settings: PageSettings, ends: bool = True) -> None:
    """Serve the page of one or several sensors until Ctrl-C, or with `ends` until the last round of their twins has ended."""
    from ninedtact.live.sensor_poller import SensorPhase, SensorPoller
    from ninedtact.live.socket_guard import SocketGuard
    from ninedtact.studio.page_controller import DisplayedSensor, PageController
    from ninedtact.studio.page_server import page_server
    from ninedtact.studio.press_control import TwinPressController
    from ninedtact.studio.scene_3d import gel_block_under_skin
    from ninedtact.studio.sensor_page import SensorPage

    with ExitStack() as opened:
        guard = settings.guard or SocketGuard.for_host(settings.host, settings.allow_origin)
        server = opened.enter_context(page_server(settings.host, settings.port, guard))
        listeners: list[Callable[[Reading, int], None]] = []
        shown: list[DisplayedSensor] = []
        for number, part in enumerate(parts):
            estimates = _estimate_history(part.sensor, settings.force, part.folder)
            keep = partial(_keep_reading, number=number, estimates=estimates, listeners=listeners)
            press = None if part.pressed is None else TwinPressController(part.pressed)
            histories = [*(poller.history for poller in part.wrenches), *estimates]
            shown.append(DisplayedSensor(SensorPoller(part.sensor, keep), histories, press, part.name))
        controller = PageController(shown, settings.out)
        for one, part in zip(shown, parts, strict=True):
            opened.enter_context(one.poller)
            for poller in part.wrenches:
                opened.enter_context(poller)
        first = parts[0]
        block = gel_block_under_skin(first.folder.shape, first.folder.record.design.gel)
        panels = connect_recordings_panel(opened, parts, controller, listeners)
        title = " · ".join(part.name or part.folder.id for part in parts)
        page = SensorPage(server, controller, block, title, panels)
        sources = ", ".join(f"{part.name}: " * bool(part.name) + part.sensor.source.name for part in parts)
        address = guard.page_address(server.port)
        print(f"{sources}: open {address} in a browser; Ctrl-C ends", flush=True)
        if settings.opens_browser and can_open_browser():
            webbrowser.open(address)

        def is_over() -> bool:
            return ends and all(one.poller.snapshot(monotonic_ns()).phase is SensorPhase.ENDED for one in shown)

        if settings.rerun:
            listeners.append(_show_in_rerun(opened, parts))
        with stop_on_signal() as stop:
            controller.run(page, settings.display_hz, lambda: stop.now or is_over())


def can_open_browser() -> bool:
    """Return whether a person sits at a terminal on a computer that can show windows."""
    shows_windows = sys.platform in ("darwin", "win32") or any(map(os.environ.get, ("DISPLAY", "WAYLAND_DISPLAY")))
    return sys.stdout.isatty() and shows_windows


def _keep_reading(
    reading: "Reading",
    number: int,
    estimates: "list[WrenchHistory]",
    listeners: "list[Callable[[Reading, int], None]]",
) -> None:
    """Keep the estimate of a reading of this sensor, and tell the listeners."""
    for history in estimates:
        if reading.force is not None:
            history.add_estimate(reading.force)
    for listener in tuple(listeners):
        listener(reading, number)


def _show_in_rerun(opened: ExitStack, parts: Sequence[PageSensor]) -> "Callable[[Reading, int], None]":
    """Return a listener that shows the readings of all sensors in the Rerun viewer until the page is closed."""
    from ninedtact.interop.rerun import RerunViewer

    viewers = [opened.enter_context(RerunViewer(part.name or part.folder.id)) for part in parts]
    return lambda reading, number: viewers[number].show(reading)


def connect_recordings_panel(
    opened: ExitStack,
    parts: Sequence[PageSensor],
    controller: "PageController",
    listeners: "list[Callable[[Reading, int], None]]",
) -> "list[PanelFactory]":
    """Return the factory of the recordings panel, and add its recorder to the listeners.

    Without the libraries of recordings, print a notice and return none.
    """
    try:
        require_recording_libraries()
    except MissingLibraryError as missing:
        print_notice(f"the page cannot record; {missing}")
        return []
    from ninedtact.studio.page_recorder import PageRecorder, PageSensorToRecord
    from ninedtact.studio.recordings_panel import RecordingsPanel, RecordingsPanelContext

    recorded = [
        PageSensorToRecord(part.folder, part.sensor.source.name, one.wrenches, part.name)
        for part, one in zip(parts, controller.sensors, strict=True)
    ]
    recorder = PageRecorder(recorded, controller.out, controller.quota)
    opened.callback(recorder.stop)
    listeners.append(recorder.keep)
    context = RecordingsPanelContext(parts[0].folder, recorder)
    return [partial(RecordingsPanel, context=context)]


def twin_sensor_and_true_wrench(
    shape: "CalibratedShape", shown: "DemoSources", references: "Sequence[Frame]" = ()
) -> "tuple[Sensor, list[WrenchPoller]]":
    """Return a sensor on the simulated camera, and a poller of the true wrench."""
    from ninedtact.capture.frame_pacing import LatestFrameSource
    from ninedtact.live.wrench_history import WrenchPoller
    from ninedtact.reference_images import ReferenceImages
    from ninedtact.sensor import Sensor
    from ninedtact.simulation.simulated_sources import TRUE_WRENCH_MEANING

    untouched = shape.depth_reader(*(references or shown.camera.reference_frames))
    return Sensor(LatestFrameSource(shown.camera), shape, ReferenceImages(untouched)), [
        WrenchPoller(shown.force_torque, "true", TRUE_WRENCH_MEANING)
    ]


def _estimate_history(sensor: "Sensor", force: str, folder: "SensorFolder") -> "list[WrenchHistory]":
    """Give the sensor its estimator, and return the history of its estimates, still empty; no history for --force none."""
    if force == NONE:
        return []
    from ninedtact.live.wrench_history import WrenchHistory

    sensor.estimator = estimator = folder.estimator(force)
    meaning = f"what {estimator.name} reads from the image alone, ± one standard deviation"
    return [WrenchHistory("estimated", meaning, estimator.notices, states_errors=True)]


def require_display_rate(display_hz: float) -> None:
    """Refuse a display rate of zero, or one above the rate of screens."""
    if not 0 < display_hz <= _MAX_DISPLAY_HZ:
        raise InputError(
            expected=f"--display-hz above 0 and at most {_MAX_DISPLAY_HZ:g}", got=f"{display_hz:g}", remedy="drop it"
        )


def require_rerun() -> None:
    """Refuse what needs Rerun without it, or with another version; raises `MissingLibraryError`."""
    if find_spec("rerun") is None:
        raise MissingLibraryError(
            expected="rerun-sdk", got="no such package", remedy=f"run {installation_command('rerun')} (740 MB)"
        )
    if other := find_incompatible_library("rerun"):
        raise MissingLibraryError(f"{other}; run {installation_command('rerun')}")


def require_page_library() -> None:
    """Refuse to start without viser, or with a version whose messages are not known; raises `MissingLibraryError`."""
    if find_spec("viser") is None:
        raise MissingLibraryError(
            expected="viser, which serves the live page",
            got="no such package",
            remedy=f"run {installation_command('studio')}",
        )
    if other := find_incompatible_library("studio"):
        raise MissingLibraryError(f"{other}; run {installation_command('studio')}")
