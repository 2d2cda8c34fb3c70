"""Driver for force/torque sensors of Bota Systems, through their own library: serial, USB, Ethernet, EtherCAT, CAN, and its dummy.

The blocking read of that library stops every thread of the process while it waits (1.1.16 keeps Python's lock), so the newest
frame is polled instead: four times in each period of the device.
"""

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ninedtact.capture.force_torque.driver_source import (
    RECEIVE_TIMEOUT_S,
    DeviceClock,
    ForceTorqueDriver,
    ForceTorqueSample,
    counter_step,
)
from ninedtact.capture.wrench_source import WrenchSensorLost
from ninedtact.errors import DeviceError
from ninedtact.required_libraries import require_libraries

_CLOCK_BITS = 32
_POLLS_PER_PERIOD = 4
_SHORTEST_PAUSE_S, _LONGEST_PAUSE_S = 2e-4, 5e-3


class BotaDriver(ForceTorqueDriver):
    """A Bota sensor, named by the configuration file that Bota delivers with it."""

    def __init__(self, config: Path) -> None:
        self.name = f"bota:{config}"
        self._config = config
        self._driver: Any = None
        self._number = 0

    @classmethod
    def from_address(cls, address: str) -> "BotaDriver":
        """Return the driver of bota:CONFIG.json."""
        return cls(Path(address.partition(":")[2]).expanduser())

    def connect(self) -> None:
        """Configure and start the sensor; raises `DeviceError` or `MissingLibraryError`."""
        require_libraries("force-torque", "bota_driver")
        import bota_driver

        if not self._config.is_file():
            raise DeviceError(
                expected=f"the configuration of a Bota sensor at {self._config}",
                got="no such file",
                remedy="docs/force_torque.md shows one",
            )
        driver = None
        try:
            driver = bota_driver.BotaDriver(str(self._config))
            if not driver.configure() or not driver.activate():
                raise RuntimeError("a refusal, whose reason its library has printed")
            self._period_us = max(driver.get_expected_timestep_us(), 1)
            pause_s = self._period_us / 1e6 / _POLLS_PER_PERIOD
            self._pause_s = min(max(pause_s, _SHORTEST_PAUSE_S), _LONGEST_PAUSE_S)
            self._last_us = driver.read_frame().timestamp
        except RuntimeError as trouble:
            if driver is not None:
                driver.shutdown()
            raise DeviceError(
                f"expected the Bota sensor of {self._config} to start, got: {trouble}; check the file and the cable"
            ) from trouble
        self._driver, self._clock = driver, DeviceClock(_CLOCK_BITS)

    def receive(self) -> Sequence[ForceTorqueSample]:
        """Wait for a new frame and return it; frames that the device skipped count as dropped."""
        give_up_at = time.monotonic() + RECEIVE_TIMEOUT_S
        try:
            while (frame := self._driver.read_frame()).timestamp == self._last_us:
                if time.monotonic() > give_up_at:
                    return []
                time.sleep(self._pause_s)
        except RuntimeError as trouble:
            raise WrenchSensorLost(
                f"expected a sample from {self.name}, got: {trouble}; check that it is plugged in"
            ) from trouble
        return [self._sample(frame, time.monotonic_ns())]

    def _sample(self, frame: Any, arrived_ns: int) -> ForceTorqueSample:
        # The device has a clock but no counter: a step of three periods means that two samples are missing.
        self._number += max(round(counter_step(self._last_us, frame.timestamp, _CLOCK_BITS) / self._period_us), 1)
        self._last_us = frame.timestamp
        six = np.array([*frame.force, *frame.torque], float)
        stamp_ns, status = self._clock.stamp_ns(frame.timestamp, arrived_ns), frame.status
        word = "invalid" if status.invalid else "raw, not calibrated" if status.raw else ""
        fault = f"one that it calls {word}" if word else ""
        return ForceTorqueSample(six, stamp_ns, self._number, bool(status.overrange), fault)

    def disconnect(self) -> None:
        """Stop and release the sensor."""
        self._driver.deactivate()
        self._driver.cleanup()
        self._driver.shutdown()
        self._driver = None
