"""A hand that presses a skin of 64 x 48 pixels by a known law, its camera and its force/torque sensor, with faults at will."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ninedtact.capture.frame_source import FrameSource, SourceEnded
from ninedtact.capture.wrench_source import WrenchSource
from ninedtact.quantities import Frame, Wrench
from ninedtact.recording.attached_sensor import sensor_folder_attachments
from ninedtact.recording.metadata import RecordingMetadata
from ninedtact.recording.writer import RecordingWriter

BEGAN_NS = 7_000_000_000
UNTOUCHED_S, TOUCH_S, TOUCHES, LOAD_N = 1.5, 1.6, 3, 8.0
REST_TOUCHES = 2
"""Nothing touches for so long after the first touches, then they go on."""
NOISE = np.array([0.01, 0.01, 0.02, 2e-4, 2e-4, 1e-4])
BIAS = np.array([1.5, -0.7, 3.0, 0.02, 0.01, 0.001])
UNCHANGED: Callable[[float, np.ndarray], np.ndarray | None] = lambda at_s, six: six  # noqa: E731


def truth(at_s: float) -> np.ndarray:
    """What presses: nothing at first, then some touches, dragged to and fro, a rest, and more touches."""
    touch, within_s = divmod(at_s - UNTOUCHED_S, TOUCH_S)
    presses = (0 <= touch < TOUCHES or touch >= TOUCHES + REST_TOUCHES) and within_s > 0.4
    pressed = np.sin(np.pi * (within_s - 0.4) / (TOUCH_S - 0.4)) if presses else 0.0
    load = LOAD_N * pressed**2
    shear = 0.3 * load * np.array([np.cos(3 * at_s), np.sin(2 * at_s)])
    return np.array([*shear, -load, 0.002 * load, -0.001 * load, 0.0005 * load])


@dataclass
class Camera(FrameSource):
    """Thirty images a second, darker under load."""

    seconds: float
    name: str = "the camera of the hand"
    number: int = 0

    def open(self) -> None:
        self.number = 0

    def read(self) -> Frame:
        at_s = self.number / 30
        if at_s > self.seconds:
            raise SourceEnded("expected an image, got the end; stop")
        rng = np.random.default_rng(self.number)
        image = np.full((48, 64, 3), 120.0) + rng.normal(0, 1, (48, 64, 3))
        image[16:32, 24:40] += 8 * truth(at_s)[2]
        self.number += 1
        return Frame(image.clip(0, 255).astype(np.uint8), stamp_ns(at_s), self.number - 1)

    def close(self) -> None: ...


@dataclass
class ForceTorque(WrenchSource):
    """A hundred and twenty-five samples a second with bias and noise; what `fault` makes of one is told, None is lost."""

    fault: Callable[[float, np.ndarray], np.ndarray | None] = UNCHANGED
    hz: float = 125.0
    late_s: float = 0.0
    name: str = "the force/torque sensor of the hand"
    number: int = 0
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(1))

    def open(self) -> None:
        self.number = 0

    def read(self) -> Wrench:
        while True:
            at_s = self.number / self.hz
            self.number += 1
            six = self.fault(at_s, truth(at_s) + BIAS + self.rng.normal(0, NOISE))
            if six is not None:
                return Wrench(six[:3], six[3:], stamp_ns=stamp_ns(at_s + self.late_s))
            if at_s > 100:
                raise SourceEnded("expected a sample, got the end; stop")

    def close(self) -> None: ...


def stamp_ns(at_s: float) -> int:
    return BEGAN_NS + round(at_s * 1e9)


def at_s(stamp: int) -> float:
    return (stamp - BEGAN_NS) / 1e9


def record_hand(path: Path, sensor: Path, seconds: float, delay_ms: float = 0.0) -> None:
    """Write everything that the devices of the hand deliver, and a sensor folder."""
    camera, force_torque, next_sample = Camera(seconds), ForceTorque(), None
    metadata = RecordingMetadata("twin", camera_delay_ms=delay_ms)
    with RecordingWriter(path, metadata, attachments=sensor_folder_attachments(sensor)) as episode, camera:
        for frame in camera:
            while next_sample is None or next_sample.stamp_ns <= frame.stamp_ns + 300_000_000:
                next_sample = force_torque.read()
                episode.write_measured(next_sample)
            episode.write_image(frame)
