"""One browser of the live page: its own panels, its own choice of views, and its own frozen moment.

A page is made of panels. A `Panel` is built once for each viewer and then gets every moment that this viewer is shown; all panels
of a viewer get the same moment. To add one, write a class with `build` and `update` in a file of its own and give it to the page.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from threading import RLock
from time import monotonic, monotonic_ns, time
from typing import Any, Literal, Protocol

from viser import ClientHandle, GuiApi, GuiButtonGroupHandle, GuiEvent, GuiTabGroupHandle, IconName, PanelHandle

from ninedtact.errors import NinedtactError
from ninedtact.live.sensor_poller import SensorPhase
from ninedtact.studio.page_controller import DisplayedSensor, PageController, PageMoment, SensorMoment
from ninedtact.studio.page_server import DrawnMoments, draw_with_retry, moment_mark
from ninedtact.studio.reading_view import ImageKind, ShownTraction, SkinColouring
from ninedtact.studio.recording_player import RecordingPlayer
from ninedtact.studio.scene_3d import DARK, LIGHT, GelBlock, SideBySideLayout

NOTICE_S = 8.0
"""Time for which a notification stays."""
MOST_DOWNLOAD_BYTES = 32_000_000
"""Larger files are only written on the sensor's computer."""
MAX_EXAGGERATION = 10.0
QUICK_S, DRAWN_WITHIN_S = 0.1, 2.0
"""Time in which a quick browser draws a moment; it is sent one more meanwhile. Time after which any browser is sent one anyway."""
CURVES_EVERY = 3
"""Number of moments after which curves are drawn again."""
LEFT_PX, RIGHT_PX = 330, 350


NARROW_PX = 600
"""Width of a browser below which it is a phone: viser then shows its panel at the bottom."""
PHONE_PANEL_SHARE = 0.6
"""Share of the height of a phone that viser's panel covers, at the bottom."""
TALL_PX = 860
"""Height of a browser from which curves stand below the images and wrenches among the controls; below, they are tabs."""


def add_theme_choice(client: ClientHandle) -> None:
    """Add the choice between a light and a dark page to the page of one browser."""
    dark = client.gui.add_checkbox("dark", False)

    def show(_: object = None) -> None:
        client.gui.configure_theme(show_logo=False, show_share_button=False, dark_mode=bool(dark.value))
        client.scene.set_background_image(DARK if dark.value else LIGHT)

    dark.on_update(show)
    show()


Side = Literal["left", "lower left", "right"]
"""The columns of the page: images, curves below them, and controls; on a phone there is only the last."""


@dataclass(frozen=True)
class ViewOptions:
    """What one viewer has chosen to see."""

    images: tuple[ImageKind, ImageKind] = (ImageKind.CAMERA, ImageKind.HEIGHT)
    with_outline: bool = True
    with_path: bool = True
    colouring: SkinColouring = SkinColouring.HEIGHT
    coarser: int = 1
    """Factor by which points of the surface are farther apart than in the finest one."""
    exaggeration: float = 1.0
    """Vertical exaggeration: factor by which heights are enlarged in 3D."""
    source: ShownTraction = ShownTraction.ESTIMATED
    pressure_arrows: bool = False
    shear_arrows: bool = False
    profile_mm: tuple[tuple[float, float], tuple[float, float]] = ((-8.0, 0.0), (8.0, 0.0))
    """Ends of the line along which heights are plotted."""
    profile_sensor: int = 0
    """Number of the sensor on which the line is, where all are side by side."""
    with_profile: bool = False
    """Whether the line is drawn in 3D."""
    sensor: int | None = 0
    """Number of the sensor that the views show, among several; None shows all side by side."""


class Panel(Protocol):
    """One part of the page of one viewer."""

    @property
    def title(self) -> str:
        """Name of its tab; a panel of the right side without a name stands above the tabs."""

    @property
    def icon(self) -> IconName | None:
        """Icon of its tab."""

    @property
    def side(self) -> Side:
        """Place on the page."""

    def build(self, gui: GuiApi) -> None:
        """Add the controls."""

    def update(self, moment: PageMoment) -> None:
        """Show a moment; called with the same moment again where only the viewer's options have changed."""


PanelFactory = Callable[["ViewerPage"], Panel]


