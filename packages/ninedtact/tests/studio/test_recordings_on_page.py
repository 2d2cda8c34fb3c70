"""From the page into a recording and back: every moment whole, labels kept, the original never damaged, exports complete."""

import csv
import json
import os
import re
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import replace
from functools import partial
from pathlib import Path
from subprocess import PIPE
from threading import Event, Thread
from urllib.request import urlopen

import cv2
import numpy as np
import pytest
from page_client import PageClient, ServedPage, page_client, served_page, served_small_page
from playwright.sync_api import Browser
from reading_clients import page_errors
from small_sensor import SkinCamera, sensor_folder, sensor_on, wait_until

import ninedtact
from ninedtact.calibration.sensor_folder import load_sensor
from ninedtact.cli import main
from ninedtact.errors import InputError, NinedtactError, OutputError
from ninedtact.force.estimator_and_scale import ForceEstimator
from ninedtact.live.reading_recorder import RecordedSensorMetadata, RecorderState
from ninedtact.live.sensor_poller import SensorPhase, SensorPoller, SensorSnapshot
from ninedtact.live.wrench_history import WrenchHistory
from ninedtact.live_sensor import assemble_live_sensor
from ninedtact.quantities import EstimateWarning, Frame, Wrench, WrenchEstimate
from ninedtact.reading import Reading
from ninedtact.recording.attached_sensor import sensor_folder_attachments
from ninedtact.recording.errors import RecordingUnreadable
from ninedtact.recording.labels_and_whole_copy import edit_labelled_spans
from ninedtact.recording.metadata import RecordingMetadata
from ninedtact.recording.reader import Recording
from ninedtact.recording.topics_and_messages import LabelledSpan, Topic
from ninedtact.recording.writer import RecordingWriter
from ninedtact.studio.page_cards import time_slider_marks
from ninedtact.studio.page_controller import (
    DisplayedSensor,
    PageMoment,
    SensorMoment,
    SensorStatusMessage,
)
from ninedtact.studio.reading_view import full_range_colour_scale
from ninedtact.studio.recorded_readings import RecordedReadings, empty_wrench_histories
from ninedtact.studio.recording_player import RecordedSensor, RecordingPlayer
from ninedtact.studio.recordings_panel import WHOLE, RecordingsPanel, RecordingsPanelContext
from ninedtact.studio.saved_files import SaveQuota, save_video
from ninedtact.studio.viewer import ViewerPage

PATIENCE_S = 90.0


def scaled_force(reading: Reading) -> WrenchEstimate:
    """A force of 2 N for every mm of indentation, doubtful from 0.5 mm on."""
    deep_mm = reading.max_indentation_mm
    wrench = Wrench(np.array([0.0, 0.0, -2.0 * deep_mm]), np.zeros(3), stamp_ns=reading.stamp_ns)
    warnings = (EstimateWarning.OUT_OF_RANGE,) if deep_mm > 0.5 else ()
    return WrenchEstimate(wrench, np.diag(np.full(6, 0.01)), deep_mm > 0, warnings)


class ScaledForce(ForceEstimator):
    """Estimates by `scaled_force`."""

    name = "scaled"

    def estimate(self, reading: Reading) -> WrenchEstimate:
        return scaled_force(reading)

    def forget(self) -> None: ...


class Bench:
    """A sensor whose readings are recorded as on the page: its skin is pressed in deeper from reading to reading."""

    def __init__(self, folder: Path, out: Path, share: float = 0.1) -> None:
        self.folder = load_sensor(sensor_folder(folder))
        self.true, self.estimated = (
            WrenchHistory("true", "of the bench"),
            WrenchHistory("estimated", "", states_errors=True),
        )
        self.quota = SaveQuota(per_minute=100, disk_share=share)
        recorded = RecordedSensorMetadata(self.folder, "bench", "of the bench", True, ("±27%, an unknown gel",))
        self.recorder = self.quota.new_recorder([recorded], out)
        self.camera = SkinCamera()
        self.sensor = sensor_on(self.camera)
        self.sensor.estimator = ScaledForce()
        self.kept: list[Reading] = []

    def press(self, levels: list[int]) -> None:
        for level in levels:
            self.camera.level = level
            time.sleep(0.02)
            self.sensor.read()
            reading = self.sensor.read()
            wrench = Wrench(np.array([0.0, 0.0, float(-level)]), np.zeros(3), stamp_ns=reading.stamp_ns)
            for item in (wrench, reading):
                self.recorder.add(item)
            self.kept.append(reading)


