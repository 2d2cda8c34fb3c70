"""Videos of other programs, written by FFmpeg (PyAV): their times, their codecs, and the JPEG images of its encoder."""

import sys
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from ninedtact.capture.video_file import VideoFile
from ninedtact.errors import FileFormatError

av = pytest.importorskip("av")

PATTERN = np.random.default_rng(0).integers(0, 60, (48, 64, 3))


class Pipe:
    """A stream that cannot seek, as a browser's recorder writes to it: its header states neither rate nor duration."""

    def __init__(self, path: Path) -> None:
        self.file = path.open("wb")

    def write(self, content: bytes) -> int:
        return self.file.write(content)

    def close(self) -> None:
        self.file.close()


def write_video(path: Path, codec: str, times_ms: np.ndarray, container: str, live: bool = False) -> None:
    pipe = Pipe(path) if live else None
    with av.open(pipe or str(path), "w", format=container, options={"live": "1"} if live else {}) as file:
        stream = file.add_stream(codec, rate=30)
        stream.width, stream.height = 64, 48
        stream.pix_fmt = "yuvj420p" if codec == "mjpeg" else "yuv420p"
        stream.codec_context.time_base = Fraction(1, 1000)
        for number, time_ms in enumerate(times_ms.tolist()):
            frame = av.VideoFrame.from_ndarray((PATTERN + 3 * number).astype(np.uint8), format="bgr24")
            frame.pts, frame.time_base = time_ms, Fraction(1, 1000)
            file.mux(stream.encode(frame))
        file.mux(stream.encode(None))
    if pipe is not None:
        pipe.close()


@pytest.mark.parametrize(
    ("codec", "container", "live"),
    [("libvpx", "webm", True), ("libvpx", "webm", False), ("libx264", "matroska", True), ("libx264", "mp4", False)],
)
@pytest.mark.parametrize("step_ms", [17, 50, 200])
def test_a_video_has_the_rate_and_the_times_of_its_images(
    tmp_path: Path, codec: str, container: str, live: bool, step_ms: int
) -> None:
    """Whatever its header says: that of a live stream says 1000 images per second."""
    jitter = np.random.default_rng(step_ms).integers(-step_ms // 5, step_ms // 5, 20)
    times_ms = step_ms * np.arange(1, 21) + jitter
    write_video(tmp_path / "video", codec, times_ms, container, live)
    with VideoFile(tmp_path / "video") as video:
        assert video.recorded_hz == pytest.approx(1000 / step_ms, rel=0.2)
        stamps_ns = [frame.stamp_ns for frame in video]
    assert np.diff(stamps_ns) / 1e6 == pytest.approx(np.diff(times_ms), abs=0.1)


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have no such names")
def test_a_video_may_have_any_name_of_the_file_system(tmp_path: Path) -> None:
    """OpenCV ends the process at one that is not UTF-8."""
    write_video(tmp_path / "video", "mjpeg", 33 * np.arange(4), "avi")
    path = (tmp_path / "video").rename(tmp_path / "dr\udcfcck.avi")
    with VideoFile(path) as video:
        assert len(list(video)) == 4


def test_a_codec_without_a_decoder_is_named(tmp_path: Path) -> None:
    write_video(tmp_path / "av1.mp4", "libsvtav1", 33 * np.arange(12), "mp4")
    try:
        with VideoFile(tmp_path / "av1.mp4") as video:
            assert len(list(video)) == 12  # an OpenCV that has the decoder
    except FileFormatError as refusal:
        assert "the codec AV1, for which it has no decoder" in str(refusal) and "ffmpeg -i" in str(refusal)


@pytest.mark.parametrize("container", ["mjpeg", "avi", "matroska"])
@pytest.mark.parametrize("quality", [2, 6, 12, 31])
def test_intact_images_of_the_jpeg_encoder_of_ffmpeg_are_whole(tmp_path: Path, container: str, quality: int) -> None:
    path = tmp_path / "video.mjpeg"
    with av.open(str(path), "w", format=container) as file:
        stream = file.add_stream("mjpeg", rate=30)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuvj420p"
        stream.codec_context.qmin = stream.codec_context.qmax = quality
        for number in range(20):
            file.mux(stream.encode(av.VideoFrame.from_ndarray((PATTERN + 3 * number).astype(np.uint8), format="bgr24")))
        file.mux(stream.encode(None))
    with VideoFile(path) as video:
        assert len(list(video)) == 20 and video.damaged == 0
