"""A setting is read back, and refused if the camera did not take it; a refusal leaves nothing open."""

import time
from functools import partial

import cv2
import pytest
from bench_camera import BenchCamera, BenchPi

from ninedtact.capture.frame_pacing import LivePlayback
from ninedtact.capture.frame_source import FIXED_EXPOSURE, CameraLost, CameraSettings, ImageFileList, SourceNotOpen
from ninedtact.capture.raspberry_pi_camera import RaspberryPiCamera
from ninedtact.capture.shared_video_capture import ThreadSafeVideoCapture
from ninedtact.capture.uvc_camera import UvcCamera
from ninedtact.errors import CameraError


@pytest.mark.parametrize(
    "wish",
    [
        CameraSettings(size_px=(320, 240)),
        CameraSettings(size_px=None),
        CameraSettings(rate_hz=30.0),  # the camera has 29.97
        CameraSettings(rate_hz=60.0, pixel_format="MJPG"),
        CameraSettings(rate_hz=61.2),  # two per cent off
        CameraSettings(white_balance_k=6560.0),  # the camera has 6500, one per cent off
        CameraSettings(exposure_ms=15.6, gain=40.0),
        CameraSettings(auto_exposure=True),
        CameraSettings(white_balance_k=4600.0),
        FIXED_EXPOSURE,
    ],
    ids=repr,
)
def test_a_setting_that_the_camera_has_is_in_force(wish: CameraSettings) -> None:
    with UvcCamera(0, wish, BenchCamera().open_capture) as camera:
        got = camera.current_settings
        for name in ("size_px", "pixel_format", "auto_exposure", "gain", "auto_white_balance"):
            assert getattr(wish, name) in (None, getattr(got, name))
        for name in ("exposure_ms", "white_balance_k", "rate_hz"):
            if getattr(wish, name) is not None:
                assert getattr(got, name) == pytest.approx(getattr(wish, name), rel=0.02)


def test_the_exposure_of_an_open_camera_is_set_within_its_limits() -> None:
    camera = LivePlayback(UvcCamera(0, FIXED_EXPOSURE, BenchCamera().open_capture))
    with camera:
        camera.set_exposure(12.5)
        assert camera.exposure is not None and camera.exposure.now_ms == 12.5
        assert camera.exposure.least_ms < 1 < 100 < camera.exposure.most_ms
        with pytest.raises(CameraError, match=r"exposure .* 9000, got 5000"):
            camera.set_exposure(900.0)
        camera.read()
    with UvcCamera(0, CameraSettings(auto_exposure=True), BenchCamera().open_capture) as automatic:
        assert automatic.exposure is None
    with pytest.raises(CameraError, match="set it with the camera's own tool"):
        ImageFileList([]).set_exposure(10.0)


@pytest.mark.parametrize(
    ("wish", "words"),
    [
        (CameraSettings(size_px=(800, 600)), "image width 800, got 640"),
        (CameraSettings(size_px=(640, 500)), "image height 500, got 480"),
        (CameraSettings(rate_hz=61.3), "images per second 61.3, got 60"),
        (CameraSettings(pixel_format="H264"), "pixel format H264"),
        (CameraSettings(exposure_ms=900.0), "exposure .* 9000, got 5000"),
        (CameraSettings(exposure_ms=0.04), r"exposure .* 0, got 1"),
        (CameraSettings(gain=100.6), "gain 100.6, got 100"),
        (CameraSettings(white_balance_k=6570.0), "white balance in kelvin 6570, got 6500"),
    ],
)
def test_a_setting_that_the_camera_clamps_is_refused(wish: CameraSettings, words: str) -> None:
    bench = BenchCamera()
    with (
        pytest.raises(CameraError, match=f"expected camera 0 to take {words}.*;"),
        UvcCamera(0, wish, bench.open_capture),
    ):
        pass
    assert bench.held == 0


