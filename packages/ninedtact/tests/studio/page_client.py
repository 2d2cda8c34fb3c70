"""A viewer of a page without a browser, who uses its controls by their names and keeps what the page sends."""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from threading import Thread
from types import SimpleNamespace
from typing import Any

import msgspec
import viser
from reading_clients import CAMERA, received_surfaces, unpack_text
from small_sensor import SkinCamera, sensor_on, wait_until
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from ninedtact.capture.frame_source import FrameSource
from ninedtact.design import Gel
from ninedtact.live.sensor_poller import SensorPoller
from ninedtact.live.socket_guard import SocketGuard
from ninedtact.reading import Reading
from ninedtact.studio.page_controller import DisplayedSensor, PageController
from ninedtact.studio.page_server import PageServer, page_server
from ninedtact.studio.press_control import TwinPressController
from ninedtact.studio.saved_files import SaveQuota
from ninedtact.studio.scene_3d import gel_block_under_skin
from ninedtact.studio.sensor_page import SensorPage
from ninedtact.studio.viewer import PanelFactory, ViewerPage

PROTOCOL = f"viser-v{viser.__version__}"
LOCAL = SocketGuard("127.0.0.1")


class PageClient:
    """What a person does in a browser, as its messages, and what viser's page would show, from the messages that arrive."""

    def __init__(self, socket: ClientConnection) -> None:
        self.socket = socket
        self.messages: list[dict[str, Any]] = []
        """All that the page has sent, without its arrays."""
        self.controls: dict[str, SimpleNamespace] = {}
        """The controls that are there by their uuid: `label`, `value`, `visible`, `options` and so on."""
        self.surfaces: list[int] = []
        """Numbers of points of the surfaces that the page has sent."""
        self.notices: list[str] = []
        """Titles and texts of the notifications."""
        self._thread = Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self) -> None:
        with suppress(ConnectionClosed):
            self._keep_messages()

    def _keep_messages(self) -> None:
        for packed in self.socket:
            self.surfaces += received_surfaces(packed)
            for message in msgspec.msgpack.decode(unpack_text(packed))["messages"]:
                kind, uuid, props = message["type"], message.get("uuid"), message.get("props") or {}
                if kind == "NotificationShowMessage":
                    self.notices.append(f"{props['title']}: {props['body']}")
                elif kind == "GuiRemoveMessage":
                    self.controls.pop(uuid, None)
                elif kind == "GuiUpdateMessage" and uuid in self.controls:
                    vars(self.controls[uuid]).update(message["updates"])
                elif kind.startswith("Gui") and props:
                    self.controls[uuid] = SimpleNamespace(**props, value=message.get("value"), uuid=uuid)
                self.messages.append(message)

    def send(self, message: dict[str, Any]) -> None:
        self.socket.send(msgspec.msgpack.encode(message))

    def control(self, label: str) -> Any:
        """Return the control of this name, once it is there."""
        found = [one for one in list(self.controls.values()) if getattr(one, "label", None) == label]
        if not found:
            wait_until(lambda: any(getattr(one, "label", None) == label for one in list(self.controls.values())))
            return self.control(label)
        return found[0]

    def use(self, label: str, value: Any = True) -> None:
        """Press a button, or give a control a value, which a browser shows at once."""
        control = self.control(label)
        control.value = value
        self.set_value(control.uuid, value)

    def set_value(self, uuid: str, value: Any) -> None:
        """Send the value of a control, also one that no browser would send."""
        self.send({"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": value}})

    def upload(self, label: str, name: str, content: bytes) -> None:
        ids = {"source_component_uuid": self.control(label).uuid, "transfer_uuid": name + str(time.monotonic_ns())}
        size = {"part_count": 1, "size_bytes": len(content)}
        self.send({"type": "FileTransferStartUpload", "filename": name, "mime_type": "model/stl"} | ids | size)
        self.send({"type": "FileTransferPart", "part_index": 0, "content": content} | ids)

    def downloaded(self, name: str) -> bytes:
        """Wait until a file has been offered to the browser, and return its content."""
        start = self.until_sent(lambda one: one["type"] == "FileTransferStartDownload" and one["filename"] == name)

        def content() -> bytes:
            parts = [one for one in list(self.messages) if one["type"] == "FileTransferPart"]
            parts = [one for one in parts if one["transfer_uuid"] == start["transfer_uuid"]]
            return b"".join(one["content"] for one in sorted(parts, key=lambda one: one["part_index"]))

        wait_until(lambda: len(content()) == start["size_bytes"])
        return content()

    def until_sent(self, is_wanted: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        """Wait for a message of the page, and return the newest of its kind."""
        wait_until(lambda: any(map(is_wanted, list(self.messages))))
        return next(filter(is_wanted, reversed(list(self.messages))))

    def shows(self, text: str) -> bool:
        """Return whether a text stands in a control that is visible."""
        return any(text in str(getattr(one, "content", "")) for one in list(self.controls.values()) if one.visible)

    def give_command(self, label: str) -> None:
        command = self.until_sent(
            lambda one: one["type"] == "RegisterCommandMessage" and one["props"]["label"] == label
        )
        self.send({"type": "CommandTriggerMessage", "uuid": command["uuid"]})

    def click_on_scene(self, x_mm: float, y_mm: float, modifier: str | None = None) -> None:
        ray = {"ray_origin": (x_mm, y_mm, 50.0), "ray_direction": (0.0, 0.0, -1.0), "screen_pos": [(0.5, 0.5)]}
        self.send({"type": "ScenePointerMessage", "event_type": "click", "modifier": modifier} | ray)

    def drag_handle(self, position: tuple[float, float, float], wxyz: tuple[float, float, float, float]) -> None:
        handle = self.until_sent(lambda one: one["type"] == "TransformControlsMessage")
        names = {"name": handle["name"], "owner": handle["owner"]}
        self.send({"type": "TransformControlsUpdateMessage", "position": position, "wxyz": wxyz} | names)

    def end_drag(self) -> None:
        handle = self.until_sent(lambda one: one["type"] == "TransformControlsMessage")
        self.send({"type": "TransformControlsDragEndMessage", "name": handle["name"], "owner": handle["owner"]})


@contextmanager
def page_client(server: PageServer, path: str = "") -> Iterator[PageClient]:
    """Connect as a browser does that has loaded the page."""
    protocols: Any = [PROTOCOL]
    address = f"ws://127.0.0.1:{server.port}/{path}"
    with connect(address, subprotocols=protocols, max_size=None, max_queue=None, close_timeout=0.1) as socket:
        socket.send(msgspec.msgpack.encode(CAMERA))
        yield PageClient(socket)


@dataclass
class ServedPage:
    """A live page that is served, refreshed by the test."""

    server: PageServer
    controller: PageController
    page: SensorPage

    def refresh(self) -> bool:
        """Show all viewers the newest moment; true, so that conditions can follow."""
        return bool(self.controller.refresh(self.page))

    @contextmanager
    def viewer(self) -> Iterator[tuple[PageClient, ViewerPage]]:
        """Connect one more viewer, and give its own page too."""
        before = len(self.page.viewers)
        with page_client(self.server) as client:
            wait_until(lambda: len(self.page.viewers) == before + 1)
            yield client, self.page.viewers[-1]


@contextmanager
def served_page(
    sensors: Sequence[DisplayedSensor],
    out: Path,
    panels: Sequence[PanelFactory] = (),
    quota: SaveQuota | None = None,
    guard: SocketGuard | None = None,
) -> Iterator[ServedPage]:
    """Serve the page of sensors, which are read already."""
    with page_server(guard or LOCAL) as server:
        controller = PageController(sensors, out, quota)
        block = gel_block_under_skin(sensors[0].poller.sensor.shape, Gel())
        yield ServedPage(server, controller, SensorPage(server, controller, block, "small", panels))


@contextmanager
def served_small_page(
    out: Path,
    panels: Sequence[PanelFactory] = (),
    camera: FrameSource | None = None,
    press: TwinPressController | None = None,
    guard: SocketGuard | None = None,
    quota: SaveQuota | None = None,
    on_reading: Callable[[Reading], None] = lambda reading: None,
) -> Iterator[ServedPage]:
    """Read a small sensor, and serve its page."""
    with (
        SensorPoller(sensor_on(camera or SkinCamera()), on_reading) as poller,
        served_page([DisplayedSensor(poller, press=press)], out, panels, quota, guard) as served,
    ):
        yield served