@pytest.fixture
def recorded(tmp_path: Path) -> tuple[Path, Bench]:
    """A recording that begins in the middle of a press, with a label, and what was read."""
    bench = Bench(tmp_path / "small", tmp_path / "out")
    with bench.sensor:
        bench.press([80])
        bench.kept.clear()
        path = bench.recorder.start()
        bench.press([80, 70, 75])
        bench.recorder.begin_label("deep")
        bench.press([60, 55])
        bench.recorder.end_label()
        bench.press([90, 100, 85])
        state = bench.recorder.stop()
    assert not state.is_running and state.labels == 1 and state.trouble == "" and state.written_bytes > 1000
    return path, bench


NO_READING = SensorSnapshot(SensorPhase.READING, None, 0, 0.0, 0.0, np.zeros((2, 0)))
NEWEST = PageMoment((SensorMoment(SensorStatusMessage("live", "now"), NO_READING, None),))


def player_of(path: Path, bench: Bench) -> RecordingPlayer:
    shape = bench.folder.shape
    recorded = RecordedSensor(path, shape, full_range_colour_scale(shape), [bench.true, bench.estimated])
    return RecordingPlayer([recorded])


def moment_of(player: RecordingPlayer) -> SensorMoment:
    (moment,) = player.moment(NEWEST).sensors
    return moment


def test_every_moment_of_a_recording_is_the_one_that_the_page_had(recorded: tuple[Path, Bench]) -> None:
    path, bench = recorded
    player = player_of(path, bench)
    assert len(player) == len(bench.kept) == 8
    for number in (5, 0, 7, 3):  # in any order
        player.seek((bench.kept[number].stamp_ns - bench.kept[0].stamp_ns) / 1e9)
        moment, kept = moment_of(player), bench.kept[number]
        assert moment.view is not None and moment.reading is not None and kept.force is not None
        assert np.array_equal(moment.reading.image, kept.image) and moment.reading.stamp_ns == kept.stamp_ns
        np.testing.assert_allclose(moment.reading.height.z_mm, kept.height.z_mm, atol=0.0006)
        true, estimated = moment.wrenches
        assert true.sample is not None and estimated.sample is not None
        assert (true.notices, estimated.notices) == ((), ("±27%, an unknown gel",))
        assert estimated.sample.wrench.stamp_ns == kept.stamp_ns and estimated.sample.warnings == kept.force.warnings
        np.testing.assert_allclose(estimated.sample.wrench.six, kept.force.wrench.six)
        np.testing.assert_allclose(estimated.sample.std, kept.force.std)
        assert true.sample.wrench.stamp_ns <= kept.stamp_ns
        assert all(at <= kept.stamp_ns for at, _ in estimated.samples) and moment.snapshot.phase is SensorPhase.RECORDED
        assert f"of {player.duration_s:.2f} s, paused" in moment.status.sentence
    same = moment_of(player)
    assert same.view is moment_of(player).view
    wait_until(lambda: moment_of(player).snapshot.history.shape[1] == 4)
    player.close()


def test_a_moment_has_no_wrench_of_another_time(recorded: tuple[Path, Bench], tmp_path: Path) -> None:
    _, bench = recorded
    image, first_ns = bench.kept[0].image, 10**12
    with RecordingWriter(tmp_path / "ended.mcap", RecordingMetadata("small")) as writer:
        for second in range(6):
            writer.write_image(Frame(image, first_ns + second * 10**9, second))
        force = Wrench(np.array([0.0, 0.0, -5.0]), np.zeros(3), stamp_ns=first_ns + 10**9)
        writer.write_measured(force)  # the force/torque sensor was lost after this
        wrench = replace(force, stamp_ns=first_ns + 2 * 10**9)
        writer.write_estimated(WrenchEstimate(wrench, np.eye(6), True, ()), 2)
    player = player_of(tmp_path / "ended.mcap", bench)
    found = []
    for second in range(6):
        player.seek(second)
        found.append(tuple(one.sample is not None for one in moment_of(player).wrenches))
    player.close()
    assert found == [(True, False), (True, False), (True, True), *[(False, False)] * 3]