def test_a_control_that_the_camera_lacks_is_refused() -> None:
    bench = BenchCamera()
    del bench.limits[cv2.CAP_PROP_AUTO_WB]
    with (
        pytest.raises(CameraError, match="automatic white balance"),
        UvcCamera(0, FIXED_EXPOSURE, bench.open_capture),
    ):
        pass
    with UvcCamera(0, opener=bench.open_capture) as camera:
        assert camera.current_settings.auto_white_balance is None


def test_settings_that_contradict_each_other_are_refused() -> None:
    for contradiction in (
        {"exposure_ms": 5.0, "auto_exposure": True},
        {"white_balance_k": 4000.0, "auto_white_balance": True},
        {"pixel_format": "MJPEG"},
    ):
        with pytest.raises(CameraError, match=r"expected .* got .*;"):
            CameraSettings(**contradiction)


def test_a_raspberry_pi_is_read_back_too() -> None:
    """Within five per cent, and after thirty images at most; its longest exposure is 20 ms."""
    asked = CameraSettings(exposure_ms=21.0, gain=2.0, rate_hz=60.0)
    late = BenchPi(late_images=29)
    with RaspberryPiCamera(2, asked, {2: late}.__getitem__) as camera:
        assert camera.name == "csi:2" and camera.read().image.shape == (480, 640, 3)
    controls = {"FrameRate": 60.0, "AeEnable": False, "ExposureTime": 21_000, "AnalogueGain": 2.0}
    main = {"format": "RGB888", "size": (640, 480)}
    assert late.configuration == {"main": main, "controls": controls, "queue": False}
    no_balance = type("NoBalance", (BenchPi,), {"camera_controls": BenchPi.camera_controls[:-1]})
    for refused, kind, said in (
        (CameraSettings(exposure_ms=21.1), BenchPi, "'ExposureTime': 21100.* got .*'ExposureTime': 20000"),
        (asked, partial(BenchPi, late_images=30), "'ExposureTime': 21000.* got .*'ExposureTime': 5"),
        (CameraSettings(white_balance_k=4000.0), BenchPi, "no white_balance_k"),
        (CameraSettings(pixel_format="MJPG"), BenchPi, "no pixel_format"),
        (CameraSettings(auto_white_balance=False), no_balance, "AwbEnable, got no such control"),
    ):
        pi = kind()
        with (
            pytest.raises(CameraError, match=rf"expected .*{said}.*;"),
            RaspberryPiCamera(1, refused, {1: pi}.__getitem__),
        ):
            pass
        assert pi.is_closed


def test_a_raspberry_pi_camera_is_lost_after_two_seconds_of_silence() -> None:
    pi = BenchPi()
    with RaspberryPiCamera(settings=CameraSettings(size_px=None), opener=lambda number: pi) as camera:
        assert [camera.read().index for _ in range(3)] == [0, 1, 2] and (pi.cols, pi.rows) == (640, 480)
        pi.is_silent = True
        with pytest.raises(CameraLost, match="check the ribbon cable") as lost:
            camera.read()
        assert lost.value.__cause__ is not None and lost.value.__cause__.args == (2.0,)
    assert pi.is_closed


def test_an_image_that_waited_in_the_driver_is_stamped_with_its_arrival() -> None:
    """However long it waited, as long as another one had not to."""
    bench = BenchCamera(driver_delay_ms=70.0)
    with UvcCamera(0, opener=bench.open_capture) as camera:
        for bench.driver_delay_ms in (70.0, 3000.0):
            time.sleep(bench.driver_delay_ms / 1e3 - 0.07 + 0.01)
            stamp_ns = camera.read().stamp_ns
            assert bench.driver_delay_ms <= (time.monotonic_ns() - stamp_ns) / 1e6 < bench.driver_delay_ms + 900
        assert not camera.notices


