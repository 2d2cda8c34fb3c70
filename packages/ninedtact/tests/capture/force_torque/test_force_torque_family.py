"""What every member of the family honours: devices, wrappers, and the sensor that is not there."""

import json
import re
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from rdt_server import RdtServer, ati_page
from serial_device import SerialDevice
from small_press_simulation import small_press_simulation

from ninedtact._version import installation_command
from ninedtact.capture.force_torque.driver_source import DriverWrenchSource
from ninedtact.capture.force_torque.netft import ATI, NetFtDriver
from ninedtact.capture.force_torque.sample_checks import CheckedWrenchSource, SkippingWrenchSource
from ninedtact.capture.force_torque.wrench_source_from_address import (
    MountedWrenchSource,
    force_torque_sensor_for,
)
from ninedtact.capture.frame_source import SourceNotOpen
from ninedtact.capture.reconnecting import ReconnectingWrenchSource
from ninedtact.capture.wrench_source import WrenchSource
from ninedtact.errors import DeviceError, InputError, MissingLibraryError
from ninedtact.quantities import Wrench
from ninedtact.recording.metadata import RecordingMetadata
from ninedtact.recording.recorded_source import RecordedWrenchSource
from ninedtact.recording.writer import RecordingWriter
from ninedtact.simulation.simulated_sources import SimulatedForceTorque

DUMMY = {
    "driver_config": {
        "communication_interface_name": "Bota_Dummy",
        "communication_interface_params": {},
        "product_name": "BFT-DUMMY-DUMMY-DUMMY",
        "serial_number": "SN000001",
        "sensor_operation_params": {"app_mode": 0, "app_submode": 0},
        "driver_operation_params": {"runtime_verbosity": False},
    }
}


class Bench:
    """Makes a member of the family by name; whatever it needs lasts until the test ends."""

    def __init__(self, folder: Path, resources: ExitStack) -> None:
        self.folder, self.resources = folder, resources
        self.server: RdtServer
        self.device: SerialDevice

    def onrobot(self) -> DriverWrenchSource:
        self.server = self.resources.enter_context(RdtServer())
        return force_torque_sensor_for(f"onrobot:{self.server.place}")

    def ati(self) -> DriverWrenchSource:
        self.server = self.resources.enter_context(RdtServer())
        host, port = self.server.place.split(":")
        http_port = self.resources.enter_context(ati_page())
        return DriverWrenchSource(NetFtDriver("netft:bench", host, ATI, int(port), http_port))

    def serial(self) -> DriverWrenchSource:
        self.device = self.resources.enter_context(SerialDevice(self.folder))
        return force_torque_sensor_for(f"serial:{self.device.port}")

    def bota(self) -> DriverWrenchSource:
        config = self.folder / "dummy.json"
        config.write_text(json.dumps(DUMMY))
        return force_torque_sensor_for(f"bota:{config}")

    def twin(self) -> WrenchSource:
        return SimulatedForceTorque(small_press_simulation(real_time=True), hz=100.0)

    def replayed(self) -> WrenchSource:
        with RecordingWriter(self.folder / "forces.mcap", RecordingMetadata("bench")) as episode:
            for number in range(8):
                episode.write_measured(Wrench(np.full(3, float(number)), np.zeros(3), stamp_ns=time.monotonic_ns()))
        return RecordedWrenchSource(self.folder / "forces.mcap")

    def reopening(self) -> WrenchSource:
        return ReconnectingWrenchSource(self.onrobot(), on_lost=lambda loss: pytest.fail(str(loss)))


DEVICES = {"onrobot": Bench.onrobot, "ati": Bench.ati, "serial": Bench.serial, "bota": Bench.bota}
FAMILY: dict[str, Callable[[Bench], WrenchSource]] = {
    **DEVICES,
    "twin": Bench.twin,
    "twin that ends": lambda bench: SimulatedForceTorque(small_press_simulation(real_time=True, rounds=1), hz=100.0),
    "replayed": Bench.replayed,
    "trusted twin": lambda bench: CheckedWrenchSource(bench.twin()),
    "skipping twin": lambda bench: SkippingWrenchSource(bench.twin(), lambda reason: pytest.fail(str(reason))),
    "mounted serial": lambda bench: MountedWrenchSource(bench.serial()),
    "reopening onrobot": Bench.reopening,
}


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    with ExitStack() as resources:
        yield Bench(tmp_path, resources)


