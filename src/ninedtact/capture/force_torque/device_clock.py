"""A device's own clock and count: arrival stamps without the transport's jitter, and the numbers that never arrived."""

LEAK = 0.01
"""How far the device's clock may be off and still be followed: a cheap ceramic resonator is within 0.5 %."""
NS_PER_US = 1000


def step(before: int, after: int, bits: int) -> int:
    """From one value of a counter that wraps to another; negative where it went back by less than half its width."""
    forward = (after - before) % (1 << bits)
    return forward - (1 << bits) if forward >> (bits - 1) else forward


class DeviceClock:
    """Arrival times, spaced as the device's clock spaces them.

    Operating systems and USB adapters deliver several samples at once (16 ms of them is common), and a thread may wake
    late; both make arrivals late, never early. So the offset between the two clocks is the least that was seen lately.
    Stamps are never after the arrival, and grow.
    """

    def __init__(self, bits: int = 32) -> None:
        self._bits = bits
        self._last_us: int | None = None
        self._device_ns = self._offset_ns = self._last_stamp_ns = 0

    def stamp_ns(self, device_us: int, arrived_ns: int) -> int:
        """When a sample with this device time would have arrived without delay, monotonic clock."""
        passed_ns = 0 if self._last_us is None else step(self._last_us, device_us, self._bits) * NS_PER_US
        self._device_ns += passed_ns
        late_ns = arrived_ns - self._device_ns
        restarted = self._last_us is None or passed_ns < 0
        self._offset_ns = late_ns if restarted else min(self._offset_ns + int(LEAK * passed_ns), late_ns)
        self._last_us = device_us
        self._last_stamp_ns = max(self._device_ns + self._offset_ns, self._last_stamp_ns + 1)
        return self._last_stamp_ns


class Numbering:
    """Counts the numbers that a device gave to samples that never arrived."""

    def __init__(self, bits: int) -> None:
        self._bits = bits
        self._last: int | None = None

    def missed(self, number: int) -> int:
        """How many are missing between the last one and this; none when the device began to count anew."""
        passed = 1 if self._last is None else step(self._last, number, self._bits)
        self._last = number
        return max(passed - 1, 0)
