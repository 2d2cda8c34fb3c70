"""Data sets of sequences: rows whose truth agrees with their wrenches, and the same bytes after a stop."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ninedtact.errors import OutputError
from ninedtact.simulation.object_motions import HZ
from ninedtact_train.cli.simulate_sequences import SimulateSequencesCommand
from ninedtact_train.dataset.generation.sequences import generate_sequences
from ninedtact_train.dataset.generation.settings import SequenceSettings
from ninedtact_train.dataset.parquet_files import iterate_rows, require_pair_columns
from ninedtact_train.dataset.schema import PAIR_COLUMNS, TRUTH_COLUMNS

SETTINGS = SequenceSettings(
    2, (64, 48), sensors=1, object_names=("ball:4", "ball:6"), pitch_mm=0.6, speed_mm_s=(18, 20), friction=(0.2, 0.3)
)


def test_the_truth_of_every_image_agrees_with_its_wrench_and_a_stopped_run_ends_with_the_same_bytes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    result = generate_sequences(tmp_path, SETTINGS)
    files = sorted((tmp_path / "data").iterdir())
    assert result.new_files == len(files) == 2
    for file in files:
        require_pair_columns(file)
        rows = list(iterate_rows(file))
        assert list(rows[0]) == [column.name for column in (*PAIR_COLUMNS, *TRUTH_COLUMNS)]
        assert {row["motion"] for row in rows} == {"slide" if file == files[0] else "reverse"}
        assert np.diff([row["time_ns"] for row in rows]) == pytest.approx(1e9 / HZ, abs=1)
        slid = [row for row in rows if row["slip"] == "gross"]
        assert slid and all(row["sticking_share"] < 0.02 for row in slid)
        for row in slid:
            x_n, y_n, z_n = row["wrench"][:3]
            assert np.hypot(x_n, y_n) == pytest.approx(-row["friction"] * z_n, rel=0.02)
    content, card = files[1].read_bytes(), (tmp_path / "README.md").read_text()
    files[1].unlink()
    assert SimulateSequencesCommand(tmp_path, SETTINGS, workers=1).run() == 0
    assert files[1].read_bytes() == content and (tmp_path / "README.md").read_text() == card
    assert "1 new sequences" in capsys.readouterr().out
    with pytest.raises(OutputError, match="another sequences"):
        generate_sequences(tmp_path, replace(SETTINGS, sequences=3))
