"""The panel of recordings: record the sensor with labels, open a recording, go through its time, label it, export it.

Recording is shared by all viewers; what is open, and where in its time, is each viewer's own.
"""

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from datetime import datetime
from functools import partial
from pathlib import Path
from time import monotonic
from typing import Any

from viser import GuiApi, GuiButtonHandle, GuiEvent, Icon, IconName

from ninedtact.atomic_write import write_file_atomically
from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.errors import InputError
from ninedtact.live.reading_recorder import ReadingRecorder, RecorderState
from ninedtact.reading import Reading
from ninedtact.recording.export import export_each_sensor
from ninedtact.recording.reader import Recording, recorded_sensor_addresses
from ninedtact.recording.topics_and_messages import LabelledSpan
from ninedtact.shape.calibrated_shape import CalibratedShape
from ninedtact.source_addresses import RECORDING_SUFFIX, load_recorded_sensor
from ninedtact.studio.page_cards import (
    card_html,
    recorder_html,
    shape_summary_html,
    standalone_moment_html,
    status_html,
    time_slider_marks,
    wrench_meaning_html,
    wrench_table_html,
)
from ninedtact.studio.page_controller import WITHOUT_READING, PageMoment
from ninedtact.studio.recording_player import SPEEDS, RecordedSensor, RecordingPlayer
from ninedtact.studio.saved_files import save_video
from ninedtact.studio.viewer import Side, ViewerPage, on_user_change

NOTHING, WHOLE = "none", "the whole recording"
STEPS = {"back": -1, "play": 0, "next": 1}
_SPEED_OF_NAME = {f"{each:g} ×": each for each in SPEEDS}
PLAY_KEYS = "keys: J frame back, K play or pause, L frame forward"
_LIST_EVERY_S = 1.0
_HEIGHT_BYTES = 4


@dataclass(frozen=True)
class RecordingsPanelContext:
    """What the recordings panels of all viewers share: recorder, first recording, calibrations and exporters."""

    sensor: SensorFolder
    recorder: ReadingRecorder | None = None
    """None on a page without a sensor."""
    opens: Path | None = None
    """The recording that every viewer begins with."""
    shapes: Mapping[str, CalibratedShape] = field(default_factory=dict)
    """The calibrations of its sensors by how `Recording` opens them; those that are not here are read from the recording."""

    def shape_of(self, path: Path) -> CalibratedShape:
        """Return the calibration that a recording carries, or that of the page's sensor where it carries none of the same sensor.

        Raises `RecordingUnreadable` for a recording of another sensor that carries none.
        """
        if str(path) in self.shapes:
            return self.shapes[str(path)]
        with Recording(path) as recording:
            carries_none = not recording.sensor_files()
            if carries_none and recording.sensor == self.sensor.id:
                return self.sensor.shape
        with load_recorded_sensor(str(path)) as folder:
            return folder.shape


