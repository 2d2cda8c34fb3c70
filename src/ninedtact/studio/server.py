"""The web server of the page: on the port that a person asked for, or not at all."""

import errno
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from io import StringIO

from viser import ViserServer

from ninedtact.errors import NinedtactError

LAST_WORDS_S = 0.1
"""For what was shown last to leave: viser drops what is still under way when it stops."""
IN_USE = "it in use (another 'ninedtact live'?)"


class PortRefused(NinedtactError):
    """The page cannot be served there."""


@contextmanager
def serving(host: str, port: int) -> Iterator[ViserServer]:
    """A server that is gone when the block ends; port 0 takes any free one. Raises `PortRefused`."""
    require_free(host, port)
    server = quietly_started(host, port)
    try:
        # viser tries the next ports where one is taken; a page that is elsewhere than it was told to be is not found.
        if port not in (0, server.get_port()):
            raise refused(host, port, IN_USE)
        yield server
    finally:
        server.flush()
        time.sleep(LAST_WORDS_S)
        with redirect_stdout(StringIO()):
            server.stop()


def quietly_started(host: str, port: int) -> ViserServer:
    """Start viser without the banner that it prints: only the command line speaks to a person."""
    with redirect_stdout(StringIO()):
        return ViserServer(host=host, port=port, label="9DTact", verbose=False)


def require_free(host: str, port: int) -> None:
    """Try the port, because viser neither refuses one that is taken nor survives a host that does not exist."""
    if not 0 <= port <= 65535:
        raise refused(host, port, "a number that is not a port")
    try:
        socket.create_server((host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET).close()
    except OSError as trouble:
        taken = trouble.errno == errno.EADDRINUSE
        raise refused(host, port, IN_USE if taken else f"'{trouble.strerror}'") from trouble


def refused(host: str, port: int, got: str) -> PortRefused:
    """Say what to do about it."""
    return PortRefused(
        f"expected port {port} on {host} to be free for the page, got {got}; choose another with --port, or a host of "
        "this machine with --host"
    )
