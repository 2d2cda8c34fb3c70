"""What every member of the FrameSource family honours, live or recorded, bare or wrapped."""

import json
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from threading import Thread

import cv2
import numpy as np
import pytest
from bench_camera import BenchCamera, BenchPi
from hand_fed import HandFed, Hanging
from mjpeg_camera import MjpegCamera
from small_press_simulation import TWIN, small_press_simulation
from twin_folder import twin_folder

from ninedtact.capture.frame_pacing import DelayCorrectedSource, LatestFrameSource, LivePlayback
from ninedtact.capture.frame_source import (
    CameraLost,
    ExposureWithLimits,
    FrameSource,
    ImageFolder,
    SourceEnded,
    SourceIncomplete,
    SourceNotOpen,
)
from ninedtact.capture.network_stream import NetworkStream
from ninedtact.capture.raspberry_pi_camera import RaspberryPiCamera
from ninedtact.capture.reconnecting import ReconnectingFrameSource, RepeatingSource
from ninedtact.capture.source_from_address import camera_or_file_source
from ninedtact.capture.uvc_camera import UvcCamera
from ninedtact.capture.video_file import VideoFile
from ninedtact.errors import CameraError, FileFormatError, InputError
from ninedtact.quantities import Frame
from ninedtact.recording.metadata import RecordingMetadata
from ninedtact.recording.reader import Recording
from ninedtact.recording.recorded_source import RecordedFrameSource
from ninedtact.recording.recorder import Recorder
from ninedtact.recording.topics_and_messages import Topic
from ninedtact.recording.writer import RecordingWriter
from ninedtact.simulation.simulated_sources import SimulatedCamera

IMAGES = 8


class Bench:
    """Makes a member of the family by name; whatever it needs lasts until the test ends."""

    def __init__(self, folder: Path, resources: ExitStack) -> None:
        self.folder, self.resources = folder, resources

    def folder_source(self) -> FrameSource:
        for number in range(IMAGES):
            cv2.imwrite(str(self.folder / f"press_{number}.png"), np.full((48, 64, 3), 20 * number, np.uint8))
        return ImageFolder(self.folder, recorded_hz=50.0)

    def video_source(self) -> FrameSource:
        path = self.folder / "prüfung.avi"
        writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"FFV1"), 50.0, (64, 48))
        for number in range(IMAGES):
            writer.write(np.full((48, 64, 3), 20 * number, np.uint8))
        writer.release()
        return VideoFile(path)

    def replay_source(self) -> FrameSource:
        path = self.folder / "press.mcap"
        with RecordingWriter(path, RecordingMetadata("bench")) as episode:
            for number in range(IMAGES):
                image = np.full((48, 64, 3), 20 * number, np.uint8)
                stamp_ns = time.monotonic_ns() - (IMAGES - number) * 20_000_000
                episode.write_image(Frame(image, stamp_ns, number))
        return RecordedFrameSource(path)

    def stream_source(self) -> FrameSource:
        return NetworkStream(self.resources.enter_context(MjpegCamera()).url)

    def camera_source(self) -> FrameSource:
        return UvcCamera(0, opener=BenchCamera().open_capture)

    def raspberry_pi_source(self) -> FrameSource:
        return RaspberryPiCamera(opener=BenchPi)

    def twin_source(self) -> FrameSource:
        TWIN.renderer(TWIN.model.initial_contact())  # what is made once is made before the clock runs
        return SimulatedCamera(small_press_simulation(hz=6.0, real_time=True))


RECORDED = {"folder": Bench.folder_source, "video": Bench.video_source, "replay": Bench.replay_source}
RECORDED["replay as if now"] = lambda bench: LivePlayback(bench.replay_source())
LIVE = {"stream": Bench.stream_source, "camera": Bench.camera_source, "raspberry pi": Bench.raspberry_pi_source}
LIVE["twin"] = Bench.twin_source
BARE = RECORDED | LIVE
WRAPPED = ("folder", "replay", "stream", "camera")


def reconnecting(source: FrameSource) -> FrameSource:
    return ReconnectingFrameSource(source, on_lost=lambda loss: pytest.fail(str(loss)))


def patient(source: FrameSource) -> FrameSource:
    return LatestFrameSource(LivePlayback(source), max_age_ms=20_000.0, timeout_ms=20_000.0)


