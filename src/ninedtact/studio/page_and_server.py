"""The live page and its web server: images on the left, the skin in 3D, status, measured values and timings on the right."""

import errno
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from io import StringIO
from typing import Any, Literal

import numpy as np
from viser import GuiEvent, GuiUplotHandle, Icon, ViserServer, uplot

from ninedtact.errors import DeviceError, NinedtactError
from ninedtact.studio.displayed_reading import WAITING_STATUS, DisplayOptions, PageController, PageReport
from ninedtact.studio.page_cards import (
    WrenchCard,
    colour_legend_html,
    name_value_table_html,
    shape_summary_html,
    status_html,
)
from ninedtact.studio.reading_view import ReadingView
from ninedtact.studio.scene_3d import GelBlock, SkinScene
from ninedtact.studio.sensor_poller import HISTORY_S, SensorPhase
from ninedtact.studio.socket_guard import SocketGuard
from ninedtact.studio.viser_guard import start_guarded_viser

LAST_WORDS_S = 0.1
"""Time to wait for the last messages, because viser drops unsent ones when it stops."""
IN_USE = "it in use (another 'ninedtact live'?)"


class PagePortRefused(DeviceError):
    """Raised where the page cannot be served at this address."""


@contextmanager
def page_server(host: str, port: int, guard: SocketGuard | None = None) -> Iterator[ViserServer]:
    """Serve until the `with` block ends; port 0 takes any free port. Raises `PagePortRefused`, `UnknownPageServer`.

    guard: the rules by which requests are accepted; without it those of the host, without further allowed origins.
    """
    _require_port_free(host, port)
    server = start_guarded_viser(guard or SocketGuard.for_host(host), host, port, label="9DTact")
    try:
        # viser takes another port where the requested one is in use; a page at another address would not be found.
        if port not in (0, server.get_port()):
            raise _port_refusal(host, port, IN_USE)
        yield server
    finally:
        server.flush()
        time.sleep(LAST_WORDS_S)
        with redirect_stdout(StringIO()):
            server.stop()


