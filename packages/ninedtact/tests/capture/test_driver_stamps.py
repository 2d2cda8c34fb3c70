"""Whatever a driver says, stamps increase, precede the arrival, and are near the moment at which the image was taken."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as some

from ninedtact.capture.driver_stamps import DriverStamps

MS = 1_000_000
BEGAN_NS = 50_000 * MS
IMAGES = 120


def corrected(taken_ns: np.ndarray, arrived_ns: np.ndarray, said_ns: np.ndarray) -> tuple[np.ndarray, tuple[str, ...]]:
    stamps = DriverStamps("camera 0")
    given_ns = [stamps.stamp_ns(int(said), int(arrived)) for said, arrived in zip(said_ns, arrived_ns, strict=True)]
    assert (np.diff(given_ns) > 0).all() and (arrived_ns >= given_ns).all()
    return np.array(given_ns) - taken_ns, stamps.notices


@given(
    hz=some.sampled_from([10.0, 24.5, 30.0, 60.0, 120.0]),
    offset_ms=some.one_of(some.just(0), some.integers(-9000, 9000)),
    jump_ms=some.one_of(some.just(0), some.integers(150, 900), some.integers(-900, -150)),
    every=some.integers(2, 40),
    seed=some.integers(0, 999),
)
def test_stamps_increase_and_tell_when_an_image_was_taken(
    hz: float, offset_ms: int, jump_ms: int, every: int, seed: int
) -> None:
    """With transfers of 3 to 8 ms, a constant offset, and every so many stamps displaced by a jump."""
    chance = np.random.default_rng(seed)
    taken_ns = BEGAN_NS + np.round(np.arange(IMAGES) * 1e9 / hz).astype(np.int64)
    arrived_ns = taken_ns + chance.integers(3 * MS, 8 * MS, IMAGES)
    said_ns = taken_ns + offset_ms * MS
    jumps = (np.arange(IMAGES) % every == every - 1) & (jump_ms != 0)
    said_ns[jumps] += jump_ms * MS
    errors_ns, notices = corrected(taken_ns, arrived_ns, said_ns)
    # An image that came late among images that came on time: a queue would say the same, where no stamp runs back.
    may_wait = jumps & (jump_ms < 0) & (-jump_ms * 1e-3 < 1 / hz)
    most_ms = 108 if -100 <= offset_ms < 0 else 8
    if not (jump_ms and offset_ms):
        assert np.abs(errors_ns[~may_wait]).max() <= most_ms * MS
    if not jumps.any():
        assert len(notices) == (abs(offset_ms) > 108) or 90 <= abs(offset_ms) <= 110
        assert offset_ms or not errors_ns.any()


def test_jumps_back_are_counted_and_said() -> None:
    taken_ns = BEGAN_NS + np.arange(62) * 33_333_333
    said_ns = taken_ns - 200 * MS * (np.arange(62) % 5 == 4)
    errors_ns, notices = corrected(taken_ns, taken_ns + 5 * MS, said_ns)
    assert not errors_ns.any()
    assert len(notices) == 1 and "12 of 62 images" in notices[0]


@given(step_ms=some.integers(-5000, 5000), at=some.integers(1, 60))
def test_a_step_of_the_drivers_clock_is_followed(step_ms: int, at: int) -> None:
    taken_ns = BEGAN_NS + np.arange(IMAGES * 3) * 33_333_333
    said_ns = taken_ns + step_ms * MS * (np.arange(IMAGES * 3) >= at)
    errors_ns, _ = corrected(taken_ns, taken_ns + 5 * MS, said_ns)
    if not -170 <= step_ms <= -1:  # as long as a queue
        assert np.abs(errors_ns[at + 5 :]).max() <= 105 * MS


@settings(max_examples=20)
@given(parts_per_million=some.integers(-5000, 5000), hz=some.sampled_from([5.0, 10.0]), seed=some.integers(0, 999))
def test_a_drift_of_the_drivers_clock_is_taken_out(parts_per_million: int, hz: float, seed: int) -> None:
    """Over five minutes: what remains is the jitter of arrivals, 5 ms, and the drift within two windows of 5 s and an image."""
    chance = np.random.default_rng(seed)
    taken_ns = BEGAN_NS + np.arange(300 * hz).astype(np.int64) * round(1e9 / hz)
    arrived_ns = taken_ns + chance.integers(3 * MS, 8 * MS, len(taken_ns))
    said_ns = taken_ns + (taken_ns - BEGAN_NS) * parts_per_million // 1_000_000
    errors_ns, _ = corrected(taken_ns, arrived_ns, said_ns)
    assert np.abs(errors_ns).max() <= (10 + abs(parts_per_million) * 1e-3 * (10 + 2 / hz)) * MS
