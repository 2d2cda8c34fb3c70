"""The guided calibrations in the browser, of shape (`ninedtact calibrate --page`) and of force with known loads (`ninedtact adapt
--page`), and the live page that follows them."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from random import uniform
from threading import Event
from time import sleep
from typing import TYPE_CHECKING, Any

from ninedtact.cli.result_and_interrupt import print_notice, stop_on_signal
from ninedtact.cli.serve_sensor_page import PageSensor, require_page_libraries, serve_sensor_page
from ninedtact.cli.shared_options import CameraOptions, PageAddressOption, PageAddressOptions
from ninedtact.force.estimator_loading import NONE, PHYSICS
from ninedtact.live_sensor import assemble_live_sensor
from ninedtact.source_addresses import SIMULATED, is_twin_address, source_in_real_time

if TYPE_CHECKING:
    from ninedtact.calibration.sensor_folder import SensorFolder
    from ninedtact.calibration.settings import CalibrationSettings
    from ninedtact.capture.frame_source import CameraSettings, FrameSource
    from ninedtact.design import SecondKind, SensorDesign
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
    address: PageAddressOption = PageAddressOptions()


@dataclass
class GuidedPages:
    """Serves guided calibrations, and the live page that follows them, one after the other at one address."""

    options: CalibrationPageOptions
    source: str | None = None
    """The camera that is shown first; None for the first one of this computer, or the simulated sensor."""
    camera: "CameraSettings" = field(default_factory=CameraOptions().settings)
    """Settings of a camera on this computer."""

    def __post_init__(self) -> None:
        require_page_libraries()
        self.guard, self.port = self.options.address.new_guard(), self.options.address.port

    def calibrate_shape(
        self,
        out: Path,
        sensor_id: str,
        design: "SensorDesign",
        settings: "CalibrationSettings",
        second: "tuple[SecondKind, ...]" = (),
    ) -> "SensorFolder | None":
        """Serve until Ctrl-C the calibration of a sensor, and what somebody asks for after it; return the sensor, None without."""
        from ninedtact.studio.calibration_page import CalibrationPage
        from ninedtact.studio.calibration_session import CalibrationSession

        simulated = simulated_calibration_camera(design)
        list_cameras = partial(list_calibration_cameras, self.source)
        camera = self._switchable_camera(list_cameras, simulated)
        session = CalibrationSession(camera, out, design, settings, sensor_id, second, on_step=simulated.follow)
        make_page = partial(CalibrationPage, session=session, list_cameras=list_cameras, simulated=simulated)
        with suppress(KeyboardInterrupt):
            wanted = session.live_requested, session.force_requested
            if self._serve_until_wanted("calibration", session, make_page, wanted):
                result, self.source = session.state.result, session.state.source
                assert result is not None
                if session.force_requested.is_set():
                    self.calibrate_force(result)
                else:
                    self._serve_live(result)
        return session.saved

    def calibrate_force(self, folder: "SensorFolder", force: str = PHYSICS) -> Path | None:
        """Serve until Ctrl-C the force calibration of a sensor with known loads, and the live page once somebody asks for it.

        force: estimator that is calibrated. Returns the file that was written, if any.
        """
        from ninedtact.calibration.force_calibration import KnownLoadCalibration
        from ninedtact.calibration.sensor_folder import load_sensor
        from ninedtact.errors import CameraError
        from ninedtact.studio.force_calibration_page import ForceCalibrationPage, ball_press_under_load
        from ninedtact.studio.force_calibration_session import ForceCalibrationSession

        calibration = KnownLoadCalibration(folder, force)
        has_twin = folder.record.twin is not None or (self.source is not None and is_twin_address(self.source))
        simulated, stiffness = simulated_loaded_camera(folder) if has_twin else (None, None)
        list_cameras = partial(list_calibration_cameras, self.source, has_twin)
        if not list_cameras():
            raise CameraError(
                expected="a camera", got="none", remedy="plug it in, or name a stream or recording with --source"
            )

        def offer_load(grams: float) -> None:
            if simulated is not None:
                simulated.offer(ball_press_under_load(grams))

        camera = self._switchable_camera(list_cameras, simulated, folder)
        session = ForceCalibrationSession(camera, folder.path, calibration, on_load=offer_load)
        make_page = partial(
            ForceCalibrationPage,
            session=session,
            list_cameras=list_cameras,
            ball_radius_mm=folder.record.design.ball.radius_mm,
            simulated=simulated,
            stiffness=stiffness,
        )
        with suppress(KeyboardInterrupt):
            if self._serve_until_wanted("force calibration", session, make_page, [session.live_requested]):
                self.source = session.state.source
                self._serve_live(load_sensor(folder.path), force)
        return session.saved

    def live_sensor(self, folder: "SensorFolder", force: str | None = None) -> PageSensor:
        """Return a calibrated sensor on its source, for the live page.

        force: estimator that it shows; without it physics, which a sensor needs a twin for.
        """
        assert self.source is not None
        force = force or (NONE if folder.record.twin is None else PHYSICS)
        live = assemble_live_sensor(folder, self.source, settings=self.camera, estimator=force, notify=print_notice)
        return PageSensor(folder, live)

    def _serve_live(self, folder: "SensorFolder", force: str | None = None) -> None:
        sensor = self.live_sensor(folder, force)
        serve_sensor_page([sensor], self.guard, self.port, _READINGS, _LIVE_HZ, ends=False)

    def _switchable_camera(
        self,
        list_cameras: "Callable[[], dict[str, str]]",
        simulated: "SimulatedCalibrationCamera | None",
        folder: "SensorFolder | None" = None,
    ) -> "SwitchableCamera":
        """Return the camera that a page begins with; another one, or the simulated sensor, can be chosen there."""
        from ninedtact.studio.guided_session import SwitchableCamera

        def open_source(address: str) -> "FrameSource":
            if simulated is not None and is_twin_address(address):
                return simulated
            return source_in_real_time(address, self.camera, sensor=folder)

        return SwitchableCamera(open_source, self.source or next(iter(list_cameras())))

    def _serve_until_wanted(
        self,
        what: str,
        session: "GuidedSession[Any]",
        make_page: "Callable[[PageServer], CalibrationPage | ForceCalibrationPage]",
        wanted: Sequence[Event],
    ) -> bool:
        """Serve a guided page until one of the events is set, and return whether one is; Ctrl-C ends it before."""
        from ninedtact.studio.guided_page import REFRESH_HZ
        from ninedtact.studio.page_server import page_server

        with page_server(self.guard, self.port) as server, session, stop_on_signal() as stop:
            page, self.port = make_page(server), server.port
            print(f"{what}: open {self.guard.page_address(server.port)} in a browser; Ctrl-C ends", flush=True)
            while not (stop.now or any(event.is_set() for event in wanted)):
                page.refresh()
                sleep(1 / REFRESH_HZ)
            return not stop.now


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
    from ninedtact.simulation.calibration_camera import SimulatedCalibrationCamera

    stiffness = uniform(*_STIFFNESS_RANGE)
    gel = replace(folder.gel, shear_modulus_mpa=folder.gel.shear_modulus_mpa * stiffness)
    twin = replace(folder.twin(), gel=gel)
    return SimulatedCalibrationCamera(twin, folder.record.design), stiffness
