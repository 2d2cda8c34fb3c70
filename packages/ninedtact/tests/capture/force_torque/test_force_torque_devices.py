"""What is particular to one device: units, rates, drop counts, flags, stamps."""

import contextlib
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pynetft
import pytest
from test_force_torque_family import Bench

from ninedtact.capture.force_torque.bota import BotaDriver
from ninedtact.capture.force_torque.netft import NetFtDriver
from ninedtact.capture.force_torque.serial_driver import SerialPortDriver
from ninedtact.capture.force_torque.wrench_source_from_address import (
    force_torque_sensor_for,
    untared_wrench_source_for,
)
from ninedtact.capture.wrench_source import (
    WrenchFaulty,
    WrenchSampleRejected,
    WrenchSaturated,
    WrenchSensorLost,
    WrenchSource,
)
from ninedtact.design import ForceTorqueMount
from ninedtact.errors import DeviceError
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
        before = len(read_for(source, 0.1))
        wrenches = read_for(source, 0.5)
        before += len(wrenches)
        assert len(wrenches) > 150  # of 500 on a quiet machine
        assert np.mean([wrench.six for wrench in wrenches], axis=0) == pytest.approx(LOAD, abs=0.01)
        late_ms = np.array([time.monotonic_ns() - wrench.stamp_ns for wrench in wrenches[-1:]]) / 1e6
        assert late_ms.max() < 1000  # a stamp of another clock would be off by far more
        dropped = source.dropped
        bench.server.drop_every = 10
        received = len(read_for(source, 0.5))
        bench.server.drop_every = 0
        received += len(read_for(source, 0.05))
        counted = source.dropped - dropped
        # One of ten is lost, and on a busy computer what its socket cannot hold; nothing is counted that was not sent.
        assert counted >= 0.7 * received / 9 - 3 and before + received + source.dropped <= bench.server.sent


def test_net_ft_refuses_saturated_and_faulty_records_and_goes_on_after_them(bench: Bench) -> None:
    with bench.ati() as source:
        for status, refusal, got in (
            (0x8002_0000, WrenchSaturated, "saturation"),
            (0xC000_0000, WrenchFaulty, "c0000000"),
        ):
            bench.server.status = status
            with pytest.raises(refusal, match=rf"expected .*netft:bench.* got .*{got}.*;"):
                read_for(source, 5.0)
            for _ in range(3):  # the stream is never taken for lost meanwhile
                with pytest.raises(WrenchSampleRejected):
                    source.read()
            bench.server.status = 0x8001_0000  # a threshold was passed, the measurement is good
            good_after(source)
        bench.server.stalled = True  # records go on, the measurement in them does not
        with pytest.raises(WrenchSensorLost):
            read_for(source, 5.0)


def test_a_status_of_a_net_ft_device_is_heeded_as_its_manufacturer_documents_it() -> None:
    """Bit 17 of an ATI device: saturation; with bits 16 and 31 alone, a threshold was passed."""
    saturated, threshold = 1 << 17, 1 << 31 | 1 << 16
    ati, onrobot = NetFtDriver.from_address("netft:h"), NetFtDriver.from_address("onrobot:h:1234")
    for status, of_ati, of_onrobot in (
        (0, "good", "good"),
        (threshold, "good", "faulty"),
        (saturated, "saturated", "faulty"),
        (threshold | saturated, "saturated", "faulty"),
        (1 << 31, "faulty", "faulty"),
        (1 << 16, "faulty", "faulty"),
        (1 << 18, "faulty", "faulty"),
        (1, "faulty", "faulty"),
    ):
        for driver, expected in ((ati, of_ati), (onrobot, of_onrobot)):
            sample = driver._sample(net_ft_record(status=status))
            assert ("saturated" if sample.is_saturated else "faulty" if sample.fault else "good") == expected
            assert (sample.stamp_ns, sample.number) == (5_000, 77)
    assert ati.number_bits == 32
    config = ati._config()
    assert (config.sensor_host, config.rdt_port, config.http_port) == ("h", 49152, 80)
    assert config.deliver_samples_with_error_status and config.calibration_override is None
    assert onrobot._config().rdt_port == 1234 and onrobot._config().calibration_override is not None


@pytest.mark.parametrize(
    ("units", "newtons", "newton_metres"), [(("N", "N-mm"), 1.0, 1e-3), (("lbf", "lbf-in"), 4.4482216, 0.11298483)]
)
def test_net_ft_converts_the_units_that_its_device_is_set_to(
    units: tuple[str, str], newtons: float, newton_metres: float
) -> None:
    driver = NetFtDriver.from_address("netft:h")
    six = driver._sample(net_ft_record(*units)).six
    assert six == pytest.approx([newtons, 2 * newtons, -3 * newtons, *(newton_metres * np.array([4, 5, -6]))], rel=1e-6)
    for unknown in (("unknown", units[1]), (units[0], "unknown")):
        sample = driver._sample(net_ft_record(*unknown))
        assert not sample.is_saturated and "set N and N-m on it" in sample.fault
        assert np.isnan(sample.six).sum() == 3


def net_ft_record(force_unit: str = "N", torque_unit: str = "N-m", status: int = 0) -> SimpleNamespace:
    return SimpleNamespace(
        force_unit=pynetft.ForceUnit(force_unit),
        torque_unit=pynetft.TorqueUnit(torque_unit),
        force=(1.0, 2.0, -3.0),
        torque=(4.0, 5.0, -6.0),
        status=status,
        received_at_ns=5_000,
        rdt_sequence=77,
    )


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
            with pytest.raises(refusal, match=r"expected .* got its .*;"):
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


