"""When force/torque samples were at fault, and whether the clocks of images and forces keep together."""

import numpy as np
import pytest

from ninedtact.capture.wrench_source import (
    WrenchFaulty,
    WrenchFrozen,
    WrenchJumped,
    WrenchSampleRejected,
    WrenchSaturated,
)
from ninedtact.quantities import Wrench
from ninedtact_train.collecting.sample_faults import ClockDriftMonitor, SampleFault, SampleFaultHistory

S, MS = 1_000_000_000, 1_000_000


def wrench_at(stamp_ns: int) -> Wrench:
    return Wrench(np.zeros(3), np.zeros(3), stamp_ns=stamp_ns)


def rejected(kind: type[WrenchSampleRejected]) -> WrenchSampleRejected:
    return kind("expected x, got y; z")


@pytest.fixture
def history() -> SampleFaultHistory:
    return SampleFaultHistory(frozen_ns=200 * MS)


@pytest.mark.parametrize(
    ("kind", "fault", "begin_ns"),
    [
        (WrenchFrozen, SampleFault.FROZEN, 800 * MS),  # it may have been frozen before that could be seen
        (WrenchSaturated, SampleFault.SATURATED, 1 * S),
        (WrenchFaulty, SampleFault.FAULTY, 1 * S),
        (WrenchJumped, SampleFault.JUMPED, 1 * S),
        (WrenchSampleRejected, SampleFault.FAULTY, 1 * S),
    ],
)
def test_a_fault_lasts_from_the_last_good_sample_to_the_next(
    history: SampleFaultHistory, kind: type[WrenchSampleRejected], fault: SampleFault, begin_ns: int
) -> None:
    assert history.accept(wrench_at(1 * S)) and history.fault_between(0, 9 * S) is None
    history.reject(rejected(kind))
    history.reject(rejected(WrenchFaulty))  # of one run of rejections the first counts
    assert history.fault_between(0, begin_ns) is fault and history.fault_between(0, begin_ns - 1) is None
    assert history.fault_between(8 * S, 9 * S) is fault  # as long as no sample was good
    assert history.accept(wrench_at(2 * S))
    assert history.fault_between(2 * S, 3 * S) is fault
    assert history.fault_between(2 * S + 1, 3 * S) is (SampleFault.SHIFTED if kind is WrenchJumped else None)
    history.reject(rejected(WrenchSaturated))
    assert history.fault_between(3 * S, 4 * S) is SampleFault.SATURATED


def test_a_stamp_that_does_not_follow_the_others_is_a_fault_of_the_clock(history: SampleFaultHistory) -> None:
    assert history.accept(wrench_at(1 * S)) and history.accept(wrench_at(1 * S + 1))
    assert not history.accept(wrench_at(1 * S + 1)) and not history.accept(wrench_at(1 * S))
    assert history.fault_between(0, 1 * S) is SampleFault.CLOCK and history.fault_between(0, 1 * S - 1) is None
    assert history.fault_between(1 * S + 2, 2 * S) is None


@pytest.mark.parametrize("cause", ["a jump", "a silence of more than a second"])
def test_the_zero_is_doubtful_from_its_cause_until_the_sensor_is_at_rest(
    history: SampleFaultHistory, cause: str
) -> None:
    history.accept(wrench_at(5 * S))
    history.accept(wrench_at(6 * S))  # a second is no silence
    assert history.fault_between(8 * S, 9 * S) is None
    if cause == "a jump":
        history.reject(rejected(WrenchJumped))
        history.reject(rejected(WrenchJumped))
        history.accept(wrench_at(6 * S + 1))
    else:
        history.accept(wrench_at(7 * S + 1))
    assert history.zero_changes_ns == [6 * S]
    assert history.fault_between(6 * S + 2, 8 * S) is SampleFault.SHIFTED
    assert history.fault_between(0, 6 * S - 1) is None
    history.confirm_zero(6 * S)  # an image of that moment cannot confirm what came after
    assert history.fault_between(7 * S, 8 * S) is SampleFault.SHIFTED
    history.mark_zero_uncertain()
    history.confirm_zero(6 * S + 1)
    assert history.zero_changes_ns == [history.last_ns]
    assert history.fault_between(6 * S + 2, history.last_ns) is None
    assert history.fault_between(6 * S + 2, history.last_ns + 1) is SampleFault.SHIFTED


def test_clocks_drift_by_what_the_smallest_delay_of_a_second_has_changed() -> None:
    clock = ClockDriftMonitor(tolerance_ms=10.0)
    at_ms = 1000

    def arrive(smallest_ms: int) -> None:
        """A second of stamps every 100 ms, which arrive with delays of the smallest and up to 20 ms more."""
        nonlocal at_ms
        for late_ms in (0, 10, 20, 0, 10, 20, 0, 10, 20, 0):
            clock.add_arrival(at_ms * MS, (at_ms + smallest_ms + late_ms) * MS)
            at_ms += 100

    arrive(30)
    assert clock.first_delay_ns is None and clock.drift_ns == 0 and clock.is_within_tolerance
    clock.add_arrival(at_ms * MS, (at_ms + 30) * MS)  # a second after the first arrival
    assert clock.first_delay_ns == 30 * MS
    for smallest_ms, drift_ms in ((40, 10), (41, 11), (30, 0), (20, -10), (19, -11)):
        for _ in range(3):
            arrive(smallest_ms)
        assert clock.drift_ns == drift_ms * MS and clock.is_within_tolerance == (abs(drift_ms) <= 10)
