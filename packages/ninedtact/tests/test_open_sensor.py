"""`ninedtact.open`: the program of the README on a sensor's twin, references of recordings, and what it refuses."""

import doctest
import json
import re
from dataclasses import replace
from pathlib import Path
from shutil import copytree, rmtree
from typing import Any

import cv2
import numpy as np
import pytest
from small_sensor import UNTOUCHED, sensor_folder, skin
from threadpoolctl import threadpool_info, threadpool_limits

import ninedtact
from ninedtact import EstimateWarning, Frame, SensorFolder
from ninedtact.calibration.drift.reference_check import describe_new_contact, load_reference_image_checker
from ninedtact.calibration.sensor_folder import load_sensor
from ninedtact.capture.frame_source import FrameSource, SourceEnded
from ninedtact.cli import main
from ninedtact.cli.estimate import EstimateCommand
from ninedtact.errors import InputError
from ninedtact.force.contact_detection import detect_contact
from ninedtact.force.estimator_and_scale import ForceEstimator, unknown_wrench_estimate
from ninedtact.force.traction.estimator import _on_one_blas_thread
from ninedtact.live_sensor import assemble_live_sensor
from ninedtact.mechanics.indenter import Ball
from ninedtact.quantities import HeightSource, Rectified, WrenchEstimate
from ninedtact.reading import Reading
from ninedtact.recording.attached_sensor import sensor_folder_attachments
from ninedtact.recording.metadata import RecordingMetadata
from ninedtact.recording.reader import Recording
from ninedtact.recording.recorded_source import RecordedFrameSource
from ninedtact.recording.topics_and_messages import Topic
from ninedtact.recording.writer import RecordingWriter
from ninedtact.simulation.trajectory import ScriptedPress

README = Path(__file__).parents[3] / "README.md"
FRAME_NS = 40_000_000
PRESSED = range(30, 50)
RECORDED_FRAMES = 80
IMPRINT = 0.008 * np.exp(-((np.arange(640) - 320) ** 2 + (np.arange(480)[:, None] - 240) ** 2) / 2 / 60**2)[..., None]
"""Relative darkening that stays after the press: light is darker there than in the first images for good."""
RELEASED_S = PRESSED.stop * FRAME_NS / 1e9


