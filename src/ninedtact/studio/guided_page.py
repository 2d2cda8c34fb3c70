"""The parts that the pages of guided procedures share: the sentence, the steps, the camera's image, its choice and its exposure.

All controls of such a page are shared by all browsers, so that everybody, and a page that is loaded again, sees the same state.
Only the place of the image is each browser's own (beside the controls, or on a phone among them), and whether the page is dark.
"""

from collections.abc import Callable, Mapping, Sequence
from time import monotonic
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray as Array
from viser import ClientHandle, GuiApi, GuiEvent, GuiImageHandle, Icon, ViserServer

from ninedtact.capture.frame_source import ExposureWithLimits
from ninedtact.errors import NinedtactError
from ninedtact.studio.guided_camera import ImageQuality
from ninedtact.studio.page_cards import card_html
from ninedtact.studio.viewer import (
    LIGHT,
    NOTICE_S,
    ControlFollower,
    ThemeChoice,
    is_user_event,
)
from ninedtact.studio.viser_server import NARROW_PX, PHONE_STYLE, TALL_PHONE_STYLE, set_title_and_icon

_WIDTH_PX, _LEAST_IMAGE_PX, _MOST_IMAGE_PX = 460, 300, 900
"""Width of the controls on a desktop, and limits of the width of the image beside them."""
_BRIGHTER = {"darker": 0.8, "brighter": 1.25}
"""Factors of the exposure of the two buttons."""
_NO_EXPOSURE = "The exposure of this source cannot be set here; a camera has its own tool for it."


class GuidedPageImage:
    """The camera's image in every browser of a guided page, and the look of that page."""

    def __init__(self, server: ViserServer, title: str) -> None:
        self._server = server
        self._images: dict[int, GuiImageHandle] = {}
        """The image of each browser that is connected."""
        self._canvas = LIGHT
        self.order_on_phone = 0.0
        """Place of the image among the controls on a phone."""
        server.gui.configure_theme(show_logo=False, show_share_button=False)
        server.gui.set_panel_label(title)
        server.scene.set_background_image(LIGHT)
        server.gui.main_panel.dock_right()
        server.gui.main_panel.set_width(_WIDTH_PX)
        set_title_and_icon(server, f"{title} · 9DTact")

    def serve(self, server: ViserServer) -> None:
        """Give the image to every browser that connects, once all shared controls are there."""
        server.on_client_connect(self._add)
        server.on_client_disconnect(self._forget)

    def show(self, canvas: UInt8[Array, "rows cols 3"]) -> None:
        """Send an image (RGB) to all browsers."""
        self._canvas = canvas
        for handle in tuple(self._images.values()):
            handle.image = canvas

    def _forget(self, client: ClientHandle) -> None:
        """Forget the image of a browser that has left."""
        self._images.pop(client.client_id, None)

    def _add(self, client: ClientHandle) -> None:
        """Add the image, and the choice of the theme below the shared controls, to the page of one browser."""
        gui, width_px = client.gui, client.camera.image_width
        if width_px < NARROW_PX:
            image = gui.add_image(self._canvas, format="jpeg", order=self.order_on_phone)
        else:
            panel = gui.add_panel()
            panel.dock_left()
            panel.set_width(int(np.clip(width_px - _WIDTH_PX, _LEAST_IMAGE_PX, _MOST_IMAGE_PX)))
            with panel.add_tab("Camera image", Icon.CAMERA):
                image = gui.add_image(self._canvas, format="jpeg")
        self._images[client.client_id] = image
        if client.client_id not in self._server.get_clients():  # it has left meanwhile
            self._forget(client)
        ThemeChoice(client)


ListCameras = Callable[[], Mapping[str, str]]
"""Returns the address and the name of each camera that can be chosen."""
_LIST_EVERY_S = 2.0


@runtime_checkable
class _CameraSession(Protocol):
    """A guided procedure whose camera can be chosen and exposed."""

    source: str

    def choose_source(self, source: str) -> None:
        """Show another camera."""

    def set_exposure(self, exposure_ms: float) -> None:
        """Set the exposure; raises `CameraSettingRefused`."""


