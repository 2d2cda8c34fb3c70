"""From the force/torque sensor's own frame to that of the tactile sensor on it.

A device under the tactile sensor feels what the object applies to the skin, and the weight between them, which a tare takes off.
With R its turn and o the origin of its frame (`design.ForceTorqueMount`), and s = −1 for a device that tells the reaction:
F = s R f, T = s R t, about o + R p where the device says that t is about p. `Wrench.about` goes on from there to the skin's
centre.

What a person writes to name a force/torque sensor, turned into the member of the family that it names.

The measured wrench: a device with all that makes its samples fit to be kept.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float64
from numpy import ndarray as Array

from ninedtact.capture.force_torque.bota import BotaDriver
from ninedtact.capture.force_torque.netft import ATI, ONROBOT, RDT_PORT, NetFtDriver
from ninedtact.capture.force_torque.sample_checks import CheckedWrenchSource, SampleCheckSettings
from ninedtact.capture.force_torque.sensor import ForceTorqueDriver, ForceTorqueSensor
from ninedtact.capture.force_torque.serial_port import BAUD, SerialPortDriver
from ninedtact.capture.force_torque.tare import TaredWrenchSource, TareSettings
from ninedtact.capture.reconnecting import ReconnectingWrenchSource
from ninedtact.capture.wrench_source import WrenchSensorLost, WrenchSource
from ninedtact.design import ForceTorqueMount
from ninedtact.errors import NinedtactError
from ninedtact.quantities import Wrench


class MountedWrenchSource(WrenchSource):
    """Another source, in the sensor frame: what the object applies to the skin, torque about the device's origin."""

    def __init__(self, source: WrenchSource, mount: ForceTorqueMount = ForceTorqueMount()) -> None:
        self.name = source.name
        self._source = source
        self._turn, self._origin_mm, self._sign = mount_rotation(mount), np.array(mount.origin_mm), mount.sign

    def open(self) -> None:
        """Open the source; raises what it raises."""
        self._source.open()

    def read(self) -> Wrench:
        """The next sample; raises what the source raises."""
        wrench = self._source.read()
        return replace(
            wrench,
            force_n=self._sign * self._turn @ wrench.force_n,
            torque_nm=self._sign * self._turn @ wrench.torque_nm,
            about_mm=self._origin_mm + self._turn @ wrench.about_mm,
        )

    def close(self) -> None:
        """Close the source."""
        self._source.close()


def mount_rotation(mount: ForceTorqueMount) -> Float64[Array, "3 3"]:
    """Turns a vector of the device's frame into the sensor frame: about x, then y, then z, all of the sensor."""
    matrix = np.eye(3)
    for axis, angle in enumerate(np.radians(mount.turned_deg)):
        one, other = (axis + 1) % 3, (axis + 2) % 3
        about = np.eye(3)
        about[[one, other], [one, other]] = np.cos(angle)
        about[other, one], about[one, other] = np.sin(angle), -np.sin(angle)
        matrix = about @ matrix
    return matrix


ACCEPTED = (
    "a force/torque sensor: bota:CONFIG.json (Bota Systems), netft:HOST (ATI), onrobot:HOST, or serial:PORT[@BAUD] (the frames "
    "of docs/force_torque.md)"
)
HIGHEST_PORT = 65_535


class ForceTorqueAddressUnknown(NinedtactError):
    """Text that names no force/torque sensor."""


def force_torque_sensor_for(text: str) -> ForceTorqueSensor:
    """The sensor that `text` names, not yet opened; raises `ForceTorqueAddressUnknown`, which says what is accepted."""
    kind, _, rest = text.partition(":")
    if kind not in LINES or not rest:
        raise ForceTorqueAddressUnknown(f"expected {ACCEPTED}, got '{text}', which is none of these; correct it")
    return ForceTorqueSensor(LINES[kind](text, rest))


def bota_line(text: str, config: str) -> ForceTorqueDriver:
    """A Bota sensor by its configuration file."""
    return BotaDriver(Path(config).expanduser())


def ati_line(text: str, place: str) -> ForceTorqueDriver:
    """An ATI sensor by host and, if it is another than usual, port."""
    host, port = host_and_port(text, place)
    return NetFtDriver(text, host, ATI, port)


def onrobot_line(text: str, place: str) -> ForceTorqueDriver:
    """An OnRobot sensor by host and, if it is another than usual, port."""
    host, port = host_and_port(text, place)
    return NetFtDriver(text, host, ONROBOT, port)


def serial_line(text: str, place: str) -> ForceTorqueDriver:
    """A serial port and, if it is another than usual, its baud rate."""
    port, _, baud = place.rpartition("@") if "@" in place else (place, "", str(BAUD))
    if not port or not baud.isdecimal() or int(baud) == 0:
        raise ForceTorqueAddressUnknown(f"expected serial:PORT or serial:PORT@BAUD, got '{text}'; correct it")
    return SerialPortDriver(port, int(baud))


def host_and_port(text: str, place: str) -> tuple[str, int]:
    """The two parts of HOST or HOST:PORT; raises `ForceTorqueAddressUnknown`."""
    found = re.fullmatch(r"([A-Za-z0-9.-]+)(?::(\d{1,5}))?", place)
    port = int(found[2] or RDT_PORT) if found else 0
    if not found or not 0 < port <= HIGHEST_PORT:
        raise ForceTorqueAddressUnknown(f"expected HOST or HOST:PORT after the colon, got '{text}'; correct it")
    return found[1], port


LINES = {"bota": bota_line, "netft": ati_line, "onrobot": onrobot_line, "serial": serial_line}


@dataclass(frozen=True)
class WrenchPipelineSettings:
    """What is believed of the device, and how it is tared."""

    trust: SampleCheckSettings = SampleCheckSettings()
    tare: TareSettings = TareSettings()


def build_wrench_source(
    device: WrenchSource,
    mount: ForceTorqueMount,
    on_lost: Callable[[WrenchSensorLost], None],
    on_back: Callable[[], None] = lambda: None,
    settings: WrenchPipelineSettings = WrenchPipelineSettings(),
) -> TaredWrenchSource:
    """What the object applies to the skin, in the sensor frame: trusted samples only, tared at opening, reopened when lost."""
    trusted = CheckedWrenchSource(ReconnectingWrenchSource(device, on_lost, on_back), settings.trust)
    return TaredWrenchSource(MountedWrenchSource(trusted, mount), settings.tare)
