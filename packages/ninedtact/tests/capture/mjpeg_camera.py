"""A camera on the network that a test can unplug, plug in again and slow down: MJPEG over HTTP on 127.0.0.1."""

import threading
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from types import TracebackType

import cv2
import numpy as np

BOUNDARY = "frame"


class MjpegCamera:
    """Serves numbered images at `url`, each `period_s` after the last, for as long as it is plugged in."""

    def __init__(self, rows: int = 48, cols: int = 64, period_s: float = 0.01, steady: bool = False) -> None:
        """steady: all images are alike."""
        self.rows, self.cols, self.steady = rows, cols, steady
        self.period_s = period_s
        self.served = 0
        self.plugged_in = threading.Event()
        self._server: ThreadingHTTPServer | None = None
        self._port = 0

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self._port}/stream.mjpg"

    def plug_in(self) -> None:
        """Listen, on the same port as before if there was one."""
        self.plugged_in.set()
        self._server = Listener(("127.0.0.1", self._port), handler_of(self))
        self._port = self._server.server_port
        threading.Thread(target=self._server.serve_forever, args=(0.01,), daemon=True).start()

    def unplug(self) -> None:
        """Cut every connection and refuse new ones."""
        self.plugged_in.clear()
        if self._server is not None:
            self._server.shutdown()
            self._server.server_close()
            self._server = None

    def jpegs(self) -> Iterator[bytes]:
        """Images until the plug is pulled; each one a grey level brighter than the last, or all alike."""
        while self.plugged_in.is_set():
            yield encoded(120 if self.steady else self.served % 200 + 20, self.rows, self.cols)
            self.served += 1
            time.sleep(self.period_s)

    def parts(self) -> Iterator[bytes]:
        for jpeg in self.jpegs():
            head = f"--{BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
            yield head.encode() + jpeg + b"\r\n"

    def __enter__(self) -> "MjpegCamera":
        self.plug_in()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.unplug()


class StallingCamera(MjpegCamera):
    """Sends one image again and again, and stalls once after 4 s; viewers that come back wait for the end of it, too.

    kind: "trickle" sends five bytes a second meanwhile, "half an image" stops within one, all others between two.
    """

    def __init__(self, jpeg: bytes, kind: str, length_s: float) -> None:
        super().__init__(period_s=0.05)
        self.jpeg, self.kind, self.length_s = jpeg, kind, length_s
        self.stalled, self.until_s = threading.Event(), 0.0

    def jpegs(self) -> Iterator[bytes]:
        while self.plugged_in.is_set():
            yield self.jpeg
            time.sleep(self.period_s)

    def parts(self) -> Iterator[bytes]:
        began_s = time.monotonic()
        for part in super().parts():
            if not self.stalled.is_set() and time.monotonic() - began_s > 4:
                self.until_s = time.monotonic() + self.length_s
                self.stalled.set()
                yield part[: len(part) // 2] if self.kind == "half an image" else b""
            for byte in part if self.kind == "trickle" else (None,) * 10**6:
                if time.monotonic() >= self.until_s or not self.plugged_in.is_set():
                    break
                yield b"" if byte is None else bytes([byte])
                time.sleep(0.2)
            yield part


class Listener(ThreadingHTTPServer):
    """Waits for no viewer when it closes: a viewer that reads nothing must not hold up the test."""

    daemon_threads = True
    block_on_close = False
    allow_reuse_address = True

    def handle_error(self, request: object, client_address: object) -> None:
        """A viewer that hung up is no news."""


def handler_of(camera: MjpegCamera) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            if self.path != "/stream.mjpg":
                self.send_error(404)
                return
            self.send_response(200)
            self.send_header("Content-Type", f"multipart/x-mixed-replace; boundary={BOUNDARY}")
            self.end_headers()
            for part in camera.parts():
                self.wfile.write(part)

        def log_message(self, *arguments: object) -> None:
            pass

    return Handler


def encoded(level: int, rows: int, cols: int) -> bytes:
    done, jpeg = cv2.imencode(".jpg", np.full((rows, cols, 3), level, np.uint8))
    assert done
    return jpeg.tobytes()
