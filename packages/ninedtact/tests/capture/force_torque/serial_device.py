"""A force/torque sensor on a serial port that is not there: a pseudo-terminal, under a name that stays when it is replugged."""

import contextlib
import os
import tty
from pathlib import Path
from threading import Event, Thread
from time import perf_counter, sleep

import numpy as np

from ninedtact.capture.force_torque.serial_driver import SerialFrame


class SerialDevice:
    """Sends a frame every millisecond into the port, as long as it is plugged in; what nobody reads is lost."""

    def __init__(self, folder: Path, hz: float = 1000.0) -> None:
        self.port = folder / "ttyBENCH"
        self.hz, self.bundle = hz, 1
        """So many frames leave at once, as a USB adapter sends them."""
        self.load = np.zeros(6)
        self.flags = 0
        self.sent = 0
        self._plugged: tuple[int, int] | None = None
        self._stop, self._rng = Event(), np.random.default_rng(0)
        self._thread = Thread(target=self._run, daemon=True)

    def plug_in(self) -> None:
        """Appear under the same name."""
        mine, port = os.openpty()
        tty.setraw(port)
        os.set_blocking(mine, False)
        self.port.unlink(missing_ok=True)
        self.port.symlink_to(os.ttyname(port))
        self._plugged = mine, port

    def unplug(self) -> None:
        ends, self._plugged = self._plugged, None
        sleep(0.02)
        self.port.unlink(missing_ok=True)
        for end in ends or ():
            os.close(end)

    def say(self, raw: bytes) -> None:
        if self._plugged is not None:
            with contextlib.suppress(BlockingIOError):
                os.write(self._plugged[0], raw)

    def __enter__(self) -> "SerialDevice":
        self.plug_in()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        self.unplug()

    def _run(self) -> None:
        due_at, bundle = perf_counter(), b""
        while not self._stop.is_set():
            due_at = max(due_at + 1 / self.hz, perf_counter() - 0.05)
            self._stop.wait(max(due_at - perf_counter(), 0))
            self.sent += 1
            six = self.load + self._rng.normal(0, 0.01, 6)
            bundle += SerialFrame(self.sent % 65_536, int(due_at * 1e6) % 2**32, tuple(six), self.flags).to_bytes()
            if self.sent % self.bundle == 0:
                self.say(bundle)
                bundle = b""