class PlayedBota:
    """What the library of Bota gives of a sensor with a given period: frames at given times of its 32-bit clock."""

    def __init__(self, period_us: int, device_us: Sequence[int], answers: tuple[bool, bool] = (True, True)) -> None:
        self.period_us, self.device_us, self.answers = period_us, list(device_us), answers
        self.overrange = self.invalid = self.raw = False
        self.__spec__ = ModuleSpec("bota_driver", None)
        self.ended: list[str] = []

    def BotaDriver(self, config: str) -> "PlayedBota":  # noqa: N802
        return self

    def configure(self) -> bool:
        return self.answers[0]

    def activate(self) -> bool:
        return self.answers[1]

    def deactivate(self) -> None:
        self.ended.append("deactivate")

    def cleanup(self) -> None:
        self.ended.append("cleanup")

    def shutdown(self) -> None:
        self.ended.append("shutdown")

    def get_expected_timestep_us(self) -> int:
        return self.period_us

    def read_frame(self) -> SimpleNamespace:
        if not self.device_us:
            raise RuntimeError("no answer")
        status = SimpleNamespace(overrange=self.overrange, invalid=self.invalid, raw=self.raw)
        return SimpleNamespace(timestamp=self.device_us.pop(0), force=[1, 2, 3], torque=[4, 5, 6], status=status)


@pytest.fixture
def played_bota(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[PlayedBota], BotaDriver]:
    (tmp_path / "bota.json").touch()

    def driver_of(library: PlayedBota) -> BotaDriver:
        monkeypatch.setitem(sys.modules, "bota_driver", library)
        return BotaDriver(tmp_path / "bota.json")

    return driver_of


def test_bota_numbers_its_frames_by_the_clock_of_the_device(played_bota: Callable[[PlayedBota], BotaDriver]) -> None:
    """A step of three periods is two frames that never came; a step of a third of one is a frame nevertheless."""
    wrap = 1 << 32
    library = PlayedBota(1000, [wrap - 2500, wrap - 2500, wrap - 1500, 1500, 1800, 2810])
    driver = played_bota(library)
    driver.connect()
    samples = [sample for _ in range(4) for sample in driver.receive()]
    assert [sample.number for sample in samples] == [1, 4, 5, 6]
    assert samples[0].six.tolist() == [1, 2, 3, 4, 5, 6]
    with pytest.raises(WrenchSensorLost, match="got: no answer; check that it is plugged in"):
        driver.receive()
    driver.disconnect()
    assert library.ended == ["deactivate", "cleanup", "shutdown"]


@pytest.mark.parametrize(
    ("answers", "said"), [((False, True), "a refusal"), ((True, False), "a refusal"), ((True, True), "no answer")]
)
def test_bota_that_does_not_start_is_released(
    played_bota: Callable[[PlayedBota], BotaDriver], answers: tuple[bool, bool], said: str
) -> None:
    library = PlayedBota(1000, [], answers)
    with pytest.raises(DeviceError, match=f"to start, got: {said}.*; check the file and the cable"):
        played_bota(library).connect()
    assert library.ended == ["shutdown"]


def test_bota_is_waited_for_a_tenth_of_a_second(played_bota: Callable[[PlayedBota], BotaDriver]) -> None:
    driver = played_bota(PlayedBota(100_000, [7] * 1000))
    driver.connect()
    began = time.monotonic()
    assert driver.receive() == [] and time.monotonic() - began >= 0.1


def test_bota_flags_are_heeded(played_bota: Callable[[PlayedBota], BotaDriver]) -> None:
    library = PlayedBota(1000, range(1000, 9000, 1000))
    driver = played_bota(library)
    driver.connect()
    for flag, fault in (
        (None, ""),
        ("overrange", ""),
        ("invalid", "one that it calls invalid"),
        ("raw", "one that it calls raw, not calibrated"),
    ):
        for name in ("overrange", "invalid", "raw"):
            setattr(library, name, name == flag)
        (sample,) = driver.receive()
        assert (sample.is_saturated, sample.fault) == (flag == "overrange", fault)


def test_a_serial_port_is_opened_for_one_program_and_at_the_documented_rate(bench: Bench) -> None:
    assert SerialPortDriver.from_address("serial:COM3")._baud == 460_800
    with bench.serial(), pytest.raises(DeviceError, match="expected a serial port"):
        force_torque_sensor_for(f"serial:{bench.device.port}").open()


def test_what_a_sensor_without_a_tare_leaves_out_and_loses_is_told(bench: Bench) -> None:
    bench.serial()
    told: list[str] = []
    mount = ForceTorqueMount((0.0, 0.0, -20.0), (0.0, 0.0, 90.0))
    with untared_wrench_source_for(f"serial:{bench.device.port}", mount, told.append) as source:
        bench.device.load = LOAD
        read_for(source, 0.1)
        wrench = source.read()
        assert wrench.force_n == pytest.approx([2, 1, -8], abs=0.1) and wrench.about_mm.tolist() == [0, 0, -20]
        bench.device.flags = 1
        threading.Timer(0.1, setattr, (bench.device, "flags", 0)).start()
        while not told:
            source.read()
        bench.device.unplug()
        threading.Timer(0.2, bench.device.plug_in).start()
        while len(told) < 3:
            source.read()
    assert [message.rpartition("; ")[2] for message in told] == ["left out", "waiting for it", "it is back"]
