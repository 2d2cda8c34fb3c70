"""What libraries print on their own stays off the terminal."""

import os

import cv2
import pytest

from ninedtact.capture.shared_video_capture import capture_output, silence_video_libraries


@pytest.mark.parametrize("descriptor", [1, 2])
def test_one_stream_is_captured_inside_the_block_and_nothing_else(
    descriptor: int, capfd: pytest.CaptureFixture[str]
) -> None:
    for trouble in (StopIteration, ZeroDivisionError):
        os.write(descriptor, b"before\n")
        with pytest.raises(trouble), capture_output(descriptor) as printed:
            os.write(descriptor, b"inside: \xff\n")
            os.write(3 - descriptor, b"beside\n")
            raise trouble
        os.write(descriptor, b"after\n")
        assert printed.text == "inside: \ufffd\n"
    texts = ["before\nafter\n" * 2, "beside\n" * 2]
    assert capfd.readouterr() == tuple(texts if descriptor == 1 else texts[::-1])


def test_opencv_is_silent_unless_the_user_wants_to_hear_it(monkeypatch: pytest.MonkeyPatch) -> None:
    logging = cv2.utils.logging
    before = logging.getLogLevel()
    monkeypatch.setenv("OPENCV_FFMPEG_LOGLEVEL", "16")
    try:
        logging.setLogLevel(logging.LOG_LEVEL_WARNING)
        monkeypatch.setenv("OPENCV_LOG_LEVEL", "WARNING")
        silence_video_libraries()
        assert logging.getLogLevel() == logging.LOG_LEVEL_WARNING and os.environ["OPENCV_FFMPEG_LOGLEVEL"] == "16"
        monkeypatch.delenv("OPENCV_LOG_LEVEL")
        silence_video_libraries()
        assert logging.getLogLevel() == logging.LOG_LEVEL_SILENT
    finally:
        logging.setLogLevel(before)
