"""The panels about the sensor itself: its state with the measured values, the wrenches, and its rates and times."""

from typing import Any

import numpy as np
from viser import CommandEvent, GuiApi, GuiEvent, Icon, uplot

from ninedtact.live.sensor_poller import HISTORY_S, SensorPhase
from ninedtact.studio.followed_object import FollowedObject
from ninedtact.studio.page_cards import (
    card_html,
    followed_object_html,
    shape_summary_html,
    status_html,
    wrench_table_html,
)
from ninedtact.studio.page_controller import WAITING_STATUS, PageMoment, SensorMoment
from ninedtact.studio.sensor_group import group_wrench_table_html, sensor_group_status_html
from ninedtact.studio.viewer import Side, ViewerPage, on_user_change

SIDE_BY_SIDE = "all side by side"
SAVED_AS = "the camera's image as .png, heights in mm as .npy, .png and .ply, wrenches and warnings as .json"
_NO_SENSOR_SHOWN = "expected the sensor in the views, got a recording; go back to the sensor first"
KEYS = "keys: F freeze or resume, S save, R take the reference, Ctrl+K all commands"


class StatusPanel:
    """The state of the sensor, maximum indentation and contact area, the buttons that everybody needs, and the wrenches.

    The wrenches are in one table, where `WrenchAndCurvesPanel` does not show it; of several sensors with the grip force.
    """

    title, icon = "", None
    side: Side = "right"

    def __init__(self, viewer: ViewerPage) -> None:
        self._viewer = viewer
        self._has_table = viewer.is_shared or viewer.is_tall

    def build(self, gui: GuiApi) -> None:
        """Add the choice among several sensors, state, values, buttons and the table of wrenches."""
        viewer, names = self._viewer, [one.name for one in self._viewer.controller.sensors]
        if viewer.is_shared:
            shown = gui.add_dropdown(
                "sensor",
                (SIDE_BY_SIDE, *names),
                initial_value=SIDE_BY_SIDE if viewer.options.sensor is None else names[viewer.options.sensor],
                hint="what the views show",
            )
            on_user_change(
                shown,
                lambda event: viewer.choose(
                    sensor=names.index(event.target.value) if event.target.value in names else None
                ),
            )
        self._status = gui.add_html(status_html(WAITING_STATUS))
        self._figures = gui.add_html("" if viewer.is_shared else shape_summary_html(None, True))
        self._object = gui.add_html("" if viewer.is_shared else followed_object_html(FollowedObject(), True))
        self._freeze = gui.add_button(
            "Freeze", icon=Icon.PLAYER_PAUSE, hint="keep what is shown, for this browser only (F)"
        )
        save = gui.add_button("Save this reading", icon=Icon.DEVICE_FLOPPY, hint=f"{SAVED_AS} (S)")
        self._table = gui.add_html("", visible=self._has_table)
        self._freeze.on_click(lambda event: self._toggle_freeze())
        save.on_click(lambda event: self._save())
        gui.add_command("Freeze or resume", hotkey="F").on_trigger(lambda event: self._toggle_freeze())
        gui.add_command("Save this reading", hotkey="S").on_trigger(lambda event: self._save())

    def update(self, moment: PageMoment) -> None:
        """Show state, values and wrenches, and whether the moment is frozen."""
        self._show_freeze()
        if len(moment.sensors) > 1:
            self._status.content = sensor_group_status_html(moment.sensors)
            self._figures.content = self._object.content = ""
            self._table.content = group_wrench_table_html(moment.sensors) if self._has_table else ""
            return
        (alone,) = moment.sensors
        self._status.content = status_html(alone.status)
        wrenches = alone.wrenches if self._has_table else ()
        self._table.content = wrench_table_html(wrenches, alone.status.is_past) if wrenches else ""
        if alone.view is not None:
            is_pale = alone.status.is_past or bool(alone.view.reading.image_warnings)
            self._figures.content = shape_summary_html(alone.view.summary, is_pale, alone.followed.doubt)
            self._object.content = followed_object_html(alone.followed, is_pale)

    def _toggle_freeze(self) -> None:
        self._viewer.toggle_freeze()
        self._show_freeze()

    def _show_freeze(self) -> None:
        frozen = self._viewer.is_frozen  # which opening a recording ends, too
        self._freeze.label = "Resume" if frozen else "Freeze"
        self._freeze.icon = Icon.PLAYER_PLAY if frozen else Icon.PLAYER_PAUSE

    def _save(self) -> None:
        """Save the sensors that have been read, in a thread of viser, so that a slow disk delays neither sensor nor page."""
        with self._viewer.notify_refusal("Not saved"):
            moment = self._viewer.moment
            paths = self._viewer.controller.save(() if moment is None else self._viewer.choose_shown(moment))
            self._viewer.notify("Saved", f"{len(paths)} files in {paths[0].parent}", "green")