class CameraChoiceControls:
    """The choice of the camera and its exposure, which are shown until the procedure begins."""

    def __init__(self, gui: GuiApi, session: _CameraSession, list_cameras: ListCameras) -> None:
        """list_cameras: is called again and again, so that a camera that is plugged in later can be chosen."""
        self._session, self._list_cameras = session, list_cameras
        self._labels, self._listed_at = self._present_labels(), monotonic()
        self._camera = gui.add_dropdown(
            "camera", tuple(self._labels.values()), initial_value=self._labels[session.source]
        )
        self._exposure = gui.add_number("exposure (ms)", 10.0, min=0.0, step=0.1, visible=False)
        self._brighter = gui.add_button_group("image", tuple(_BRIGHTER), visible=False)
        self._no_exposure = gui.add_html("")
        self._limits: ExposureWithLimits | None = None
        self._follower = ControlFollower()
        self._camera.on_update(self._choose_camera)
        self._exposure.on_update(self._set_exposure)
        self._brighter.on_click(self._brighten)

    def show(self, source: str, exposure: ExposureWithLimits | None, is_shown: bool, has_image: bool) -> None:
        """Show the camera and its exposure, or nothing of them."""
        self._limits = exposure
        self._camera.visible = is_shown
        if is_shown and monotonic() - self._listed_at > _LIST_EVERY_S:
            self._list_again(source)
        self._follower.follow((self._camera, self._labels[source]))
        self._exposure.visible = self._brighter.visible = is_shown and exposure is not None
        if exposure is not None:
            self._exposure.min, self._exposure.max = exposure.least_ms, exposure.most_ms
            self._follower.follow((self._exposure, round(exposure.now_ms, 2)))
        self._no_exposure.content = (
            card_html("line", text=_NO_EXPOSURE, margin="0.2em", is_dim=True)
            if is_shown and has_image and exposure is None
            else ""
        )

    def _present_labels(self) -> dict[str, str]:
        """Return what the menu says of each camera, by its address."""
        cameras = self._list_cameras()
        return {address: f"{address}: {name}" if name else address for address, name in cameras.items()}

    def _list_again(self, source: str) -> None:
        """Offer the cameras that are there now; the one that is shown stays, even if it was unplugged."""
        found = self._present_labels()
        self._labels, self._listed_at = {source: self._labels[source], **found}, monotonic()
        shown = tuple(self._labels[address] for address in sorted(self._labels, key=[*found, source].index))
        if shown != self._camera.options:
            self._camera.options = shown

    def _choose_camera(self, event: GuiEvent[Any]) -> None:
        """Show the chosen camera."""
        if is_user_event(event):
            addresses = {label: address for address, label in self._labels.items()}
            self._session.choose_source(addresses[self._camera.value])

    def _set_exposure(self, event: GuiEvent[Any]) -> None:
        """Set the exposure that a person has typed."""
        if is_user_event(event):
            attempt(event.client, lambda: self._session.set_exposure(float(self._exposure.value)))

    def _brighten(self, event: GuiEvent[Any]) -> None:
        """Change the exposure by a factor, within its limits."""
        limits = self._limits
        if limits is not None:
            wanted_ms = limits.now_ms * _BRIGHTER[self._brighter.value]
            wanted_ms = float(np.clip(wanted_ms, limits.least_ms, limits.most_ms))
            attempt(event.client, lambda: self._session.set_exposure(round(wanted_ms, 1)))


def attempt(client: ClientHandle | None, action: Callable[[], Any]) -> None:
    """Do what a button says, and show why where it is refused."""
    try:
        action()
    except NinedtactError as refusal:
        if client is not None:
            client.add_notification("Not done", str(refusal), color="red", auto_close_seconds=NOTICE_S)


def steps_html(names: Sequence[str], done: int) -> str:
    """Return the steps as HTML, those that are done ticked and the present one marked; -1 marks none."""
    return PHONE_STYLE + TALL_PHONE_STYLE + card_html("steps", names=names, done=done)


def live_image_quality_rows(quality: ImageQuality) -> dict[str, str]:
    """Return the figures of a live image, with what is usual."""
    return {
        "brightness": f"{quality.mean_grey:.0f} of 255 (140 to 170 is usual)",
        "overexposed": f"{quality.overexposed_share:.1%} of the image (below 1% is good)",
        "sharpness": f"{quality.sharpness:.2f}, best so far {quality.best_sharpness:.2f}: turn the lens until it is largest",
    }
