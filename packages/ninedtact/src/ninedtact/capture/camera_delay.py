"""The delay of a camera, from the light on its chip to the stamp of the image, measured with a light that the computer switches.

The light is switched on and off at random moments that are known on the clock of the stamps. The mean brightness of the images
follows it later: the delay is the shift of the pattern, averaged over an exposure, that correlates best with the brightness. It is
positive where an image is stamped after the light fell on it, and contains the delay of the light itself: about a frame (10 to 30
ms) for a screen, and nothing for an LED.
"""

import os
from abc import ABC, abstractmethod
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from threading import Event
from time import monotonic, monotonic_ns, sleep
from typing import Annotated, Literal, TextIO

import msgspec
import numpy as np
import tomli_w
from jaxtyping import Float64
from msgspec import Meta
from numpy import ndarray as Array

from ninedtact.atomic_write import write_file_atomically
from ninedtact.capture.frame_source import FrameSource, SourceNotOpen
from ninedtact.checked_reading import (
    CHECKSUM_KEY,
    convert_tables_to_class,
    mapping_checksum,
    parse_toml,
    read_text_file,
)
from ninedtact.errors import CameraError, FileFormatError, InputError
from ninedtact.quantities import Frame

CAMERA_FILE = "camera.toml"
"""File of a sensor folder that keeps the measured delay of the camera; it may be written by hand."""
SAVED = "saved"
"""Word in place of a delay for the one that the sensor folder keeps."""
_SHORTEST_S, _LONGEST_S = 0.12, 0.4
"""Times between two switches; several images fall between them at any usual rate."""
_DELAYS_S = np.arange(-0.1, 0.6, 0.002)
_EXPOSURES_S = np.arange(0.001, 0.052, 0.003)
_FINE_S = np.arange(-0.006, 0.00605, 0.0001)
_MODEL_ERROR_S = 0.0002
"""Error of the model itself: an exposure is not a box, and rows of a rolling shutter differ."""
_BLOCKS = 10
_LEAST_CORRELATION = 0.8
_LEAST_CONTRAST = 2.0
"""Grey levels between light and dark images."""