@pytest.mark.parametrize("member", FAMILY)
def test_every_source_keeps_the_contract(bench: Bench, member: str, capfd: pytest.CaptureFixture[str]) -> None:
    source = FAMILY[member](bench)
    assert source.name
    with pytest.raises(SourceNotOpen, match="with source"):
        source.read()
    for _ in range(2):  # a source that was closed opens again as if new
        began_ns = 1 if member == "replayed" else time.monotonic_ns()
        with source:
            wrenches = [source.read() for _ in range(3)]
            source.open()  # opening an open source does nothing
            wrenches += [source.read() for _ in range(2)]
        stamps = [wrench.stamp_ns for wrench in wrenches]
        assert all(one < other for one, other in pairwise(stamps))
        assert began_ns <= stamps[0] and stamps[-1] <= time.monotonic_ns()
        assert all(np.isfinite(wrench.six).all() for wrench in wrenches)
        assert not any(np.shares_memory(one.force_n, other.force_n) for one, other in pairwise(wrenches))
        with pytest.raises(SourceNotOpen):
            source.read()
    source.close()
    source.close()
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("listen")]
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("member", DEVICES)
def test_a_device_holds_nobody_up_and_closing_ends_a_read_that_waits(bench: Bench, member: str) -> None:
    source, ended = FAMILY[member](bench), threading.Event()

    def read_on() -> None:
        with pytest.raises(SourceNotOpen):
            for _ in source:
                pass
        ended.set()

    with source:
        threading.Thread(target=read_on, daemon=True).start()
        turns, give_up_at = 0, time.monotonic() + 0.3
        while time.monotonic() < give_up_at:
            time.sleep(1e-3)
            turns += 1
        assert turns > 30, "a driver that waits with Python's lock in its hand"
    assert ended.wait(5)


@pytest.mark.parametrize("kind", ["network", "serial port"])
def test_a_loss_is_told_once_and_reading_goes_on_when_the_device_is_back(bench: Bench, kind: str) -> None:
    source, told = bench.onrobot() if kind == "network" else bench.serial(), []

    def plug(is_in: bool) -> None:
        if kind == "network":
            bench.server.silent = not is_in
        else:
            bench.device.plug_in() if is_in else bench.device.unplug()

    with ReconnectingWrenchSource(
        source, lambda loss: told.append(str(loss)), lambda: told.append("back"), 20.0
    ) as reopening:
        reopening.read()
        plug(False)
        replug = threading.Timer(0.2, plug, [True])
        if kind == "serial port":
            replug.start()
        while not told:
            if kind == "network" and not replug.is_alive():
                replug = threading.Timer(1.5, plug, [True])
                replug.start()
            last = reopening.read()
        assert reopening.read().stamp_ns > last.stamp_ns
        replug.join()
    assert len(told) == 2 and "expected a sample" in told[0] and told[1] == "back"


def test_what_is_not_there_is_refused_in_one_sentence_and_nothing_stays_open(
    tmp_path: Path, bench: Bench, capfd: pytest.CaptureFixture[str]
) -> None:
    wrong = tmp_path / "wrong.json"
    wrong.write_text(
        json.dumps({"driver_config": DUMMY["driver_config"] | {"communication_interface_name": "Nonsense"}})
    )
    mute = bench.serial()
    bench.device.hz = 0.1
    absent = [
        *map(
            force_torque_sensor_for,
            (f"bota:{tmp_path}/none.json", f"bota:{wrong}", "serial:/dev/ttyNOPE", "onrobot:127.0.0.1:9"),
        ),
        mute,
    ]
    for source in absent:
        with pytest.raises(DeviceError, match=r"expected .* got.*;"), source:
            pass
        with pytest.raises(SourceNotOpen):
            source.read()
    assert capfd.readouterr().err == ""


def test_a_missing_library_is_named_with_the_command_that_gets_it(
    monkeypatch: pytest.MonkeyPatch, bench: Bench
) -> None:
    for library in ("bota_driver", "pynetft", "serial"):
        monkeypatch.setitem(sys.modules, library, None)
    for source in (bench.bota(), bench.onrobot(), bench.serial()):
        with pytest.raises(MissingLibraryError, match=re.escape(installation_command("force-torque"))):
            source.open()


def test_text_names_a_sensor() -> None:
    for text in ("bota:~/sensor.json", "netft:192.168.1.1", "netft:ati.local:49153", "onrobot:10.0.0.2", "serial:COM3"):
        assert force_torque_sensor_for(text).name in (text, f"bota:{Path.home()}/sensor.json")
    assert force_torque_sensor_for("serial:/dev/ttyACM0@921600").name == "serial:/dev/ttyACM0"
    assert force_torque_sensor_for("serial:COM3@123456789").name == "serial:COM3"
    wrong = (
        "",
        "sim",
        "ati",
        "netft:",
        "netft:a b",
        "netft:a:0",
        "netft:a:70000",
        "serial:",
        "serial:@9",
        "serial:x@fast",
        "serial:x@0",
        "serial:x@1000000000",
    )
    for text in wrong:
        with pytest.raises(InputError, match=r"expected .* got .*; correct it"):
            force_torque_sensor_for(text)
