"""The page thread: takes the newest moment of the sensor thread, draws it, says how it is. Read this file first."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, runtime_checkable

from ninedtact.errors import NinedtactError
from ninedtact.reading import Reading
from ninedtact.sensor import Stopwatch
from ninedtact.shape.image.palette import ColourScale
from ninedtact.studio.history import Rate
from ninedtact.studio.loop import Moment, Phase, SensorLoop
from ninedtact.studio.saved import save_reading
from ninedtact.studio.status import Status, last_words, status_of
from ninedtact.studio.view import View, drawn, scale_of
from ninedtact.studio.wrench_loop import WrenchLoop, WrenchMoment

WITHOUT_READING = "expected a reading on the page, got none yet; wait for the first image"


class NothingToSave(NinedtactError):
    """No reading has been shown yet."""


@dataclass(frozen=True)
class Look:
    """How a person wants to see the skin."""

    as_points: bool = True
    """Points in the colour of their height; otherwise a smooth surface in the colour of silicone."""
    exaggeration: float = 1.0
    """Heights are drawn this many times larger than they are."""


@dataclass(frozen=True)
class Report:
    """How it goes, apart from what is seen."""

    status: Status
    moment: Moment
    shown: Reading | None
    shown_hz: float
    page_ms: dict[str, float]
    """What drawing and sending the last reading cost."""
    wrenches: tuple[WrenchMoment, ...] = ()
    """From when the shown reading was taken, one from each source."""


@runtime_checkable
class Display(Protocol):
    """Where a person looks. Nothing is drawn while nobody does."""

    @property
    def is_watched(self) -> bool:
        """Whether anybody looks."""

    def look(self) -> Look:
        """How they want to see it now."""

    def show(self, view: View, look: Look) -> None:
        """Draw one reading."""

    def tell(self, report: Report) -> None:
        """Say how it goes."""


class Studio:
    """One sensor in front of a person, and beside it whatever else tells the force on its skin."""

    def __init__(self, loop: SensorLoop, out: Path, wrenches: Sequence[WrenchLoop] = ()) -> None:
        self.scale: ColourScale = scale_of(loop.sensor.shape.curve)
        self.frozen = False
        self.wrenches = tuple(wrenches)
        self._loop, self._out = loop, out
        self._view: View | None = None
        self._displayed: tuple[int, bool, Look] | None = None
        """What was drawn last: the number of the view, whether faded, and how."""
        self._views, self._shown, self._page_ms = 0, Rate(), Stopwatch().stage_ms

    @property
    def shown(self) -> Reading | None:
        """The reading on display."""
        return None if self._view is None else self._view.reading

    def run(self, display: Display, display_hz: float = 15.0, until: Callable[[], bool] = lambda: False) -> None:
        """Show until interrupted or `until` says so, or until the sensor thread gives up, whose trouble is then raised."""
        due_at = time.monotonic()
        try:
            while not until():
                self.refresh(display)
                due_at = max(due_at + 1 / display_hz, time.monotonic())
                time.sleep(max(due_at - time.monotonic(), 0))
        finally:
            self.bring_to_an_end(display)

    def refresh(self, display: Display) -> None:
        """Bring the display up to the present, once; raises what the sensor thread gave up with."""
        now_ns = time.monotonic_ns()
        moment = self._loop.moment(now_ns)
        if display.is_watched:
            self._take(moment.reading)
        self._present(display, moment, status_of(moment, self.shown, self.frozen, now_ns))
        if moment.phase is Phase.FAILED and moment.trouble is not None:
            raise moment.trouble

    def bring_to_an_end(self, display: Display) -> None:
        """Leave a page that nobody takes for the present: a browser keeps the last one that it got."""
        moment = self._loop.moment(time.monotonic_ns())
        self._present(display, moment, last_words(moment))

    def take_reference(self) -> None:
        """Take the skin as it is now for untouched."""
        self._loop.take_reference()

    def save(self) -> list[Path]:
        """Write what is shown to files; raises `NothingToSave`, `FileNotWritten`."""
        if self.shown is None:
            raise NothingToSave(WITHOUT_READING)
        return save_reading(self.shown, self._out)

    def _take(self, reading: Reading | None) -> None:
        held = self.frozen and self._view is not None
        if reading is None or reading is self.shown or held:
            return
        watch = Stopwatch()
        self._view, self._views = drawn(reading, self.scale), self._views + 1
        watch.mark("draw")
        self._page_ms |= watch.stage_ms
        self._shown.tick(time.monotonic_ns(), self._views)

    def _present(self, display: Display, moment: Moment, status: Status) -> None:
        if display.is_watched and self._view is not None:
            self._draw(display, self._view, status.is_past)
        now_ns, at_ns = time.monotonic_ns(), None if self.shown is None else self.shown.frame.stamp_ns
        wrenches = tuple(loop.moment(at_ns, now_ns) for loop in self.wrenches)
        display.tell(Report(status, moment, self.shown, self._shown.hz(now_ns), dict(self._page_ms), wrenches))

    def _draw(self, display: Display, view: View, is_past: bool) -> None:
        """Draw what differs from what was drawn last."""
        look = display.look()
        if (wanted := (self._views, is_past, look)) != self._displayed:
            watch = Stopwatch()
            display.show(view.faded() if is_past else view, look)
            watch.mark("send")
            self._page_ms |= watch.stage_ms
            self._displayed = wanted
