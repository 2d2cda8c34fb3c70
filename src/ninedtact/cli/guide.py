"""Calibration with a camera: the terminal guides a person through the two presses, hands free.

Nothing is asked: each step watches the images, says what it sees, and goes on by itself when it has what it needs.
"""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ninedtact.cli.devices import source_named
from ninedtact.design import SensorDesign
from ninedtact.errors import NinedtactError

if TYPE_CHECKING:
    from ninedtact.calibration.brightness import Image
    from ninedtact.calibration.flow import CalibrationImages, CalibrationSettings
    from ninedtact.calibration.guidance import Step
    from ninedtact.capture.source import FrameSource


@dataclass
class Terminal:
    """One line that is rewritten while a step goes on, and kept when it is done. Goes to standard error."""

    width: int = 100

    def title(self, words: str) -> None:
        """What to do now."""
        print(f"\n{words}", file=sys.stderr)

    def live(self, words: str) -> None:
        """What is seen at this moment."""
        print(f"\r  {words[: self.width]:<{self.width}}", end="", file=sys.stderr, flush=True)

    @contextmanager
    def line(self) -> Iterator[None]:
        """The line that a step writes on; whatever comes after it begins on a new one."""
        try:
            yield
        finally:
            print(file=sys.stderr)


def guided_images(
    source: str, design: SensorDesign, settings: "CalibrationSettings", automatic: bool
) -> "CalibrationImages":
    """Take the four images with a camera; raises what the camera raises, and `SourceEnded` from a recording."""
    from ninedtact.calibration.flow import CalibrationImages
    from ninedtact.calibration.guidance import steps

    terminal = Terminal()
    taken: dict[str, Image] = {}
    with opened(source, automatic) as camera:
        for step in steps(design, settings):
            terminal.title(step.instruction)
            taken[step.name] = followed(step, camera, taken, terminal)
    return CalibrationImages(**taken)


@contextmanager
def opened(source: str, automatic: bool) -> "Iterator[FrameSource]":
    """The camera, newest image first; a recording is read image by image instead."""
    from ninedtact.capture.freshest import Freshest
    from ninedtact.capture.settings import AS_SENSOR, STEADY

    camera = source_named(source, AS_SENSOR if automatic else STEADY)
    with Freshest(camera) if camera.recorded_hz is None else camera as frames:
        yield frames


def followed(step: "Step", camera: "FrameSource", taken: dict[str, "Image"], terminal: Terminal) -> "Image":
    """Watch images until the step is content; the mean of the last few."""
    watch = step.watch(taken)
    with terminal.line():
        for frame in camera:
            advice = watch(frame.image)
            terminal.live(advice.words)
            if advice.image is not None:
                return advice.image
    raise RecordingTooShort(
        f"expected images until the step '{step.instruction}' was done, got the end of the recording; record it longer"
    )


class RecordingTooShort(NinedtactError):
    """A recording that ended before all four images were taken."""
