"""Clients of a page, some of which never read. Run with address, protocol, number of clients, number that never read."""

import asyncio
import struct
import sys
from typing import Any

import msgspec
import zstandard
from websockets.asyncio.client import connect

CAMERA = {
    "type": "ViewerCameraMessage",
    "wxyz": (1.0, 0.0, 0.0, 0.0),
    "position": (0.0, 0.0, 1.0),
    "fov": 1.0,
    "near": 0.1,
    "far": 100.0,
    "image_height": 500,
    "image_width": 900,
    "look_at": (0.0, 0.0, 0.0),
    "up_direction": (0.0, 0.0, 1.0),
}


def open_panel(tab: Any, name: str) -> None:
    """Open a panel of the page by its tab in a browser; tabs of viser react to the mouse, not to clicks that are dispatched."""
    label = tab.get_by_role("tab", name=name)
    label.evaluate("label => label.scrollIntoView({block: 'center'})")
    box = label.bounding_box()
    tab.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)


def page_errors(tab: Any) -> list[str]:
    """All that goes wrong on a page from now on: exceptions and errors in the browser's console, except for a server that ended."""
    errors: list[str] = []
    tab.on("pageerror", lambda error: errors.append(str(error)))

    def keep(said: Any) -> None:
        of_ended_server = "WebSocket connection to" in said.text or "/drawn/" in str(said.location)
        if said.type == "error" and not of_ended_server:
            errors.append(f"{said.text} {said.location}")

    tab.on("console", keep)
    return errors


def unpack_text(message: str | bytes) -> bytes:
    """Return the texts and numbers of a message of viser: two lengths of eight bytes, what is compressed, then arrays."""
    assert isinstance(message, bytes)
    length, packed = struct.unpack("<QQ", message[:16])
    return zstandard.ZstdDecompressor().decompress(message[16 : 16 + packed], max_output_size=length)


def received_surfaces(message: str | bytes) -> list[int]:
    """Return the numbers of points of the surfaces in a message of viser; points have three coordinates of two bytes."""
    content = msgspec.msgpack.decode(unpack_text(message))
    points = [
        one["updates"]["points"]
        for one in content["messages"]
        if one["type"] == "SceneNodeUpdateMessage"
        and one["name"].endswith("/skin/points")
        and "points" in one["updates"]
    ]
    return [content["binaryBufferLengths"][each["__binary_index"]] // 6 for each in points]


async def watch(address: str, protocol: str, never_reads: bool) -> None:
    """Connect as the page of viser does, and read until the end, or not at all."""
    async with connect(address, subprotocols=[protocol], compression=None, max_size=None) as socket:  # type: ignore[list-item]
        await socket.send(msgspec.msgpack.encode(CAMERA))
        if never_reads:
            socket.transport.pause_reading()
            await asyncio.Event().wait()
        async for _ in socket:
            pass


async def watch_all(address: str, protocol: str, clients: int, silent: int) -> None:
    await asyncio.gather(*(watch(address, protocol, number < silent) for number in range(clients)))


if __name__ == "__main__":
    asyncio.run(watch_all(sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4])))
