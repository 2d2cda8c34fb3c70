"""A setting is read back, and refused if the camera did not take it; a refusal leaves nothing open."""

import time
from functools import partial

import cv2
import numpy as np
import pytest
from bench_camera import BenchCamera, BenchPi

from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.capture.frame_pacing import LivePlayback
from ninedtact.capture.frame_source import FIXED_EXPOSURE, CameraLost, CameraSettings, ImageFileList, SourceNotOpen
from ninedtact.capture.raspberry_pi_camera import RaspberryPiCamera
from ninedtact.capture.shared_video_capture import ThreadSafeVideoCapture
from ninedtact.capture.uvc_camera import UvcCamera
from ninedtact.cli.shared_options import CameraOptions
from ninedtact.errors import CameraError, InputError
from ninedtact.source_addresses import source_for


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
        CameraSettings(focus=120.0),
        CameraSettings(autofocus=True),
        FIXED_EXPOSURE,
    ],
    ids=repr,
)
def test_a_setting_that_the_camera_has_is_in_force(wish: CameraSettings) -> None:
    with UvcCamera(0, wish, BenchCamera().open_capture) as camera:
        got = camera.current_settings
        for name in ("size_px", "pixel_format", "auto_exposure", "gain", "auto_white_balance", "autofocus", "focus"):
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
        (CameraSettings(size_px=(800, 600)), "images of 800x600 pixels, got 640x480; .* --size"),
        (CameraSettings(size_px=(640, 500)), "images of 640x500 pixels, got 640x480; .* --size"),
        (CameraSettings(focus=251.0), "focus 251, got 250"),
        (CameraSettings(rate_hz=61.3), "images per second 61.3, got 60"),
        (CameraSettings(pixel_format="H264"), "pixel format H264, got YUYV"),
        (CameraSettings(exposure_ms=900.0), "exposure .* 9000, got 5000"),
        (CameraSettings(exposure_ms=0.04), r"exposure .* 0, got 1"),
        (CameraSettings(gain=100.6), "gain 100.6, got 100"),
        (CameraSettings(white_balance_k=6570.0), "white balance in kelvin 6570, got 6500"),
    ],
)
def test_a_setting_that_the_camera_clamps_is_refused(wish: CameraSettings, words: str) -> None:
    bench = BenchCamera()
    with (
        pytest.raises(CameraError, match=f"expected camera 0 to take {words}"),
        UvcCamera(0, wish, bench.open_capture),
    ):
        pass
    assert bench.held == 0


def test_an_automatic_control_is_switched_off_absent_or_refused() -> None:
    """A grey camera has no white balance and a fixed lens no autofocus; asked for, they are refused. Exposure is always there."""
    for prop, name, label in (
        (cv2.CAP_PROP_AUTO_WB, "auto_white_balance", "automatic white balance"),
        (cv2.CAP_PROP_AUTOFOCUS, "autofocus", "autofocus"),
    ):
        bench, stubborn = BenchCamera(channels=None), BenchCamera()
        del bench.limits[prop]
        stubborn.limits[prop] = (1, 1)
        with UvcCamera(0, FIXED_EXPOSURE, bench.open_capture) as camera:
            assert getattr(camera.current_settings, name) is None
        for refused, settings in ((bench, CameraSettings(**{name: True})), (stubborn, FIXED_EXPOSURE)):
            with pytest.raises(CameraError, match=f"{label}.*--automatic"):
                UvcCamera(0, settings, refused.open_capture).open()
            assert refused.held == 0
    bench = BenchCamera()
    del bench.limits[cv2.CAP_PROP_AUTO_EXPOSURE]
    bench.limits[cv2.CAP_PROP_AUTO_EXPOSURE] = (3, 3)
    with pytest.raises(CameraError, match=r"exposure mode.*--automatic"):
        UvcCamera(0, FIXED_EXPOSURE, bench.open_capture).open()


@pytest.mark.parametrize("size_px", [(640, 480), (853, 480), (1280, 800)])
def test_motion_jpeg_is_taken_where_uncompressed_images_do_not_come(size_px: tuple[int, int]) -> None:
    """Because another camera uses the USB, or because only MJPG has the size; a format that was named is kept."""
    wide = ((640, 480), (853, 480), (1280, 800))
    crowded = BenchCamera(modes=dict.fromkeys(("YUYV", "MJPG"), wide), free_bytes_per_s=1e6)
    large_by_mjpg = BenchCamera(modes={"YUYV": ((320, 240),), "MJPG": wide})
    asked = CameraSettings(size_px=size_px)
    for bench in (crowded, large_by_mjpg):
        with UvcCamera(0, asked, bench.open_capture) as camera:
            assert camera.current_settings.pixel_format == "MJPG" and bench.held == 1
            assert camera.read().image.shape[1::-1] == size_px
        assert bench.held == 0
    with UvcCamera(0, asked, BenchCamera(modes=crowded.modes).open_capture) as camera:
        assert camera.current_settings.pixel_format == "YUYV"
    plain = CameraSettings(size_px=size_px, pixel_format="YUYV")
    with pytest.raises(CameraError, match=r"got none; .*USB bandwidth: another camera on the same hub\?"):
        UvcCamera(0, plain, crowded.open_capture).open()
    with pytest.raises(CameraError, match="USB bandwidth"):
        UvcCamera(0, asked, BenchCamera(modes={"YUYV": wide}, free_bytes_per_s=1e6).open_capture).open()


@pytest.mark.parametrize("channels", [None, 1, 3, 4])
def test_images_have_three_channels_whatever_the_camera(channels: int | None) -> None:
    with UvcCamera(0, opener=BenchCamera(channels=channels).open_capture) as camera:
        image = camera.read().image
        assert image.shape == (480, 640, 3) and image.flags.c_contiguous and len(np.unique(image)) == 1


def test_a_camera_is_set_to_the_size_of_the_sensor(twin_sensor: SensorFolder) -> None:
    folder = twin_sensor
    source = source_for("0", CameraSettings(size_px=(1280, 800)), folder)
    assert isinstance(source, UvcCamera)
    assert source.settings.size_px == (folder.record.grid.raw_cols, folder.record.grid.raw_rows)
    assert CameraOptions().settings("853x480").size_px == (853, 480)
    for wrong in ("853", "0x480", "853x", "1e9x3", "853x480x3", ""):
        with pytest.raises(InputError, match="expected --size as COLSxROWS"):
            CameraOptions().settings(wrong)


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
        (CameraSettings(auto_white_balance=True), no_balance, "AwbEnable, got no such control"),
    ):
        pi = kind()
        with (
            pytest.raises(CameraError, match=rf"expected .*{said}.*;"),
            RaspberryPiCamera(1, refused, {1: pi}.__getitem__),
        ):
            pass
        assert pi.is_closed
    with RaspberryPiCamera(1, FIXED_EXPOSURE, {1: no_balance()}.__getitem__) as camera:  # a grey one
        assert camera.read().image.shape == (480, 640, 3)


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
        assert camera.current_settings == CameraSettings((640, 480), 29.97, "YUYV", True, None, 0, False, 2800, True)
        capture.values |= {cv2.CAP_PROP_AUTO_WB: 1, cv2.CAP_PROP_AUTO_EXPOSURE: 1}
        assert camera.current_settings == CameraSettings((640, 480), 29.97, "YUYV", False, 0.1, 0, True, None, True)
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