class RecordingsPanel:
    """Record, play, label and export."""

    title, icon = "Record", Icon.VIDEO
    side: Side = "right"

    def __init__(self, viewer: ViewerPage, context: RecordingsPanelContext) -> None:
        self._viewer, self._context = viewer, context
        self._out, self._quota = viewer.controller.out, viewer.controller.quota
        self._player: RecordingPlayer | None = None
        self._opened_name, self._shown_state = NOTHING, RecorderState()
        self._listed_at, self._was_running = -_LIST_EVERY_S, False
        self._marks_s, self._slid_s = [0.0, 0.0], -1.0

    @property
    def _chosen_sensor(self) -> RecordedSensor:
        """The recorded sensor that the views show, or the first; raises `InputError`."""
        sensors = self._opened.sensors
        return sensors[min(self._viewer.options.sensor or 0, len(sensors) - 1)]

    @property
    def _opened(self) -> RecordingPlayer:
        if self._player is None:
            raise InputError(expected="an open recording to export", got="none", remedy="open one first")
        return self._player

    def build(self, gui: GuiApi) -> None:
        """Add the controls of recording, playing, labels and export."""
        self._gui = gui
        if self._context.recorder is not None:
            self._build_record(gui, self._context.recorder)
        with gui.add_folder("play") as folder:
            if self._context.opens is None:
                self._choice = gui.add_dropdown("recording", (NOTHING,), hint=f"recordings in {self._out}")
                self._close_button = gui.add_button("Back to the sensor", icon=Icon.PLAYER_EJECT, visible=False)
                on_user_change(self._choice, self._choose)
                self._close_button.on_click(lambda event: self._close())
            self._play_folder, self._slider = folder, gui.add_slider("time (s)", 0.0, 1.0, 0.001, 0.0, visible=False)
            self._steps = gui.add_button_group("image", tuple(STEPS), visible=False, hint="play also pauses")
            self._speed = gui.add_dropdown("speed", tuple(_SPEED_OF_NAME), initial_value="1 ×", visible=False)
            on_user_change(self._steps, lambda event: self._step(STEPS[event.target.value]))
            on_user_change(self._speed, self._set_speed)
            self._keys = gui.add_html(card_html("lines", texts=[PLAY_KEYS]), visible=False)
        self._labels = gui.add_folder("labels", visible=False)
        with self._labels:
            self._list = gui.add_html("")
            self._label_choice = gui.add_dropdown("label", (WHOLE,))
            on_user_change(self._label_choice, self._go_to_label)
            self._label_name = gui.add_text("name", "")
            self._marks = gui.add_button_group("here", ("begins", "ends"))
            on_user_change(self._marks, self._mark)
            self._marked = gui.add_html("")
            gui.add_button("Add label", icon=Icon.PLUS).on_click(lambda event: self._edit(self._add_label))
            gui.add_button("Remove label", icon=Icon.TRASH).on_click(lambda event: self._edit(self._remove_label))
        with gui.add_folder("export"):
            page = gui.add_button("This moment as a web page", icon=Icon.HTML, hint=f"one HTML file in {self._out}")
            page.on_click(partial(self._export, self._export_page))
            exports: dict[str, tuple[IconName, str, Export]] = {
                "Images and tables": (Icon.TABLE, "PNG, CSV, .npy and the sensor folder", self._export_tables),
                "Video (MP4)": (
                    Icon.MOVIE,
                    "image beside heights, of the chosen label or of all",
                    self._export_video,
                ),
            }
            self._exports: list[GuiButtonHandle] = []
            for name, (icon, hint, export) in exports.items():
                button = gui.add_button(name, icon=icon, visible=False, hint=hint)
                button.on_click(partial(self._export, export))
                self._exports.append(button)
            self._progress = gui.add_html("")
        for name, key, images in (("Frame back", "J", -1), ("Play or pause", "K", 0), ("Frame forward", "L", 1)):
            gui.add_command(name, hotkey=key).on_trigger(lambda event, images=images: self._step(images))
        if self._context.opens is not None:
            self._open(self._context.opens)

    def update(self, moment: PageMoment) -> None:
        """Show the state of the recorder, and the place in time."""
        recorder, state = self._context.recorder, RecorderState()
        if recorder is not None:
            state = recorder.state()
            self._show_recorder(state)
        player = self._player
        if player is not None and player.at_s != self._slid_s:
            # Only where time has gone on by itself: a slider that a person drags must not be set back.
            self._slid_s = player.at_s
            self._slider.value = round(self._slid_s, 3)
        is_due = monotonic() - self._listed_at > _LIST_EVERY_S or state.is_running != self._was_running
        if self._context.opens is None and is_due:
            self._listed_at, self._was_running = monotonic(), state.is_running
            self._list_recordings(state)

    def _build_record(self, gui: GuiApi, recorder: ReadingRecorder) -> None:
        with gui.add_folder("record"):
            self._record = gui.add_button("Record", icon=Icon.PLAYER_RECORD, color="red", hint=f"into {recorder.out}")
            self._recorded = gui.add_html("")
            self._live_label = gui.add_text("label", "", hint="for example the name of the object")
            self._live_begin = gui.add_button("Begin label", icon=Icon.TAG)
            self._record.on_click(lambda event: self._toggle_record(recorder))
            self._live_begin.on_click(lambda event: self._toggle_label(recorder))

    def _toggle_record(self, recorder: ReadingRecorder) -> None:
        """Do what the button says, also where another person has just done so."""
        with self._viewer.notify_refusal("Not recorded"):
            if self._shown_state.is_running:
                state = recorder.stop()
                if not state.trouble and state.path is not None:
                    self._viewer.notify("Recorded", state.path.name, "green")
            else:
                recorder.start()

    def _toggle_label(self, recorder: ReadingRecorder) -> None:
        with self._viewer.notify_refusal("No label"):
            if self._shown_state.label is None:
                recorder.begin_label(self._live_label.value)
            elif recorder.state().label == self._shown_state.label:
                recorder.end_label()

    def _show_recorder(self, state: RecorderState) -> None:
        self._shown_state = state
        self._record.label = "Stop recording" if state.is_running else "Record"
        self._record.icon = Icon.PLAYER_STOP if state.is_running else Icon.PLAYER_RECORD
        self._live_begin.label = "Begin label" if state.label is None else f"End label '{state.label}'"
        self._live_begin.disabled = not state.is_running
        self._recorded.content = recorder_html(state)

    def _list_recordings(self, state: RecorderState) -> None:
        paths = sorted(self._out.glob("*.mcap"), reverse=True) if self._out.is_dir() else []
        names = (NOTHING, *(path.name for path in paths if not state.is_running or path != state.path))
        if names != self._choice.options:
            self._choice.options = names

    def _choose(self, event: GuiEvent[Any]) -> None:
        name = str(event.target.value)
        self._close() if name not in self._choice.options[1:] else self._open(self._out / name)

    def _open(self, path: Path) -> None:
        """Show a recording in place of the sensor, to this viewer."""
        viewer = self._viewer
        with self._viewer.notify_refusal("Not opened"), ExitStack() as opened:
            recorded, columns = list[RecordedSensor](), [one.wrenches for one in viewer.controller.sensors]
            for number, address in enumerate(map(Path, recorded_sensor_addresses(path))):
                sources, shape = columns[min(number, len(columns) - 1)], self._context.shape_of(address)
                recorded.append(RecordedSensor(address, shape, viewer.controller.scale, sources))
                opened.callback(recorded[-1].close)
            player = RecordingPlayer(recorded)
            opened.pop_all()
            player.speed = _SPEED_OF_NAME.get(str(self._speed.value), 1.0)
            self._player, self._opened_name = player, path.name
            self._marks_s = [0.0, player.duration_s]
            viewer.play(player)
            self._show_labels(player)
        self._show_controls()

    def _close(self) -> None:
        self._player, self._opened_name = None, NOTHING
        self._viewer.play(None)
        self._show_controls()

    def _show_controls(self) -> None:
        is_open = self._player is not None
        for control in (self._labels, self._keys, self._slider, self._steps, self._speed, *self._exports):
            control.visible = is_open
        if self._context.opens is None:
            self._close_button.visible = is_open
            self._choice.value = self._opened_name  # also where another one could not be opened

    def _seek(self, event: GuiEvent[Any]) -> None:
        player = self._player
        if player is not None:
            player.seek(float(event.target.value))
            self._slid_s = player.at_s

    def _step(self, images: int) -> None:
        if self._player is not None:
            self._player.step(images) if images else self._player.toggle_play()

    def _set_speed(self, event: GuiEvent[Any]) -> None:
        if self._player is not None:
            self._player.speed = _SPEED_OF_NAME.get(str(event.target.value), 1.0)

    def _chosen_span(self) -> LabelledSpan | None:
        player, chosen = self._player, self._label_choice.value
        spans = [] if player is None else [one for one in player.spans if _span_name(player, one) == chosen]
        return spans[0] if spans else None

    def _go_to_label(self, event: GuiEvent[Any]) -> None:
        player, span = self._player, self._chosen_span()
        if player is not None and span is not None:
            self._marks_s = list(player.span_s(span))
            player.seek(self._marks_s[0])
            self._show_marks()

    def _mark(self, event: GuiEvent[Any]) -> None:
        if self._player is not None:
            self._marks_s[0 if event.target.value == "begins" else 1] = self._player.at_s
            self._show_marks()

    def _add_label(self, player: RecordingPlayer) -> None:
        player.add_span(self._marks_s[0], self._marks_s[1], self._label_name.value)

    def _remove_label(self, player: RecordingPlayer) -> None:
        span = self._chosen_span()
        if span is None:
            raise InputError(
                expected="a label to remove", got=f"'{self._label_choice.value}'", remedy="choose one first"
            )
        player.remove_span(span)

    def _edit(self, change: Callable[[RecordingPlayer], None]) -> None:
        player = self._player
        if player is not None:
            with self._viewer.notify_refusal("Label not changed"):
                change(player)
            if self._player is player:  # which may have been closed while its file was written
                self._show_labels(player)

    def _show_labels(self, player: RecordingPlayer) -> None:
        names = [_span_name(player, span) for span in player.spans]
        self._label_choice.options = (WHOLE, *dict.fromkeys(names))
        self._replace_slider(player)
        self._list.content = card_html("lines", texts=names)
        self._show_marks()

    def _replace_slider(self, player: RecordingPlayer) -> None:
        """Show the time on another slider, because viser takes the marks of labels only when a slider is made."""
        before, end_s = self._slider, max(round(player.duration_s, 3), 0.001)
        at_s, marks = min(round(player.at_s, 3), end_s), tuple(time_slider_marks(player))
        with self._play_folder:
            self._slider = self._gui.add_slider(
                "time (s)", 0.0, end_s, 0.001, at_s, marks=marks, order=before.order, visible=before.visible
            )
        on_user_change(self._slider, self._seek)
        before.remove()

    def _show_marks(self) -> None:
        self._marked.content = card_html("lines", texts=["marked: {:.2f} to {:.2f} s".format(*self._marks_s)])

    def _export(self, export: "Export", event: GuiEvent[Any]) -> None:
        result = ""
        with self._viewer.notify_refusal("Not exported"):
            with self._quota.one_export():
                self._quota.count_save(0, self._out, "an export")
                self._out.mkdir(parents=True, exist_ok=True)
                path = export(f"{datetime.now():%Y%m%d_%H%M%S_%f}")
            result = card_html("lines", texts=[f"exported to {path}"])
            self._viewer.notify("Exported", path.name, "green")
            self._viewer.offer_download(path)
        self._progress.content = result

    def _export_page(self, time: str) -> Path:
        newest = self._viewer.moment
        moment = None if newest is None else self._viewer.choose_shown(newest)[0]
        if moment is None or moment.view is None:
            raise InputError(WITHOUT_READING)
        view, path = moment.view.with_past(False), self._out / f"moment_{time}.html"
        cards = (
            status_html(moment.status),
            shape_summary_html(view.summary, False),
            *(
                (wrench_table_html(moment.wrenches, False), wrench_meaning_html(moment.wrenches))
                if moment.wrenches
                else ()
            ),
        )
        sample = moment.wrenches[0].sample if moment.wrenches else None
        sensor = moment.name or (
            self._context.sensor.id if self._player is None else self._player.sensors[0].readings.recording.sensor
        )
        title = f"{sensor}, {f'{datetime.now():%Y-%m-%d %H:%M:%S}' if self._player is None else moment.status.sentence}"
        wrench = None if sample is None else sample.wrench
        content = standalone_moment_html(view, cards, self._viewer.block, title, wrench).encode()
        self._quota.require_space(len(content), self._out, "a web page")
        write_file_atomically(path, content)
        self._quota.add_bytes(len(content))
        return path

    def _export_tables(self, time: str) -> Path:
        path = self._out / f"{self._opened.path.stem}_export_{time}"
        with ExitStack() as opened:
            recordings = [opened.enter_context(Recording(one.path)) for one in self._opened.sensors]
            count = sum(len(one.readings) for one in self._opened.sensors)
            first = None if self._viewer.moment is None else self._viewer.moment.sensors[0].reading
            image_bytes = 0 if first is None else first.frame.image.nbytes + _HEIGHT_BYTES * first.height.z_mm.size
            self._quota.require_space(count * image_bytes, self._out, "an export")
            said = iter(range(1, count + 1))
            export_each_sensor(recordings, path, lambda: self._say_progress(next(said, count), count))
        self._quota.add_bytes(sum(file.stat().st_size for file in path.rglob("*") if file.is_file()))
        return path

    def _export_video(self, time: str) -> Path:
        sensor = self._chosen_sensor
        readings, numbers = sensor.readings_within(self._chosen_span())
        name = sensor.path.name.replace(RECORDING_SUFFIX, "").replace("#", "_")  # grasp_left of grasp.mcap#left
        path = self._out / f"{name}_{time}.mp4"
        with readings:
            if not numbers:
                raise InputError(
                    expected=f"images in {self._label_choice.value}", got="none", remedy="choose another label"
                )

            def read(number: int) -> Reading:
                self._say_progress(number - numbers.start + 1, len(numbers))
                return readings.reading(number)

            save_video(map(read, numbers), self._viewer.controller.scale, sensor.readings.hz, path, self._quota)
        return path

    def _say_progress(self, number: int, count: int) -> None:
        if number % 10 == 1 or number == count:
            self._progress.content = card_html("lines", texts=[f"exporting {number} of {count}"])


Export = Callable[[str], Path]
"""Writes something under a name that contains this time, and returns its path."""


def _span_name(player: RecordingPlayer, span: LabelledSpan) -> str:
    begin_s, end_s = player.span_s(span)
    return f"{span.label}: {begin_s:.2f} to {end_s:.2f} s"