FAMILY: dict[str, Callable[[Bench], FrameSource]] = {
    **BARE,
    **{f"freshest of {name}": lambda bench, make=BARE[name]: patient(make(bench)) for name in WRAPPED},
    **{f"reconnecting {name}": lambda bench, make=BARE[name]: reconnecting(make(bench)) for name in WRAPPED},
    "delayed camera": lambda bench: DelayCorrectedSource(bench.camera_source(), 20.0),
    "repeating folder": lambda bench: RepeatingSource(bench.folder_source()),
    "freshest of reconnecting stream": lambda bench: patient(reconnecting(bench.stream_source())),
}


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    with ExitStack() as resources:
        yield Bench(tmp_path, resources)


@pytest.mark.parametrize("member", FAMILY)
def test_every_source_keeps_the_contract(bench: Bench, member: str) -> None:
    source = FAMILY[member](bench)
    assert source.is_live != any(name in member for name in RECORDED)  # known before it is open
    assert source.is_simulated == ("twin" in member)
    with pytest.raises(SourceNotOpen, match="with source"):
        source.read()
    for _ in range(2):  # a source that was closed opens again as if new
        with source:
            frames = [source.read() for _ in range(4)]
            as_read = [frame.image.copy() for frame in frames]
            source.open()  # opening an open source does nothing
            frames.append(source.read())
        images, indices = [frame.image for frame in frames], [frame.index for frame in frames]
        assert all(image.dtype == np.uint8 and image.shape == images[0].shape for image in images)
        assert images[0].ndim == 3 and images[0].shape[2] == 3
        assert all(np.array_equal(image, copy) for image, copy in zip(images, as_read, strict=False))
        assert not any(np.shares_memory(images[i], images[j]) for i in range(5) for j in range(i))
        stamps = [frame.stamp_ns for frame in frames]
        assert stamps == sorted(stamps) and stamps[0] > 0 and stamps[-1] <= time.monotonic_ns()
        assert indices == list(range(5)) if "freshest" not in member else indices == sorted(set(indices))
        with pytest.raises(SourceNotOpen):
            source.read()
    source.close()
    source.close()
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("fetch")]


class RemarkableCamera(HandFed):
    """A source each of whose facts differs from what a source has by default."""

    is_live, is_simulated, recorded_hz, recording = False, True, 12.5, "press.mcap#left"
    reference_frames = (Frame(np.zeros((4, 5, 3), np.uint8)),)
    exposure = ExposureWithLimits(5.0, 1.0, 50.0)

    def set_exposure(self, exposure_ms: float) -> None:
        self.exposure = ExposureWithLimits(exposure_ms, 1.0, 50.0)


WRAPPERS: dict[str, Callable[[FrameSource], FrameSource]] = {
    "newest": LatestFrameSource,
    "paced": LivePlayback,
    "repeated": RepeatingSource,
    "reconnecting": reconnecting,
    "delayed": lambda source: DelayCorrectedSource(source, 20.0),
}


@pytest.mark.parametrize("wrapper", WRAPPERS)
def test_a_wrapper_has_every_fact_of_its_source(wrapper: str) -> None:
    source = RemarkableCamera()
    wrapped = WRAPPERS[wrapper](WRAPPERS[wrapper](source))
    facts = {name for name, value in vars(FrameSource).items() if not name.startswith("_") and not callable(value)}
    assert facts > {"recorded_hz", "recording", "exposure"}
    for fact in ("name", *facts):
        assert getattr(wrapped, fact) == getattr(source, fact) != getattr(FrameSource, fact, None), fact
    wrapped.set_exposure(7.0)
    assert wrapped.exposure is source.exposure and source.exposure.now_ms == 7.0


@pytest.mark.parametrize("recording", RECORDED)
def test_a_recording_gives_every_image_and_then_ends(bench: Bench, recording: str) -> None:
    with RECORDED[recording](bench) as source:
        assert [int(frame.image[0, 0, 0]) for frame in source] == [20 * number for number in range(IMAGES)]
        with pytest.raises(SourceEnded, match=f"after {IMAGES}"):
            source.read()


def test_a_recording_that_is_repeated_counts_on_and_starts_anew_when_it_is_opened_anew(bench: Bench) -> None:
    with RepeatingSource(bench.folder_source()) as source:
        assert source.recorded_hz == 50.0
        for number in range(2 * IMAGES + 3):
            frame = source.read()
            source.open()
            assert frame.index == number and int(frame.image[0, 0, 0]) == 20 * (number % IMAGES)
    with source:
        assert source.read().index == 0


