"""Troubles with time for `chaos`: the clock of the computer is set while a command runs, and the stream of a camera stalls.

clock set   the wall clock jumps by an hour, forwards or backwards, at a random moment (a `sitecustomize` of the child patches
            `time.time`, so that no permission is needed)
stall       a network camera (MJPEG over HTTP) stops sending for 3 s, for 30 s or for ever, sends a few bytes a second, or
            stops in the middle of an image
"""

import os
import signal
import socket
import subprocess
import threading
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from mcap.reader import make_reader

from ninedtact.recording.reader import Recording
from ninedtact.recording.topics_and_messages import Topic

HOUR_S = 3600.0
TOLD_S = 5.0
"""Time within which a command must say that its stream stalls."""
PASSING_STALLS = {"3 s": 3.0, "30 s": 30.0}
"""Length in s of the stalls that end."""
STALLS = (*PASSING_STALLS, "for ever", "trickle", "half an image")
_PERIOD_S = 0.05
_SITE = """import os, time
_time, _time_ns = time.time, time.time_ns
def _shift(): return {step} if os.path.exists({trigger!r}) else 0
time.time = lambda: _time() + _shift()
time.time_ns = lambda: _time_ns() + int(_shift() * 10**9)
"""


def clock_step_environment(folder: Path, step_s: float, trigger: Path) -> dict[str, str]:
    """Write the patch of the clock into a folder, and return the variables with which a child finds it.

    step_s: by which the child's clock is ahead of the computer's as soon as the file `trigger` exists.
    """
    site = folder / "site"
    site.mkdir()
    (site / "sitecustomize.py").write_text(_SITE.format(step=step_s, trigger=str(trigger)))
    paths = [str(site), *filter(None, [os.environ.get("PYTHONPATH")])]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}


def complaint_about_stamps(path: Path, said: str) -> str | None:
    """Return a complaint about a recording during which the clock was set; None where all stamps rise and the step is told."""
    with Recording(path) as recording:
        steps = np.diff(recording.stamps_ns(Topic.IMAGES))
        remarks = [event for event in recording.events() if event.subject == "clock"]
        topic = Topic.IMAGES.path(recording.metadata.sensor)
    with path.open("rb") as file:
        wall = np.diff([message.publish_time for _, _, message in make_reader(file).iter_messages(topic)])
    if not (len(steps) and (steps > 0).all() and (np.abs(wall - steps) < 1e6).all()):
        return "stamps that do not rise, or follow the clock that was set"
    return None if remarks and "clock of the computer moved" in said else "a step of the clock that is not told"


def answers(url: str) -> bool:
    """Return whether a page answers."""
    try:
        with urllib.request.urlopen(url, timeout=10) as answer:
            return bool(answer.status == 200)
    except OSError:
        return False


def complaint_about_page(running: "subprocess.Popen[str]", url: str) -> str | None:
    """Request the page, and interrupt the command; return a complaint about a page that does not answer."""
    complaint = None if answers(url) else "a page that does not answer"
    running.send_signal(signal.SIGINT)
    return complaint


def free_port() -> int:
    """Return a port that is free now."""
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


@dataclass
class StallingCamera:
    """Serves one image again and again as MJPEG, and stalls once, in the given manner, after some seconds."""

    image: np.ndarray
    stall: str
    after_s: float
    stalled: threading.Event = field(default_factory=threading.Event)
    is_over: threading.Event = field(default_factory=threading.Event)

    def length_s(self) -> float:
        """Return how long to wait for the end of the stall, s; nothing for one that does not end."""
        return PASSING_STALLS.get(self.stall, 0.0)

    @contextmanager
    def serve(self) -> Iterator[str]:
        """Serve until the block ends; yields the URL."""
        with socket.create_server(("127.0.0.1", 0)) as server:
            threading.Thread(target=self._accept, args=(server,), daemon=True).start()
            try:
                yield f"http://127.0.0.1:{server.getsockname()[1]}/stream.mjpg"
            finally:
                self.is_over.set()

    def _accept(self, server: socket.socket) -> None:
        with suppress(OSError):
            while True:
                client, _ = server.accept()
                threading.Thread(target=self._serve_client, args=(client,), daemon=True).start()

    def _serve_client(self, client: socket.socket) -> None:
        jpeg = cv2.imencode(".jpg", self.image)[1].tobytes()
        head = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n".encode()
        began = time.monotonic()
        with suppress(OSError), client:
            client.recv(65536)
            client.sendall(b"HTTP/1.0 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=frame\r\n\r\n")
            while not self.is_over.is_set():
                if not self.stalled.is_set() and time.monotonic() - began > self.after_s:
                    self._begin_stall(client, head + jpeg)
                if self.stalled.is_set() and time.monotonic() < self._until:
                    self.is_over.wait(_PERIOD_S)  # a new client waits as well
                    continue
                client.sendall(head + jpeg + b"\r\n")
                self.is_over.wait(_PERIOD_S)

    def _begin_stall(self, client: socket.socket, part: bytes) -> None:
        self._until = time.monotonic() + PASSING_STALLS.get(self.stall, float("inf"))
        self.stalled.set()
        if self.stall == "half an image":
            client.sendall(part[: len(part) // 2])
        elif self.stall == "trickle":
            for at in range(len(part)):
                if self.is_over.wait(0.2):
                    return
                client.sendall(part[at : at + 1])