def test_a_program_reads_the_reference_of_the_page_and_not_the_first_images(recorded: tuple[Path, Bench]) -> None:
    path, bench = recorded  # which begins in the middle of a press
    deep_mm = [kept.max_indentation_mm for kept in bench.kept]
    with Recording(path) as recording:
        np.testing.assert_allclose([one.max_indentation_mm for one in recording.readings()], deep_mm, atol=1e-5)
    with ninedtact.open(source=str(path), force="none") as sensor:
        np.testing.assert_allclose([one.max_indentation_mm for one in sensor], deep_mm, atol=1e-5)
    live = assemble_live_sensor(bench.folder, str(path)).sensor
    assert live.current_depth_reader is not None and deep_mm[0] > 0.5


def test_a_player_steps_and_plays_at_its_speed_and_stops_at_the_end(recorded: tuple[Path, Bench]) -> None:
    player = player_of(*recorded)
    player.step(-1)
    assert player.number == 0
    player.step(3)
    player.step(-1)
    assert player.number == 2 and not player.is_playing
    player.seek(np.inf)
    assert player.number == 0
    player.speed = 0.25
    began = time.monotonic()
    player.toggle_play()
    wait_until(lambda: player.moment(NEWEST) is not None and not player.is_playing)
    assert time.monotonic() - began >= 4 * player.duration_s and player.number == len(player) - 1
    player.toggle_play()
    assert player.is_playing and player.number == 0
    player.close()


def test_labels_are_kept_in_the_file_and_exported_and_the_rest_of_it_stays(
    recorded: tuple[Path, Bench], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, bench = recorded
    with Recording(path) as recording:
        (deep,) = recording.spans()
        images = [frame.image for frame in recording.frames()]
    assert deep.label == "deep" and bench.kept[2].stamp_ns <= deep.begin_ns <= bench.kept[4].stamp_ns <= deep.end_ns
    player = player_of(path, bench)
    player.add_span(0.0, player.duration_s, " whole ")
    deep_s, marks = player.span_s(deep), list(time_slider_marks(player))
    assert marks[-1] == (player.duration_s, f"{player.duration_s:.1f} s") and {0.0, *deep_s} <= set(marks)
    size = path.stat().st_size
    player.add_span(0.0, 0.01, "first")
    assert path.stat().st_size < size + 200  # an earlier list of labels does not pile up
    player.remove_span(deep)
    with pytest.raises(InputError, match=r"expected a label and an end after its beginning, got ' ' from 0.00"):
        player.add_span(0.0, 0.1, " ")
    player.close()
    with Recording(path) as recording:
        assert recording.is_finished and [span.label for span in recording.spans()] == ["first", "whole"]
        assert all(np.array_equal(*pair) for pair in zip(images, (f.image for f in recording.frames()), strict=True))
    assert main(["export", str(path), "--out", str(tmp_path / "tables")]) == 0
    rows = list(csv.DictReader((tmp_path / "tables" / "spans.csv").open()))
    assert [row["label"] for row in rows] == ["first", "whole"]
    assert int(rows[1]["end_monotonic_ns"]) == bench.kept[-1].stamp_ns
    assert main(["info", str(path)]) == 0 and "label 'whole'" in capsys.readouterr().out


def test_two_viewers_of_a_recording_keep_each_others_labels(recorded: tuple[Path, Bench]) -> None:
    path, bench = recorded
    one, other = player_of(path, bench), player_of(path, bench)
    with Recording(path) as recording:
        (deep,) = recording.spans()
    one.add_span(0.0, 0.01, "by one")
    other.add_span(0.02, 0.03, "by other")
    assert {span.label for span in other.spans} == {"by one", "deep", "by other"}
    at_once = [Thread(target=player.add_span, args=(0.0, 0.05, "again")) for player in (one, other)]
    at_once.append(Thread(target=one.remove_span, args=(deep,)))
    for thread in at_once:
        thread.start()
    for thread in at_once:
        thread.join()
    other.remove_span(deep)  # which is gone already
    one.close()
    other.close()
    with Recording(path) as recording:
        assert sorted(span.label for span in recording.spans()) == ["again", "again", "by one", "by other"]


def test_labels_that_cannot_be_written_leave_the_file_as_it_was(recorded: tuple[Path, Bench]) -> None:
    path, _ = recorded
    before, limit = path.read_bytes(), resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (len(before) // 2, limit[1]))
    try:
        with pytest.raises(NinedtactError, match="expected to write"):
            edit_labelled_spans(path, lambda _: [LabelledSpan(0, 1, "x")])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limit)
    assert path.read_bytes() == before and len(list(path.parent.iterdir())) == 1
    path.write_bytes(before[:-300])
    with pytest.raises(OutputError, match="still being written, or was until 5 s ago"):
        edit_labelled_spans(path, lambda _: [LabelledSpan(0, 1, "x")])
    assert path.read_bytes() == before[:-300]


def test_a_full_disk_and_a_used_up_quota_end_a_recording_and_say_what_was_kept(tmp_path: Path) -> None:
    limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    bench = Bench(tmp_path / "small", tmp_path / "out")

    def press_until_it_ends(saved_bytes: int = 0) -> RecorderState:
        bench.recorder.start()
        bench.quota.add_bytes(saved_bytes)  # by another save
        while bench.recorder.state().is_running:
            bench.press([80, 60])
        return bench.recorder.stop()

    with bench.sensor:
        resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, limit[1]))
        try:
            state = press_until_it_ends()
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limit)
        assert "expected to continue writing" in state.trouble and "keeps the messages" in state.trouble
        assert state.path is not None
        with Recording(state.path) as recording:
            assert f"{len(recording.positions(Topic.IMAGES))} of /small/image_raw" in state.trouble
        state = press_until_it_ends(10**15)
        assert "of the free disk" in state.trouble and "a recording in progress" in state.trouble
        with pytest.raises(InputError, match="expected a recording and a name for the label"):
            bench.recorder.begin_label("late")


