"""What a source makes of the samples of its driver, which the test hands in: order, losses, silence and stamps."""

import time
from collections.abc import Sequence
from queue import Empty, Queue

import numpy as np
import pytest
from played import MS

from ninedtact.capture.force_torque.driver_source import (
    DeviceClock,
    DriverWrenchSource,
    ForceTorqueDriver,
    ForceTorqueSample,
    counter_step,
)
from ninedtact.capture.wrench_source import WrenchFaulty, WrenchSaturated, WrenchSensorLost
from ninedtact.errors import DeviceError


class HandFedDriver(ForceTorqueDriver):
    """A device that numbers its samples in eight bits."""

    name = "a driver fed by hand"
    number_bits = 8

    def __init__(self) -> None:
        self.queue: Queue[ForceTorqueSample | Exception] = Queue()
        self.connections = 0

    def feed(self, at_ms: float, number: int | None = None, **fields: object) -> None:
        six = fields.pop("six", np.arange(6.0) + at_ms)
        self.queue.put(ForceTorqueSample(six, round(at_ms * MS), number, **fields))

    def connect(self) -> None:
        self.connections += 1

    def receive(self) -> Sequence[ForceTorqueSample]:
        try:
            received = self.queue.get(timeout=0.02)
        except Empty:
            return []
        if isinstance(received, Exception):
            raise received
        return [received]

    def disconnect(self) -> None:
        self.connections -= 1


@pytest.fixture
def driver() -> HandFedDriver:
    return HandFedDriver()


def wait_for_drops(source: DriverWrenchSource, count: int) -> None:
    give_up_at = time.monotonic() + 10
    while source.dropped < count and time.monotonic() < give_up_at:
        time.sleep(1e-3)
    assert source.dropped == count


def test_a_reader_gets_the_samples_of_the_last_half_second_in_order(driver: HandFedDriver) -> None:
    source = DriverWrenchSource(driver)
    assert source.dropped == 0
    for _ in range(2):  # and nothing of the time before it was opened
        for at_ms in (1, 100, 501, 501.000001):
            driver.feed(at_ms)
        with source:
            wait_for_drops(source, 1)
            wrenches = [source.read() for _ in range(3)]
        assert [wrench.stamp_ns / MS for wrench in wrenches] == [100, 501, 501.000001]
        assert wrenches[0].force_n.tolist() == [100, 101, 102] and wrenches[0].torque_nm.tolist() == [103, 104, 105]
    assert driver.connections == 0


def test_a_sample_of_half_a_second_ago_is_kept(driver: HandFedDriver) -> None:
    driver.feed(1, 1)
    driver.feed(501, 3)
    with DriverWrenchSource(driver) as source:
        wait_for_drops(source, 1)  # the second one is there
        assert [source.read().stamp_ns for _ in range(2)] == [1 * MS, 501 * MS] and source.dropped == 1


def test_numbers_that_are_left_out_count_as_dropped_and_no_number_counts_as_none(driver: HandFedDriver) -> None:
    for number in (250, 251, 255, None, None, 1, 0, 1):
        driver.feed(1, number)
    with DriverWrenchSource(driver) as source:
        for _ in range(8):
            source.read()
        assert source.dropped == 4  # 252 to 254, and 0; a step back is a device that began anew


def test_bad_samples_are_raised_one_by_one_and_an_error_after_the_last(driver: HandFedDriver) -> None:
    driver.feed(1, is_saturated=True)
    driver.feed(2, six=np.array([0, 0, np.inf, 0, 0, 0]))
    driver.feed(3)
    driver.queue.put(OSError("the cable"))
    with DriverWrenchSource(driver) as source:
        for error in (WrenchSaturated, WrenchFaulty):
            with pytest.raises(error):
                source.read()
        assert source.read().stamp_ns == 3 * MS
        for _ in range(2):
            with pytest.raises(OSError, match="the cable"):
                source.read()
    driver.feed(4)
    with source:
        assert source.read().stamp_ns == 4 * MS


def test_a_silent_device_is_lost_and_one_that_never_spoke_is_not_found(driver: HandFedDriver) -> None:
    source = DriverWrenchSource(driver, silence_s=0.05)
    with pytest.raises(DeviceError, match=r"got none for 0\.05 s; check its power"):
        source.open()
    assert driver.connections == 0
    driver.feed(1)
    with source:
        source.read()
        with pytest.raises(WrenchSensorLost, match=r"got none for 0\.05 s"):
            source.read()
        driver.feed(2)
        assert source.read().stamp_ns == 2 * MS


@pytest.mark.parametrize("bits", [3, 8])
def test_the_step_of_a_counter_is_known_up_to_half_its_width(bits: int) -> None:
    width = 1 << bits
    for before in range(width):
        for step in range(-width // 2, width // 2):
            assert counter_step(before, (before + step) % width, bits) == step


def test_a_late_sample_is_stamped_by_the_clock_of_the_device_and_one_per_cent() -> None:
    clock = DeviceClock(16)
    second = 1_000_000_000
    for device_us, arrived_ns, stamp_ns in (
        (65_000, second, second),  # the first one has nothing to go by
        (464, second + 1 * MS, second + 1 * MS),  # the counter wraps; in time
        (1464, second + 9 * MS, second + 2_010_000),  # seven milliseconds late
        (1464, second + 9 * MS, second + 2_010_001),  # stamps increase
        (2464, second + 2_995_000, second + 2_995_000),  # earlier than any before: the others were late
        (2400, second + 20 * MS, second + 20 * MS),  # the clock of the device began anew
    ):
        assert clock.stamp_ns(device_us, arrived_ns) == stamp_ns
    of_32_bits = DeviceClock()
    assert of_32_bits.stamp_ns((1 << 32) - 400, second) == second
    assert of_32_bits.stamp_ns(600, second + 9 * MS) == second + 1_010_000
