"""The page of a guided calibration: one large sentence, the camera's image with the pins, the buttons, the fit and its result.

The parts that it shares with other guided pages are in `guided_page`.
"""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from viser import GuiEvent, Icon

from ninedtact.calibration.certificate.checks import (
    certificate_headline,
    compute_certificate_checks,
    overall_check_level,
    uses_in_words,
)
from ninedtact.calibration.save import CERTIFICATE_FILE, failed_calibration_notices
from ninedtact.calibration.sensor_toml_schema import Certificate
from ninedtact.design import SecondKind
from ninedtact.simulation.calibration_camera import HeldCalibrationObject, SimulatedCalibrationCamera
from ninedtact.studio.calibration_session import CalibrationPhase, CalibrationSession, CalibrationState
from ninedtact.studio.guided_page import (
    GuidedPageLayout,
    Instruction,
    ListCameras,
    SimulatedSensorControls,
    add_action_button,
    attempt,
    live_image_quality_rows,
)
from ninedtact.studio.page_cards import card_html
from ninedtact.studio.page_server import PageServer, draw_with_retry
from ninedtact.studio.viewer import on_user_change

_STEP_NAMES = ("untouched", "board", "untouched", "ball")
_GRADES = {
    "pass": ("Ready to measure", "live"),
    "warn": ("Can be used with care", "busy"),
    "poor": ("Calibrate again", "lost"),
    "fail": ("Do not use", "lost"),
}
_CHECK_MARKS = {"pass": ("✓", "live"), "warn": ("!", "busy"), "fail": ("✗", "lost")}


class CalibrationPage:
    """A `CalibrationSession` in browsers."""

    def __init__(
        self,
        server: PageServer,
        session: CalibrationSession,
        list_cameras: ListCameras,
        simulated: SimulatedCalibrationCamera | None = None,
    ) -> None:
        """list_cameras: returns the cameras that can be chosen. simulated: the camera that is pressed on the page."""
        self._server, self._session, self._simulated = server, session, simulated
        self._layout = GuidedPageLayout(server, session, list_cameras, "Calibration")
        self._progress = server.viser.gui.add_progress_bar(0.0, visible=False)
        self._build_buttons()
        self._figures, self._result = server.viser.gui.add_html(""), server.viser.gui.add_html("")
        if simulated is not None:
            self._build_presses(simulated)
        self.refresh()
        self._layout.serve()

    def refresh(self) -> None:
        """Show the present state of the session in all browsers."""
        draw_with_retry(self._draw)

    def _draw(self) -> None:
        state = self._session.state
        with self._server.viser.atomic():
            names = self._step_names
            done = {CalibrationPhase.RESULT: len(names), CalibrationPhase.PREVIEW: -1}.get(state.phase, state.step)
            self._layout.show(state, names, done, _instruction(state), state.pins)
            self._figures.content = "" if state.phase is CalibrationPhase.RESULT else _figures_html(state)
            self._result.content = calibration_result_html(state, self._session.out)
            self._show_buttons(state)
            self._progress.visible = state.phase is CalibrationPhase.FIT
            self._progress.value = 100 * state.fit_progress
            if self._simulated is not None:
                self._follow_presses(state, self._simulated)

    @property
    def _step_names(self) -> tuple[str, ...]:
        second = (name for kind in self._session.second for name in ("untouched", kind.replace("_", " ")))
        return (*_STEP_NAMES, *second, "fit")

    @property
    def _chosen_second(self) -> tuple[SecondKind, ...]:
        return tuple(kind for kind, box in self._second.items() if box.value)

    def _build_buttons(self) -> None:
        gui, session = self._server.viser.gui, self._session
        self._replace = gui.add_checkbox("replace the sensor", False, hint=f"{session.out} holds a calibrated sensor")
        hints: dict[SecondKind, str] = {
            "second_ball": f"of radius {session.design.ball.second_radius_mm:g} mm",
            "flat_end": f"of a rod of radius {session.design.flat_end.radius_mm:g} mm, which a stop lets in "
            f"{session.design.flat_end.depth_mm:g} mm deep",
        }
        self._second = {
            kind: gui.add_checkbox(
                f"press a {kind.replace('_', ' ')} too",
                kind in session.second,
                hint=f"{hint}; it shows how far the base yields, and so the true depth",
            )
            for kind, hint in hints.items()
        }
        add = partial(add_action_button, gui)
        self._start = add("Start", Icon.PLAYER_PLAY, lambda: session.start(self._replace.value, self._chosen_second))
        self._fit_again = add(
            "Calibrate again from the images", Icon.REFRESH, lambda: session.fit_again(self._replace.value)
        )
        self._live = add("Open the sensor live", Icon.PLAYER_PLAY, session.request_live)
        self._force = add("Calibrate its force with known loads", Icon.SCALE, session.request_force, "gray")
        self._download = gui.add_button("Download the certificate", color="gray", icon=Icon.DOWNLOAD)
        self._download.on_click(self._send_certificate)
        self._back = add("One press back", Icon.ARROW_BACK_UP, session.back, "gray")
        self._start_over = add("Start over", Icon.RELOAD, session.start_over, "gray")

    def _build_presses(self, simulated: SimulatedCalibrationCamera) -> None:
        gui = self._server.viser.gui
        self._presses = SimulatedSensorControls(gui, simulated, "Press the simulated sensor", "press automatically")
        with self._presses.folder:
            hold = gui.add_button_group("hold", ("board", "ball", "second ball", "flat end", "nothing"))
            self._depth = gui.add_slider("depth (mm)", 0.0, 2.5, 0.05, 0.0)
            self._tilt_x = gui.add_slider("tilt about x (°)", -4.0, 4.0, 0.1, 0.0)
            self._tilt_y = gui.add_slider("tilt about y (°)", -4.0, 4.0, 0.1, 0.0)
            self._held = gui.add_html("")

        def move(event: GuiEvent[Any]) -> None:
            tilt = self._tilt_x.value, self._tilt_y.value
            self._presses.hold(replace(simulated.held, depth_mm=self._depth.value, tilt_deg=tilt))

        on_user_change(
            hold, lambda event: self._presses.hold(simulated.good_press(event.target.value.replace(" ", "_")))
        )
        for slider in (self._depth, self._tilt_x, self._tilt_y):
            on_user_change(slider, move)

    def _follow_presses(self, state: CalibrationState, simulated: SimulatedCalibrationCamera) -> None:
        held, sliders = simulated.held, (self._depth, self._tilt_x, self._tilt_y)
        values = [round(value, 2) for value in (held.depth_mm, *held.tilt_deg)]
        is_pressed = state.phase not in (CalibrationPhase.FIT, CalibrationPhase.RESULT)
        self._presses.follow(state, is_pressed, *zip(sliders, values, strict=True))
        for slider in sliders:
            slider.disabled = held.gauge == "nothing"
        self._held.content = _held_html(held, simulated.refusal)

    def _send_certificate(self, event: GuiEvent[Any]) -> None:
        folder, client = self._session.state.result, event.client
        if folder is None or client is None:
            return
        file, name = folder.path / CERTIFICATE_FILE, f"{folder.id}_certificate.html"
        attempt(client, lambda: client.send_file_download(name, file.read_bytes(), save_immediately=True))

    def _show_buttons(self, state: CalibrationState) -> None:
        phase, complete = state.phase, state.step == len(self._step_names) - 1
        can_fit = phase is CalibrationPhase.REFUSED and complete
        self._start.visible = phase is CalibrationPhase.PREVIEW
        for box in self._second.values():
            box.visible = phase is CalibrationPhase.PREVIEW and self._session.settings.method == "physics"
        self._start.disabled = bool(state.camera_trouble) or state.image is None
        self._replace.visible = (phase is CalibrationPhase.PREVIEW or can_fit) and self._session.would_replace
        self._fit_again.visible = can_fit
        self._live.visible = self._download.visible = phase is CalibrationPhase.RESULT
        self._force.visible = state.result is not None and state.result.record.twin is not None
        self._back.visible = phase in (CalibrationPhase.CAPTURE, CalibrationPhase.REFUSED) and state.step > 0
        self._start_over.visible = phase not in (CalibrationPhase.PREVIEW, CalibrationPhase.FIT)


