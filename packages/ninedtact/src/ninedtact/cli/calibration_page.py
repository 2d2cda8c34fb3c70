"""The guided calibrations in the browser, of shape (`ninedtact calibrate --page`) and of force with known loads (`ninedtact adapt
--page`), and the live page that follows them."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from random import uniform
from threading import Event
from time import sleep
from typing import TYPE_CHECKING, Any

from ninedtact.cli.result_and_interrupt import print_notice, stop_on_signal
from ninedtact.cli.serve_sensor_page import PageSensor, PageSettings, require_page_libraries, serve_sensor_page
from ninedtact.cli.shared_options import PageHostOption, PageOriginOption, PagePortOption, camera_settings
from ninedtact.force.estimator_loading import NONE, PHYSICS
from ninedtact.open_sensor import assemble_live_sensor
from ninedtact.source_addresses import SIMULATED, is_twin_address, source_in_real_time

if TYPE_CHECKING:
    from ninedtact.calibration.sensor_folder import SensorFolder
    from ninedtact.calibration.settings import CalibrationSettings
    from ninedtact.capture.frame_source import FrameSource
    from ninedtact.design import SensorDesign
    from ninedtact.live.socket_guard import SocketGuard
    from ninedtact.simulation.calibration_camera import SimulatedCalibrationCamera
    from ninedtact.studio.calibration_page import CalibrationPage
    from ninedtact.studio.force_calibration_page import ForceCalibrationPage
    from ninedtact.studio.guided_session import GuidedSession, SwitchableCamera
    from ninedtact.studio.page_server import PageServer

_READINGS = Path("readings")
"""Folder for the readings that are saved from the live page after a calibration."""
_LIVE_HZ = 15.0
_STIFFNESS_RANGE = 0.8, 1.3
"""Range of the hidden factor of a simulated gel's modulus; silicone of one name and hardness varies by a quarter."""


@dataclass(frozen=True)
class CalibrationPageOptions:
    """A page in the browser that guides through the calibration."""

    page: bool = False
    """Guide through the presses on a page in the browser, which a phone beside the sensor can open too (--host 0.0.0.0). The
    camera is chosen there; --source chooses the first one, and sim is a simulated sensor, which is pressed on the page."""
    host: PageHostOption = "127.0.0.1"
    port: PagePortOption = None
    allow_origin: PageOriginOption = ()


@dataclass(frozen=True)
class CalibrationPageServer:
    """Serves the calibration page, and the live page after it: what to calibrate, and where the page is."""

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
        require_page_libraries()
        from ninedtact.live.socket_guard import SocketGuard
        from ninedtact.studio.calibration_page import CalibrationPage
        from ninedtact.studio.calibration_session import CalibrationSession

        guard = SocketGuard.for_host(self.options.host, self.options.allow_origin)
        simulated = simulated_calibration_camera(self.design)
        list_cameras = partial(list_calibration_cameras, self.source)
        camera = _switchable_camera(self.source, list_cameras, simulated, self.automatic)
        session = CalibrationSession(
            camera, self.out, self.design, self.settings, self.sensor_id, on_step=simulated.follow
        )
        make_page = partial(CalibrationPage, session=session, list_cameras=list_cameras, simulated=simulated)
        wanted = session.live_requested, session.force_requested
        with suppress(KeyboardInterrupt):
            port = _serve_until_wanted("calibration", self.options, guard, session, make_page, wanted)
            if port is None:
                return session.saved
            result, source = session.state.result, session.state.source
            assert result is not None
            if session.force_requested.is_set():
                options = replace(self.options, port=port)
                ForceCalibrationPageServer(result, options, source, automatic=self.automatic).serve(guard)
            else:
                serve_calibrated_sensor(result, source, port, guard, self.automatic)
        return session.saved


@dataclass(frozen=True)
class ForceCalibrationPageServer:
    """A guided calibration of a sensor's force with known loads in the browser."""

    folder: "SensorFolder"
    options: CalibrationPageOptions
    source: str | None = None
    """The camera that is shown first; None for the first one of this computer, or the simulated sensor."""
    force: str = PHYSICS
    """Estimator that is calibrated."""
    automatic: bool = False
    """Keep the camera's automatic exposure and white balance."""

    def serve(self, guard: "SocketGuard | None" = None) -> Path | None:
        """Serve the page until Ctrl-C, and the live page once somebody asks for it; return the file that was written, if any."""
        require_page_libraries()
        from ninedtact.calibration.force_calibration import UnscaledForceReader
        from ninedtact.errors import CameraError
        from ninedtact.live.socket_guard import SocketGuard
        from ninedtact.studio.force_calibration_page import ForceCalibrationPage, ball_press_under_load
        from ninedtact.studio.force_calibration_session import ForceCalibrationSession

        reader, folder, options = UnscaledForceReader(self.folder, self.force), self.folder, self.options
        simulated, stiffness = self._simulated_camera()
        list_cameras = partial(list_calibration_cameras, self.source, simulated is not None)
        if not list_cameras():
            raise CameraError(
                expected="a camera", got="none", remedy="plug it in, or name a stream or recording with --source"
            )
        guard = guard or SocketGuard.for_host(options.host, options.allow_origin)

        def offer_load(grams: float) -> None:
            if simulated is not None:
                simulated.offer(ball_press_under_load(grams))

        camera = _switchable_camera(self.source, list_cameras, simulated, self.automatic)
        session = ForceCalibrationSession(camera, folder.path, reader, on_load=offer_load)
        make_page = partial(
            ForceCalibrationPage,
            session=session,
            list_cameras=list_cameras,
            ball_radius_mm=folder.record.design.ball.radius_mm,
            simulated=simulated,
            stiffness=stiffness,
        )
        with suppress(KeyboardInterrupt):
            port = _serve_until_wanted(
                "force calibration", options, guard, session, make_page, [session.live_requested]
            )
            if port is not None:
                serve_calibrated_sensor(folder, session.state.source, port, guard, self.automatic, self.force)
        return session.saved

    def _simulated_camera(self) -> "tuple[SimulatedCalibrationCamera, float] | tuple[None, None]":
        """Return the sensor's twin under loads and its stiffness; nothing for a sensor without a twin, unless it is named."""
        has_twin = self.folder.record.twin is not None or (self.source is not None and is_twin_address(self.source))
        return simulated_loaded_camera(self.folder) if has_twin else (None, None)


