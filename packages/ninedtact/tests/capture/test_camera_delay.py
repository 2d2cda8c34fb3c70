"""The delay of a camera is found from a light that blinks, and its stated error holds it."""

import json
import os
from pathlib import Path

import numpy as np
import pytest

from ninedtact.capture.camera_check import describe_camera_settings
from ninedtact.capture.camera_delay import (
    CameraDelay,
    FlashingTerminal,
    LightSwitchedByFile,
    SimulatedDelayedCamera,
    SimulatedLight,
    estimate_delay,
    measure_camera_delay,
    read_camera_delay,
    resolve_camera_delay_ms,
    write_camera_delay,
)
from ninedtact.capture.frame_source import FIXED_EXPOSURE, CameraLost, CameraSettings
from ninedtact.cli import main
from ninedtact.errors import CameraError, FileFormatError, InputError
from ninedtact.quantities import Frame

WRITTEN = CameraDelay(delay_ms=42.0, error_ms=0.5, camera="camera 0", rate_hz=30.0, correlation=0.99)


def blinking(
    delay_s: float, exposure_s: float, rate_hz: float, seed: int = 0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Switches, stamps with half a millisecond of jitter, and brightness with noise of a grey level."""
    rng = np.random.default_rng(seed)
    switches_s = np.cumsum(rng.uniform(0.12, 0.4, 40))
    light = SimulatedLight()
    light.switched_ns += (switches_s * 1e9).astype(int).tolist()
    stamps_s = np.arange(0, switches_s[-1], 1 / rate_hz) + rng.normal(
        0, 5e-4, len(np.arange(0, switches_s[-1], 1 / rate_hz))
    )
    seen = [((at - delay_s - exposure_s / 2) * 1e9, (at - delay_s + exposure_s / 2) * 1e9) for at in stamps_s]
    grey = [60 + 80 * light.share_on(round(begin), round(end)) for begin, end in seen]
    return switches_s, stamps_s, np.array(grey) + rng.normal(0, 1, len(grey))


@pytest.mark.parametrize(
    ("delay_ms", "exposure_ms", "rate_hz"),
    [(0.0, 2.0, 90.0), (42.0, 12.0, 30.0), (180.0, 30.0, 15.0), (-20.0, 5.0, 60.0)],
)
def test_a_known_delay_is_found(delay_ms: float, exposure_ms: float, rate_hz: float) -> None:
    found = estimate_delay(*blinking(delay_ms / 1e3, exposure_ms / 1e3, rate_hz))
    assert abs(found.delay_ms - delay_ms) < 3 * found.error_ms < 3.0
    assert found.rate_hz == pytest.approx(rate_hz, rel=0.01) and found.correlation > 0.99


def test_delays_are_searched_from_a_tenth_of_a_second_early_to_six_tenths_late() -> None:
    for delay_s, is_found in ((-0.12, False), (-0.095, True), (0.59, True), (0.62, False)):
        observed = blinking(delay_s, 0.01, 60)
        if is_found:
            assert estimate_delay(*observed).delay_ms == pytest.approx(1e3 * delay_s, abs=2)
        else:
            with pytest.raises(CameraError, match=r"by -0\.1 to 0\.6 s with a correlation above 0\.8, got"):
                estimate_delay(*observed)


def test_the_light_must_change_the_images_by_two_grey_levels_and_there_must_be_more_than_fifty() -> None:
    switches_s, stamps_s, grey = blinking(0.03, 0.01, 30)
    use = (stamps_s > switches_s[0]) & (stamps_s < switches_s[-1])
    contrast = np.subtract(*np.percentile(grey[use], (90, 10)))
    found = estimate_delay(switches_s, stamps_s, 2.001 / contrast * grey)
    first, *_, last = stamps_s[use]
    assert found.rate_hz == pytest.approx((use.sum() - 1) / (last - first), rel=1e-12) and found.camera == ""
    with pytest.raises(CameraError, match=f"at least 2 grey levels .* got {use.sum()} that change by 2.0;"):
        estimate_delay(switches_s, stamps_s, 1.999 / contrast * grey)
    begin = int(use.argmax())
    with pytest.raises(CameraError, match=r"got 50 that change by 0\.0"):
        estimate_delay(switches_s, stamps_s[begin : begin + 50], grey[begin : begin + 50])
    assert estimate_delay(switches_s, stamps_s[: begin + 51], grey[: begin + 51]).delay_ms == pytest.approx(30, abs=5)


def test_a_terminal_is_inverted_and_one_that_is_none_is_refused() -> None:
    viewer, screen = os.openpty()
    with os.fdopen(screen, "w") as terminal:
        for is_on in (True, False):
            FlashingTerminal(terminal).switch(is_on)
        assert b"".join(os.read(viewer, 1) for _ in range(10)) == b"\x1b[?5h\x1b[?5l"
    os.close(viewer)
    with (
        Path(os.devnull).open("w") as nothing,
        pytest.raises(InputError, match="expected a terminal as the light, got none"),
    ):
        FlashingTerminal(nothing).switch(True)


def test_images_that_do_not_follow_the_light_give_no_delay() -> None:
    switches_s, stamps_s, grey = blinking(0.03, 0.01, 30)
    with pytest.raises(CameraError, match="follow the light"):
        estimate_delay(switches_s, stamps_s, np.random.default_rng(0).permutation(grey))


def test_the_command_finds_the_delay_of_the_simulated_camera(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["camera-delay", "--source", "sim", "--seconds", "3", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    truth_ms = SimulatedDelayedCamera(SimulatedLight()).delay_ms
    # A busy computer switches late, and the error says so.
    assert abs(found["delay_ms"] - truth_ms) < 4 * found["error_ms"] < 60 and found["file"] is None


def test_the_delay_is_kept_in_the_sensor_folder(tmp_path: Path) -> None:
    path = write_camera_delay(tmp_path, WRITTEN)
    assert read_camera_delay(tmp_path) == WRITTEN
    written = path.read_text()
    path.write_text(written.replace(f"delay_ms = {WRITTEN.delay_ms}", f"delay_ms = {WRITTEN.delay_ms + 50}"))
    assert path.read_text() != written
    with pytest.raises(FileFormatError, match="other numbers than its checksum"):
        read_camera_delay(tmp_path)
    path.write_text("delay_ms = 42.0\nerror_ms = 1.0\n")
    assert read_camera_delay(tmp_path) == CameraDelay(42.0, 1.0)
    path.write_text("delay_ms = nan\nerror_ms = 1.0\n")
    with pytest.raises(FileFormatError, match="delay_ms = nan"):
        read_camera_delay(tmp_path)


def test_a_delay_is_given_or_that_which_the_folder_keeps_of_this_camera(tmp_path: Path) -> None:
    for given in (0, -5000, 5000.0):
        assert resolve_camera_delay_ms(given, tmp_path, "camera 1") == given
    for impossible in (5000.1, -5001, np.nan):
        with pytest.raises(InputError, match=f"at most 5000 ms, got {impossible}"):
            resolve_camera_delay_ms(impossible, tmp_path, "camera 1")
    with pytest.raises(FileFormatError):
        resolve_camera_delay_ms("saved", tmp_path, "camera 0")
    write_camera_delay(tmp_path, WRITTEN)
    assert resolve_camera_delay_ms("saved", tmp_path, "camera 0") == 42.0
    with pytest.raises(InputError, match=r"delay of 'camera 1' .* got that of 'camera 0'"):
        resolve_camera_delay_ms("saved", tmp_path, "camera 1")
    write_camera_delay(tmp_path, CameraDelay(7.0, 1.0))
    assert resolve_camera_delay_ms("saved", tmp_path, "camera 1") == 7.0


def test_a_light_that_cannot_be_switched_is_one_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(InputError, match="expected to switch the light by writing"):
        LightSwitchedByFile(tmp_path / "missing").switch(True)
    (tmp_path / "brightness").write_text("0")
    LightSwitchedByFile(tmp_path / "brightness").switch(True)
    assert (tmp_path / "brightness").read_text() == "1" and not (tmp_path / "missing").exists()


def test_an_led_is_switched_to_its_largest_brightness(tmp_path: Path) -> None:
    (tmp_path / "max_brightness").write_text("255\n")
    (tmp_path / "brightness").write_text("7")
    light = LightSwitchedByFile(tmp_path / "brightness")
    for is_on, written in ((True, "255"), (False, "0")):
        light.switch(is_on)
        assert (tmp_path / "brightness").read_text() == written


class UnpluggedCamera(SimulatedDelayedCamera):
    def read(self) -> Frame:
        if (frame := super().read()).index < 5:
            return frame
        raise CameraLost("expected an image, got none; check the cable")


def test_a_camera_that_is_lost_ends_the_measurement_with_the_light_off(tmp_path: Path) -> None:
    light = SimulatedLight()
    with UnpluggedCamera(light) as camera, pytest.raises(CameraLost, match="check the cable"):
        measure_camera_delay(camera, light, seconds=1e6)
    assert len(light.switched_ns) % 2 == 1


def test_settings_are_printed_as_the_camera_reports_them() -> None:
    fixed = CameraSettings(exposure_ms=8.3, gain=0, white_balance_k=4600)
    assert describe_camera_settings(fixed) == (
        "exposure 8.3 ms, fixed; gain 0; white balance 4600 K, fixed; focus not reported"
    )
    automatic = CameraSettings(auto_exposure=True, auto_white_balance=True)
    assert describe_camera_settings(automatic) == (
        "automatic exposure; gain not reported; automatic white balance; focus not reported"
    )
    unknown = "exposure not reported; gain not reported; white balance not reported"
    assert describe_camera_settings(FIXED_EXPOSURE) == f"{unknown}; focus fixed"
    assert describe_camera_settings(CameraSettings()) == f"{unknown}; focus not reported"
