"""A sample of the mutated files of `make benchmarks/mutated_files`: none is answered with a traceback, in silence, or never."""

import shutil
import sys
from dataclasses import replace
from pathlib import Path

import msgspec
import pytest

from ninedtact.calibration.save import to_sensor_toml
from ninedtact.calibration.sensor_folder import SENSOR_FILE, SensorFolder
from ninedtact.shape.deblurring import Deblurring

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"
SLOW = ("video, press.mp4", "video, press.mkv", "mesh, strange")
"""Kinds that only the benchmark tries."""


@pytest.mark.skipif(sys.platform == "win32", reason="cases run in forked processes")
def test_no_mutated_file_is_answered_badly(
    twin_sensor: SensorFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    from mutated_files import table_lines, tally_kind
    from mutated_kinds import file_kinds

    shutil.copytree(twin_sensor.path, tmp_path / "sensor")
    usual = twin_sensor.record.depth  # force by physics needs bulges and the point spread
    curve = replace(usual.curve, brightening=(0.0, 0.36), bulge_mm=(0.0, 1.0))
    depth = msgspec.structs.replace(usual, curve=curve, deblurring=Deblurring(0.45))
    record = msgspec.structs.replace(twin_sensor.record, depth=depth)
    (tmp_path / "sensor" / SENSOR_FILE).write_bytes(to_sensor_toml(record))
    kinds = file_kinds(tmp_path / "sensor", tmp_path, cases=60, seed=1, places=("fifo",))
    tallies = [tally_kind(kind, tmp_path) for kind in kinds if kind.name not in SLOW]
    report = "\n".join(table_lines(tallies))
    assert len(kinds) > 30 and sum(tally.verdicts.total() for tally in tallies) >= 60, report
    assert not any(tally.bad for tally in tallies), report