def _require_port_free(host: str, port: int) -> None:
    """Refuse a port in use or an unknown host, which viser itself does not report; raises `PagePortRefused`."""
    if not 0 <= port <= 65535:
        raise _port_refusal(host, port, "a number that is not a port")
    try:
        socket.create_server((host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET).close()
    except OSError as trouble:
        taken = trouble.errno == errno.EADDRINUSE
        raise _port_refusal(host, port, IN_USE if taken else f"'{trouble.strerror}'") from trouble


def _port_refusal(host: str, port: int, got: str) -> PagePortRefused:
    """Return the error for a port that cannot be used."""
    return PagePortRefused(
        f"expected port {port} on {host} to be free for the page, got {got}; choose another with --port, or a host of "
        "this machine with --host"
    )


LEFT_PX, RIGHT_PX = 330, 330
BACKGROUND = np.full((2, 2, 3), (236, 239, 242), np.uint8)
BLANK = np.full((3, 4, 3), 90, np.uint8)
PLOT_EVERY = 3
"""Number of reports after which the curves are redrawn."""
SHOWN_S = 8.0
"""Time for which a notification stays."""
MOST_TIMES = 10.0
"""Largest vertical exaggeration."""
SKINS = ("coloured points", "shaded surface")
SAVED_AS = "the camera's image as .png, heights in mm as .npy, .png and .ply"


class SensorPage:
    """A `Display` made of viser's panels; all connected browsers show the same page."""

    def __init__(self, server: ViserServer, studio: PageController, block: GelBlock, title: str) -> None:
        self._server, self._studio = server, studio
        self._scene = SkinScene(server, block)
        self._reports = 0
        server.gui.configure_theme(show_logo=False, show_share_button=False)
        server.gui.set_panel_label(title)
        server.scene.set_background_image(BACKGROUND)
        self._lay_out_images()
        self._lay_out_controls()

    @property
    def is_watched(self) -> bool:
        """Whether a browser is connected."""
        return bool(self._server.get_clients())

    def display_options(self) -> DisplayOptions:
        """Return the options that the controls hold."""
        return DisplayOptions(self._as.value == SKINS[0], float(np.clip(self._times.value, 1.0, MOST_TIMES)))

    def show(self, view: ReadingView, options: DisplayOptions) -> None:
        """Draw all parts of one reading together."""
        with self._server.atomic():
            self._image.image = view.image[..., ::-1]
            self._heights.image = view.heights[..., ::-1]
            self._figures.content = shape_summary_html(view.summary, view.is_past)
            self._scene.show(view.surface, options, view.is_past)

    def show_report(self, report: PageReport) -> None:
        """Show state, rates, costs and wrenches; redraw the curves after every `PLOT_EVERY` reports."""
        self._status.content = status_html(report.status)
        self._show_wrenches(report)
        self._costs.content = name_value_table_html(_format_rates(report) | _format_stage_costs(report))
        self._reference.disabled = report.moment.phase is not SensorPhase.READING
        self._reports += 1
        if self._reports % PLOT_EVERY == 0:
            self._plot.data = tuple(report.moment.history)
            if self._wrenches is not None:
                self._wrenches.draw_curves(report.wrenches)

    def _show_wrenches(self, report: PageReport) -> None:
        with self._server.atomic():
            if self._wrenches is not None:
                self._wrenches.show_numbers(report.wrenches, report.status.is_past)
            first = report.wrenches[0].sample if report.wrenches and not report.status.is_past else None
            self._scene.show_wrench(None if first is None else first.wrench)

    def _lay_out_images(self) -> None:
        panel = self._server.gui.add_panel()
        with panel.add_tab("Seen from inside"):
            self._image = self._server.gui.add_image(BLANK, label="camera", format="jpeg", jpeg_quality=85)
            self._heights = self._server.gui.add_image(BLANK, label="height of the skin", format="jpeg")
            self._server.gui.add_html(colour_legend_html(self._studio.scale))
        panel.dock_left()
        panel.set_width(LEFT_PX)

    def _lay_out_controls(self) -> None:
        gui = self._server.gui
        gui.main_panel.dock_right()
        gui.main_panel.set_width(RIGHT_PX)
        self._status = gui.add_html(status_html(WAITING_STATUS))
        self._figures = gui.add_html("")
        self._plot = self._curve()
        self._wrenches = WrenchCard(self._server, self._studio.wrenches) if self._studio.wrenches else None
        self._lay_out_buttons()
        self._as = gui.add_dropdown("surface colouring", SKINS)
        self._times = gui.add_slider("vertical exaggeration", 1.0, MOST_TIMES, 0.5, 1.0, hint="1 is true to scale")
        self._costs = gui.add_html("")

    def _curve(self) -> GuiUplotHandle:
        top_mm = 1.1 * self._studio.scale.pressed_mm
        return self._server.gui.add_uplot(
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

    def _lay_out_buttons(self) -> None:
        gui = self._server.gui
        self._reference = gui.add_button("Take reference", icon=Icon.TARGET, hint="while nothing touches the gel")
        self._freeze = gui.add_button("Freeze", color="gray", icon=Icon.PLAYER_PAUSE, hint="keep the shown reading")
        save = gui.add_button("Save this reading", color="gray", icon=Icon.DEVICE_FLOPPY, hint=SAVED_AS)
        self._reference.on_click(lambda event: self._studio.take_reference())
        self._freeze.on_click(lambda event: self._toggle_freeze())
        save.on_click(self._save)

    def _toggle_freeze(self) -> None:
        self._studio.frozen = not self._studio.frozen
        self._freeze.label = "Resume" if self._studio.frozen else "Freeze"
        self._freeze.icon = Icon.PLAYER_PLAY if self._studio.frozen else Icon.PLAYER_PAUSE

    def _save(self, event: GuiEvent[Any]) -> None:
        """Save in a thread of viser, so that a slow disk delays neither the sensor nor the page."""
        try:
            paths = self._studio.save()
        except (NinedtactError, OSError) as trouble:
            _notify(event, "Not saved", str(trouble), "red")
        else:
            _notify(event, "Saved", f"{len(paths)} files in {paths[0].parent}", "green")


def _notify(event: GuiEvent[Any], title: str, body: str, colour: Literal["red", "green"]) -> None:
    """Show a notification to the person who clicked."""
    if event.client is not None:
        event.client.add_notification(title, body, color=colour, auto_close_seconds=SHOWN_S)


def _format_rates(report: PageReport) -> dict[str, str]:
    """Return the rates from camera to browser."""
    dropped = report.shown.dropped if report.shown else 0
    return {
        "camera": f"{report.moment.delivered_hz:.1f} images/s",
        "read": f"{report.moment.read_hz:.1f} /s, {dropped} dropped",
        "shown": f"{report.shown_hz:.1f} /s",
    }


def _format_stage_costs(report: PageReport) -> dict[str, str]:
    """Return the time of each stage of a reading and of drawing it, without the wait for the camera."""
    stages = {} if report.shown is None else report.shown.stage_ms | report.page_ms
    return {name: f"{ms:.1f} ms" for name, ms in stages.items() if name != "capture"}