def _switchable_camera(
    source: str | None,
    list_cameras: "Callable[[], dict[str, str]]",
    simulated: "SimulatedCalibrationCamera | None",
    automatic: bool,
) -> "SwitchableCamera":
    """Return the camera that a page begins with; another one, or the simulated sensor, can be chosen there."""
    from ninedtact.studio.guided_session import SwitchableCamera

    def open_source(address: str) -> "FrameSource":
        is_simulated = simulated is not None and is_twin_address(address)
        return simulated if simulated is not None and is_simulated else _live_camera(address, automatic)

    return SwitchableCamera(open_source, source or next(iter(list_cameras())))


def _serve_until_wanted(
    what: str,
    options: CalibrationPageOptions,
    guard: "SocketGuard",
    session: "GuidedSession[Any]",
    make_page: "Callable[[PageServer], CalibrationPage | ForceCalibrationPage]",
    wanted: Sequence[Event],
) -> int | None:
    """Serve a guided page until one of the events is set, and return its port; None where Ctrl-C ends it before."""
    from ninedtact.studio.guided_page import REFRESH_HZ
    from ninedtact.studio.page_server import page_server

    with page_server(options.host, options.port, guard) as server, session, stop_on_signal() as stop:
        page = make_page(server)
        print(f"{what}: open {guard.page_address(server.port)} in a browser; Ctrl-C ends", flush=True)
        while not (stop.now or any(event.is_set() for event in wanted)):
            page.refresh()
            sleep(1 / REFRESH_HZ)
        return None if stop.now else server.port


def _live_camera(address: str, automatic: bool) -> "FrameSource":
    """Return a camera or recording, its exposure fixed unless it is to stay automatic."""
    return source_in_real_time(address, camera_settings(automatic))


def serve_calibrated_sensor(
    folder: "SensorFolder", source: str, port: int, guard: "SocketGuard", automatic: bool, force: str | None = None
) -> None:
    """Serve the live page of a calibrated sensor at the address of its calibration, until Ctrl-C.

    force: estimator that it shows; without it physics, which a sensor needs a twin for.
    """
    force = force or (NONE if folder.record.twin is None else PHYSICS)
    camera = camera_settings(automatic)
    live = assemble_live_sensor(folder, source, settings=camera, estimator=force, notify=print_notice)
    settings = PageSettings(_READINGS, _LIVE_HZ, guard.host, port, guard=guard)
    serve_sensor_page([PageSensor(folder, live)], settings, ends=False)


def list_calibration_cameras(source: str | None = None, simulated: bool = True) -> dict[str, str]:
    """Return the address and the name of each source that the page offers: the named one, all cameras, and the simulated sensor."""
    from ninedtact.capture.uvc_camera import list_cameras

    named = {} if source is None or is_twin_address(source) else {source: ""}
    found = {device.path: device.name for device in list_cameras()}
    return named | found | ({SIMULATED: "simulated sensor"} if simulated else {})


def simulated_calibration_camera(design: "SensorDesign") -> "SimulatedCalibrationCamera":
    """Return the camera of a simulated sensor of a design, which is pressed by itself until a person does it."""
    from ninedtact.simulation.calibration_camera import SimulatedCalibrationCamera
    from ninedtact.simulation.twin import twin_from_design

    return SimulatedCalibrationCamera(twin_from_design(design), design)


def simulated_loaded_camera(folder: "SensorFolder") -> "tuple[SimulatedCalibrationCamera, float]":
    """Return the simulated camera on which the force calibration is practised, and the stiffness of its gel over the assumed one.

    The factor is drawn anew each time, so that the person who calibrates does not know it. Raises `CalibrationError`.
    """
    from ninedtact.mechanics.layer_compliance import bonded_layer_compliance
    from ninedtact.simulation.calibration_camera import SimulatedCalibrationCamera

    stiffness = uniform(*_STIFFNESS_RANGE)
    gel = replace(folder.gel, shear_modulus_mpa=folder.gel.shear_modulus_mpa * stiffness)
    twin = replace(folder.twin(), compliance_of=partial(bonded_layer_compliance, gel=gel))
    return SimulatedCalibrationCamera(twin, folder.record.design), stiffness