class ReferenceAndRatesPanel:
    """The button that takes the reference, the curve of the indentation in the last seconds, and rates and times."""

    title, icon = "Sensor", Icon.SETTINGS
    side: Side = "right"

    def __init__(self, viewer: ViewerPage) -> None:
        self._viewer = viewer

    def build(self, gui: GuiApi) -> None:
        """Add the button, the curve and the folded table."""
        self._reference = gui.add_button("Take reference", icon=Icon.TARGET, hint="while nothing touches the gel (R)")
        top_mm = 1.1 * self._viewer.controller.scale.pressed_mm
        self._plot = gui.add_uplot(
            (np.zeros(2), np.zeros(2)),
            (
                uplot.Series(label="s ago"),
                uplot.Series(label="maximum indentation (mm)", stroke="#2166ac", width=1.5, fill="#2166ac22"),
            ),
            scales={"x": uplot.Scale(time=False, range=(-HISTORY_S, 0.0)), "y": uplot.Scale(range=(0.0, top_mm))},
            legend=uplot.Legend(show=False),
            title=f"maximum indentation (mm), last {HISTORY_S:g} s",
            height=130,
        )
        with gui.add_folder("rates and computing times", expand_by_default=False):
            self._costs = gui.add_html("")
        gui.add_html(card_html("line", text=KEYS, margin="0.3em", size="0.8em"))
        self._reference.on_click(self._take_reference)
        gui.add_command("Take reference", hotkey="R").on_trigger(self._take_reference)

    def update(self, moment: PageMoment) -> None:
        """Show rates and computing times, and from time to time the curve."""
        rates = {
            f"{one.name} {name}".strip(): rate for one in moment.sensors for name, rate in _format_rates(one).items()
        }
        shown = self._viewer.choose_shown(moment)[0]
        self._costs.content = card_html("name_value_table", rows=rates | _format_stage_costs(shown, moment.page_ms))
        self._reference.disabled = shown.snapshot.phase is not SensorPhase.READING
        if self._viewer.redraws_curves:
            self._plot.data = tuple(shown.snapshot.history)

    def _take_reference(self, event: GuiEvent[Any] | CommandEvent) -> None:
        """Take the reference of the sensors that are shown; while a recording is, they are not seen, and others use them."""
        if self._viewer.plays_recording:
            self._viewer.notify("No reference taken", _NO_SENSOR_SHOWN, "red")
            return
        for one in self._viewer.shown_sensors:
            one.poller.take_reference()


def _format_rates(moment: SensorMoment) -> dict[str, str]:
    dropped = moment.reading.dropped if moment.reading else 0
    return {
        "camera": f"{moment.snapshot.delivered_hz:.1f} images/s",
        "read": f"{moment.snapshot.read_hz:.1f} /s, {dropped} dropped",
        "shown": f"{moment.shown_hz:.1f} /s",
    }


def _format_stage_costs(moment: SensorMoment, page_ms: dict[str, float]) -> dict[str, str]:
    """Return the time of each stage of a reading and of drawing it, without the wait for the camera."""
    stages = {} if moment.reading is None else moment.reading.stage_ms | page_ms
    return {name: f"{ms:.1f} ms" for name, ms in stages.items() if name != "capture"}
