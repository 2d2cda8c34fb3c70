"""The page of a force calibration with known loads: one large sentence, the camera's image, the presses and the scale so far."""

from functools import partial
from typing import Any

from viser import GuiEvent, Icon

from ninedtact.calibration.force_calibration import weight_of_grams_n
from ninedtact.calibration.gel_fit_to_known_loads import KnownLoadFit
from ninedtact.simulation.calibration_camera import HeldCalibrationObject, SimulatedCalibrationCamera
from ninedtact.source_addresses import is_twin_address
from ninedtact.studio.force_calibration_session import (
    ForceCalibrationPhase,
    ForceCalibrationSession,
    ForceCalibrationState,
    LoadScaleSoFar,
    TakenPress,
)
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
from ninedtact.studio.viewer import ControlFollower, on_user_change

_LEAST_G, _MOST_G = 1.0, 5000.0
_MOST_SIMULATED_G = 800.0
_HOW = (
    "Rest weights of this mass on the ball. Or put the sensor on a kitchen scale with the gel up, set the scale to zero, press the "
    "ball straight down until the scale shows about this load, and hold; then correct the load here to what the scale showed."
)


class ForceCalibrationPage:
    """A `ForceCalibrationSession` in browsers."""

    def __init__(
        self,
        server: PageServer,
        session: ForceCalibrationSession,
        list_cameras: ListCameras,
        ball_radius_mm: float,
        simulated: SimulatedCalibrationCamera | None = None,
        stiffness: float | None = None,
    ) -> None:
        """list_cameras: returns the cameras that can be chosen. simulated: the camera that is pressed on the page.

        stiffness: true factor between the simulated gel's modulus and the assumed one, which is told at the end.
        """
        self._server, self._session, self._simulated, self._stiffness = server, session, simulated, stiffness
        self._ball = f"the ball (radius {ball_radius_mm:g} mm)"
        self._named_press: TakenPress | None = None
        """The press that the button to remove one names."""
        self._follower = ControlFollower()
        self._layout = GuidedPageLayout(server, session, list_cameras, "Force calibration")
        self._build_buttons()
        self._presses, self._figures = server.viser.gui.add_html(""), server.viser.gui.add_html("")
        if simulated is not None:
            self._build_simulated_load(simulated)
        self.refresh()
        self._layout.serve()

    def refresh(self) -> None:
        """Show the present state of the session in all browsers."""
        draw_with_retry(self._draw)

    def _draw(self) -> None:
        state = self._session.state
        with self._server.viser.atomic():
            self._layout.show(state, *_steps(state, len(self._session.loads_g)), self._instruction(state))
            self._presses.content = _scale_html(state, self._stiffness if is_twin_address(state.source) else None)
            self._figures.content = (
                ""
                if state.quality is None or state.presses
                else card_html("name_value_table", rows=live_image_quality_rows(state.quality))
            )
            self._show_buttons(state)
            if self._simulated is not None:
                self._follow_load(state, self._simulated)

    def _build_buttons(self) -> None:
        gui, session = self._server.viser.gui, self._session
        self._load = gui.add_number("load (g)", session.loads_g[0], min=_LEAST_G, max=_MOST_G, step=1.0)
        on_user_change(self._load, self._set_load)
        add = partial(add_action_button, gui)
        self._start = add("Start", Icon.PLAYER_PLAY, session.start)
        self._save = add("Save the force scale", Icon.DEVICE_FLOPPY, session.save)
        self._live = add("Open the sensor live", Icon.PLAYER_PLAY, session.live_requested.set)
        self._another = add("Take another press", Icon.PLUS, session.take_another, "gray")
        self._remove = add("Remove a press", Icon.TRASH, self._remove_doubtful, "gray")
        self._start_over = add("Start over", Icon.RELOAD, session.start_over, "gray")

    def _build_simulated_load(self, simulated: SimulatedCalibrationCamera) -> None:
        gui = self._server.viser.gui
        self._loads = SimulatedSensorControls(gui, simulated, "Load the simulated sensor", "load automatically")
        with self._loads.folder:
            self._weight = gui.add_slider("load on the ball (g)", 0.0, _MOST_SIMULATED_G, 5.0, 0.0)
            self._place = gui.add_slider("place of the ball, x (mm)", -8.0, 8.0, 0.5, 0.0)
            self._refusal = gui.add_html("")

        def hold(event: GuiEvent[Any]) -> None:
            self._loads.hold(ball_press_under_load(float(self._weight.value), float(self._place.value)))

        on_user_change(self._weight, hold)
        on_user_change(self._place, hold)

    def _follow_load(self, state: ForceCalibrationState, simulated: SimulatedCalibrationCamera) -> None:
        held = simulated.held
        is_pressed = state.phase not in (ForceCalibrationPhase.PREVIEW, ForceCalibrationPhase.SAVED)
        weight = self._weight, round((held.load_n or 0.0) / weight_of_grams_n(1.0))
        place = self._place, held.at_mm[0] if held.load_n else self._place.value
        self._loads.follow(state, is_pressed, weight, place)
        self._refusal.content = card_html("alert", text=simulated.refusal, margin="0 0.9em")

    def _set_load(self, event: GuiEvent[Any]) -> None:
        """State the load that a person has typed, unless it is beyond the limits, as while it is typed."""
        load_g = float(self._load.value)
        if _LEAST_G <= load_g <= _MOST_G:
            attempt(event.client, partial(self._session.set_load, load_g))

    def _remove_doubtful(self) -> None:
        """Drop the press that the button names, also where another person has just dropped it and another one is doubtful now."""
        if self._named_press is not None:
            self._session.remove(self._named_press)

    def _instruction(self, state: ForceCalibrationState) -> Instruction:
        detail, tone, phase = state.advice, "held", state.phase
        if phase is ForceCalibrationPhase.PREVIEW:
            sentence = ""
        elif phase is ForceCalibrationPhase.REFERENCE:
            sentence = "Do not touch the gel."
        elif phase is ForceCalibrationPhase.PRESS:
            sentence = f"Load {self._ball} with {state.load_g:g} g in the middle of the skin, and hold still."
        elif phase is ForceCalibrationPhase.LIFT:
            sentence = f"Taken with {state.load_g:g} g. Take the load away."
        elif phase is ForceCalibrationPhase.SAVED:
            sentence, tone = "The force of this sensor is calibrated.", "live"
            detail = f"Saved in {state.saved}."
        elif state.scale.fit is None:
            sentence, tone = "No force scale follows from these loads.", "lost"
        else:
            sentence, tone = "All loads are taken.", "live"
            detail = "Save the force scale if its error is small enough for you."
        return Instruction(sentence, detail, tone, _HOW if phase is ForceCalibrationPhase.PRESS else "")

    def _show_buttons(self, state: ForceCalibrationState) -> None:
        phase, doubtful = state.phase, state.scale.doubtful
        self._start.visible = phase is ForceCalibrationPhase.PREVIEW
        self._start.disabled = bool(state.camera_trouble) or state.image is None
        self._load.visible = phase in (ForceCalibrationPhase.PRESS, ForceCalibrationPhase.LIFT)
        self._follower.follow((self._load, state.load_g))
        self._save.visible = state.scale.fit is not None and phase is not ForceCalibrationPhase.SAVED
        self._save.color = "gray" if phase is not ForceCalibrationPhase.COMPLETE else None
        self._live.visible = phase is ForceCalibrationPhase.SAVED
        self._another.visible = phase is ForceCalibrationPhase.COMPLETE
        self._remove.visible = doubtful is not None and phase is not ForceCalibrationPhase.SAVED
        self._named_press = None if doubtful is None else state.presses[doubtful]
        if doubtful is not None:
            self._remove.label = f"Remove press {doubtful + 1} ({state.presses[doubtful].grams:g} g)"
        self._start_over.visible = phase is not ForceCalibrationPhase.PREVIEW


