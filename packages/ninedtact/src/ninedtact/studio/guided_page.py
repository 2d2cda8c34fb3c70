"""The parts that the pages of guided procedures share: steps, sentence, the camera with its image, and a simulated sensor.

All controls of such a page are shared by all browsers, so that everybody, and a page that is loaded again, sees the same state.
Only the place of the image is each browser's own (beside the controls, or on a phone among them), and whether the page is dark.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from time import monotonic
from typing import Any, Literal

import cv2
import numpy as np
from jaxtyping import UInt8
from numpy import ndarray as Array
from viser import ClientHandle, GuiApi, GuiButtonHandle, GuiEvent, GuiImageHandle, Icon, IconName

from ninedtact.calibration.guidance import PinSearchResult
from ninedtact.capture.frame_source import ExposureWithLimits
from ninedtact.errors import NinedtactError
from ninedtact.simulation.calibration_camera import HeldCalibrationObject, SimulatedCalibrationCamera
from ninedtact.source_addresses import is_twin_address
from ninedtact.studio.guided_session import GuidedSession, GuidedState, ImageQuality
from ninedtact.studio.page_cards import card_html
from ninedtact.studio.page_server import PageServer, moment_mark, prepare_page
from ninedtact.studio.scene_3d import LIGHT
from ninedtact.studio.viewer import (
    NARROW_PX,
    NOTICE_S,
    ControlFollower,
    add_theme_choice,
    on_user_change,
)

REFRESH_HZ = 8.0
_WIDTH_PX, _LEAST_IMAGE_PX, _MOST_IMAGE_PX = 460, 300, 900
"""Width of the controls on a desktop, and limits of the width of the image beside them."""
_IMAGE_PX = 640
"""Largest number of columns of the image that is sent."""
_FOUND_BGR, _MISSING_BGR = (232, 180, 86), (0, 94, 213)
"""Sky blue and vermilion of Okabe and Ito."""
_BRIGHTER = {"darker": 0.8, "brighter": 1.25}
"""Factors of the exposure of the two buttons."""
_NO_EXPOSURE = "The exposure of this source cannot be set here; a camera has its own tool for it."


ListCameras = Callable[[], Mapping[str, str]]
"""Returns the address and the name of each camera that can be chosen."""
_LIST_EVERY_S = 2.0
_TALL_PHONE_STYLE = (
    f"<style>@media (max-width: {NARROW_PX}px) {{ [style*='max-height: 60%'] "
    "{ max-height: 100% !important; height: 100% !important; } }</style>"
)
"""Lets the controls fill the screen of a phone; there is nothing behind them."""


@dataclass(frozen=True)
class Instruction:
    """What a person is to do, in one large sentence, and below it what the images say."""

    sentence: str
    detail: str
    tone: str = "held"
    how: str = ""
    """A longer explanation, shown small."""


class GuidedPageLayout:
    """What every guided page has in every browser: its look, the steps, the sentence, the choice of the camera, and its image."""

    def __init__(self, server: PageServer, session: GuidedSession[Any], list_cameras: ListCameras, title: str) -> None:
        """Add these parts; the controls that follow are those of the page, which then calls `serve`."""
        self._server = server
        self._images: dict[int, GuiImageHandle] = {}
        """The image of each browser that is connected."""
        self._canvas, self._drawn, self._shown = LIGHT, (0, 0), 0
        gui = server.viser.gui
        server.viser.scene.set_background_image(LIGHT)
        gui.main_panel.dock_right()
        gui.main_panel.set_width(_WIDTH_PX)
        prepare_page(server, title)
        self._steps, self._instruction = gui.add_html(""), gui.add_html("")
        self._camera = _CameraChoiceControls(gui, session, list_cameras)

    def serve(self) -> None:
        """Give the image to every browser that connects, once all shared controls are there."""
        self._server.viser.on_client_connect(self._add_image)
        self._server.viser.on_client_disconnect(self._forget)

    def show(
        self,
        state: GuidedState,
        steps: Sequence[str],
        done: int,
        what: Instruction,
        pins: PinSearchResult | None = None,
    ) -> None:
        """Show the present state in all browsers.

        done: number of the steps that are ticked, of which the next one is marked; -1 marks none. what: before the start, and
        where no images arrive, the sentence is that of all guided pages. pins: are drawn into the image.
        """
        if state.camera_trouble:
            what = Instruction("No images arrive.", state.camera_trouble, "lost")
        elif state.is_preview:
            what = replace(what, sentence="Choose the camera of the sensor.")
        self._shown += 1
        self._steps.content = _TALL_PHONE_STYLE + card_html("steps", names=steps, done=done) + moment_mark(self._shown)
        self._instruction.content = card_html("instruction", **vars(what))
        self._camera.show(state)
        drawn = id(state.image), id(pins)
        if state.image is not None and drawn != self._drawn:
            self._drawn, self._canvas = drawn, draw_found_pins(state.image, pins)[..., ::-1]
            for handle in tuple(self._images.values()):
                handle.image = self._canvas

    def _forget(self, client: ClientHandle) -> None:
        self._images.pop(client.client_id, None)

    def _add_image(self, client: ClientHandle) -> None:
        """Add the image, and the choice of the theme below the shared controls, to the page of one browser."""
        gui, width_px = client.gui, client.camera.image_width
        if width_px < NARROW_PX:
            image = gui.add_image(self._canvas, format="jpeg", order=self._instruction.order + 0.5)
        else:
            panel = gui.add_panel()
            panel.dock_left()
            panel.set_width(int(np.clip(width_px - _WIDTH_PX, _LEAST_IMAGE_PX, _MOST_IMAGE_PX)))
            with panel.add_tab("Camera image", Icon.CAMERA):
                image = gui.add_image(self._canvas, format="jpeg")
        self._images[client.client_id] = image
        if client.client_id not in self._server.viser.get_clients():  # it has left meanwhile
            self._forget(client)
        add_theme_choice(client)


def draw_found_pins(
    image: UInt8[Array, "rows cols 3"], pins: PinSearchResult | None
) -> UInt8[Array, "few_rows few_cols 3"]:
    """Return an image with the pins that were found circled and the missing ones crossed, BGR, at most 640 columns wide."""
    scale = min(1.0, _IMAGE_PX / image.shape[1])
    canvas = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA) if scale < 1 else image.copy()
    if pins is not None:
        radius = max(3, canvas.shape[1] // 60)
        for x, y in np.rint(pins.found_px * scale).astype(int).tolist():
            cv2.circle(canvas, (x, y), radius, _FOUND_BGR, 1, cv2.LINE_AA)
        for x, y in np.rint(pins.missing_px * scale).astype(int).tolist():
            cv2.drawMarker(canvas, (x, y), _MISSING_BGR, cv2.MARKER_TILTED_CROSS, 3 * radius, 2, cv2.LINE_AA)
    return np.asarray(canvas, np.uint8)


class _CameraChoiceControls:
    """The choice of the camera and its exposure, which are shown until the procedure begins."""

    def __init__(self, gui: GuiApi, session: GuidedSession[Any], list_cameras: ListCameras) -> None:
        """list_cameras: is called again and again, so that a camera that is plugged in later can be chosen."""
        self._session, self._list_cameras = session, list_cameras
        self._labels, self._listed_at = self._present_labels(), monotonic()
        self._camera = gui.add_dropdown(
            "camera", tuple(self._labels.values()), initial_value=self._labels[session.state.source]
        )
        self._exposure = gui.add_number("exposure (ms)", 10.0, min=0.0, step=0.1, visible=False)
        self._brighter = gui.add_button_group("image", tuple(_BRIGHTER), visible=False)
        self._no_exposure = gui.add_html("")
        self._limits: ExposureWithLimits | None = None
        self._follower = ControlFollower()
        on_user_change(self._camera, self._choose_camera)
        on_user_change(self._exposure, self._set_exposure)
        on_user_change(self._brighter, self._brighten)

    def show(self, state: GuidedState) -> None:
        """Show the camera and its exposure in the preview, and nothing of them afterwards."""
        self._limits = exposure = state.exposure
        self._camera.visible = state.is_preview
        if state.is_preview and monotonic() - self._listed_at > _LIST_EVERY_S:
            self._list_again(state.source)
        self._follower.follow((self._camera, self._labels[state.source]))
        self._exposure.visible = self._brighter.visible = state.is_preview and exposure is not None
        if exposure is not None:
            self._exposure.min, self._exposure.max = exposure.least_ms, exposure.most_ms
            self._follower.follow((self._exposure, round(exposure.now_ms, 2)))
        is_fixed = state.is_preview and state.image is not None and exposure is None
        self._no_exposure.content = (
            card_html("line", text=_NO_EXPOSURE, margin="0.2em", is_dim=True) if is_fixed else ""
        )

    def _present_labels(self) -> dict[str, str]:
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
        addresses = {label: address for address, label in self._labels.items()}
        self._session.choose_source(addresses[self._camera.value])

    def _set_exposure(self, event: GuiEvent[Any]) -> None:
        """Set the exposure that a person has typed, unless it is beyond the limits, as the 1 of 15 while it is typed may be."""
        wanted_ms, limits = float(self._exposure.value), self._limits
        if limits is not None and limits.least_ms <= wanted_ms <= limits.most_ms:
            attempt(event.client, lambda: self._session.set_exposure(wanted_ms))

    def _brighten(self, event: GuiEvent[Any]) -> None:
        limits = self._limits
        if limits is not None:
            wanted_ms = limits.now_ms * _BRIGHTER[self._brighter.value]
            wanted_ms = float(np.clip(wanted_ms, limits.least_ms, limits.most_ms))
            attempt(event.client, lambda: self._session.set_exposure(round(wanted_ms, 1)))


class SimulatedSensorControls:
    """The folder of controls that press a simulated sensor, which is pressed by itself until a person does it."""

    def __init__(self, gui: GuiApi, simulated: SimulatedCalibrationCamera, title: str, plays_label: str) -> None:
        """title, plays_label: of the folder and of its first control; the others are added in `folder` by the page."""
        self._simulated, self._follower = simulated, ControlFollower()
        self.folder = gui.add_folder(title)
        with self.folder:
            self._plays = gui.add_checkbox(plays_label, simulated.plays_by_itself)
        on_user_change(self._plays, self._play)

    def hold(self, held: HeldCalibrationObject) -> None:
        """Press the sensor as a person wants it."""
        self._simulated.plays_by_itself = False
        self._simulated.hold(held)

    def follow(self, state: GuidedState, is_pressed: bool, *values: tuple[Any, Any]) -> None:
        """Show what is held. is_pressed: whether the procedure waits for presses. values: controls and what they show."""
        self.folder.visible = is_twin_address(state.source) and is_pressed
        for control, value in ((self._plays, self._simulated.plays_by_itself), *values):
            self._follower.follow((control, value))

    def _play(self, event: GuiEvent[Any]) -> None:
        self._simulated.plays_by_itself = self._plays.value


def add_action_button(
    gui: GuiApi, label: str, icon: IconName, action: Callable[[], Any], color: Literal["gray"] | None = None
) -> GuiButtonHandle:
    """Add a button that does something, or shows why that is refused."""
    button = gui.add_button(label, color=color, icon=icon)
    button.on_click(lambda event: attempt(event.client, action))
    return button


def attempt(client: ClientHandle | None, action: Callable[[], Any]) -> None:
    """Do what a button says, and show why where it is refused."""
    try:
        action()
    except (NinedtactError, OSError) as refusal:
        if client is not None:
            client.add_notification("Not done", str(refusal), color="red", auto_close_seconds=NOTICE_S)


def live_image_quality_rows(quality: ImageQuality) -> dict[str, str]:
    """Return the figures of a live image, with what is usual."""
    return {
        "brightness": f"{quality.mean_grey:.0f} of 255 (140 to 170 is usual)",
        "overexposed": f"{quality.overexposed_share:.1%} of the image (below 1% is good)",
        "sharpness": f"{quality.sharpness:.2f}, best so far {quality.best_sharpness:.2f}: turn the lens until it is largest",
    }