@pytest.fixture(scope="module")
def recording(physical_sensor: SensorFolder, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of the sensor's twin that carries its sensor: nothing touches, a press in the middle, its imprint after that."""
    path, twin = tmp_path_factory.mktemp("recording") / "press.mcap", physical_sensor.twin()
    contact = ScriptedPress(0.8).simulate(twin, Ball(5.0))
    metadata = RecordingMetadata(physical_sensor.id)
    with RecordingWriter(path, metadata, attachments=sensor_folder_attachments(physical_sensor.path)) as writer:
        for number in range(RECORDED_FRAMES):
            image = twin.renderer(contact if number in PRESSED else None, number)
            if number >= PRESSED.stop:
                image = (image * (1 - IMPRINT)).round().astype(np.uint8)
            writer.write_image(Frame(image, 1_000_000 + number * FRAME_NS, number))
    return path


def test_the_twin_opens_with_force_and_starts_without_contact(physical_sensor: SensorFolder) -> None:
    with ninedtact.open(physical_sensor.path, source="sim", force="physics") as sensor:
        first = sensor.read()
        assert first.wrench is not None and not first.wrench.force_n.any()
        deepest = max((sensor.read() for _ in range(40)), key=lambda reading: reading.max_indentation_mm)
    assert deepest.wrench is not None and deepest.wrench_std is not None
    assert deepest.max_indentation_mm > 0.2 and deepest.wrench.force_n[2] < -0.1
    assert np.isfinite(deepest.wrench_std).all() and deepest.contact_area_mm2 > 0


def test_the_program_of_the_readme_runs_as_printed(
    physical_sensor: SensorFolder, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    program = re.search(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)
    assert program is not None
    code = program[1].replace('source="0"', 'source="sim"')
    assert code != program[1] and len(code.strip().splitlines()) <= 5
    # The loop never ends on a camera; here it ends after three readings.
    code = code.replace("for reading in sensor:", "for _, reading in zip(range(3), sensor):")
    monkeypatch.chdir(physical_sensor.path.parent)
    exec(compile(code, "README.md", "exec"), {})
    assert len(capsys.readouterr().out.splitlines()) == 3


def test_every_example_of_the_public_names_runs_as_printed(
    physical_sensor: SensorFolder, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    copytree(physical_sensor.path, tmp_path / "my_sensor")
    monkeypatch.chdir(tmp_path)
    given = {"ninedtact": ninedtact, "np": np, "Path": Path}
    finder, runner = doctest.DocTestFinder(recurse=False), doctest.DocTestRunner()
    elsewhere = {"load_dataset", "save_sensor", "NinedtactError"}  # with their data sets, images and errors
    names = [name for name in ninedtact.__all__ if name not in elsewhere and not name.startswith("__")]
    found = [
        test
        for name in names
        for test in finder.find(getattr(ninedtact, name), name, globs=dict(given))
        if test.examples
    ]
    assert len(found) >= 10
    for test in found:
        assert runner.run(test).failed == 0, test.name


def test_a_source_without_a_sensor_is_refused_unless_it_is_a_recording() -> None:
    with pytest.raises(InputError, match="expected --sensor with --source 0"):
        ninedtact.open(source=0)


@pytest.mark.parametrize("wrong", [None, 3.5, [1], np.zeros((4, 5, 3), np.uint8)])
def test_what_is_no_source_and_no_path_is_refused_in_one_sentence(wrong: object, physical_sensor: SensorFolder) -> None:
    with pytest.raises(InputError, match=r"expected source of open to be Path \| str \| int \| FrameSource, got"):
        ninedtact.open(physical_sensor, source=wrong)  # type: ignore[arg-type]


def test_a_recording_opens_with_the_sensor_that_it_carries_and_serves_every_frame(recording: Path) -> None:
    with ninedtact.open(source=str(recording), force="none") as sensor:
        assert sensor.reference_faults == ()
        first, *others = sensor
    assert first.warnings == () and first.frame.index == sensor.reference_frames
    assert [reading.frame.index for reading in others] == list(range(sensor.reference_frames + 1, RECORDED_FRAMES))
    assert max(reading.max_indentation_mm for reading in others) > 0.5


def test_only_the_reference_of_live_sources_follows_unless_told_otherwise(
    physical_sensor: SensorFolder, recording: Path, tmp_path: Path
) -> None:
    cv2.imwrite(str(tmp_path / "0.png"), physical_sensor.stored_image("ball_reference").image)
    (tmp_path / "video.avi").touch()

    def follows(source: str, follow_reference: bool | None = None) -> bool:
        opened = ninedtact.open(physical_sensor, source, force="none", follow_reference=follow_reference)
        return opened.references.following is not None

    assert all(map(follows, ("0", "http://127.0.0.1/stream.mjpg", "sim")))
    assert not any(map(follows, (str(recording), str(tmp_path), str(tmp_path / "video.avi"))))
    assert follows(str(recording), True) and not follows("sim", False)


def test_a_reference_check_needs_no_folder_once_it_is_loaded(physical_sensor: SensorFolder, tmp_path: Path) -> None:
    folder = load_sensor(copytree(physical_sensor.path, tmp_path / "copy"))
    check, frame = load_reference_image_checker(folder), physical_sensor.stored_image("ball_reference")
    rmtree(folder.path)
    assert check.find_faults([frame]) == ()
    check.require_faultless([frame])


@pytest.mark.parametrize(("grey", "fault"), [(255, "overexposed"), (0, "dark")])
def test_a_reference_of_one_grey_level_is_a_fault_and_no_crash(
    grey: int, fault: str, physical_sensor: SensorFolder, tmp_path: Path
) -> None:
    check, frame = load_reference_image_checker(physical_sensor), physical_sensor.stored_image("ball_reference")
    (found,) = check.find_faults([replace(frame, image=np.full_like(frame.image, grey))])
    assert found.startswith(f"{fault}: ")
    cv2.imwrite(str(tmp_path / "reference.png"), np.full_like(frame.image, grey))
    with pytest.raises(InputError, match=f"expected the reference images to show sensor my_sensor .*; {fault}: "):
        ninedtact.open(physical_sensor, source="sim", force="none", reference=tmp_path / "reference.png")


def test_a_white_reference_that_the_sensor_takes_itself_is_reported(
    physical_sensor: SensorFolder, tmp_path: Path
) -> None:
    white = np.full((480, 640, 3), 255, np.uint8)
    for number in range(12):
        cv2.imwrite(str(tmp_path / f"{number}.png"), white)
    with ninedtact.open(physical_sensor, source=str(tmp_path), force="none") as sensor:
        (fault,) = sensor.reference_faults
        assert fault.startswith("overexposed: ")
        assert EstimateWarning.REFERENCE_UNLIKE_CALIBRATION in sensor.read().warnings


def contacts_in(recording: Path, **options: Any) -> list[int]:
    """Indices of the images in which contact is detected."""
    with ninedtact.open(source=str(recording), force="none", **options) as sensor:
        return [reading.frame.index for reading in sensor if detect_contact(reading)]


def test_the_rest_of_a_recording_is_measured_from_the_reference_taken_anew(recording: Path) -> None:
    assert contacts_in(recording) == list(range(PRESSED.start, RECORDED_FRAMES))  # the imprint is read as a contact
    assert contacts_in(recording, reference_at_s=RELEASED_S) == list(PRESSED)
    with ninedtact.open(source=str(recording), force="none", reference_at_s=[RELEASED_S]) as sensor:
        once = [reading.max_indentation_mm for reading in sensor]
        sensor.close()
        sensor.open()  # as if new
        assert [reading.max_indentation_mm for reading in sensor] == once
    with ninedtact.open(source=str(recording), force="none") as sensor:
        before = [reading.max_indentation_mm for reading in sensor]
    first_new = PRESSED.stop - sensor.reference_frames
    assert once[:first_new] == before[:first_new]
    assert np.mean(once[first_new:]) < 0.6 * np.mean(before[first_new:])


def test_estimate_takes_the_reference_anew_and_names_a_moment_that_is_not_there(
    recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["estimate", str(recording), "--reference-at"]
    assert main([*words, f"{RELEASED_S}", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["wrenches"]
    assert [int(row["image"]) for row in rows if row["touching"]] == list(PRESSED)
    assert main([*words, "99"]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("ninedtact: expected a moment between 0 and 2.80 s")


@pytest.mark.parametrize(
    ("moment_s", "said"),
    [
        (99.0, "expected a moment between 0 and 2.80 s .*, got 99 s"),
        (2.9, "got 2.9 s"),
        (-1.0, "got -1 s"),
        (float("nan"), "expected reference_at_s of open to be a number, got nan;"),
        (PRESSED.start * FRAME_NS / 1e9, "without contact, got a fault; something touches the gel: .* nothing touches"),
        ((PRESSED.start - 5) * FRAME_NS / 1e9, "something touches the gel"),
    ],
)
def test_a_moment_outside_of_the_recording_or_under_contact_is_refused(
    moment_s: float, said: str, recording: Path
) -> None:
    with pytest.raises(InputError, match=said):
        ninedtact.open(source=str(recording), force="none", reference_at_s=moment_s)


def test_only_a_recording_has_moments(physical_sensor: SensorFolder) -> None:
    with pytest.raises(
        InputError, match=r"expected a recording \(\.mcap\) .*, got twin my_sensor; .* take_reference\(\)"
    ):
        ninedtact.open(physical_sensor, source="sim", force="none", reference_at_s=1.0)


def test_a_light_contact_is_found_against_the_session_and_a_release_is_none(physical_sensor: SensorFolder) -> None:
    shape, twin = physical_sensor.shape, physical_sensor.twin()

    def mean_image(depth_mm: float, at_mm: tuple[float, float]) -> Rectified:
        contact = ScriptedPress(depth_mm, at_mm=at_mm).simulate(twin, Ball(5.0)) if depth_mm else None
        return shape.depth_reader(*(Frame(twin.renderer(contact, number)) for number in range(10))).reference

    seen = shape.rectify.height_source != HeightSource.OUT_OF_VIEW
    untouched, light, deep = mean_image(0, (0, 0)), mean_image(0.2, (4.0, 0.0)), mean_image(0.8, (-4.0, 0.0))
    found = describe_new_contact(untouched, light, seen)
    assert found is not None and "dimmer" in found
    assert describe_new_contact(deep, untouched, seen) is None
    assert describe_new_contact(deep, light, seen) is not None


def reference_recording(
    folder: Path, path: Path, rectified: bool, lamps: tuple[float, float] = (1.0, 0.8)
) -> SensorFolder:
    """Write two references, each with three pressed images after it, and no image without contact (as `collect` does)."""
    sensor = load_sensor(sensor_folder(folder))
    topics = [Topic.IMAGES, Topic.REFERENCE_GREY if rectified else Topic.REFERENCE]
    attached = sensor_folder_attachments(sensor.path)
    with RecordingWriter(path, RecordingMetadata(sensor.id), topics, attached) as writer:
        number = 0
        for tare, lamp in enumerate(lamps):
            at_ns = FRAME_NS * (number + 1) + FRAME_NS // 2
            frames = [Frame(dimmed(UNTOUCHED, lamp), at_ns, number) for _ in range(10)]
            if rectified:
                writer.write_reference_grey(sensor.shape.depth_reader(*frames).reference, at_ns)
            else:
                for frame in frames:
                    writer.write_reference(frame, tare)
            for _ in range(3):
                number += 1
                writer.write_image(Frame(dimmed(60, lamp), FRAME_NS * (number + 1), number))
    return sensor


def dimmed(level: int, lamp: float) -> np.ndarray:
    return (skin(level) * lamp).round().astype(np.uint8)


@pytest.mark.parametrize("rectified", [False, True], ids=["of collect", "of the page"])
def test_a_recording_is_measured_against_the_references_that_it_holds(tmp_path: Path, rectified: bool) -> None:
    path = tmp_path / "pairs.mcap"
    folder = reference_recording(tmp_path / "small", path, rectified)
    reader = folder.shape.depth_reader(Frame(skin(UNTOUCHED)))
    deep_mm = -float(reader(folder.shape.rectify(Frame(skin(60)))).z_mm.min())
    assert deep_mm > 1
    for source in (path, str(path), RecordedFrameSource(path)):
        with ninedtact.open(source=source, force="none") as sensor:
            readings = list(sensor)
        assert [one.max_indentation_mm for one in readings] == pytest.approx([deep_mm] * 6, abs=0.03)
        assert [one.dropped for one in readings] == [0] * 6, "a recording may begin with any index"
    with Recording(path) as recording:
        assert [one.max_indentation_mm for one in recording.readings()] == pytest.approx([deep_mm] * 6, abs=0.03)


def test_only_readings_against_a_faulty_reference_of_a_recording_are_warned_of(tmp_path: Path) -> None:
    path = tmp_path / "pairs.mcap"
    reference_recording(tmp_path / "small", path, rectified=False, lamps=(1.0, 2.55))  # the second one is overexposed
    with ninedtact.open(source=path, force="none") as sensor, Recording(path) as recording:
        for readings in (sensor, recording.readings()):
            warned = [EstimateWarning.REFERENCE_UNLIKE_CALIBRATION in reading.warnings for reading in readings]
            assert warned == [False] * 3 + [True] * 3


def test_every_reference_of_a_recording_ends_what_the_estimator_remembers(tmp_path: Path) -> None:
    class CountingEstimator(ForceEstimator):
        name, estimated, forgotten_at = "counting", 0, list[int]()

        def estimate(self, reading: Reading) -> WrenchEstimate:
            self.estimated += 1
            return unknown_wrench_estimate(reading.stamp_ns)

        def forget(self) -> None:
            self.forgotten_at.append(self.estimated)

    path = tmp_path / "pairs.mcap"
    reference_recording(tmp_path / "small", path, rectified=False)
    with ninedtact.open(source=path, force="none") as sensor:
        sensor.estimator = estimator = CountingEstimator()
        assert len(list(sensor)) == 6
    assert estimator.forgotten_at == [0, 3]


def test_the_twin_of_the_sensor_is_estimated_and_not_that_of_the_published_design(
    physical_sensor: SensorFolder,
) -> None:
    def first_image(source: FrameSource) -> np.ndarray:
        with source:
            return np.asarray(source.read().image)

    shown = first_image(EstimateCommand(("sim",)).open_on_source(physical_sensor).source)
    assert (shown == first_image(ninedtact.source_for("sim", sensor=physical_sensor))).all()
    assert (shown != first_image(ninedtact.source_for("sim"))).any()


def test_a_reference_that_a_program_takes_stays_in_spite_of_those_of_the_recording(tmp_path: Path) -> None:
    path = tmp_path / "pairs.mcap"
    reference_recording(tmp_path / "small", path, rectified=False)
    with ninedtact.open(source=path, force="none") as sensor:
        sensor.use_reference([sensor.read().frame])
        found = [reading.max_indentation_mm for _, reading in zip(range(2), sensor, strict=False)]
        assert found == pytest.approx([0.0, 0.0], abs=0.03)
        chosen = sensor.current_depth_reader
        for _ in sensor:  # the second reference of the recording comes with its fourth image
            assert sensor.current_depth_reader is chosen


def test_a_rectified_reference_of_another_calibration_is_a_warning_on_every_reading(tmp_path: Path) -> None:
    path = tmp_path / "page.mcap"
    own = reference_recording(tmp_path / "small", path, rectified=True)
    other = tmp_path / "other"
    copytree(own.path, other)
    text = (other / "sensor.toml").read_text()
    (other / "sensor.toml").write_text(text.replace("noise_mm = 0.001", "noise_mm = 0.002"))
    for sensor, expected in ((own.path, 0), (other, 6)):
        shown = assemble_live_sensor(load_sensor(sensor), str(path)).sensor
        assert len(shown.reference_faults) == (expected > 0)
        with ninedtact.open(sensor, source=path, force="none") as opened:
            warned = [EstimateWarning.REFERENCE_UNLIKE_CALIBRATION in reading.warnings for reading in opened]
        assert (len(warned), sum(warned)) == (6, expected)


def test_an_opening_does_not_know_the_contact_of_the_one_before(physical_sensor: SensorFolder, tmp_path: Path) -> None:
    twin = physical_sensor.twin()
    contact = ScriptedPress(0.8).simulate(twin, Ball(4.0))
    (tmp_path / "images").mkdir()
    for number in range(2):
        cv2.imwrite(str(tmp_path / "images" / f"{number}.png"), twin.renderer(contact, number))
    cv2.imwrite(str(tmp_path / "reference.png"), twin.renderer(None, 9))
    sensor = ninedtact.open(physical_sensor.path, str(tmp_path / "images"), reference=tmp_path / "reference.png")
    found = []
    for _ in range(2):
        with sensor:
            found.append([reading.wrench.six for reading in sensor if reading.wrench is not None])
    np.testing.assert_array_equal(found[0], found[1])


def test_estimates_that_overlap_leave_the_number_of_blas_threads_as_it_was() -> None:
    def blas_threads() -> set[int]:
        return {one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"}

    with _on_one_blas_thread():
        pass  # all libraries are loaded
    with threadpool_limits(2, user_api="blas"):
        assert blas_threads() == {2}
        first, second = _on_one_blas_thread(), _on_one_blas_thread()
        first.__enter__()
        second.__enter__()
        assert blas_threads() == {1}
        first.__exit__(None, None, None)
        assert blas_threads() == {1}
        second.__exit__(None, None, None)
        assert blas_threads() == {2}


def test_a_source_that_ends_within_the_reference_is_refused_with_what_to_do(tmp_path: Path) -> None:
    (tmp_path / "images").mkdir()
    for number in range(3):
        cv2.imwrite(str(tmp_path / "images" / f"{number}.png"), skin(UNTOUCHED))
    expected = (
        r"expected 10 images without contact for the reference, got the end of .* after 3; give a reference image"
    )
    with pytest.raises(SourceEnded, match=expected):
        ninedtact.open(sensor_folder(tmp_path / "small"), tmp_path / "images", force="none").__enter__()