@pytest.mark.parametrize("harm", ["removed", "a folder", "cut", "moved"])
@pytest.mark.parametrize("is_running", [True, False])
def test_a_recording_whose_file_is_gone_is_not_said_to_be_recorded(harm: str, is_running: bool, tmp_path: Path) -> None:
    bench = Bench(tmp_path / "small", tmp_path / "out")
    with bench.sensor:
        path = bench.recorder.start()
        bench.press([80])
        if not is_running:
            assert bench.recorder.stop().trouble == ""
        if harm == "cut":
            os.truncate(path, 100)
        elif harm == "moved":
            path.rename(tmp_path / "elsewhere.mcap")
        else:
            path.unlink()
        if harm == "a folder":
            path.mkdir()
        bench.press([60])
        if is_running and harm != "cut":
            assert "it was removed or moved" in bench.recorder.state().trouble
        state = bench.recorder.stop()
    assert "was cut; record again" in state.trouble or "removed or cut; record again" in state.trouble


def test_a_label_ends_with_a_recording_that_the_quota_ends(tmp_path: Path) -> None:
    bench = Bench(tmp_path / "small", tmp_path / "out")
    with bench.sensor:
        path = bench.recorder.start()
        bench.press([80])
        bench.recorder.begin_label("to the end")
        bench.press([60])
        bench.quota.add_bytes(10**15)
        wait_until(lambda: not bench.recorder.state().is_running)
        state = bench.recorder.stop()
    assert "a recording in progress" in state.trouble and state.labels == 1 and state.label is None
    with Recording(path) as recording:
        (span,) = recording.spans()
    assert span.label == "to the end" and span.begin_ns <= bench.kept[-1].stamp_ns <= span.end_ns


