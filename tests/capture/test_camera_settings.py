"""A setting is read back, and refused if the camera did not take it; a refusal leaves nothing open."""

import time

import cv2
import pytest
from bench_camera import BenchCamera, BenchPi

from ninedtact.capture.frame_pacing import LivePlayback
from ninedtact.capture.frame_source import FIXED_EXPOSURE, CameraLost, CameraSettingRefused, CameraSettings
from ninedtact.capture.image_and_video_files import ImageFileList
from ninedtact.capture.raspberry_pi_camera import RaspberryPiCamera, _libcamera_controls
from ninedtact.capture.uvc_camera import UvcCamera


@pytest.mark.parametrize(
    "wish",
    [
        CameraSettings(size_px=(320, 240)),
        CameraSettings(size_px=None),
        CameraSettings(rate_hz=30.0),  # the camera has 29.97
        CameraSettings(rate_hz=60.0, pixel_format="MJPG"),
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
                assert getattr(got, name) == pytest.approx(getattr(wish, name), rel=0.01)


def test_the_exposure_of_an_open_camera_is_set_within_its_limits() -> None:
    camera = LivePlayback(UvcCamera(0, FIXED_EXPOSURE, BenchCamera().open_capture))
    with camera:
        camera.set_exposure(12.5)
        assert camera.exposure is not None and camera.exposure.now_ms == 12.5
        assert camera.exposure.least_ms < 1 < 100 < camera.exposure.most_ms
        with pytest.raises(CameraSettingRefused, match=r"exposure .* 9000, got 5000"):
            camera.set_exposure(900.0)
        camera.read()
    with UvcCamera(0, CameraSettings(auto_exposure=True), BenchCamera().open_capture) as automatic:
        assert automatic.exposure is None
    with pytest.raises(CameraSettingRefused, match="set it with the camera's own tool"):
        ImageFileList([]).set_exposure(10.0)


@pytest.mark.parametrize(
    ("wish", "words"),
    [
        (CameraSettings(size_px=(800, 600)), "image width 800, got 640"),
        (CameraSettings(rate_hz=90.0), "images per second 90, got 60"),
        (CameraSettings(pixel_format="H264"), "pixel format H264"),
        (CameraSettings(exposure_ms=900.0), "exposure .* 9000, got 5000"),
        (CameraSettings(gain=101.0), "gain 101, got 100"),
        (CameraSettings(white_balance_k=9000.0), "white balance in kelvin 9000, got 6500"),
    ],
)
def test_a_setting_that_the_camera_clamps_is_refused(wish: CameraSettings, words: str) -> None:
    bench = BenchCamera()
    with (
        pytest.raises(CameraSettingRefused, match=f"expected camera 0 to take {words}.*;"),
        UvcCamera(0, wish, bench.open_capture),
    ):
        pass
    assert bench.held == 0


def test_a_control_that_the_camera_lacks_is_refused() -> None:
    bench = BenchCamera()
    del bench.limits[cv2.CAP_PROP_AUTO_WB]
    with (
        pytest.raises(CameraSettingRefused, match="automatic white balance"),
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
        with pytest.raises(CameraSettingRefused, match=r"expected .* got .*;"):
            CameraSettings(**contradiction)


def test_a_raspberry_pi_is_read_back_too() -> None:
    with RaspberryPiCamera(settings=CameraSettings(exposure_ms=8.0, gain=2.0, rate_hz=60.0), opener=BenchPi) as camera:
        assert camera.read().image.shape == (480, 640, 3)
    for refused in (CameraSettings(exposure_ms=50.0), CameraSettings(white_balance_k=4000.0)):
        with (
            pytest.raises(CameraSettingRefused, match=r"expected .* got .*;"),
            RaspberryPiCamera(settings=refused, opener=BenchPi),
        ):
            pass


def test_a_image_that_waited_in_the_driver_is_stamped_with_its_arrival() -> None:
    with UvcCamera(0, opener=BenchCamera(driver_delay_ms=70).open_capture) as camera:
        frame = camera.read()
        assert 70 <= (time.monotonic_ns() - frame.stamp_ns) / 1e6 < 10_000
    with UvcCamera(0, opener=BenchCamera(driver_delay_ms=-1e12).open_capture) as camera:  # a wall clock is no stamp
        before = time.monotonic_ns()
        assert before <= camera.read().stamp_ns <= time.monotonic_ns()


def test_one_damaged_image_is_read_over_and_a_dead_camera_is_lost() -> None:
    bench = BenchCamera()
    with UvcCamera(0, opener=bench.open_capture) as camera:
        bench.damaged_images = 1
        assert camera.read().index == 0
        bench.plugged_in = False
        with pytest.raises(CameraLost):
            camera.read()


def test_only_the_settings_that_are_given_are_sent_to_a_raspberry_pi() -> None:
    assert dict(_libcamera_controls(CameraSettings())) == {}
    assert dict(_libcamera_controls(CameraSettings(auto_exposure=True))) == {"AeEnable": True}
    assert dict(_libcamera_controls(CameraSettings(exposure_ms=8.0))) == {"AeEnable": False, "ExposureTime": 8000}
    rest = CameraSettings(auto_white_balance=False, gain=2.0, rate_hz=60.0)
    assert dict(_libcamera_controls(rest)) == {"FrameRate": 60.0, "AnalogueGain": 2.0, "AwbEnable": False}


def test_the_first_camera_is_taken_unless_another_is_named() -> None:
    assert UvcCamera(opener=BenchCamera().open_capture).name == "camera 0"
