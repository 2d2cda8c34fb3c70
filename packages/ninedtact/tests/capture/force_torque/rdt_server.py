"""A force/torque sensor on the network that is not there: RDT records over UDP at 1 kHz, as ATI and OnRobot send them."""

import contextlib
import socket
import struct
import time
from http.server import BaseHTTPRequestHandler, HTTPServer
from threading import Event, Thread

import numpy as np

START, STOP = 2, 0
COUNTS = np.array([10_000.0] * 3 + [100_000.0] * 3)


class RdtServer:
    """Streams to whoever asked last; the tests turn its attributes while it runs."""

    def __init__(self, hz: float = 1000.0) -> None:
        self.hz = hz
        self.load = np.zeros(6)
        self.noise = np.array([0.02] * 3 + [5e-4] * 3)
        self.status = 0
        self.drop_every = 0
        self.silent = self.stalled = False
        self.sent = 0
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.settimeout(5e-4)
        self._stop, self._rng = Event(), np.random.default_rng(0)
        self._thread = Thread(target=self._run, daemon=True)

    @property
    def place(self) -> str:
        return f"127.0.0.1:{self._socket.getsockname()[1]}"

    def __enter__(self) -> "RdtServer":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        self._socket.close()

    def _run(self) -> None:
        client, due_at = None, time.perf_counter()
        while not self._stop.is_set():
            with contextlib.suppress(TimeoutError):
                request, sender = self._socket.recvfrom(64)
                header, command, _ = struct.unpack(">HHI", request)
                assert header == 0x1234
                client = sender if command == START else None if command == STOP else client
            due_at = max(due_at, time.perf_counter() - 0.05)
            while client and time.perf_counter() >= due_at:
                due_at += 1 / self.hz
                self._send(client)

    def _send(self, client: tuple[str, int]) -> None:
        self.sent += 1
        if self.silent or (self.drop_every and self.sent % self.drop_every == 0):
            return
        counts = np.round((self.load + self._rng.normal(0, self.noise)) * COUNTS).astype(int)
        measured = 1 if self.stalled else self.sent
        self._socket.sendto(struct.pack(">III6i", self.sent, measured, self.status, *counts), client)


class AtiPage(BaseHTTPRequestHandler):
    """What an ATI device tells of itself over HTTP; torques in N·mm, as most of them do."""

    def do_GET(self) -> None:
        page = (
            b'<?xml version="1.0"?><netft><prodname>bench</prodname><setcfgsel>0</setcfgsel><cfgcpf>10000</cfgcpf>'
            b"<cfgcpt>100</cfgcpt><scfgfu>N</scfgfu><scfgtu>N-mm</scfgtu><comrdte>Enabled</comrdte></netft>"
        )
        self.send_response(200)
        self.send_header("Content-Length", str(len(page)))
        self.end_headers()
        self.wfile.write(page)

    def log_message(self, *_: object) -> None: ...


@contextlib.contextmanager
def ati_page():
    """The number of the port on which it is served."""
    server = HTTPServer(("127.0.0.1", 0), AtiPage)
    thread = Thread(target=server.serve_forever, daemon=True, kwargs={"poll_interval": 0.02})
    thread.start()
    try:
        yield server.server_port
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