class ViewerPage:
    """The page of one browser."""

    def __init__(
        self,
        client: ClientHandle,
        controller: PageController,
        block: GelBlock,
        panels: Sequence[PanelFactory],
        passed_messages: Callable[[], int],
        drawn: DrawnMoments,
    ) -> None:
        """passed_messages: returns the number of messages to this browser that do not wait on their way any more. drawn: what
        browsers have drawn."""
        self.client, self.controller, self.block = client, controller, block
        self._passed_messages, self._passed_before = passed_messages, -1
        self._drawn, self._name, self._sent_s, self._drawn_before, self._is_quick = drawn, drawn.begin(), 0.0, 0, True
        self.is_narrow = client.camera.image_width < NARROW_PX
        self.is_tall = client.camera.image_height >= TALL_PX and not self.is_narrow
        self.is_shared = len(controller.sensors) > 1
        """Whether the page has several sensors."""
        sensor = None if self.is_shared and not self.is_narrow else 0
        self.options = ViewOptions(coarser=2 if self.is_narrow or self.is_shared else 1, sensor=sensor)
        self.moment: PageMoment | None = None
        """The moment that this viewer is shown; None before the first."""
        self._played: RecordingPlayer | None = None
        self._has_left, self._moments, self.redraws_curves = False, 0, False
        """redraws_curves: whether curves are drawn with this moment; with every one of a recording, else from time to time."""
        self.is_frozen = False
        """Whether this viewer keeps its moment."""
        self._lock = RLock()
        self._panels = [make(self) for make in panels]
        self._place_panels()

    def choose_shown(self, moment: PageMoment) -> tuple[SensorMoment, ...]:
        """Return the moments of the sensors that the views show: of one, or of all side by side."""
        number = self.options.sensor
        return moment.sensors if number is None else (moment.sensors[min(number, len(moment.sensors) - 1)],)

    @property
    def profiled_sensor(self) -> int:
        """Number of the sensor along which heights are plotted."""
        return self.options.profile_sensor if self.options.sensor is None else self.options.sensor

    @property
    def arrangement(self) -> SideBySideLayout:
        """The places of the sensors that the views show, in what the panels leave free of the window."""
        camera = self.client.camera
        free_px = camera.image_width - (0 if self.is_narrow else LEFT_PX + RIGHT_PX)
        aspect = max(free_px / max(camera.image_height, 1), 0.5)
        return SideBySideLayout(
            self.block, len(self.shown_sensors), aspect, PHONE_PANEL_SHARE if self.is_narrow else 0.0
        )

    @property
    def shown_sensors(self) -> tuple[DisplayedSensor, ...]:
        """The sensors that the views show."""
        sensors, number = self.controller.sensors, self.options.sensor
        return sensors if number is None else (sensors[number],)

    @property
    def plays_recording(self) -> bool:
        """Whether this viewer is shown a recording in place of the sensor."""
        return self._played is not None

    def toggle_freeze(self) -> None:
        """Keep the moment that is shown, or follow the sensor again; other viewers are not affected."""
        with self._lock:
            self.is_frozen = not self.is_frozen and self.moment is not None

    def play(self, source: RecordingPlayer | None) -> None:
        """Show a recording in place of the sensor, or the sensor again; what is not shown any more is closed."""
        with self._lock:
            before, self.is_frozen = [self._played], False
            self._played = None if self._has_left else source
            before += [source] if self._has_left else []
        for one in before:
            if one is not None:
                one.close()

    def leave(self) -> None:
        """Close what is shown in place of the sensor, and what a callback that still runs will open: the browser has gone."""
        with self._lock:
            self._has_left = True
        self._drawn.end(self._name)
        self.play(None)

    def choose(self, **changes: Any) -> None:
        """Change options of this viewer; the next refresh draws them, also in a frozen moment."""
        with self._lock:
            self.options = replace(self.options, **changes)

    def show(self, newest: PageMoment) -> None:
        """Show the newest moment, or the frozen one with its age; a client that has not drawn the last ones goes on with them."""
        with self._lock:
            passed = self._passed_messages()
            is_ready = passed != self._passed_before and not self._is_drawing()
            if not is_ready and not all(one.status.is_past for one in newest.sensors):
                return
            moment = newest if self._played is None else self._played.moment(newest)
            if self.is_frozen and self.moment is not None:
                moment = self.moment.frozen_copy(moment, monotonic_ns())
            self.moment, self._moments = moment, self._moments + 1
            is_recorded = moment.sensors[0].snapshot.phase is SensorPhase.RECORDED
            self.redraws_curves = not self.is_frozen and (is_recorded or self._moments % CURVES_EVERY == 0)
            self._passed_before, self._sent_s = passed, monotonic()
            with self.client.atomic():
                self._mark.content = moment_mark(self._moments, self._name)
                for panel in self._panels:
                    draw_with_retry(partial(panel.update, moment))
            # viser would wait 17 ms for more, and send nothing where the next moment has begun by then.
            self.client.flush()

    def _is_drawing(self) -> bool:
        """Return whether the browser still draws what it has been sent; one that is out of sight draws nothing for seconds."""
        last, waited_s = self._drawn.last(self._name), monotonic() - self._sent_s
        if last == self._drawn_before and waited_s > QUICK_S:
            self._is_quick = False
        elif last == self._moments:
            self._is_quick = waited_s < QUICK_S
        self._drawn_before = last
        return last > 0 and self._moments - last >= (2 if self._is_quick else 1) and waited_s < DRAWN_WITHIN_S

    def notify(self, title: str, body: str, colour: Literal["red", "green"]) -> None:
        """Show a notification to this viewer."""
        self.client.add_notification(title, body, color=colour, auto_close_seconds=NOTICE_S)

    def offer_download(self, path: Path) -> None:
        """Offer a file that was written on the sensor's computer to the browser, which may be on another one.

        Folders and files of more than `MOST_DOWNLOAD_BYTES` are not sent.
        """
        if path.is_file() and path.stat().st_size <= MOST_DOWNLOAD_BYTES:
            self.client.send_file_download(path.name, path.read_bytes())

    @contextmanager
    def notify_refusal(self, title: str) -> Iterator[None]:
        """Show this viewer what is refused in the block."""
        try:
            yield
        except (NinedtactError, OSError) as trouble:
            self.notify(title, str(trouble), "red")

    def _place_panels(self) -> None:
        """Build all panels, each in its column; on a phone all named ones are tabs below the others."""
        gui = self.client.gui
        gui.main_panel.dock_right()
        gui.main_panel.set_width(RIGHT_PX)
        self._mark = gui.add_html(moment_mark(0, self._name))
        columns: dict[Side, PanelHandle | GuiTabGroupHandle] = {}
        for panel in sorted(self._panels, key=lambda panel: bool(panel.title)) if self.is_narrow else self._panels:
            side: Side = "right" if self.is_narrow else panel.side if self.is_tall or panel.side == "right" else "left"
            if side == "right" and not panel.title:
                panel.build(gui)
                continue
            if side not in columns:
                columns[side] = gui.add_tab_group() if side == "right" else gui.add_panel()
            with columns[side].add_tab(panel.title, panel.icon):
                panel.build(gui)
        upper, lower = columns.get("left"), columns.get("lower left")
        if isinstance(upper, PanelHandle):
            upper.dock_left()
            upper.set_width(LEFT_PX)
            if isinstance(lower, PanelHandle):
                lower.dock_below(upper)


