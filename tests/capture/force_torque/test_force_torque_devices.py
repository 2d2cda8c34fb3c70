"""What is particular to one device: units, rates, drop counts, flags, stamps."""

import contextlib
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
from test_force_torque_family import Bench

from ninedtact.capture.wrench_source import (
    WrenchFaulty,
    WrenchSampleRejected,
    WrenchSaturated,
    WrenchSensorLost,
    WrenchSource,
)
from ninedtact.quantities import Wrench

LOAD = np.array([1.0, -2.0, -8.0, 0.05, 0.02, -0.01])


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    with ExitStack() as resources:
        yield Bench(tmp_path, resources)


def read_for(source: WrenchSource, seconds: float) -> list[Wrench]:
    ends_at, wrenches = time.monotonic() + seconds, []
    while time.monotonic() < ends_at:
        wrenches.append(source.read())
    return wrenches


@pytest.mark.parametrize("kind", ["onrobot", "ati"])
def test_net_ft_tells_newtons_at_its_own_rate_and_counts_what_the_network_lost(bench: Bench, kind: str) -> None:
    with bench.onrobot() if kind == "onrobot" else bench.ati() as source:
        bench.server.load = LOAD
        read_for(source, 0.1)
        wrenches = read_for(source, 0.5)
        assert len(wrenches) > 150  # of 500 on a quiet machine
        assert np.mean([wrench.six for wrench in wrenches], axis=0) == pytest.approx(LOAD, abs=0.01)
        late_ms = np.array([time.monotonic_ns() - wrench.stamp_ns for wrench in wrenches[-1:]]) / 1e6
        assert late_ms.max() < 1000  # a stamp of another clock would be off by far more
        dropped, sent = source.dropped, bench.server.sent
        bench.server.drop_every = 10
        read_for(source, 0.5)
        bench.server.drop_every = 0
        expected = (bench.server.sent - sent) / 10
        read_for(source, 0.05)
        assert source.dropped - dropped == pytest.approx(expected, abs=0.3 * expected + 3)


def test_net_ft_refuses_saturated_and_faulty_records_and_goes_on_after_them(bench: Bench) -> None:
    with bench.ati() as source:
        for status, refusal in ((0x8002_0000, WrenchSaturated), (0xC000_0000, WrenchFaulty)):
            bench.server.status = status
            with pytest.raises(refusal, match=rf"expected .*netft:bench.* got .*{status:08x}.*;"):
                read_for(source, 5.0)
            for _ in range(3):  # the stream is never taken for lost meanwhile
                with pytest.raises(WrenchSampleRejected):
                    source.read()
            bench.server.status = 0x8001_0000  # a threshold was passed, the measurement is good
            good_after(source)
        bench.server.stalled = True  # records go on, the measurement in them does not
        with pytest.raises(WrenchSensorLost):
            read_for(source, 5.0)


def good_after(source: WrenchSource) -> Wrench:
    ends_at = time.monotonic() + 5
    while time.monotonic() < ends_at:
        try:
            return source.read()
        except WrenchSampleRejected:
            continue
    pytest.fail("no good sample came again")


def test_a_serial_device_is_read_through_garbage_and_its_flags_are_heeded(bench: Bench) -> None:
    with bench.serial() as source:
        bench.device.load = LOAD
        read_for(source, 0.1)
        for raw in (b"\xa5\x5a", b"boot: ok\r\n", bytes(range(256))):
            bench.device.say(raw)
            assert np.median([wrench.six for wrench in read_for(source, 0.1)], axis=0) == pytest.approx(LOAD, abs=0.01)
        for flag, refusal in ((1, WrenchSaturated), (2, WrenchFaulty)):
            bench.device.flags = flag
            with pytest.raises(refusal, match=r"expected .* got its .* flag;"):
                read_for(source, 5.0)
            bench.device.flags = 0
            good_after(source)
        bench.device.load = LOAD * np.nan
        with pytest.raises(WrenchFaulty, match="expected six numbers"):
            read_for(source, 5.0)
        bench.device.hz = 1e-3  # and now something else entirely
        for _ in range(4):
            bench.device.say(b"F: 1.00 2.00 3.00\r\n" * 100)
            time.sleep(0.05)
        with pytest.raises(WrenchSensorLost, match="baud rate"):
            while True:
                with contextlib.suppress(WrenchFaulty):
                    source.read()


def test_frames_that_come_in_bundles_are_stamped_as_the_device_measured_them(bench: Bench) -> None:
    with bench.serial() as source:
        bench.device.bundle = 16
        read_for(source, 0.3)
        stamps_ms = np.array([wrench.stamp_ns for wrench in read_for(source, 0.5)]) / 1e6
    assert len(stamps_ms) > 100
    apart_ms = np.diff(stamps_ms)
    assert np.median(apart_ms) == pytest.approx(1.0, abs=0.25)
    assert np.mean(apart_ms < 0.3) < 0.1  # by their arrivals alone, fifteen of sixteen would be at once


def test_bota_tells_its_bias_and_saves_old_frames_for_nobody(bench: Bench) -> None:
    with bench.bota() as source:
        time.sleep(1.2)  # nobody reads, 12 frames come
        began_ns = time.monotonic_ns()
        wrenches = [source.read() for _ in range(9)]
        assert began_ns - wrenches[0].stamp_ns < 0.8e9 and source.dropped > 0
        mean = np.mean([wrench.six for wrench in wrenches], axis=0)
    assert mean == pytest.approx([1, 2, 3, 0.1, 0.2, 0.3], abs=0.3)
    assert np.median(np.diff([wrench.stamp_ns for wrench in wrenches])) / 1e6 == pytest.approx(100, abs=20)
