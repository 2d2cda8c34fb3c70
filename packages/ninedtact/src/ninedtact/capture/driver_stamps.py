"""Stamps that a camera's driver gives its images: an offset and a drift are taken out, and a stamp that runs back is replaced."""

_OLDEST_NS = 10_000_000_000
"""Distance from the arrival from which on a stamp is that of another clock, such as the wall clock, or none at all."""
_LONGEST_DELAY_NS = 100_000_000
"""Delay between driver and arrival up to which it is that of a transfer. A queue is shorter for the image that waits least."""
_DRIFT_NS = 5_000_000
"""Growth of the least delay up to which it is no drift of the driver's clock."""
_WINDOW_NS = 5_000_000_000
"""The least delay of now is that of the last one to two such times."""
_STEP_IMAGES = 5
"""Wrong stamps in a row that tell a step of the driver's clock, which is then followed."""


class DriverStamps:
    """The stamps of the images of one open camera, ns of the monotonic clock; they increase, and none is after the arrival.

    An image can wait in the driver for its reader, so the image that waited least since the camera was opened tells the offset of
    the driver's clock: a negative delay, or one that no transfer takes, is taken out of all stamps. Where the least delay of some
    seconds grows later, the driver's clock is slow, and the growth is taken out as well.
    """

    def __init__(self, name: str) -> None:
        """name: of the camera, for messages."""
        self._name = name
        self._images = self._replaced = self._wrong_in_a_row = 0
        self._least_delay_ns: int | None = None
        """Since the camera was opened or the driver's clock stepped."""
        self._least_before_ns = self._least_now_ns = self._window_began_ns = 0
        """In the window before this one, and in this one."""
        self._newest_ns = self._last_ns = 0
        """The newest stamp of the driver, and the last one that was given."""

    def stamp_ns(self, driver_ns: int, arrived_ns: int) -> int:
        """Return the stamp of the next image, with what the driver says and its arrival, ns of the monotonic clock."""
        self._images += 1
        stamp_ns = self._corrected_ns(driver_ns, arrived_ns)
        if stamp_ns <= self._last_ns:
            stamp_ns = max(arrived_ns - self._transfer_ns, self._last_ns + 1)
        self._last_ns = stamp_ns
        return stamp_ns

    @property
    def notices(self) -> tuple[str, ...]:
        """What was wrong with the stamps so far and was corrected: sentences."""
        offset_s, notices = self._offset_ns / 1e9, []
        if abs(self._offset_ns) > _LONGEST_DELAY_NS:
            side = "early" if offset_s > 0 else "late"
            notices.append(
                f"the driver of {self._name} stamps images {abs(offset_s):.1f} s too {side}, which is taken out"
            )
        if self._replaced:
            notices.append(
                f"the driver of {self._name} gave {self._replaced} of {self._images} images stamps that run back or lie in the "
                "future, in place of which their arrival was taken"
            )
        return tuple(notices)

    @property
    def _offset_ns(self) -> int:
        growth_ns = min(self._least_before_ns, self._least_now_ns) - (self._least_delay_ns or 0)
        return (self._least_delay_ns or 0) - self._transfer_ns + max(growth_ns - _DRIFT_NS, 0)

    @property
    def _transfer_ns(self) -> int:
        """The time from the driver to the reader that every image takes, which is not part of the offset."""
        least_ns = self._least_delay_ns or 0
        return least_ns if 0 <= least_ns <= _LONGEST_DELAY_NS else 0

    def _corrected_ns(self, driver_ns: int, arrived_ns: int) -> int:
        """Return the driver's stamp without its offset, or the arrival where the driver's stamp is wrong."""
        delay_ns = arrived_ns - driver_ns
        if abs(delay_ns) >= _OLDEST_NS:
            return arrived_ns
        known_ns = self._least_delay_ns
        is_wrong = known_ns is not None and (
            driver_ns <= self._newest_ns or delay_ns < min(known_ns, 0) - _LONGEST_DELAY_NS
        )
        self._wrong_in_a_row = self._wrong_in_a_row + 1 if is_wrong else 0
        if is_wrong and self._wrong_in_a_row < _STEP_IMAGES:
            self._replaced += 1
            return arrived_ns - self._transfer_ns
        if is_wrong or known_ns is None:
            self._least_delay_ns = self._least_before_ns = self._least_now_ns = delay_ns
            self._window_began_ns = arrived_ns
        else:
            self._least_delay_ns = min(known_ns, delay_ns)
            self._update_window(delay_ns, arrived_ns)
        self._newest_ns = driver_ns
        return driver_ns + self._offset_ns

    def _update_window(self, delay_ns: int, arrived_ns: int) -> None:
        """Take the delay of one more image into the least delay of now."""
        if arrived_ns - self._window_began_ns > _WINDOW_NS:
            self._least_before_ns, self._window_began_ns = self._least_now_ns, arrived_ns
            self._least_now_ns = delay_ns
        self._least_now_ns = min(self._least_now_ns, delay_ns)
