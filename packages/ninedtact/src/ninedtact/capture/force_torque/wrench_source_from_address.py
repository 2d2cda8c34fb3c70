"""The pipeline from the address of a force/torque sensor to the wrench that the object applies to the skin, in the sensor frame.

`DRIVERS` lists the devices by the word before the colon. `untared_wrench_source_for` chains the wrappers: reconnection, rejection
of samples, frame conversion.

Frame conversion: a device under the tactile sensor measures what the object applies to the skin, plus the weight between them,
which a tare removes. With R its rotation, o the origin of its frame (`design.ForceTorqueMount`), and s = −1 for a device that
reports the reaction: F = s R f, T = s R t, about o + R p where the device reports t about p. `Wrench.about` moves
the torque from there to the skin centre.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import Float64
from numpy import ndarray as Array

from ninedtact.capture.force_torque.bota import BotaDriver
from ninedtact.capture.force_torque.driver_source import DriverWrenchSource, ForceTorqueDriver
from ninedtact.capture.force_torque.netft import NetFtDriver
from ninedtact.capture.force_torque.sample_checks import SkippingWrenchSource
from ninedtact.capture.force_torque.serial_driver import SerialPortDriver
from ninedtact.capture.reconnecting import ReconnectingWrenchSource
from ninedtact.capture.wrench_source import WrenchSource, WrenchSourceWrapper
from ninedtact.design import ForceTorqueMount
from ninedtact.errors import InputError
from ninedtact.quantities import Wrench

DRIVERS: dict[str, Callable[[str], ForceTorqueDriver]] = {
    "bota": BotaDriver.from_address,
    "netft": NetFtDriver.from_address,
    "onrobot": NetFtDriver.from_address,
    "serial": SerialPortDriver.from_address,
}
"""Functions that make a driver from an address, by the word before the colon. A new device is one more line here."""
_ACCEPTED = (
    "a force/torque sensor: bota:CONFIG.json (Bota Systems), netft:HOST (ATI), onrobot:HOST, or serial:PORT[@BAUD] (the frames "
    "of docs/force_torque.md)"
)


def force_torque_sensor_for(address: str) -> DriverWrenchSource:
    """Return the sensor that the address names, not yet opened; raises `InputError`.

    with force_torque_sensor_for("netft:192.168.1.1") as device:
        wrench = device.read()
    """
    kind, _, rest = address.partition(":")
    if kind not in DRIVERS or not rest:
        raise InputError(expected=f"{_ACCEPTED}", got=f"'{address}', which is none of these", remedy="correct it")
    return DriverWrenchSource(DRIVERS[kind](address))


class _FrameConversion(WrenchSourceWrapper):
    """Wraps a source whose samples are converted between the frame of a mounted device and the sensor frame."""

    def __init__(self, source: WrenchSource, mount: ForceTorqueMount = ForceTorqueMount()) -> None:
        super().__init__(source)
        self._rotation, self._sign = mount_rotation(mount), mount.sign
        self._origin_mm = np.array(mount.origin_mm, float)


class MountedWrenchSource(_FrameConversion):
    """Converts another source to the sensor frame: what the object applies to the skin, torque about the origin of the device."""

    def read(self) -> Wrench:
        """Return the next sample in the sensor frame; raises what the source raises."""
        wrench = self._source.read()
        return replace(
            wrench,
            force_n=self._sign * self._rotation @ wrench.force_n,
            torque_nm=self._sign * self._rotation @ wrench.torque_nm,
            about_mm=self._origin_mm + self._rotation @ wrench.about_mm,
        )


class DeviceFrameWrenchSource(_FrameConversion):
    """Converts a source in the sensor frame back to the frame of the device, as recordings need for checks against its range.

    It is the inverse of `MountedWrenchSource`: the load that the device reported, torque about its origin.
    """

    def read(self) -> Wrench:
        """Return the next sample in the frame of the device; raises what the source raises."""
        wrench = self._source.read().about(self._origin_mm)
        return replace(
            wrench,
            force_n=self._sign * self._rotation.T @ wrench.force_n,
            torque_nm=self._sign * self._rotation.T @ wrench.torque_nm,
            about_mm=np.zeros(3),
        )


def mount_rotation(mount: ForceTorqueMount) -> Float64[Array, "3 3"]:
    """Return the rotation from the frame of the device to the sensor frame: about x, then y, then z of the sensor."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_euler("xyz", mount.rotation_deg, degrees=True).as_matrix())


def untared_wrench_source_for(address: str, mount: ForceTorqueMount, notify: Callable[[str], None]) -> WrenchSource:
    """Return what the sensor at an address measures, in the sensor frame and without a tare; not yet opened.

    It is reopened when lost, and samples that the device marks as wrong are left out; `notify` receives a sentence about either.
    Raises `InputError`.
    """
    reopened = ReconnectingWrenchSource(
        force_torque_sensor_for(address),
        on_lost=lambda loss: notify(f"{loss}; waiting for it"),
        on_back=lambda: notify("it is back"),
    )
    return MountedWrenchSource(SkippingWrenchSource(reopened, lambda reason: notify(f"{reason}; left out")), mount)