def test_a_recording_that_is_closed_while_it_ends_is_not_started_again() -> None:
    class EndsWhileClosed(HandFed):
        opened = 0

        def open(self) -> None:
            self.opened += 1

        def read(self) -> Frame:
            repeating.close()
            raise SourceEnded("expected another image, got the end; stop")

    recording = EndsWhileClosed()
    repeating = RepeatingSource(recording)
    with repeating, pytest.raises(SourceNotOpen):
        repeating.read()
    assert recording.opened == 1


def test_the_delay_of_a_camera_is_subtracted_from_the_stamps_of_its_images() -> None:
    fed = HandFed()
    with DelayCorrectedSource(fed, 42.0) as source:
        fed.show(stamp_ns=1_000_000_000)
        assert source.read().stamp_ns == 958_000_000


@pytest.mark.parametrize(
    "absent",
    [
        UvcCamera(0, opener=BenchCamera(plugged_in=False).open_capture),
        UvcCamera("/dev/video-not-there"),
        NetworkStream("http://127.0.0.1:9/stream.mjpg", open_timeout_ms=1000.0),
        VideoFile("no/such.mp4"),
        RecordedFrameSource("no/such.mcap"),
        ImageFolder("no/such/folder"),
        RaspberryPiCamera(),
    ],
    ids=lambda source: source.name,
)
def test_what_is_not_there_is_refused_in_one_sentence_and_nothing_stays_open(
    absent: FrameSource, capfd: pytest.CaptureFixture[str]
) -> None:
    for source in (absent, LatestFrameSource(absent), reconnecting(absent)):
        with pytest.raises(CameraError, match=r"expected .* got .*;"), source:
            pass
        with pytest.raises(SourceNotOpen):
            source.read()
    assert capfd.readouterr().err == ""


def test_a_stream_is_lost_when_it_is_unplugged_and_when_it_falls_silent() -> None:
    with MjpegCamera() as camera, NetworkStream(camera.url, read_timeout_ms=300.0) as source:
        source.read()
        camera.unplug()
        with pytest.raises(CameraLost):
            list(source)
    with MjpegCamera() as camera, NetworkStream(camera.url, read_timeout_ms=300.0) as source:
        source.read()
        camera.period_s = 60
        with pytest.raises(CameraLost):
            list(source)