def test_buttons_of_two_viewers_do_what_they_say(recorded: tuple[Path, Bench]) -> None:
    path, bench = recorded
    with recordings_page(bench, path.parent) as served, served.viewer() as (client, _), served.viewer() as (other, _):

        def press_both(label: str, is_done: Callable[[RecorderState], bool]) -> None:
            def has(one: PageClient) -> bool:
                return any(getattr(each, "label", "") == label for each in one.controls.values())

            wait_until(lambda: served.refresh() and has(client) and has(other))
            for one in (client, other):
                one.use(label)
            wait_until(lambda: is_done(bench.recorder.state()))
            time.sleep(0.3)  # for the second press, which is handled in another thread and changes nothing
            assert is_done(bench.recorder.state())

        press_both("Record", lambda state: state.is_running)
        for one in (client, other):
            one.use("label", "twice")
        press_both("Begin label", lambda state: state.label == "twice")
        press_both("End label 'twice'", lambda state: state.label is None)
        press_both("Stop recording", lambda state: not state.is_running)
        assert len(list(path.parent.glob("*.mcap"))) == 2
        wait_until(lambda: bool(client.notices + other.notices))
        assert set(client.notices + other.notices) == {f"Recorded: {max(path.parent.glob('*.mcap')).name}"}


class UntilAlone:
    """A panel that takes as long to build as a browser stays."""

    title, icon, side = "Slow", None, "right"

    def __init__(self, viewer: ViewerPage, built: list[ViewerPage], has_left: Event) -> None:
        self._viewer, self._built, self._has_left = viewer, built, has_left

    def build(self, gui: object) -> None:
        self._has_left.wait(PATIENCE_S)
        self._built.append(self._viewer)

    def update(self, moment: PageMoment) -> None: ...


def test_a_recording_is_closed_for_a_viewer_who_left_before_it_was_opened(recorded: tuple[Path, Bench]) -> None:
    path, bench = recorded
    built, has_left = list[ViewerPage](), Event()
    panels = [
        partial(RecordingsPanel, context=RecordingsPanelContext(bench.folder, opens=path)),
        partial(UntilAlone, built=built, has_left=has_left),
    ]
    with served_small_page(path.parent, panels) as served:
        clients = served.server.viser.get_clients
        with page_client(served.server):
            wait_until(lambda: len(clients()) == 1)
        wait_until(lambda: not clients())
        has_left.set()
        wait_until(lambda: len(built) == 1 and not built[0].plays_recording)
        assert not served.page.viewers
        wait_until(lambda: not is_open(path))
        built[0].play(player_of(path, bench))  # by a callback that ends after the viewer has left
        wait_until(lambda: not is_open(path))
        assert not built[0].plays_recording


def is_open(path: Path) -> bool:
    links = Path("/proc/self/fd").iterdir()
    return any(os.path.realpath(link) == str(path.resolve()) for link in links)


def test_controls_of_a_recording_show_what_is_open(recorded: tuple[Path, Bench]) -> None:
    path, bench = recorded
    player = player_of(path, bench)
    player.add_span(0.004, 0.006, "between two images")
    player.close()
    (path.parent / "bad.mcap").write_bytes(b"")
    attached = sensor_folder_attachments(bench.folder.path)
    with RecordingWriter(path.parent / "other.mcap", RecordingMetadata("other"), attachments=attached) as writer:
        writer.write_image(Frame(bench.kept[0].image, 1, 0))
    with recordings_page(bench, path.parent) as served, served.viewer() as (client, viewer):

        def wait_for(is_done: Callable[[], bool]) -> None:
            wait_until(lambda: served.refresh() and is_done())

        def shows(stamp_ns: int) -> bool:
            reading = None if viewer.moment is None else viewer.moment.sensors[0].reading
            return reading is not None and reading.stamp_ns == stamp_ns and viewer.plays_recording

        def labels() -> list[str]:
            return [name for one in client.controls.values() for name in getattr(one, "options", ()) if " to " in name]

        wait_for(lambda: len(client.control("recording").options) == 4)
        client.use("recording", path.name)
        wait_for(lambda: shows(bench.kept[0].stamp_ns) and len(labels()) == 2)
        client.use("Remove label")
        wait_for(lambda: client.notices == [f"Label not changed: {_NO_LABEL}"])
        between = next(name for name in labels() if name.startswith("between"))
        choice = next(one for one in client.controls.values() if between in getattr(one, "options", ()))
        client.set_value(choice.uuid, between)
        wait_for(lambda: client.shows("marked: 0.00 to 0.01 s"))
        client.use("Video (MP4)")
        refusal = f"Not exported: expected images in {between}, got none; choose another label"
        wait_for(lambda: client.notices[1:] == [refusal])
        assert not list(path.parent.glob("*.mp4"))
        client.use("speed", "4 ×")
        client.use("recording", "bad.mcap")
        wait_for(lambda: len(client.notices) == 3 and client.control("recording").value == path.name)
        assert "an empty file" in client.notices[2] and viewer.plays_recording
        client.use("recording", "other.mcap")
        wait_for(lambda: shows(1) and client.control("recording").value == "other.mcap")
        client.use("This moment as a web page")
        wait_for(lambda: len(client.notices) == 4)
        (exported,) = path.parent.glob("moment_*.html")
        assert "<title>other, recorded, 0.00 of" in exported.read_text()


