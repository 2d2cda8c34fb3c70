"""The guided calibration of `ninedtact calibrate --page` in the browser, and the live page that follows it."""

from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from time import sleep
from typing import TYPE_CHECKING, Annotated

import tyro

from ninedtact.cli.live import Live, PageSensor, PageSettings, require_page_library, serve_sensor_page
from ninedtact.force.estimator_loading import NONE, PHYSICS
from ninedtact.open_sensor import SIMULATED, is_simulated, live_source_for

if TYPE_CHECKING:
    from ninedtact.calibration.procedure import CalibrationSettings
    from ninedtact.calibration.sensor_folder import SensorFolder
    from ninedtact.capture.frame_source import FrameSource
    from ninedtact.design import SensorDesign
    from ninedtact.simulation.calibration_camera import SimulatedCalibrationCamera
    from ninedtact.studio.socket_guard import SocketGuard

_READINGS = Path("readings")
"""Folder for the readings that are saved from the live page after a calibration."""
_LIVE_HZ = 15.0


@dataclass(frozen=True)
class CalibrationPageOptions:
    """A page in the browser that guides through the calibration."""

    page: bool = False
    """Guide through the presses on a page in the browser, which a phone beside the sensor can open too (--host 0.0.0.0). The
    camera is chosen there; --source chooses the first one, and sim is a simulated sensor, which is pressed on the page."""
    host: str = "127.0.0.1"
    """Address of the page; with another one than this computer's own, the printed address contains a random token."""
    port: int | None = None
    """Port of the page; without it 8080, or the next free one. 0 takes any free port."""
    allow_origin: Annotated[tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(metavar="URL")] = ()
    """Website (http://NAME:PORT) that may use the page besides the page itself: the address of a proxy or tunnel to it."""


@dataclass(frozen=True)
class GuidedCalibration:
    """A guided calibration in the browser: what to calibrate, and where the page is."""

    out: Path
    sensor_id: str
    design: "SensorDesign"
    settings: "CalibrationSettings"
    options: CalibrationPageOptions
    source: str | None = None
    """The camera that is shown first; None for the first one of this computer, or the simulated sensor."""
    automatic: bool = False
    """Keep the camera's automatic exposure and white balance."""

    def serve(self) -> "SensorFolder | None":
        """Serve the page until Ctrl-C, and the live page once somebody asks for it; return the sensor, None without one."""
        require_page_library()
        from ninedtact.studio.calibration_page import REFRESH_HZ, CalibrationPage
        from ninedtact.studio.calibration_session import CalibrationSession
        from ninedtact.studio.page_and_server import find_default_port, page_server
        from ninedtact.studio.socket_guard import SocketGuard

        guard = SocketGuard.for_host(self.options.host, self.options.allow_origin)
        port = find_default_port(self.options.host) if self.options.port is None else self.options.port
        cameras, simulated = list_calibration_cameras(self.source), simulated_calibration_camera(self.design)
        source = self.source or next(iter(cameras))
        session = CalibrationSession(
            self.out,
            lambda address: simulated if is_simulated(address) else self._camera(address),
            source,
            self.design,
            self.settings,
            self.sensor_id,
            simulated.follow,
        )
        with suppress(KeyboardInterrupt):
            with ExitStack() as opened:
                server = opened.enter_context(page_server(self.options.host, port, guard))
                opened.enter_context(session)
                page, port = CalibrationPage(server, session, cameras, simulated), server.get_port()
                print(f"calibration: open {guard.page_address(port)} in a browser; Ctrl-C ends", flush=True)
                while not session.live_requested.is_set():
                    page.refresh()
                    sleep(1 / REFRESH_HZ)
            result, source = session.state.result, session.state.source
            assert result is not None
            self._serve_live(result, source, port, guard)
        return session.state.result

    def _camera(self, address: str) -> "FrameSource":
        """Return a camera or recording, its exposure fixed unless it is to stay automatic."""
        from ninedtact.capture.frame_source import DEFAULT_CAMERA, FIXED_EXPOSURE

        return live_source_for(address, DEFAULT_CAMERA if self.automatic else FIXED_EXPOSURE)

    def _serve_live(self, folder: "SensorFolder", source: str, port: int, guard: "SocketGuard") -> None:
        """Serve the live page of the calibrated sensor at the same address, until Ctrl-C."""
        live = Live((source,), (str(folder.path),), automatic=self.automatic)
        part = PageSensor(folder, *live.sensor_and_wrenches(folder))
        force = NONE if folder.record.twin is None else PHYSICS
        settings = PageSettings(_READINGS, _LIVE_HZ, self.options.host, port, force, guard=guard)
        serve_sensor_page([part], settings, ends=False)


def list_calibration_cameras(source: str | None = None) -> dict[str, str]:
    """Return the address and the name of each source that the page offers: the named one, all cameras, and the simulated sensor."""
    from ninedtact.capture.uvc_camera import list_cameras

    named = {} if source is None or is_simulated(source) else {source: ""}
    found = {device.path: device.name for device in list_cameras()}
    return named | found | {SIMULATED: "simulated sensor"}


def simulated_calibration_camera(design: "SensorDesign") -> "SimulatedCalibrationCamera":
    """Return the camera of a simulated sensor of a design, which is pressed by itself until a person does it."""
    from ninedtact.simulation.calibration_camera import SimulatedCalibrationCamera
    from ninedtact.simulation.twin import twin_from_design

    return SimulatedCalibrationCamera(twin_from_design(design), design)
