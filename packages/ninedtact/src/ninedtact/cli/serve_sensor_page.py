"""The page of sensors on their sources, as `live`, `demo` and the guided calibrations serve it."""

import os
import sys
import webbrowser
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import monotonic_ns
from typing import TYPE_CHECKING

from ninedtact.cli.result_and_interrupt import stop_on_signal
from ninedtact.required_libraries import require_libraries

if TYPE_CHECKING:
    from ninedtact.calibration.sensor_folder import SensorFolder
    from ninedtact.live.reading_recorder import ReadingRecorder
    from ninedtact.live.socket_guard import SocketGuard
    from ninedtact.live_sensor import LiveSensor
    from ninedtact.reading import Reading
    from ninedtact.studio.page_controller import DisplayedSensor


@dataclass(frozen=True)
class PageSensor:
    """A sensor of a page, on its source and not yet opened."""

    folder: "SensorFolder"
    live: "LiveSensor"
    name: str = ""
    """Name among several sensors."""

    @property
    def estimates_force(self) -> bool:
        """Whether its readings have a wrench."""
        from ninedtact.force.estimator_and_scale import NoForceEstimator

        return not isinstance(self.live.sensor.estimator, NoForceEstimator)


def serve_sensor_page(
    parts: Sequence[PageSensor],
    guard: "SocketGuard",
    port: int | None,
    out: Path,
    display_hz: float,
    ends: bool = True,
    opens_browser: bool = False,
) -> None:
    """Serve the page of one or several sensors until Ctrl-C, or with `ends` until the last round of their twins has ended.

    port: None takes the default one or the next that is free. out: folder for what is saved from the page. opens_browser: whether
    the page is opened in a browser, where a person sits at a terminal on a computer with a screen.
    """
    from ninedtact.live.reading_recorder import RecordedSensorMetadata
    from ninedtact.live.sensor_poller import SensorPhase
    from ninedtact.simulation.simulated_sources import TRUE_WRENCH_MEANING
    from ninedtact.studio.page_controller import PageController
    from ninedtact.studio.page_server import page_server
    from ninedtact.studio.recordings_panel import RecordingsPanel, RecordingsPanelContext
    from ninedtact.studio.saved_files import SaveQuota
    from ninedtact.studio.scene_3d import gel_block_under_skin
    from ninedtact.studio.sensor_page import SensorPage

    with ExitStack() as opened:
        server = opened.enter_context(page_server(guard, port))
        recorded = [
            RecordedSensorMetadata(
                part.folder,
                part.live.sensor.source.name,
                "" if part.live.true_wrench is None else TRUE_WRENCH_MEANING,
                part.estimates_force,
                part.live.sensor.estimator.notices,
                part.name,
            )
            for part in parts
        ]
        quota = SaveQuota()
        recorder = quota.new_recorder(recorded, out)
        opened.callback(recorder.stop)
        shown = [_open_displayed_sensor(opened, part, number, recorder) for number, part in enumerate(parts)]
        controller, first = PageController(shown, out, quota), parts[0].folder
        page = SensorPage(
            server,
            controller,
            gel_block_under_skin(first.shape, first.record.design.gel),
            " · ".join(part.name or part.folder.id for part in parts),
            [partial(RecordingsPanel, context=RecordingsPanelContext(first, recorder))],
        )
        sources = ", ".join(f"{part.name}: " * bool(part.name) + part.live.sensor.source.name for part in parts)
        address = guard.page_address(server.port)
        print(f"{sources}: open {address} in a browser; Ctrl-C ends", flush=True)
        if opens_browser and can_open_browser():
            webbrowser.open(address)

        def is_over() -> bool:
            return ends and all(one.poller.snapshot(monotonic_ns()).phase is SensorPhase.ENDED for one in shown)

        with stop_on_signal() as stop:
            controller.run(page, display_hz, lambda: stop.now or is_over())


def can_open_browser() -> bool:
    """Return whether a person sits at a terminal on a computer that can show windows."""
    shows_windows = sys.platform in ("darwin", "win32") or any(map(os.environ.get, ("DISPLAY", "WAYLAND_DISPLAY")))
    return sys.stdout.isatty() and shows_windows


def _open_displayed_sensor(
    opened: ExitStack, part: PageSensor, number: int, recorder: "ReadingRecorder"
) -> "DisplayedSensor":
    """Begin to read a sensor and the true wrench of a twin, for the page and its recorder."""
    from ninedtact.live.sensor_poller import SensorPoller
    from ninedtact.live.wrench_history import WrenchHistory, WrenchPoller
    from ninedtact.simulation.simulated_sources import TRUE_WRENCH_MEANING
    from ninedtact.studio.followed_object import ObjectFollower
    from ninedtact.studio.page_controller import DisplayedSensor
    from ninedtact.studio.press_control import TwinPressController

    live, histories = part.live, []
    if live.true_wrench is not None:
        keep_sample = partial(recorder.add, number=number)
        poller = WrenchPoller(live.true_wrench, "true", TRUE_WRENCH_MEANING, keep_sample)
        histories.append(opened.enter_context(poller).history)
    if part.estimates_force:
        estimator = live.sensor.estimator
        meaning = f"what {estimator.name} reads from the image and the turn of the object, ± one standard deviation"
        histories.append(WrenchHistory("estimated", meaning, estimator.notices, states_errors=True))

    follower = ObjectFollower() if live.simulation is None else ObjectFollower(live.simulation.press_at)

    def keep(reading: "Reading") -> "Reading":
        reading = follower.add(reading)
        if reading.force is not None:
            histories[-1].add_estimate(reading.force)
        recorder.add(reading, number)
        return reading

    press = None if live.simulation is None else TwinPressController(live.simulation)
    readings = opened.enter_context(SensorPoller(live.sensor, keep))
    return DisplayedSensor(readings, histories, press, part.name, follower)


def require_page_libraries() -> None:
    """Refuse to start without the libraries of the page, or with a viser whose messages are not known."""
    require_libraries("studio", "viser", "websockets", "rosbags", "mcap")
