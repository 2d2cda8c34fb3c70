"""What libraries print on their own stays off the terminal."""

import os

import cv2
import pytest

from ninedtact.capture.shared_video_capture import silence_video_libraries


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