def on_user_change(control: Any, act: Callable[[GuiEvent[Any]], object]) -> None:
    """Call `act` where a person changes a control, or presses a button of a group.

    The page itself changes controls too, to follow what others do. An option that a menu or a group does not offer, which only a
    program can send, is passed over.
    """

    def handle(event: GuiEvent[Any]) -> None:
        is_offered = event.target.value in getattr(control, "options", (event.target.value,))
        if event.client is not None and is_offered:
            act(event)

    (control.on_click if isinstance(control, GuiButtonGroupHandle) else control.on_update)(handle)


class ControlFollower:
    """Sets controls to the present values of what they control, again and again.

    A control that a person changed within the last second is left alone. The change is in the control at once, but its callback
    runs later in another thread, and would otherwise read back the value that is set here.
    """

    handled_within_s = 1.0
    """Time within which the callback of a control has run."""

    def __init__(self) -> None:
        self._set_at: dict[int, float] = {}

    def follow(self, *values: tuple[Any, Any]) -> bool:
        """Set controls to values, given as pairs; return whether all controls show their values now."""
        are_shown = True
        for control, value in values:
            changed_at = control.update_timestamp
            if changed_at != self._set_at.get(id(control), changed_at) and time() - changed_at < self.handled_within_s:
                are_shown &= bool(control.value == value)
            else:
                control.value = value
                self._set_at[id(control)] = control.update_timestamp
        return are_shown
