"""Recordings as a LeRobotDataset, read back by pyarrow, against the layout that LeRobot's own code reads (docs/lerobot.md)."""

import json
import os
import re
import shlex
import subprocess
from pathlib import Path

import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest
from episodes import SHAPE, frame, sample, write_episode, write_estimates

from ninedtact.cli import main
from ninedtact.interop.lerobot import UNKNOWN_STD, RecordingsDiffer, export_lerobot
from ninedtact.recording.reader import Recording


def test_a_recording_is_an_episode_with_images_and_wrenches(tmp_path: Path) -> None:
    one, other = write_episode(tmp_path / "one.mcap", 12), write_episode(tmp_path / "other.mcap", 7)
    out = tmp_path / "set"
    with Recording(one) as first, Recording(other) as second:
        written = export_lerobot([first, second], out, "press the ball")
    assert written == {"episodes": 2, "frames": 19, "features": 8}
    info = json.loads((out / "meta/info.json").read_text())
    assert (info["codebase_version"], info["fps"], info["total_frames"], info["total_episodes"]) == ("v3.0", 30, 19, 2)
    assert info["features"]["observation.images.tactile"] == {
        "dtype": "image",
        "shape": list(SHAPE),
        "names": ["height", "width", "channels"],
    }
    episodes = pq.read_table(out / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    assert [(row["dataset_from_index"], row["dataset_to_index"], row["length"]) for row in episodes] == [
        (0, 12, 12),
        (12, 19, 7),
    ]
    frames = []
    for row in episodes:
        assert row["tasks"] == ["press the ball"]
        path = info["data_path"].format(chunk_index=row["data/chunk_index"], file_index=row["data/file_index"])
        table = pq.read_table(out / path)
        assert set(table.column_names) == set(info["features"])
        frames += table.to_pylist()
    assert [row["index"] for row in frames] == list(range(19))
    assert [row["episode_index"] for row in frames] == 12 * [0] + 7 * [1]
    for number, row in enumerate(frames[:12]):
        image = cv2.imdecode(np.frombuffer(row["observation.images.tactile"]["bytes"], np.uint8), cv2.IMREAD_COLOR)
        np.testing.assert_array_equal(image, frame(number).image)
        assert row["timestamp"] == pytest.approx(number / 30, abs=1e-6)
        at_s = (frame(number).stamp_ns - frame(0).stamp_ns) / 1e9
        assert row["observation.time_s"] == pytest.approx(at_s, abs=1e-9)
        samples = [sample(index) for index in range(200)]
        times = [(wrench.stamp_ns - frame(0).stamp_ns) / 1e9 for wrench in samples]
        wanted = [np.interp(at_s, times, column) for column in np.array([wrench.six for wrench in samples]).T]
        assert row["observation.wrench"] == pytest.approx(wanted, abs=1e-5)
    tasks = pq.read_table(out / "meta/tasks.parquet")
    assert tasks.to_pylist() == [{"task_index": 0, "task": "press the ball"}]
    assert json.loads(tasks.schema.metadata[b"pandas"])["index_columns"] == ["task"]
    stats = json.loads((out / "meta/stats.json").read_text())
    loads = np.array([row["observation.wrench"] for row in frames])
    np.testing.assert_allclose(stats["observation.wrench"]["mean"], loads.mean(0), atol=1e-5)
    np.testing.assert_allclose(stats["observation.wrench"]["std"], loads.std(0), atol=1e-5)
    assert np.shape(stats["observation.images.tactile"]["mean"]) == (3, 1, 1)
    assert stats["observation.images.tactile"]["count"] == [19]


def test_estimates_keep_their_errors_and_warnings(tmp_path: Path) -> None:
    estimates = write_estimates(tmp_path / "one.mcap")
    with Recording(tmp_path / "one.mcap") as recording:
        assert export_lerobot([recording], tmp_path / "set")["features"] == 10
    rows = pq.read_table(tmp_path / "set/data/chunk-000/file-000.parquet").to_pylist()
    for row, estimate in zip(rows, estimates, strict=True):
        assert row["observation.wrench_estimated"] == pytest.approx(estimate.wrench.six.tolist(), abs=1e-6)
        std = np.minimum(estimate.std, UNKNOWN_STD).tolist()
        assert row["observation.wrench_estimated_std"] == pytest.approx(std, rel=1e-6)
        assert row["wrench_estimated_warnings"] == len(estimate.warnings)
    stats = json.loads((tmp_path / "set/meta/stats.json").read_text(), parse_constant=lambda word: pytest.fail(word))
    assert stats["observation.wrench_estimated_std"]["max"] == 6 * [UNKNOWN_STD]


def test_the_command_says_what_it_wrote_and_refuses_in_one_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, out = write_episode(tmp_path / "one.mcap", 3), tmp_path / "set"
    arguments = ["export", str(path), "--out", str(out), "--to", "lerobot", "--task", "press", "--json"]
    assert main(arguments) == 0
    assert json.loads(capsys.readouterr().out)["written"] == {"episodes": 1, "frames": 3, "features": 8}
    assert main(arguments) == 1
    assert "new or empty folder" in capsys.readouterr().err
    without = write_episode(tmp_path / "without.mcap", 3, samples=0)
    with Recording(without) as no_wrench, Recording(path) as wrenches:
        assert export_lerobot([no_wrench], tmp_path / "images")["features"] == 7
        with pytest.raises(
            RecordingsDiffer, match=r"the same wrenches, got .*without.mcap with 44 x 30 px at 30 Hz and no w"
        ):
            export_lerobot([no_wrench, no_wrench, wrenches], tmp_path / "both")
        with pytest.raises(RecordingsDiffer, match="at least one recording, got none"):
            export_lerobot([], tmp_path / "both")
    assert not (tmp_path / "both").exists()


def test_the_command_joins_several_recordings_for_lerobot_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    paths = [str(write_episode(tmp_path / f"{number}.mcap", 3 + number)) for number in range(3)]
    cut = Path(paths[1])
    cut.write_bytes(cut.read_bytes()[:-1000])
    assert main(["export", *paths, "--out", str(tmp_path / "set"), "--to", "lerobot"]) == 1
    printed = capsys.readouterr()
    assert "       3  episodes\n" in printed.out
    assert printed.err.count("cut short") == 1 and f"expected all of {cut}, got 0." in printed.err
    table = pq.read_table(tmp_path / "set/meta/episodes/chunk-000/file-000.parquet")
    assert table["length"].to_pylist() == [3, 4, 5]
    assert main(["export", *paths, "--out", str(tmp_path / "both"), "--to", "lerobot", "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["finished"] is False
    for kind in ("files", "rerun"):
        out = tmp_path / f"{kind}.rrd"
        assert main(["export", *paths, "--out", str(out), "--to", kind]) == 1
        (sentence,) = capsys.readouterr().err.strip().splitlines()
        assert f"expected one recording, or several with --to lerobot, got 3 with --to {kind}; export each" in sentence
        assert not out.exists()
    assert main(["export", "--out", str(tmp_path / "none")]) == 1
    assert "expected a recording, got none; name it" in capsys.readouterr().err


ROOT = Path(__file__).parents[4]
LEROBOT_PYTHON = os.environ.get("NINEDTACT_LEROBOT_PYTHON", "")
TORCHVISION = (ROOT / "plugins/lerobot_camera_ninedtact/tests/conftest.py").read_text(encoding="utf-8")
READ_BACK = """
import json, sys
from lerobot.datasets.lerobot_dataset import LeRobotDataset
read = LeRobotDataset("local/set", root=sys.argv[1], delta_timestamps={"observation.wrench": [-1 / 30, 0.0]})
row = read[13]
print(json.dumps([len(read), read.meta.total_episodes, read.fps, row["task"], list(row["observation.images.tactile"].shape),
    row["observation.wrench"].tolist(), int(row["episode_index"]), int(row["frame_index"])]))
"""


@pytest.mark.interop
@pytest.mark.skipif(not LEROBOT_PYTHON, reason="NINEDTACT_LEROBOT_PYTHON does not name an interpreter with lerobot")
def test_lerobot_itself_reads_the_data_set(tmp_path: Path) -> None:
    out = tmp_path / "set"
    one, other = write_episode(tmp_path / "one.mcap", 12), write_episode(tmp_path / "other.mcap", 7)
    with Recording(one) as first, Recording(other) as second:
        export_lerobot([first, second], out, "press the ball")
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"} | {"HF_HUB_OFFLINE": "1"}
    read = subprocess.run(
        [LEROBOT_PYTHON, "-c", TORCHVISION + READ_BACK, str(out)],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    frames, episodes, fps, task, shape, wrenches, episode, index = json.loads(read.stdout.splitlines()[-1])
    assert (frames, episodes, fps, task, shape) == (19, 2, 30, "press the ball", [3, *SHAPE[:2]])
    assert (episode, index) == (1, 1)
    rows = pq.read_table(out / "data/chunk-000/file-001.parquet").to_pylist()
    np.testing.assert_allclose(wrenches, [row["observation.wrench"] for row in rows[:2]], atol=1e-6)


@pytest.mark.interop
def test_the_way_of_the_pages_without_a_sensor(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("rerun", reason="the extra 'rerun' is not installed")
    monkeypatch.chdir(tmp_path)
    commands: list[str] = []
    for page in ("lerobot", "foxglove_rerun"):
        lines = (ROOT / f"docs/{page}.md").read_text(encoding="utf-8").splitlines()
        commands += [line.strip() for line in lines if re.match("    ninedtact (calibrate|record|export) ", line)]
    commands = [line for line in dict.fromkeys(commands) if "--source 0" not in line and "--seconds 10" not in line]
    kinds = ("calibrate", "record", "export")
    commands.sort(key=lambda line: kinds.index(line.split()[1]))
    assert [line.split()[1] for line in commands] == ["calibrate", "record", "export", "export"]
    for line in commands:
        assert main(shlex.split(line, comments=True)[1:]) == 0, line
    images = pq.read_table("press_set/data/chunk-000/file-000.parquet")
    assert {"observation.wrench", "observation.wrench_estimated"} <= set(images.column_names)
    assert images.num_rows > 10 and Path("press.rrd").stat().st_size > 100_000
