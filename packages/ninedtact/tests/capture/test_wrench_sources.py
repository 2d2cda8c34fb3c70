"""What every member of the WrenchSource family honours."""

import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from small_press_simulation import small_press_simulation

from ninedtact.capture.frame_source import SourceEnded, SourceNotOpen
from ninedtact.capture.wrench_source import WrenchSource
from ninedtact.quantities import Wrench
from ninedtact.recording.metadata import RecordingMetadata
from ninedtact.recording.recorded_source import RecordedWrenchSource
from ninedtact.recording.writer import RecordingWriter
from ninedtact.simulation.simulated_sources import SimulatedForceTorque

FAMILY: dict[str, Callable[[], WrenchSource]] = {
    "twin": lambda: SimulatedForceTorque(small_press_simulation(real_time=True), hz=100.0),
    "twin that ends": lambda: SimulatedForceTorque(small_press_simulation(real_time=True, rounds=1), hz=100.0),
}


def replayed(folder: Path) -> WrenchSource:
    with RecordingWriter(folder / "forces.mcap", RecordingMetadata("bench")) as episode:
        for number in range(8):
            episode.write_measured(Wrench(np.full(3, float(number)), np.zeros(3), stamp_ns=time.monotonic_ns()))
    return RecordedWrenchSource(folder / "forces.mcap")


@pytest.mark.parametrize("member", [*FAMILY, "replayed"])
def test_every_source_keeps_the_contract(member: str, tmp_path: Path) -> None:
    source = replayed(tmp_path) if member == "replayed" else FAMILY[member]()
    assert source.name
    with pytest.raises(SourceNotOpen, match="with source"):
        source.read()
    for _ in range(2):  # a source that was closed opens again as if new
        with source:
            wrenches = [source.read() for _ in range(3)]
            source.open()  # opening an open source does nothing
            wrenches += [source.read() for _ in range(2)]
        stamps = [wrench.stamp_ns for wrench in wrenches]
        assert (
            all(one < other for one, other in pairwise(stamps)) and stamps[0] > 0 and stamps[-1] <= time.monotonic_ns()
        )
        assert all(np.isfinite(wrench.six).all() for wrench in wrenches)
        assert not any(np.shares_memory(one.force_n, other.force_n) for one, other in pairwise(wrenches))
        with pytest.raises(SourceNotOpen):
            source.read()
    source.close()
    source.close()


def test_a_source_ends_as_it_says() -> None:
    with (
        SimulatedForceTorque(small_press_simulation(rounds=1), hz=10.0) as source,
        pytest.raises(SourceEnded, match="it has ended"),
    ):
        for wrench in source:
            assert np.isfinite(wrench.six).all()