def ball_press_under_load(grams: float, x_mm: float = 0.0) -> HeldCalibrationObject:
    """Return the press of the ball under a load; nothing for no load."""
    return (
        HeldCalibrationObject("ball", load_n=weight_of_grams_n(grams), at_mm=(x_mm, 0.0))
        if grams > 0
        else HeldCalibrationObject()
    )


def _steps(state: ForceCalibrationState, suggested: int) -> tuple[list[str], int]:
    """Return the presses that are taken and those still to come as steps, and the number of those that are done."""
    taken = len(state.presses)
    names = ["untouched", *(f"{press.grams:g} g" for press in state.presses)]
    names += [f"press {number + 1}" for number in range(taken, suggested)] + ["save"]
    done = {
        ForceCalibrationPhase.PREVIEW: -1,
        ForceCalibrationPhase.REFERENCE: 0,
        ForceCalibrationPhase.COMPLETE: len(names) - 1,
        ForceCalibrationPhase.SAVED: len(names),
    }.get(state.phase, taken + 1)
    return names, done


def _scale_html(state: ForceCalibrationState, stiffness: float | None) -> str:
    """Return the presses, the scale and why there is none as HTML."""
    scale, is_saved = state.scale, state.phase is ForceCalibrationPhase.SAVED
    return card_html(
        "force_scale",
        presses=[(_press_cells(number, press, scale), press.warnings) for number, press in enumerate(state.presses, 1)],
        refusal=scale.refusal,
        fit=None if scale.fit is None else _fit_rows(scale.fit),
        is_fit_awaited=scale.fit is None and state.presses and not scale.refusal,
        stiffness=f"{stiffness:.3f}" if is_saved and stiffness is not None else "",
    )


def _press_cells(number: int, press: TakenPress, scale: LoadScaleSoFar) -> tuple[str, ...]:
    """Return number, load, estimate, calibrated force and its error of a press, as far as they are known."""
    weighed_n, calibrated, off = weight_of_grams_n(press.grams), "", ""
    if scale.fit is not None:
        calibrated_n = scale.fit.estimated_n[number - 1]
        calibrated, off = f"{calibrated_n:.2f} N", f"{calibrated_n / weighed_n - 1:+.1%}"
    return f"{number}", f"{press.grams:g} g = {weighed_n:.2f} N", f"{press.estimated_n:.2f} N", calibrated, off


def _fit_rows(fit: KnownLoadFit) -> dict[str, str]:
    base = {"modulus of gel over base": f"{fit.ratio:.3f} ± {fit.ratio_std:.3f}"} if fit.ratio_std > 0 else {}
    return {
        "modulus, found over assumed": f"{fit.factor:.3f} ± {fit.factor * fit.modulus_std:.3f}",
        **base,
        "error of a left-out press": "" if fit.left_out is None else f"{fit.left_out:.1%}",
        "error before": f"{fit.unadapted:.1%}",
    }