class CameraDelay(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A measured delay of a camera, as `camera.toml` keeps it."""

    delay_ms: Annotated[float, Meta(ge=-1000, le=5000)]
    """Time from the middle of the exposure to the stamp of the image."""
    error_ms: Annotated[float, Meta(ge=0, le=5000)]
    """One standard deviation of it."""
    camera: str = ""
    """Name of the camera's source, such as `camera usb:1-2`; empty for any camera."""
    rate_hz: Annotated[float, Meta(ge=0, le=10_000)] = 0.0
    """Images per second while it was measured."""
    correlation: Annotated[float, Meta(ge=-1, le=1)] = 1.0
    """Correlation of brightness and shifted pattern."""


class LightSwitch(ABC):
    """A light that the computer switches; `switch` returns as soon as the light has changed."""

    @abstractmethod
    def switch(self, is_on: bool) -> None:
        """Switch the light on or off; raises `InputError`."""


class FlashingTerminal(LightSwitch):
    """A terminal whose whole screen is switched between its colours and their inverse (DECSCNM)."""

    def __init__(self, terminal: TextIO) -> None:
        self._terminal = terminal

    def switch(self, is_on: bool) -> None:
        """Invert the screen, or show it as usual; raises `InputError` where there is no terminal."""
        if not self._terminal.isatty():
            raise InputError(
                expected="a terminal as the light",
                got="none",
                remedy="run the command in a terminal, or name the file of an LED with --light",
            )
        self._terminal.write("\033[?5h" if is_on else "\033[?5l")
        self._terminal.flush()


class LightSwitchedByFile(LightSwitch):
    """A light that follows a file into which 1 or 0 is written, such as `/sys/class/leds/NAME/brightness` or a GPIO's `value`.

    Where a file `max_brightness` stands beside it, as beside that of an LED, its number is written in place of 1.
    """

    def __init__(self, path: Path) -> None:
        self._path = path

    def switch(self, is_on: bool) -> None:
        """Write 0, or 1 or the largest brightness; raises `InputError`."""
        largest = self._path.with_name("max_brightness")
        try:
            lit = largest.read_text().strip() if is_on and largest.is_file() else "1"
            file = os.open(self._path, os.O_WRONLY | os.O_TRUNC)  # a missing file is not created
            try:
                os.write(file, (lit if is_on else "0").encode())
            finally:
                os.close(file)
        except OSError as error:
            raise InputError(
                f"expected to switch the light by writing to {self._path}, got: {error.strerror}; correct the path and its "
                "permissions"
            ) from error


class SimulatedLight(LightSwitch):
    """A light that simulated cameras see."""

    def __init__(self) -> None:
        self.switched_ns = [0]
        """Moments of all switches; it is off before the second, on until the third, and so on."""

    def switch(self, is_on: bool) -> None:
        """Remember the moment, if this changes the light."""
        if is_on != (len(self.switched_ns) % 2 == 0):
            self.switched_ns.append(monotonic_ns())

    def share_on(self, from_ns: int, to_ns: int) -> float:
        """Return the share of a time during which the light was on."""
        edges = np.clip([*self.switched_ns, *([] if len(self.switched_ns) % 2 else [to_ns])], from_ns, to_ns)
        return float(np.diff(edges)[1::2].sum() / (to_ns - from_ns))


@dataclass
class SimulatedDelayedCamera(FrameSource):
    """A camera that sees a simulated light and stamps its images a known time after the middle of their exposure."""

    light: SimulatedLight
    delay_ms: float = 42.0
    rate_hz: float = 30.0
    exposure_ms: float = 12.0
    name: str = "simulated camera with a known delay"
    is_simulated = True
    _next: int = field(default=-1, init=False)

    def open(self) -> None:
        """Start at the present moment."""
        self._next, self._began_ns = 0, monotonic_ns()

    def close(self) -> None:
        """Stop."""
        self._next = -1

    def read(self) -> Frame:
        """Wait for the next image and return it, with noise of one grey level; raises `SourceNotOpen`."""
        if self._next < 0:
            raise SourceNotOpen(self.name)
        index, self._next = self._next, self._next + 1
        stamp_ns = self._began_ns + round(index * 1e9 / self.rate_hz)
        sleep(max(0.0, (stamp_ns - monotonic_ns()) / 1e9))
        middle_ns, half_ns = stamp_ns - self.delay_ms * 1e6, self.exposure_ms * 0.5e6
        grey = 60 + 80 * self.light.share_on(round(middle_ns - half_ns), round(middle_ns + half_ns))
        noise = np.random.default_rng(index).normal(grey, 1.0, (48, 64, 3))
        return Frame(np.clip(np.rint(noise), 0, 255).astype(np.uint8), stamp_ns, index)


def measure_camera_delay(camera: FrameSource, light: LightSwitch, seconds: float = 15.0) -> CameraDelay:
    """Switch the light for some seconds and return the delay of the open camera; the light is off before and afterwards.

    Raises `CameraError`, `InputError`, and what reading the camera raises.
    """
    if not camera.is_live:
        raise CameraError(
            expected="a live camera or stream, which can see the light",
            got=f"{camera.name}, which is recorded",
            remedy="give a live camera",
        )
    rng, switches, is_over = np.random.default_rng(0), [], Event()
    began_at, is_on = monotonic(), False
    with ThreadPoolExecutor(1, f"brightness of {camera.name}") as pool:
        reading = pool.submit(_read_brightness, camera, is_over)
        try:
            light.switch(False)
            while not reading.done() and monotonic() - began_at < seconds:
                sleep(rng.uniform(_SHORTEST_S, _LONGEST_S))
                before_ns, is_on = monotonic_ns(), not is_on
                light.switch(is_on)
                switches.append((before_ns, monotonic_ns()))
            sleep(_LONGEST_S)
        finally:
            is_over.set()
            with suppress(InputError):
                light.switch(False)
    stamps_ns, brightness = reading.result()
    if len(switches) < 2:
        raise CameraError(expected="a measurement of some seconds", got=f"{seconds:g} s", remedy="measure longer")
    before, after = np.array(switches).T
    found = estimate_delay((before + after) / 2e9, stamps_ns / 1e9, brightness)
    switching_ms = float(np.mean(after - before)) / 2e6
    return msgspec.structs.replace(found, camera=camera.name, error_ms=float(np.hypot(found.error_ms, switching_ms)))


def _read_brightness(camera: FrameSource, is_over: Event) -> tuple[Array, Float64[Array, " n"]]:
    """Return stamps in ns and mean brightness of all images until the measurement is over; raises what the camera raises."""
    stamps_ns, brightness = list[int](), list[float]()
    while not is_over.is_set():
        frame = camera.read()
        stamps_ns.append(frame.stamp_ns)
        brightness.append(float(frame.image.mean()))
    return np.array(stamps_ns, np.int64), np.array(brightness)


def estimate_delay(
    switches_s: Float64[Array, " switches"], stamps_s: Float64[Array, " n"], brightness: Float64[Array, " n"]
) -> CameraDelay:
    """Return the delay by which the brightness of images follows a light that was off before the first of the switches.

    Its error is that of a jackknife over ten parts of the images. Raises `CameraError`.
    """
    use = (stamps_s > switches_s[0]) & (stamps_s < switches_s[-1])
    stamps_s, brightness = stamps_s[use], brightness[use]
    contrast = float(np.subtract(*np.percentile(brightness, (90, 10)))) if len(brightness) > 5 * _BLOCKS else 0.0
    if contrast < _LEAST_CONTRAST:
        raise CameraError(
            expected=f"images that change by at least {_LEAST_CONTRAST:g} grey levels with the light",
            got=f"{len(brightness)} that change by {contrast:.1f}",
            remedy="bring the camera to the light, darken the room, and measure longer",
        )
    correlations = [_correlations(switches_s, stamps_s, brightness, _DELAYS_S, width) for width in _EXPOSURES_S[::3]]
    best = np.unravel_index(np.argmax(correlations), np.shape(correlations))
    coarse_s, correlation = float(_DELAYS_S[best[1]]), float(np.max(correlations))
    if correlation < _LEAST_CORRELATION or best[1] in (0, len(_DELAYS_S) - 1):
        raise CameraError(
            expected=f"the brightness of the images to follow the light by {_DELAYS_S[0]:g} to {_DELAYS_S[-1]:.1f} "
            f"s with a correlation above {_LEAST_CORRELATION}",
            got=f"{correlation:.2f} at {coarse_s:.2f} s",
            remedy="switch automatic exposure off and darken the room",
        )

    def fine_delay_s(kept: Array) -> float:
        found = [
            _correlations(switches_s, stamps_s[kept], brightness[kept], coarse_s + _FINE_S, w) for w in _EXPOSURES_S
        ]
        return coarse_s + float(_FINE_S[np.unravel_index(np.argmax(found), np.shape(found))[1]])

    block = np.arange(len(stamps_s)) * _BLOCKS // len(stamps_s)
    parts = np.array([fine_delay_s(block != one) for one in range(_BLOCKS)])
    error_s = np.hypot(np.sqrt((_BLOCKS - 1) * parts.var()), _MODEL_ERROR_S)
    rate_hz = (len(stamps_s) - 1) / float(stamps_s[-1] - stamps_s[0])
    return CameraDelay(1e3 * fine_delay_s(np.full(len(block), True)), 1e3 * float(error_s), "", rate_hz, correlation)


def _correlations(switches_s: Array, stamps_s: Array, brightness: Array, delays_s: Array, exposure_s: float) -> Array:
    on_s = np.concatenate([[0.0], np.cumsum(np.diff(switches_s) * (np.arange(len(switches_s) - 1) % 2 == 0))])
    at_s = stamps_s - delays_s[:, None]
    seen = np.interp(at_s + exposure_s / 2, switches_s, on_s) - np.interp(at_s - exposure_s / 2, switches_s, on_s)
    seen -= seen.mean(axis=1, keepdims=True)
    wanted = brightness - brightness.mean()
    return (seen @ wanted) / np.maximum(np.linalg.norm(seen, axis=1) * np.linalg.norm(wanted), 1e-12)


def write_camera_delay(sensor: Path, delay: CameraDelay) -> Path:
    """Keep the delay in a sensor folder and return the file; raises `FileNotWritten`."""
    values = msgspec.to_builtins(delay)
    write_file_atomically(
        sensor / CAMERA_FILE, tomli_w.dumps({CHECKSUM_KEY: mapping_checksum(values), **values}).encode()
    )
    return sensor / CAMERA_FILE


def read_camera_delay(sensor: Path) -> CameraDelay:
    """Return the delay that a sensor folder keeps.

    Raises `FileFormatError`, also where it keeps none or where the numbers are not those that were written; a file without a
    checksum is one that a person wrote.
    """
    path = sensor / CAMERA_FILE
    try:
        values = parse_toml(read_text_file(path))
        if values.pop(CHECKSUM_KEY, None) not in (None, mapping_checksum(values)):
            raise ValueError("other numbers than its checksum")
        return convert_tables_to_class(values, CameraDelay)
    except (OSError, ValueError, RecursionError) as trouble:
        raise FileFormatError(
            f"expected {path} with the delay of the camera, got: {trouble}; measure it with 'ninedtact camera-delay --sensor "
            f"{sensor}', or give it in ms"
        ) from trouble


def resolve_camera_delay_ms(given: float | Literal["saved"], sensor: Path, camera: str) -> float:
    """Return a delay as it was given, or the one that the sensor folder keeps of this camera, by the name of its source.

    A kept delay that names no camera is that of any. Raises `InputError` or `FileFormatError`.
    """
    if given == SAVED:
        kept = read_camera_delay(sensor)
        if kept.camera not in ("", camera):
            raise InputError(
                expected=f"the delay of '{camera}' in {sensor / CAMERA_FILE}",
                got=f"that of '{kept.camera}'",
                remedy="measure it with 'ninedtact camera-delay' and the same --source, or give it in ms",
            )
        return kept.delay_ms
    if not isinstance(given, int | float) or not abs(given) <= 5000:
        raise InputError(expected="a delay of the camera of at most 5000 ms", got=f"{given}", remedy="correct it")
    return float(given)
