"""What a person writes to name a force/torque sensor, turned into the member of the family that it names."""

import re
from pathlib import Path

from ninedtact.capture.force_torque.bota import BotaLine
from ninedtact.capture.force_torque.line import Line
from ninedtact.capture.force_torque.netft import ATI, ONROBOT, RDT_PORT, NetFtLine
from ninedtact.capture.force_torque.sensor import ForceTorqueSensor
from ninedtact.capture.force_torque.serial_port import BAUD, SerialLine
from ninedtact.errors import NinedtactError

ACCEPTED = (
    "a force/torque sensor: bota:CONFIG.json (Bota Systems), netft:HOST (ATI), onrobot:HOST, or serial:PORT[@BAUD] (the frames "
    "of docs/force_torque.md)"
)
HIGHEST_PORT = 65_535


class ForceTorqueUnknown(NinedtactError):
    """Text that names no force/torque sensor."""


def force_torque_for(text: str) -> ForceTorqueSensor:
    """The sensor that `text` names, not yet opened; raises `ForceTorqueUnknown`, which says what is accepted."""
    kind, _, rest = text.partition(":")
    if kind not in LINES or not rest:
        raise ForceTorqueUnknown(f"expected {ACCEPTED}, got '{text}', which is none of these; correct it")
    return ForceTorqueSensor(LINES[kind](text, rest))


def bota_line(text: str, config: str) -> Line:
    """A Bota sensor by its configuration file."""
    return BotaLine(Path(config).expanduser())


def ati_line(text: str, place: str) -> Line:
    """An ATI sensor by host and, if it is another than usual, port."""
    host, port = host_and_port(text, place)
    return NetFtLine(text, host, ATI, port)


def onrobot_line(text: str, place: str) -> Line:
    """An OnRobot sensor by host and, if it is another than usual, port."""
    host, port = host_and_port(text, place)
    return NetFtLine(text, host, ONROBOT, port)


def serial_line(text: str, place: str) -> Line:
    """A serial port and, if it is another than usual, its baud rate."""
    port, _, baud = place.rpartition("@") if "@" in place else (place, "", str(BAUD))
    if not port or not baud.isdecimal() or int(baud) == 0:
        raise ForceTorqueUnknown(f"expected serial:PORT or serial:PORT@BAUD, got '{text}'; correct it")
    return SerialLine(port, int(baud))


def host_and_port(text: str, place: str) -> tuple[str, int]:
    """The two parts of HOST or HOST:PORT; raises `ForceTorqueUnknown`."""
    found = re.fullmatch(r"([A-Za-z0-9.-]+)(?::(\d{1,5}))?", place)
    port = int(found[2] or RDT_PORT) if found else 0
    if not found or not 0 < port <= HIGHEST_PORT:
        raise ForceTorqueUnknown(f"expected HOST or HOST:PORT after the colon, got '{text}'; correct it")
    return found[1], port


LINES = {"bota": bota_line, "netft": ati_line, "onrobot": onrobot_line, "serial": serial_line}
