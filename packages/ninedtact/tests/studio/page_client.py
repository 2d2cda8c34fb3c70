"""A viewer of a page without a browser, who uses its controls by their names."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import msgspec
import viser
from reading_clients import CAMERA, unpack_text
from small_sensor import wait_until
from websockets.sync.client import ClientConnection, connect

from ninedtact.studio.page_and_server import SensorPage
from ninedtact.studio.viewer import ViewerPage


class PageClient:
    """What a person does in a browser, as its messages."""

    def __init__(self, socket: ClientConnection, viewer: ViewerPage) -> None:
        self.socket, self.viewer = socket, viewer
        self.notices: list[str] = []
        """Titles and texts of the notifications that this viewer was shown."""
        notify = viewer.notify

        def keep(title: str, body: str, colour: Any) -> None:
            self.notices.append(f"{title}: {body}")
            notify(title, body, colour)

        viewer.notify = keep  # type: ignore[method-assign]

    def send(self, message: dict[str, Any]) -> None:
        """Send one message."""
        self.socket.send(msgspec.msgpack.encode(message))

    def control(self, label: str) -> Any:
        """Return the control of this name."""
        handles = self.viewer.client.gui._gui_input_handle_from_uuid.values()
        return next(handle for handle in handles if getattr(handle, "label", None) == label)

    def use(self, label: str, value: Any = True) -> None:
        """Press a button, or give a control a value."""
        self.send({"type": "GuiUpdateMessage", "uuid": self.control(label)._impl.uuid, "updates": {"value": value}})

    def upload(self, label: str, name: str, content: bytes) -> None:
        """Choose a file at an upload button."""
        ids = {"source_component_uuid": self.control(label)._impl.uuid, "transfer_uuid": name}
        size = {"part_count": 1, "size_bytes": len(content)}
        self.send({"type": "FileTransferStartUpload", "filename": name, "mime_type": "model/stl"} | ids | size)
        self.send({"type": "FileTransferPart", "part_index": 0, "content": content} | ids)

    def downloaded(self, name: str) -> bytes:
        """Wait until a file is offered to the browser, and return its content."""
        uuid, size, parts = "", -1, dict[int, bytes]()
        for message in received_messages(self.socket):
            if message["type"] == "FileTransferStartDownload" and message["filename"] == name:
                uuid, size = message["transfer_uuid"], message["size_bytes"]
            elif message["type"] == "FileTransferPart" and message["transfer_uuid"] == uuid:
                parts[message["part_index"]] = message["content"]
            if sum(map(len, parts.values())) == size:
                return b"".join(parts[number] for number in sorted(parts))
        raise EOFError(f"expected {name}, got the end of the connection")

    def give_command(self, label: str) -> None:
        """Press the key of a command."""
        commands = self.viewer.client.gui._command_handle_from_uuid.items()
        uuid = next(uuid for uuid, command in commands if command._impl.props.label == label)
        self.send({"type": "CommandTriggerMessage", "uuid": uuid})

    def click_on_scene(self, x_mm: float, y_mm: float, modifier: str | None = None) -> None:
        """Click on a place of the plane of the skins, seen from above."""
        ray = {"ray_origin": (x_mm, y_mm, 50.0), "ray_direction": (0.0, 0.0, -1.0), "screen_pos": [(0.5, 0.5)]}
        self.send({"type": "ScenePointerMessage", "event_type": "click", "modifier": modifier} | ray)


@contextmanager
def page_socket(port: int) -> Iterator[ClientConnection]:
    """Connect as a browser does that has loaded the page."""
    protocols: Any = [f"viser-v{viser.__version__}"]
    with connect(f"ws://127.0.0.1:{port}", subprotocols=protocols, max_size=None, max_queue=None) as socket:
        socket.send(msgspec.msgpack.encode(CAMERA))
        yield socket


def received_messages(socket: ClientConnection) -> Iterator[dict[str, Any]]:
    """Yield what the page sends, without its arrays."""
    for message in socket:
        yield from msgspec.msgpack.decode(unpack_text(message))["messages"]


@contextmanager
def page_client(page: SensorPage, port: int) -> Iterator[PageClient]:
    """Connect one more viewer."""
    before = len(page.viewers)
    with page_socket(port) as socket:
        wait_until(lambda: len(page.viewers) == before + 1)
        yield PageClient(socket, page.viewers[-1])