@pytest.mark.parametrize("delay_ms", [9000.0, 900.0, 150.0, -50.0, -900.0])
def test_a_constant_offset_of_the_driver_is_taken_out_and_said(delay_ms: float) -> None:
    told: list[str] = []
    with LivePlayback(UvcCamera(0, opener=BenchCamera(driver_delay_ms=delay_ms).open_capture), told.append) as camera:
        for _ in range(3):
            before = time.monotonic_ns()
            stamp_ns = camera.read().stamp_ns
            assert before - 100e6 <= stamp_ns <= time.monotonic_ns()
        assert len(told) == (abs(delay_ms) > 100) and told == list(camera.notices)


@pytest.mark.parametrize("delay_ms", [None, 10_001.0, -10_001.0, -1e12])
def test_a_stamp_of_another_clock_is_not_taken(delay_ms: float | None) -> None:
    """None that is more than ten seconds away, as of a clock of the wall."""
    with UvcCamera(0, opener=BenchCamera(driver_delay_ms=delay_ms).open_capture) as camera:
        before = time.monotonic_ns()
        assert before <= camera.read().stamp_ns <= time.monotonic_ns()


def test_two_damaged_images_are_read_over_and_a_camera_of_three_is_lost() -> None:
    bench = BenchCamera()
    with UvcCamera(0, opener=bench.open_capture) as camera:
        bench.damaged_images = 2
        assert camera.read().index == 0
        bench.damaged_images = 3
        with pytest.raises(CameraLost):
            camera.read()
        assert camera.read().index == 1
        bench.plugged_in = False
        with pytest.raises(CameraLost):
            camera.read()


@pytest.mark.parametrize(
    "modes", [(1, 3), (2, 0)], ids=["manual or aperture priority", "shutter priority or automatic"]
)
def test_the_exposure_is_fixed_in_whichever_mode_the_camera_has(modes: tuple[int, int]) -> None:
    """The camera starts in its automatic mode; its exposure is known where it is fixed."""
    bench = BenchCamera(manual_and_automatic=modes)
    for wish, is_automatic, exposure_ms in (
        (CameraSettings(), True, None),
        (CameraSettings(auto_exposure=True), True, None),
        (CameraSettings(auto_exposure=False), False, 0.1),
        (CameraSettings(exposure_ms=12.34), False, 12.3),
    ):
        with UvcCamera(0, wish, bench.open_capture) as camera:
            got = camera.current_settings
        assert (got.auto_exposure, got.exposure_ms) == (is_automatic, exposure_ms)


def test_a_setting_that_the_camera_does_not_report_is_none() -> None:
    capture = BenchCamera().open_capture(0)
    with UvcCamera(0, opener=lambda device: capture) as camera:
        assert camera.current_settings == CameraSettings((640, 480), 29.97, "YUYV", True, None, 0, False, 2800)
        capture.values |= {cv2.CAP_PROP_AUTO_WB: 1, cv2.CAP_PROP_AUTO_EXPOSURE: 1}
        assert camera.current_settings == CameraSettings((640, 480), 29.97, "YUYV", False, 0.1, 0, True, None)
        del capture.values[cv2.CAP_PROP_AUTO_EXPOSURE]
        assert camera.current_settings.auto_exposure is None and camera.current_settings.exposure_ms == 0.1
        capture.values[cv2.CAP_PROP_FOURCC] = 0
        assert camera.current_settings.pixel_format is None
        capture.values.clear()
        assert camera.current_settings == CameraSettings()
    with pytest.raises(SourceNotOpen):
        _ = camera.current_settings


def test_a_device_is_neither_read_nor_asked_after_its_release() -> None:
    bench = BenchCamera()
    shared = ThreadSafeVideoCapture("camera 0", bench.open_capture(0))
    assert shared.query(lambda capture: capture.get(cv2.CAP_PROP_GAIN)) == 0
    shared.release()
    for use in (shared.read, lambda: shared.query(lambda capture: capture.get(cv2.CAP_PROP_GAIN))):
        with pytest.raises(SourceNotOpen, match="expected camera 0 to be open"):
            use()
    assert bench.held == 0
