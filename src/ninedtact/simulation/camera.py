"""The camera of a twin: a frame source like any other."""

from dataclasses import dataclass, field
from threading import Lock

from ninedtact.capture.frame_source import FrameSource, SourceNotOpen
from ninedtact.quantities import Frame
from ninedtact.simulation.pace import Pace
from ninedtact.simulation.stage import Stage


@dataclass
class SimulatedCamera(FrameSource):
    """Images of the stage, one per step of its motion, for ever or until its last round ends."""

    stage: Stage
    is_open: bool = field(default=False, init=False)
    first: int = field(default=-1, init=False)
    """Step of the first image."""
    lock: Lock = field(default_factory=Lock, init=False, repr=False)
    """Of opening, reading and closing."""

    def __post_init__(self) -> None:
        self.name = f"twin {self.stage.twin.name}"
        self.pace = Pace(self.stage.clock, self.stage.hz)

    def open(self) -> None:
        """Begin the motion, or join it."""
        with self.lock:
            if not self.is_open:
                self.stage.join()
                self.pace.restart()
                self.first, self.is_open = -1, True

    def read(self) -> Frame:
        """Wait for the next image; raises `SourceEnded` after the last round."""
        with self.lock:
            if not self.is_open:
                raise SourceNotOpen(self.name)
            number, stamp_ns = self.pace.next()
            self.stage.require_time(number / self.stage.hz)
            self.first = number if self.first < 0 else self.first
            image = self.stage.twin.renderer(self.stage.contact(number), number)
            return Frame(image, stamp_ns, number - self.first)

    def close(self) -> None:
        """End it."""
        with self.lock:
            if self.is_open:
                self.stage.clock.leave()
                self.is_open = False
