"""The live page of sensors: one page for each browser, made of the same panels; a new panel (`viewer.Panel`) is one more."""

from collections.abc import Sequence
from functools import partial
from threading import Lock

from viser import ClientHandle

from ninedtact.live.server_log import one_line_logger
from ninedtact.studio.page_controller import PageController, PageMoment
from ninedtact.studio.page_server import PageServer, prepare_page
from ninedtact.studio.scene_3d import GelBlock, set_up_view
from ninedtact.studio.status_and_rates_panels import ReferenceAndRatesPanel, StatusPanel
from ninedtact.studio.twin_press_panel import TwinPressPanel
from ninedtact.studio.view_panels import ImagesPanel, ProfilePanel, ScenePanel
from ninedtact.studio.viewer import PanelFactory, ViewerPage
from ninedtact.studio.wrench_curves import SensorGroupCurvesPanel, WrenchAndCurvesPanel


class SensorPage:
    """A `PageMomentDisplay` in browsers: each one gets its own panels, and all of them each moment."""

    def __init__(
        self,
        server: PageServer,
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
            *press_panels,
            ScenePanel,
            ProfilePanel,
            *more_panels,
            ReferenceAndRatesPanel,
            *([curves] if has_wrenches else []),
        )
        set_up_view(server.viser, block)
        prepare_page(server, title)
        server.viser.on_client_connect(self._add_viewer)
        server.viser.on_client_disconnect(self._remove_viewer)

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
        viewer = ViewerPage(
            client,
            self._controller,
            self._block,
            self._panels,
            partial(self._server.passed_messages, client),
            self._server.drawn_moments,
        )
        with self._lock:
            is_there = client.client_id in self._server.viser.get_clients()
            if is_there:
                self._viewers[client.client_id] = viewer
        if not is_there:
            viewer.leave()

    def _remove_viewer(self, client: ClientHandle) -> None:
        with self._lock:
            viewer = self._viewers.pop(client.client_id, None)
        if viewer is not None:
            viewer.leave()
