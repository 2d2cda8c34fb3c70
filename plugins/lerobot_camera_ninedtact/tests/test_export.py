"""Recordings as a LeRobotDataset, read back by LeRobot."""

import json
import sys
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
from lerobot.datasets.lerobot_dataset import LeRobotDataset

sys.path.insert(0, str(Path(__file__).parents[3] / "packages/ninedtact/tests/recording"))
from episodes import BEGAN_NS, SHAPE, frame, noise, sample, write_episode, write_estimates

from lerobot_camera_ninedtact.export import UNKNOWN_STD, export_lerobot
from lerobot_camera_ninedtact.tracking_features import TRACKING_NAMES
from ninedtact import load_sensor, record, source_for
from ninedtact.cli import main
from ninedtact.errors import InputError
from ninedtact.quantities import Frame
from ninedtact.recording.metadata import RecordingMetadata
from ninedtact.recording.reader import Recording
from ninedtact.recording.topics_and_messages import Topic
from ninedtact.recording.writer import RecordingWriter


def test_recordings_are_episodes_with_images_and_wrenches(tmp_path: Path) -> None:
    one, other = write_episode(tmp_path / "one.mcap", 12), write_episode(tmp_path / "other.mcap", 7)
    with Recording(one) as first, Recording(other) as second:
        written = export_lerobot([first, second], tmp_path / "set", "press the ball")
    assert written == {"episodes": 2, "frames": 19, "features": 8}
    sensors = json.loads((tmp_path / "set/ninedtact/episodes.json").read_text())
    assert [one["episode"] for one in sensors] == [0, 1] and (
        tmp_path / "set/ninedtact" / sensors[1]["reference"]
    ).is_file()
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


def test_tracking_is_a_feature_where_it_is_asked_for(tmp_path: Path, sensor_folder: str) -> None:
    """A recording of the twin, whose contacts are those that its own exported images show."""
    path, folder = tmp_path / "press.mcap", load_sensor(sensor_folder)
    record(source_for("sim", sensor=folder), path, folder, seconds=4.0)
    arguments = ["export", str(path), "--out", str(tmp_path / "set"), "--to", "lerobot", "--tracking"]
    assert main(arguments) == 0
    read = LeRobotDataset("local/set", tmp_path / "set")
    assert read.meta.features["observation.tracking"]["names"] == list(TRACKING_NAMES)
    values = np.array([read[number]["observation.tracking"].numpy() for number in range(len(read))])
    with Recording(path) as recording:
        contacts = [len(reading.contacts) for reading in recording.readings()]
    assert values[:, 0].tolist() == contacts and max(contacts) >= 1 > min(contacts)


def test_recordings_that_differ_are_refused_in_one_sentence_and_leave_nothing(tmp_path: Path) -> None:
    path, without = write_episode(tmp_path / "one.mcap", 3), write_episode(tmp_path / "two.mcap", 3, samples=0)
    with Recording(without) as no_wrench, Recording(path) as wrenches:
        assert export_lerobot([no_wrench], tmp_path / "images")["features"] == 7
        with pytest.raises(InputError, match=r"the same wrenches, got .*two.mcap with 44 x 30 px and no wrench"):
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


def write_at_rate(path: Path, hz: float, frames: int = 12) -> Path:
    with RecordingWriter(
        path, RecordingMetadata("small"), (Topic.IMAGES,), {"sensor/sensor.toml": b"id = 'small'"}
    ) as file:
        for number in range(frames):
            file.write_image(Frame(noise(number), BEGAN_NS + round(number * 1e9 / hz), number))
    return path


@pytest.mark.parametrize(
    ("rates_hz", "fps"), [((24.5, 25.5), 25), ((29.97, 30.9, 29.0), 30), ((59.0, 61.2, 60.0, 60.0), 60)]
)
def test_recordings_of_about_one_rate_are_one_set_with_all_images(
    rates_hz: tuple[float, ...], fps: int, tmp_path: Path
) -> None:
    """In any order; a recording of one image has any rate."""
    paths = [write_at_rate(tmp_path / f"{number}.mcap", hz) for number, hz in enumerate(rates_hz)]
    for out, files in (("set", paths), ("reversed", [*paths[::-1], write_at_rate(tmp_path / "one.mcap", 1.0, 1)])):
        with ExitStack() as opened:
            written = export_lerobot([opened.enter_context(Recording(path)) for path in files], tmp_path / out)
        assert written["frames"] == 12 * len(paths) + (out == "reversed")
        assert LeRobotDataset(f"local/{out}", tmp_path / out).fps == fps


@pytest.mark.parametrize("fps", [7, 20, 50])
def test_a_rate_that_is_asked_for_takes_the_nearest_images_of_every_recording(fps: int, tmp_path: Path) -> None:
    rates_hz = (24.5, 40.0)
    paths = [write_at_rate(tmp_path / f"{hz}.mcap", hz) for hz in rates_hz]
    with Recording(paths[0]) as slow, Recording(paths[1]) as fast:
        with pytest.raises(InputError, match=r"within 5% of one rate.*got .*24.5 Hz; .*--fps"):
            export_lerobot([slow, fast], tmp_path / "set")
        with pytest.raises(InputError, match=r"1 to 1000 frames per second, got 0;"):
            export_lerobot([slow, fast], tmp_path / "set", fps=0)
    assert not (tmp_path / "set").exists()
    arguments = ["export", *map(str, paths), "--out", str(tmp_path / "set"), "--to", "lerobot", "--fps", str(fps)]
    assert main(arguments) == 0
    read = LeRobotDataset("local/set", tmp_path / "set")
    assert read.fps == fps
    rows = [read[at] for at in range(len(read))]
    for episode, hz in enumerate(rates_hz):
        mine = [row for row in rows if row["episode_index"] == episode]
        assert len(mine) == round(11 / hz * fps) + 1
        for number, row in enumerate(mine):
            assert abs(float(row["observation.time_s"]) - number / fps) <= 0.5 / hz + 1e-6 or number == len(mine) - 1
            image = np.rint(row["observation.images.tactile"].numpy() * 255).astype(np.uint8).transpose(1, 2, 0)
            np.testing.assert_array_equal(image[..., ::-1], noise(round(float(row["observation.time_s"]) * hz)))


@pytest.mark.parametrize(
    ("hz", "fps", "words"), [(0.3, None, "whole number.*got 0.3 Hz"), (1e-5, 50, "are 55000000 frames")]
)
def test_a_set_that_would_stretch_time_or_be_of_repeated_images_is_refused(
    hz: float, fps: int | None, words: str, tmp_path: Path
) -> None:
    path = write_at_rate(tmp_path / "slow.mcap", hz)
    with Recording(path) as slow, pytest.raises(InputError, match=rf"{words}.*--fps"):
        export_lerobot([slow], tmp_path / "set", fps=fps)
    assert not (tmp_path / "set").exists()
