"""Recordings as a LeRobotDataset, read back by LeRobot."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from lerobot.datasets.lerobot_dataset import LeRobotDataset

sys.path.insert(0, str(Path(__file__).parents[3] / "packages/ninedtact/tests/recording"))
from episodes import SHAPE, frame, sample, write_episode, write_estimates

from lerobot_camera_ninedtact.export import UNKNOWN_STD, export_lerobot
from ninedtact.cli import main
from ninedtact.errors import InputError
from ninedtact.recording.reader import Recording


def test_recordings_are_episodes_with_images_and_wrenches(tmp_path: Path) -> None:
    one, other = write_episode(tmp_path / "one.mcap", 12), write_episode(tmp_path / "other.mcap", 7)
    with Recording(one) as first, Recording(other) as second:
        written = export_lerobot([first, second], tmp_path / "set", "press the ball")
    assert written == {"episodes": 2, "frames": 19, "features": 8}
    read = LeRobotDataset("local/set", tmp_path / "set", delta_timestamps={"observation.wrench": [-1 / 30, 0.0]})
    assert (len(read), read.meta.total_episodes, read.fps) == (19, 2, 30)
    episodes, numbers = 12 * [0] + 7 * [1], [*range(12), *range(7)]
    samples = [sample(index) for index in range(200)]
    times_s = [(wrench.stamp_ns - frame(0).stamp_ns) / 1e9 for wrench in samples]
    for row, episode, number in zip((read[at] for at in range(len(read))), episodes, numbers, strict=True):
        assert (row["episode_index"], row["frame_index"], row["task"]) == (episode, number, "press the ball")
        image = np.rint(row["observation.images.tactile"].numpy() * 255).astype(np.uint8).transpose(1, 2, 0)[..., ::-1]
        np.testing.assert_array_equal(image, frame(number).image)
        assert row["timestamp"] == pytest.approx(number / 30, abs=1e-6)
        at_s = (frame(number).stamp_ns - frame(0).stamp_ns) / 1e9
        assert row["observation.time_s"] == pytest.approx(at_s, abs=1e-9)
        wanted = [np.interp(at_s, times_s, column) for column in np.array([wrench.six for wrench in samples]).T]
        assert row["observation.wrench"][1].numpy() == pytest.approx(wanted, abs=1e-5)
    assert read.meta.features["observation.images.tactile"]["shape"] == SHAPE


def test_estimates_keep_their_errors_and_warnings(tmp_path: Path) -> None:
    estimates = write_estimates(tmp_path / "one.mcap")
    with Recording(tmp_path / "one.mcap") as recording:
        assert export_lerobot([recording], tmp_path / "set")["features"] == 10
    read = LeRobotDataset("local/set", tmp_path / "set")
    for row, estimate in zip((read[number] for number in range(len(read))), estimates, strict=True):
        assert row["observation.wrench_estimated"].numpy() == pytest.approx(estimate.wrench.six, abs=1e-6)
        std = np.minimum(estimate.std, UNKNOWN_STD)
        assert row["observation.wrench_estimated_std"].numpy() == pytest.approx(std, rel=1e-6)
        assert row["wrench_estimated_warnings"] == len(estimate.warnings)
    json.loads((tmp_path / "set/meta/stats.json").read_text(), parse_constant=lambda word: pytest.fail(word))


def test_recordings_that_differ_are_refused_in_one_sentence_and_leave_nothing(tmp_path: Path) -> None:
    path, without = write_episode(tmp_path / "one.mcap", 3), write_episode(tmp_path / "two.mcap", 3, samples=0)
    with Recording(without) as no_wrench, Recording(path) as wrenches:
        assert export_lerobot([no_wrench], tmp_path / "images")["features"] == 7
        with pytest.raises(
            InputError, match=r"the same wrenches, got .*two.mcap with 44 x 30 px at 30 Hz and no wrench"
        ):
            export_lerobot([no_wrench, no_wrench, wrenches], tmp_path / "both")
        with pytest.raises(InputError, match="at least one recording, got none"):
            export_lerobot([], tmp_path / "both")
    assert not (tmp_path / "both").exists()


def test_the_command_joins_recordings_and_says_what_it_wrote(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    paths = [str(write_episode(tmp_path / f"{number}.mcap", 3 + number)) for number in range(3)]
    cut = Path(paths[1])
    cut.write_bytes(cut.read_bytes()[:-1000])
    arguments = ["export", *paths, "--out", str(tmp_path / "set"), "--to", "lerobot", "--task", "press", "--json"]
    assert main(arguments) == 1
    printed = capsys.readouterr()
    assert json.loads(printed.out)["written"] == {"episodes": 3, "frames": 12, "features": 8}
    assert json.loads(printed.out)["finished"] is False and printed.err.count("cut short") == 1
    assert main(arguments) == 1
    assert "new or empty folder" in capsys.readouterr().err
