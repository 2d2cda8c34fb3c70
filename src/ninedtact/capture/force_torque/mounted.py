"""From the force/torque sensor's own frame to that of the tactile sensor on it.

A device under the tactile sensor feels what the object applies to the skin, and the weight between them, which a tare takes off.
With R its turn and o the origin of its frame (`design.ForceTorqueMount`), and s = −1 for a device that tells the reaction:
F = s R f, T = s R t, about o + R p where the device says that t is about p. `Wrench.about` goes on from there to the skin's
centre.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float64
from numpy import ndarray as Array

from ninedtact.capture.wrench_source import WrenchSource
from ninedtact.design import ForceTorqueMount
from ninedtact.quantities import Wrench


class Mounted(WrenchSource):
    """Another source, in the sensor frame: what the object applies to the skin, torque about the device's origin."""

    def __init__(self, source: WrenchSource, mount: ForceTorqueMount = ForceTorqueMount()) -> None:
        self.name = source.name
        self._source = source
        self._turn, self._origin_mm, self._sign = turn(mount), np.array(mount.origin_mm), mount.sign

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


def turn(mount: ForceTorqueMount) -> Float64[Array, "3 3"]:
    """Turns a vector of the device's frame into the sensor frame: about x, then y, then z, all of the sensor."""
    matrix = np.eye(3)
    for axis, angle in enumerate(np.radians(mount.turned_deg)):
        one, other = (axis + 1) % 3, (axis + 2) % 3
        about = np.eye(3)
        about[[one, other], [one, other]] = np.cos(angle)
        about[other, one], about[one, other] = np.sin(angle), -np.sin(angle)
        matrix = about @ matrix
    return matrix
