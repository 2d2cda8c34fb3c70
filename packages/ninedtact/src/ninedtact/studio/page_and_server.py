"""The live page and its web server: one page for each browser, made of the same panels, and the port that it is served at."""

import errno
import socket
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from functools import partial
from io import StringIO
from threading import Lock

from viser import ClientHandle, ViserServer

from ninedtact.errors import DeviceError
from ninedtact.studio.page_controller import PageController, PageMoment
from ninedtact.studio.scene_3d import GelBlock, set_up_view
from ninedtact.studio.sensor_group import SensorGroupCurvesPanel
from ninedtact.studio.sensor_panels import ReferenceAndRatesPanel, StatusPanel, WrenchAndCurvesPanel, WrenchPanel
from ninedtact.studio.socket_guard import SocketGuard, one_line_logger
from ninedtact.studio.twin_press_panel import TwinPressPanel
from ninedtact.studio.view_panels import ImagesPanel, ProfilePanel, ScenePanel
from ninedtact.studio.viewer import LIGHT, PanelFactory, ViewerPage
from ninedtact.studio.viser_internals import set_title_and_icon, start_guarded_viser

LAST_WORDS_S = 0.1
"""Time to wait for the last messages, because viser drops unsent ones when it stops."""
IN_USE = "it in use (another 'ninedtact live'?)"
DEFAULT_PORT, PORTS_TRIED = 8080, 20
"""First port that is tried where none is named, and the number of ports from there on."""


class PagePortRefused(DeviceError):
    """Raised where the page cannot be served at this address."""


@contextmanager
def page_server(host: str, port: int | None, guard: SocketGuard | None = None) -> Iterator[ViserServer]:
    """Serve until the `with` block ends; raises `PagePortRefused`, `UnknownPageServer`.

    port: 0 takes any free port, None the default one or the next that is free. guard: the rules by which requests are accepted;
    without it those of the host, without further allowed origins.
    """
    if port is None:
        port = find_default_port(host)
    else:
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


def find_default_port(host: str) -> int:
    """Return the default port, or the next free one; raises `PagePortRefused` where all that are tried are in use."""
    for port in range(DEFAULT_PORT, DEFAULT_PORT + PORTS_TRIED - 1):
        try:
            _require_port_free(host, port)
        except PagePortRefused as refusal:
            if not isinstance(refusal.__cause__, OSError) or refusal.__cause__.errno != errno.EADDRINUSE:
                raise
        else:
            return port
    _require_port_free(host, port := DEFAULT_PORT + PORTS_TRIED - 1)
    return port


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


class SensorPage:
    """A `PageMomentDisplay` in browsers: each one gets its own panels, and all of them each moment."""

    def __init__(
        self,
        server: ViserServer,
        controller: PageController,
        block: GelBlock,
        title: str,
        more_panels: Sequence[PanelFactory] = (),
    ) -> None:
        """more_panels: further tabs, before the last."""
        self._server, self._controller, self._block = server, controller, block
        self._viewers: dict[int, ViewerPage] = {}
        self._lock, self._log = Lock(), one_line_logger()
        presses = [one.press for one in controller.sensors if one.press is not None]
        are_twins = len(presses) == len(controller.sensors)
        press_panels: list[PanelFactory] = [partial(TwinPressPanel, controls=presses)] if are_twins else []
        curves: PanelFactory = SensorGroupCurvesPanel if len(controller.sensors) > 1 else WrenchAndCurvesPanel
        has_wrenches = any(one.wrenches for one in controller.sensors)
        self._panels: tuple[PanelFactory, ...] = (
            ImagesPanel,
            StatusPanel,
            WrenchPanel,
            *press_panels,
            ScenePanel,
            ProfilePanel,
            *more_panels,
            ReferenceAndRatesPanel,
            *([curves] if has_wrenches else []),
        )
        server.gui.configure_theme(show_logo=False, show_share_button=False)
        server.gui.set_panel_label(title)
        server.scene.set_background_image(LIGHT)
        set_up_view(server, block)
        set_title_and_icon(server, f"{title} · 9DTact")
        server.on_client_connect(self._add_viewer)
        server.on_client_disconnect(self._remove_viewer)

    @property
    def is_watched(self) -> bool:
        """Whether a browser is connected."""
        return bool(self._viewers)

    @property
    def viewers(self) -> tuple[ViewerPage, ...]:
        """The pages of all browsers that are connected."""
        with self._lock:
            return tuple(self._viewers.values())

    def show(self, moment: PageMoment) -> None:
        """Show all viewers a moment, of which each shows the parts it has chosen, or the moment it has frozen.

        What goes wrong for one viewer is logged; the others and the sensor go on.
        """
        for viewer in self.viewers:
            try:
                viewer.show(moment)
            except Exception:
                self._log.warning("a moment could not be shown to one browser", exc_info=True)

    def _add_viewer(self, client: ClientHandle) -> None:
        viewer = ViewerPage(client, self._controller, self._block, self._panels)
        with self._lock:
            is_there = client.client_id in self._server.get_clients()
            if is_there:
                self._viewers[client.client_id] = viewer
        if not is_there:
            viewer.leave()

    def _remove_viewer(self, client: ClientHandle) -> None:
        with self._lock:
            viewer = self._viewers.pop(client.client_id, None)
        if viewer is not None:
            viewer.leave()