_NO_LABEL = f"expected a label to remove, got '{WHOLE}'; choose one first"


def recordings_page(bench: Bench, out: Path) -> AbstractContextManager[ServedPage]:
    panel = partial(RecordingsPanel, context=RecordingsPanelContext(bench.folder, bench.recorder))
    return served_small_page(out, [panel], quota=bench.quota, on_reading=bench.recorder.add)


def test_files_that_cannot_be_played_are_refused_in_one_sentence(
    recorded: tuple[Path, Bench], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    content, bare, cut_short = recorded[0].read_bytes(), tmp_path / "bare.mcap", tmp_path / "damaged.mcap"
    with RecordingWriter(bare, RecordingMetadata("other")) as written:
        written.write_image(Frame(np.zeros((48, 64, 3), np.uint8), 1, 0))
    inside = [match.start() for match in re.finditer(b"zstd", content)][1] + 60  # after the sensor's folder
    cut_short.write_bytes(content[:inside] + bytes(60) + content[inside + 60 :])
    files = {
        bare: "to carry its sensor's folder, got a recording without",
        cut_short: "got damaged",
        tmp_path / "none.mcap": "expected a recording at",
        tmp_path / "none.avi": "expected a recording (.mcap), got",
    }
    for file, said in files.items():
        assert main(["play", str(file), "--port", "0"]) == 1
        captured = capsys.readouterr()
        assert said in captured.err and captured.err.count("\n") == 1 and captured.out == "", file


def test_two_images_with_one_stamp_are_both_shown_each_with_its_own_heights(
    recorded: tuple[Path, Bench], tmp_path: Path
) -> None:
    _, bench = recorded
    first, second, third = bench.kept[0], bench.kept[3], bench.kept[5]
    path, topics = tmp_path / "twice.mcap", (Topic.IMAGES, Topic.HEIGHTS)
    attached = sensor_folder_attachments(bench.folder.path)
    with RecordingWriter(path, RecordingMetadata("small", height_step_mm=0.001), topics, attached) as writer:
        for number, (reading, stamp_ns) in enumerate(((first, 1), (second, 10**9), (third, 10**9))):
            writer.write_image(Frame(reading.image, stamp_ns, number))
            writer.write_height(replace(reading.height, stamp_ns=stamp_ns), number)
    player = player_of(path, bench)
    shown = []
    for _ in range(3):
        reading = moment_of(player).reading
        assert reading is not None
        shown.append((reading.image.min(), round(reading.max_indentation_mm, 2)))
        player.step(1)
    player.close()
    assert shown == [(kept.image.min(), round(kept.max_indentation_mm, 2)) for kept in (first, second, third)]


def test_an_image_that_is_damaged_is_said_and_the_last_whole_one_stays(recorded: tuple[Path, Bench]) -> None:
    path, bench = recorded
    player = player_of(path, bench)
    whole = moment_of(player).view
    player.sensors[0].readings.recording.file.message = lambda position: (_ for _ in ()).throw(  # type: ignore[method-assign]
        RecordingUnreadable("expected it as it was recorded, got damaged data at byte 7; restore it")
    )
    player.step(1)
    moment = moment_of(player)
    assert moment.view is whole and moment.status.tone == "lost" and "damaged data at byte 7" in moment.status.sentence
    player.close()


def test_a_video_has_every_image_or_is_not_written(recorded: tuple[Path, Bench], tmp_path: Path) -> None:
    path, bench = recorded
    scale, shape = full_range_colour_scale(bench.folder.shape), bench.folder.shape
    with RecordedReadings(path, shape) as readings:
        save_video(map(readings.reading, range(len(readings))), scale, 69.6971, tmp_path / "all.mp4", bench.quota)
        video = cv2.VideoCapture(str(tmp_path / "all.mp4"))
        assert video.get(cv2.CAP_PROP_FRAME_COUNT) == 8 and video.read()[1].shape == (72, 128, 3)
        with pytest.raises(NinedtactError, match="at most 0% of the free disk"):
            images, path = map(readings.reading, range(len(readings))), tmp_path / "too" / "long.mp4"
            save_video(images, scale, 10.0, path, SaveQuota(disk_share=0.0))
    assert not list((tmp_path / "too").iterdir())
    with (
        bench.quota.one_export(),
        pytest.raises(NinedtactError, match="one export at a time"),
        bench.quota.one_export(),
    ):
        pass


def test_recordings_of_the_command_line_are_played_too(tmp_path: Path) -> None:
    folder = load_sensor(sensor_folder(tmp_path / "small"))
    path, camera = tmp_path / "plain.mcap", SkinCamera()
    with RecordingWriter(
        path, RecordingMetadata("small"), (Topic.IMAGES,), sensor_folder_attachments(folder.path)
    ) as out:
        camera.open()
        for number in range(14):
            camera.level = 100 if number < 11 else 75
            out.write_image(camera.read())
    assert empty_wrench_histories(path, folder.shape) == []
    with RecordedReadings(path, folder.shape) as readings:
        depths = [reading.max_indentation_mm for reading in map(readings.reading, range(len(readings)))]
    np.testing.assert_allclose(depths, [0.0] * 11 + [1.0] * 3, atol=0.02)


def test_play_serves_a_recording_until_ctrl_c(recorded: tuple[Path, Bench], tmp_path: Path) -> None:
    command = [sys.executable, "-m", "ninedtact", "play", str(recorded[0]), "--port", "0", "--out", str(tmp_path)]
    play = subprocess.Popen(command, stdout=PIPE, stderr=PIPE, text=True)
    assert play.stdout is not None
    address = re.search(r"open (http://127.0.0.1:\d+) in a browser; Ctrl-C ends", play.stdout.readline())
    assert address is not None
    with urlopen(address[1], timeout=60) as page:
        assert page.status == 200 and b"<html" in page.read()
    play.send_signal(signal.SIGINT)
    assert play.communicate(timeout=60) == ("", "") and play.returncode == 0


def test_a_person_records_opens_scrubs_labels_and_exports(browser: Browser, tmp_path: Path) -> None:
    bench, out = Bench(tmp_path / "small", tmp_path / "readings"), tmp_path / "readings"
    camera, estimated = SkinCamera(), bench.estimated
    sensor = sensor_on(camera)
    sensor.estimator = ScaledForce()

    def keep(reading: Reading) -> None:
        assert reading.force is not None
        estimated.add_estimate(reading.force)
        bench.recorder.add(reading)

    panel = partial(RecordingsPanel, context=RecordingsPanelContext(bench.folder, bench.recorder))
    with (
        SensorPoller(sensor, keep) as loop,
        served_page([DisplayedSensor(loop, [estimated])], out, [panel], bench.quota) as served,
        served.viewer() as (client, _),
    ):

        def until(*texts: str) -> None:
            wait_until(lambda: served.refresh() and all(map(client.shows, texts)), PATIENCE_S)

        def until_noticed(text: str) -> None:
            wait_until(lambda: served.refresh() and any(text in notice for notice in client.notices), PATIENCE_S)

        def use(label: str) -> None:
            wait_until(
                lambda: served.refresh() and any(getattr(one, "label", "") == label for one in client.controls.values())
            )
            client.use(label)

        until("live, ", ">0.00<")
        camera.level = 75
        until(">1.00<")
        use("Record")
        until("recording recording_", "0 images dropped")
        client.use("label", "shallow")
        use("Begin label")
        camera.level = 88
        until(">0.48<")
        use("End label 'shallow'")
        until("1 labels")
        use("Stop recording")
        until_noticed("Recorded: recording_")
        (path,) = out.glob("*.mcap")
        with Recording(path) as recording:
            stamps_s = (lambda at: (at - at[0]) / 1e9)(recording.stamps_ns(Topic.IMAGES))
        wait_until(lambda: served.refresh() and path.name in client.control("recording").options)
        client.use("recording", path.name)
        until("recorded, 0.00 of ", "paused", ">1.00<", "shallow: ", "2.00")
        camera.level = 50  # the sensor goes on, and this viewer is shown none of it
        client.use("time (s)", float(stamps_s[-1]))
        until(">0.48<", "0.96")
        wait_until(lambda: served.refresh() and any(client.shows(f'nowrap">{sign}0.0') for sign in "+\N{MINUS SIGN}"))
        client.use("time (s)", 0.0)
        until("recorded, 0.00 of ", ">1.00<", "out of range", "2.00")
        for command, number in (("forward", 1), ("forward", 2), ("forward", 3), ("back", 2)):
            client.give_command(f"Frame {command}")
            until(f"recorded, {stamps_s[number]:.2f} of {stamps_s[-1]:.2f} s")
        client.use("Save this reading")
        until_noticed("Saved: 5 files in")
        (saved,) = (json.loads(found.read_text()) for found in out.glob("reading_*_moment.json"))
        assert saved["warnings"] == ["out of range"] and saved["wrenches"][0]["name"] == "estimated"
        assert saved["wrenches"][0]["force_n"][2] == pytest.approx(-2.0, abs=0.05)
        assert saved["wrenches"][0]["std"] == pytest.approx([0.1] * 6)

        def exported(button: str, pattern: str, count: int) -> Path:
            use(button)
            wait_until(lambda: served.refresh() and len([one for one in client.notices if "Exported" in one]) == count)
            (found,) = out.glob(pattern)
            return found

        moment_page = exported("This moment as a web page", "moment_*.html", 1)
        tables = exported("Images and tables", "recording_*_export_*", 2)
        assert (tables / "spans.csv").is_file() and len(list((tables / "images").iterdir())) == len(stamps_s)
        choice = next(one for one in client.controls.values() if WHOLE in (getattr(one, "options", None) or ()))
        client.set_value(choice.uuid, choice.options[1])
        video = cv2.VideoCapture(str(exported("Video (MP4)", "recording_*.mp4", 3)))
        assert 0 < video.get(cv2.CAP_PROP_FRAME_COUNT) < len(stamps_s), "of the chosen label alone"
        use("Back to the sensor")
        until("live, ", ">2.00<")
    tab = browser.new_page(viewport={"width": 1000, "height": 800})
    errors = page_errors(tab)
    tab.goto(moment_page.as_uri())
    tab.frame_locator("iframe").locator("canvas").first.wait_for(timeout=PATIENCE_S * 1000)
    said = tab.inner_text("body").replace("\n", " ")
    assert "1.00 mm" in said and "out of range" in said and tab.locator("figure img").count() == 2 and errors == []


def test_a_viewer_of_a_recording_is_not_frozen_and_takes_no_reference_of_the_sensor(
    recorded: tuple[Path, Bench], tmp_path: Path
) -> None:
    path, bench = recorded
    panel = partial(RecordingsPanel, context=RecordingsPanelContext(bench.folder))
    with served_small_page(path.parent, [panel]) as served:
        loop = served.controller.sensors[0].poller
        with served.viewer() as (client, viewer):

            def shows(sentence: str, freeze: str) -> bool:
                served.refresh()
                shown = viewer.moment is not None and viewer.moment.sensors[0].status.sentence.startswith(sentence)
                return shown and any(getattr(one, "label", "") == freeze for one in client.controls.values())

            wait_until(lambda: shows("live", "Freeze") and path.name in client.control("recording").options)
            client.use("Freeze")
            wait_until(lambda: shows("frozen", "Resume"))
            client.use("recording", path.name)
            wait_until(lambda: shows("recorded", "Freeze"))
            before = loop.sensor.current_depth_reader
            client.give_command("Take reference")
            wait_until(lambda: bool(client.notices))
            assert client.notices == [
                "No reference taken: expected the sensor in the views, got a recording; go back to the sensor first"
            ]
            assert loop.snapshot(0).phase is SensorPhase.READING
            client.use("Back to the sensor")
            wait_until(lambda: shows("live", "Freeze"))
            assert loop.sensor.current_depth_reader is before
            client.give_command("Take reference")
            wait_until(lambda: loop.sensor.current_depth_reader is not before)
            assert len(client.notices) == 1