@pytest.mark.parametrize("command", ["record --out={out}.mcap", "live --port=0"])
def test_every_command_says_within_five_seconds_that_a_stream_has_stalled(command: str, tmp_path: Path) -> None:
    """The stream stays open and sends nothing more, after the images of a reference and some more."""
    sensor = twin_folder(tmp_path / "sensor", for_force=True)
    with MjpegCamera(480, 640, period_s=0.02, steady=True) as camera:
        words = command.format(out=tmp_path / "out").split()
        run = [sys.executable, "-m", "ninedtact", *words, f"--source={camera.url}", f"--sensor={sensor}"]
        with subprocess.Popen(run, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as running:
            began = time.monotonic()
            while camera.served < 40 and running.poll() is None and time.monotonic() - began < 120:
                time.sleep(0.02)
            camera.period_s, served, stalled_at = 600.0, camera.served, time.monotonic()
            assert running.stderr is not None and served >= 40
            said = next((line for line in running.stderr if f"from {camera.url}, got none" in line), "")
            seconds = time.monotonic() - stalled_at
            running.terminate()
    assert "; check " in said and seconds < 5
    if words[0] == "record":
        with Recording(tmp_path / "out.mcap") as recording:
            assert len(recording.stamps_ns(Topic.IMAGES)) > 20


def test_an_estimate_of_a_stream_ends_with_its_answer_at_ctrl_c(tmp_path: Path) -> None:
    sensor = twin_folder(tmp_path / "sensor", for_force=True)
    with MjpegCamera(480, 640, period_s=0.02, steady=True) as camera:
        run = [sys.executable, "-m", "ninedtact", "estimate", camera.url, f"--sensor={sensor}", "--json"]
        with subprocess.Popen(run, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as running:
            assert running.stderr is not None
            said = next((line for line in running.stderr if "until Ctrl-C" in line), "")
            served, began = camera.served, time.monotonic()
            while camera.served < served + 60 and running.poll() is None and time.monotonic() - began < 120:
                time.sleep(0.02)
            running.terminate()  # as Ctrl-C, which jobs in the background ignore
            answer, _ = running.communicate(timeout=120)
    assert camera.url in said and running.returncode == 0
    assert [row["touching"] for row in json.loads(answer)["wrenches"]][:1] == [False]


def test_a_driver_that_hangs_is_told_once(tmp_path: Path) -> None:
    told: list[str] = []
    began = time.monotonic()
    with RecordingWriter(tmp_path / "hung.mcap", RecordingMetadata("hung")) as episode:
        recorder = Recorder(episode, Hanging(), notify=told.append, stall_s=0.3)
        with recorder.opened():
            recorder.write(lambda: time.monotonic() - began > 1.0)
    assert told == ["nothing has arrived from a camera that hangs for 0.3 s; check it and its cable"]


@pytest.mark.parametrize("status", [301, 302, 303, 307, 308])
def test_a_camera_that_redirects_to_another_port_is_not_followed(status: int) -> None:
    class Redirection(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(status)
            self.send_header("Location", camera.url)
            self.end_headers()

        def log_message(self, *said: object) -> None: ...

    with MjpegCamera() as camera, HTTPServer(("127.0.0.1", 0), Redirection) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        url = f"http://127.0.0.1:{server.server_port}/stream.mjpg"
        with pytest.raises(CameraError, match="where it redirects to another one, give that"), NetworkStream(url):
            pass
        server.shutdown()


def test_a_page_that_is_no_stream_and_a_file_that_is_no_video_are_refused(tmp_path: Path) -> None:
    with MjpegCamera() as camera, pytest.raises(CameraError), NetworkStream(camera.url.replace("stream", "other")):
        pass
    (tmp_path / "video.mp4").write_bytes(b"not a video" * 100)
    with pytest.raises(FileFormatError, match="expected a video"), VideoFile(tmp_path / "video.mp4"):
        pass


def written_video(path: Path, codec: str, size: tuple[int, int] = (64, 48)) -> bytes:
    """Thirty images of rising brightness, with a pattern that fills the bytes of each."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*codec), 30.0, size)
    pattern = np.random.default_rng(0).integers(0, 90, (size[1], size[0], 3))
    for number in range(30):
        writer.write((pattern + 5 * number).astype(np.uint8))
    writer.release()
    return path.read_bytes()


def zeroed(content: bytes, share: float, count: int) -> bytes:
    start = int(share * len(content))
    return content[:start] + bytes(count) + content[start + count :]


DAMAGES = {
    "cut": ("a.avi", "MJPG", lambda content: content[: len(content) // 2]),
    "zeros over whole images": ("b.avi", "MJPG", lambda content: zeroed(content, 0.5, len(content) // 10)),
    "zeros in one image, which a checksum finds": ("c.mkv", "FFV1", lambda content: zeroed(content, 0.5, 20)),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_video_gives_its_whole_images_and_then_says_how_many_are_missing(
    tmp_path: Path, damage: str, capfd: pytest.CaptureFixture[str]
) -> None:
    name, codec, change = DAMAGES[damage]
    path = tmp_path / name
    content = written_video(path, codec)
    with VideoFile(path) as video:
        whole = {frame.index: frame.image for frame in video}
    assert sorted(whole) == list(range(30))
    path.write_bytes(change(content))
    with VideoFile(path) as video:
        frames = []
        with pytest.raises(
            SourceIncomplete, match=r"expected every image of .*: \d+ are whole, \d+ (is|are) missing or damaged; use"
        ) as said:
            frames.extend(iter(video.read, None))
        with pytest.raises(SourceEnded, match=f"after {len(frames)}"):
            video.read()
    assert {frame.index for frame in frames} <= set(range(len(frames) + video.damaged))
    assert 0 < video.damaged <= 30 - len(frames)
    lost = 30 - len(frames)
    assert 0 < len(frames) < 30 and f"{len(frames)} are whole, {lost} {'is' if lost == 1 else 'are'}" in str(said.value)
    unseen = frames[-1].index + 1 - len(frames)  # by the indices of the frames
    assert said.value.uncounted == lost - unseen
    images = np.array(list(whole.values()), np.int16)
    assert all((np.abs(images - frame.image).max((1, 2, 3)) <= 1).any() for frame in frames)
    assert capfd.readouterr() == ("", "")


def test_images_that_a_decoder_gives_up_are_counted(tmp_path: Path) -> None:
    path = tmp_path / "press.mp4"
    path.write_bytes(zeroed(written_video(path, "mp4v"), 0.5, 200))
    with VideoFile(path) as video, pytest.raises(SourceIncomplete, match="are missing or damaged") as said:
        list(video)
    assert said.value.uncounted > 0 and not video.damaged


def test_the_images_of_a_video_are_stamped_by_their_own_times(tmp_path: Path) -> None:
    """A third of a second between images, whatever the rate at which they are read."""
    writer = cv2.VideoWriter(str(tmp_path / "slow.mp4"), cv2.VideoWriter.fourcc(*"mp4v"), 3.0, (64, 48))
    for _ in range(5):
        writer.write(np.zeros((48, 64, 3), np.uint8))
    writer.release()
    with VideoFile(tmp_path / "slow.mp4") as video:
        stamps_ns = [frame.stamp_ns for frame in video]
    assert np.diff(stamps_ns) / 1e9 == pytest.approx([1 / 3] * 4, abs=1e-3) and stamps_ns[-1] < time.monotonic_ns()


def test_a_video_whose_images_change_their_size_ends_there(tmp_path: Path) -> None:
    large, small = (cv2.imencode(".jpg", np.full((rows, 64, 3), 90, np.uint8))[1].tobytes() for rows in (48, 32))
    (tmp_path / "two.mjpg").write_bytes(7 * large + 5 * small)
    with VideoFile(tmp_path / "two.mjpg") as video:
        assert [video.read().image.shape[:2] for _ in range(7)] == 7 * [(48, 64)]
        with pytest.raises(FileFormatError, match="to be 64 x 48 pixels, got 64 x 32 after 7 images;"):
            video.read()
        with pytest.raises(SourceEnded):
            video.read()


def test_a_folder_is_read_in_counting_order_and_goes_on_after_a_bad_image(tmp_path: Path) -> None:
    for number, rows in ((10, 8), (2, 8), (1, 8), (11, 9)):
        cv2.imwrite(str(tmp_path / f"press_{number}.png"), np.full((rows, 8, 3), number, np.uint8))
    (tmp_path / "press_3.png").write_bytes(b"")
    (tmp_path / ".press_0.png").write_bytes(b"left behind by a copying program")
    (tmp_path / "notes.txt").write_text("none of its business")
    with ImageFolder(tmp_path) as folder:
        assert [int(folder.read().image[0, 0, 0]) for _ in range(2)] == [1, 2]
        (tmp_path / "press_4.png").write_bytes(b"")  # of which an open folder knows nothing
        folder.open()
        with pytest.raises(FileFormatError, match=r"press_3.*empty"):
            folder.read()
        after = folder.read()
        assert int(after.image[0, 0, 0]) == 10 and after.index == 3
        with pytest.raises(FileFormatError, match="8 x 8 pixels, got 8 x 9"):
            folder.read()


def test_text_names_a_source(bench: Bench) -> None:
    video, folder = bench.video_source(), bench.folder_source()
    named = {
        "0": UvcCamera,
        "/dev/video0": UvcCamera,
        "csi": RaspberryPiCamera,
        "csi:1": RaspberryPiCamera,
        "999999999": UvcCamera,
        "usb:1-2": UvcCamera,
        "http://127.0.0.1/a.mjpg": NetworkStream,
        "RTSP://127.0.0.1/a": NetworkStream,
        str(video.path): VideoFile,
        str(folder.folder): ImageFolder,
    }
    assert {text: type(camera_or_file_source(text)) for text in named} == named
    for address, name in (("7", "camera 7"), ("csi", "csi:0"), ("csi:12", "csi:12")):
        assert camera_or_file_source(address).name == name
    for text in (
        "sim",
        "",
        "no/such/file",
        "gopher://x",
        "http://[x",
        "1000000000",
        "csi:",
        "csi:one",
        "-1",
        str(bench.folder / "press_0.png"),
    ):
        with pytest.raises(InputError, match=r"expected .* got .*;"):
            camera_or_file_source(text)


def test_a_password_is_never_shown() -> None:
    source = NetworkStream("rtsp://me:secret@127.0.0.1:9/live?x=1", open_timeout_ms=500.0)
    with pytest.raises(CameraError) as refusal:
        source.open()
    assert source.name == "rtsp://127.0.0.1:9/live?x=1"
    assert "secret" not in str(refusal.value)
    for wrong in ("rtps://me:secret@[x/live", "http://me:secret@[x/live"):
        with pytest.raises(InputError) as unknown:
            camera_or_file_source(wrong)
        assert "secret" not in str(unknown.value)
