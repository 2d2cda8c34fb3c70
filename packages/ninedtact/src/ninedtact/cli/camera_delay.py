"""ninedtact camera-delay: the time from the light to the stamp of an image, measured with a light that the computer switches."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from ninedtact.cli.result_and_interrupt import load_sensor_with_notices, print_notice, print_result
from ninedtact.cli.shared_options import AboveZero, JsonOption
from ninedtact.source_addresses import is_twin_address, source_for

if TYPE_CHECKING:
    from ninedtact.calibration.sensor_folder import SensorFolder
    from ninedtact.capture.camera_delay import LightSwitch
    from ninedtact.capture.frame_source import FrameSource

SCREEN = "screen"
"""Name of the terminal as a light."""


@dataclass(frozen=True)
class CameraDelayCommand:
    """Measure the time from the light to the stamp of an image: a light is switched at random, and the images follow it.

    Hold the camera without its gel to the screen, or let the computer switch an LED that the camera sees. The result contains the
    delay of the light: 10 to 30 ms for a screen, none for an LED.
    """

    source: str
    """Camera (0, /dev/video0, usb:1-2, csi:0) or stream (http://…, rtsp://…); or sim, a simulated camera with a delay of 42 ms."""
    light: str = SCREEN
    """screen: this terminal, whose colours are inverted. Otherwise a file into which 1 (on; the number in max_brightness beside it,
    if there is one) and 0 (off) are written, such as /sys/class/leds/NAME/brightness."""
    sensor: Path | None = None
    """Sensor folder in which the delay is kept, in camera.toml; `record` and `collect` use it with --camera-delay-ms saved, for the
    same source. A new calibration removes it. The delay of sim is printed only."""
    seconds: AboveZero = 15.0
    """Duration."""
    json: JsonOption = False

    def run(self) -> int:
        """Measure, print and keep the delay."""
        from ninedtact.capture.camera_check import describe_camera_settings
        from ninedtact.capture.camera_delay import measure_camera_delay, write_camera_delay
        from ninedtact.capture.uvc_camera import UvcCamera

        folder = None if self.sensor is None else load_sensor_with_notices(self.sensor)
        camera, light = self._camera_and_light(folder)
        with camera:
            if isinstance(camera, UvcCamera):
                print_notice(f"{camera.name}: {describe_camera_settings(camera.current_settings)}")
            found = measure_camera_delay(camera, light, self.seconds)
        is_kept = folder is not None and not is_twin_address(self.source)
        file = write_camera_delay(folder.path, found) if folder is not None and is_kept else None
        delay = f"{found.delay_ms:.1f} ± {found.error_ms:.1f} ms (one standard deviation)"
        lines = [f"{found.camera}: stamps are {delay} after the light"]
        lines += [f"  at {found.rate_hz:.1f} images per second; correlation with the light {found.correlation:.3f}"]
        if self.light == SCREEN and not is_twin_address(self.source):
            lines.append("  of it 10 to 30 ms are the screen's own delay")
        lines += [] if file is None else [f"  kept in {file}; subtract it with --camera-delay-ms saved"]
        if folder is not None and file is None:
            lines.append(f"  not kept in {folder.path}: it is the delay of a simulated camera")
        return print_result(
            self.json, {**msgspec.to_builtins(found), "file": None if file is None else str(file)}, lines
        )

    def _camera_and_light(self, folder: "SensorFolder | None") -> "tuple[FrameSource, LightSwitch]":
        """Return the camera, not yet opened, and the light; raises `InputError`."""
        from ninedtact.capture.camera_delay import (
            FlashingTerminal,
            LightSwitchedByFile,
            SimulatedDelayedCamera,
            SimulatedLight,
        )
        from ninedtact.capture.frame_source import FIXED_EXPOSURE

        if is_twin_address(self.source):
            simulated = SimulatedLight()
            return SimulatedDelayedCamera(simulated), simulated
        light = (
            FlashingTerminal(sys.stderr) if self.light == SCREEN else LightSwitchedByFile(Path(self.light).expanduser())
        )
        return source_for(self.source, FIXED_EXPOSURE, folder), light