def _instruction(state: CalibrationState) -> Instruction:
    sentence, detail, tone = state.instruction, state.advice, "held"
    if state.phase is CalibrationPhase.REFUSED:
        sentence, tone = "This calibration is refused.", "lost"
    elif state.phase is CalibrationPhase.RESULT and state.result is not None:
        sentence, tone = _GRADES[overall_check_level(_certificate(state))]
        detail = certificate_headline(_certificate(state))
    return Instruction(sentence, detail, tone)


def _figures_html(state: CalibrationState) -> str:
    rows = {} if state.quality is None else live_image_quality_rows(state.quality)
    if state.pins is not None:
        rows["pins"] = f"{state.pins.found} of {state.pins.expected}"
        if len(state.pins.missing_px):
            rows["pins"] += f"; {len(state.pins.missing_px)} missing, crossed in the image"
    return card_html("name_value_table", rows=rows)


def _certificate(state: CalibrationState) -> Certificate:
    assert state.result is not None and state.result.record.certificate is not None
    return state.result.record.certificate


def calibration_result_html(state: CalibrationState, out: Path) -> str:
    """Return checks and warnings of the certificate as HTML; empty before there is one.

    out: sensor folder that was to be written.
    """
    if state.result is None:
        return ""
    certificate = _certificate(state)
    checks = [
        (
            *_CHECK_MARKS[check.level],
            check.text if check.level == "pass" else f"{check.text} This {uses_in_words(check.affects)}.",
        )
        for check in compute_certificate_checks(certificate)
    ]
    warnings = (*failed_calibration_notices(out, state.result), *certificate.warnings)
    return card_html("calibration_result", path=state.result.path, warnings=warnings, checks=checks)


def _held_html(held: HeldCalibrationObject, refusal: str) -> str:
    words = (
        "nothing touches"
        if held.gauge == "nothing"
        else f"the {held.gauge.replace('_', ' ')} is held {held.depth_mm:.2f} mm deep"
    )
    return card_html("held_object", said=words, refusal=refusal, is_dim=True)
