"""How the sensor is doing, in one sentence and one colour.

One reading as files, for whoever wants to keep what they just saw.

The page thread: takes the newest moment of the sensor thread, draws it, says how it is. Read this file first.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Literal, Protocol, runtime_checkable

import cv2

from ninedtact.atomic_write import write_file_atomically
from ninedtact.errors import InputError
from ninedtact.reading import Reading
from ninedtact.sensor import Stopwatch
from ninedtact.shape.export import export_shape
from ninedtact.shape.height_map_image import ColourScale
from ninedtact.studio.reading_view import ReadingView, render_reading, session_colour_scale
from ninedtact.studio.sensor_poller import RateMeter, SensorPhase, SensorPoller, SensorSnapshot
from ninedtact.studio.wrench_poller import WrenchPoller, WrenchSnapshot

SILENT_AFTER_MS = 1000.0
"""Ten images of the slowest camera in use. A person then no longer takes what is shown for the present."""

Tone = Literal["live", "busy", "held", "lost"]


@dataclass(frozen=True)
class SensorStatus:
    """What a person must know before believing anything else on the page."""

    tone: Tone
    sentence: str

    @property
    def is_past(self) -> bool:
        """Whether what is shown is not the present, although nobody asked for that."""
        return self.tone == "lost"


WAITING_STATUS = SensorStatus("busy", "waiting for the first image…")


def sensor_status(moment: SensorSnapshot, shown: Reading | None, frozen: bool, now_ns: int) -> SensorStatus:
    """The most urgent thing first."""
    silent_ms = (now_ns - moment.heard_ns) / 1e6
    reading = shown or moment.reading
    age_ms = reading.age_ms(now_ns) if reading is not None else 0.0
    if moment.phase is SensorPhase.FAILED:
        return _final_status(moment)
    if moment.phase is SensorPhase.ENDED:
        return SensorStatus("held", f"recording ended, its last image is shown ({_format_duration(age_ms)} old)")
    if silent_ms > SILENT_AFTER_MS:
        return SensorStatus("lost", f"no image for {_format_duration(silent_ms)}: unplugged? reconnecting…")
    if moment.phase is SensorPhase.REFERENCE:
        return _reference_status(moment.trouble)
    if reading is None:
        return WAITING_STATUS
    if frozen:
        return SensorStatus("held", f"frozen, what is shown is {_format_duration(age_ms)} old")
    return SensorStatus("live", f"live, {age_ms:.0f} ms old")


def _final_status(moment: SensorSnapshot) -> SensorStatus:
    """What a page says for good when nothing will come any more."""
    return SensorStatus(
        "lost", f"stopped: {moment.trouble if moment.phase is SensorPhase.FAILED else 'the program has ended'}"
    )


def _reference_status(trouble: BaseException | None) -> SensorStatus:
    """While the untouched skin is being taken."""
    if trouble is not None:
        return SensorStatus("lost", f"{trouble}; trying again…")
    return SensorStatus("busy", "taking the untouched skin: do not touch it…")


def _format_duration(ms: float) -> str:
    """A time span as a person says it."""
    return f"{ms:.0f} ms" if ms < 1000 else f"{ms / 1000:.1f} s" if ms < 60_000 else f"{ms / 60_000:.0f} min"


FORMATS = ("npy", "png", "ply")


def _save_reading_files(reading: Reading, folder: Path) -> list[Path]:
    """Write the camera's image and the heights (mm) under a name made of the time; raises `FileNotWritten`."""
    folder.mkdir(parents=True, exist_ok=True)
    name = f"reading_{datetime.now():%Y%m%d_%H%M%S_%f}"
    image, heights = folder / f"{name}_image.png", [folder / f"{name}_height.{ending}" for ending in FORMATS]
    write_file_atomically(image, cv2.imencode(".png", reading.frame.image)[1].tobytes())
    for path in heights:
        export_shape(reading.height, path)
    return [image, *heights]


WITHOUT_READING = "expected a reading on the page, got none yet; wait for the first image"


class NothingToSave(InputError):
    """No reading has been shown yet."""


@dataclass(frozen=True)
class DisplayOptions:
    """How a person wants to see the skin."""

    as_points: bool = True
    """Points in the colour of their height; otherwise a smooth surface in the colour of silicone."""
    exaggeration: float = 1.0
    """Heights are drawn this many times larger than they are."""


@dataclass(frozen=True)
class PageReport:
    """How it goes, apart from what is seen."""

    status: SensorStatus
    moment: SensorSnapshot
    shown: Reading | None
    shown_hz: float
    page_ms: dict[str, float]
    """What drawing and sending the last reading cost."""
    wrenches: tuple[WrenchSnapshot, ...] = ()
    """From when the shown reading was taken, one from each source."""


@runtime_checkable
class _PageDisplay(Protocol):
    """Where a person looks. Nothing is drawn while nobody does."""

    @property
    def is_watched(self) -> bool:
        """Whether anybody looks."""

    def look(self) -> DisplayOptions:
        """How they want to see it now."""

    def show(self, view: ReadingView, look: DisplayOptions) -> None:
        """Draw one reading."""

    def tell(self, report: PageReport) -> None:
        """Say how it goes."""


class PageController:
    """One sensor in front of a person, and beside it whatever else tells the force on its skin."""

    def __init__(self, loop: SensorPoller, out: Path, wrenches: Sequence[WrenchPoller] = ()) -> None:
        self.scale: ColourScale = session_colour_scale(loop.sensor.shape.curve)
        self.frozen = False
        self.wrenches = tuple(wrenches)
        self._loop, self._out = loop, out
        self._view: ReadingView | None = None
        self._displayed: tuple[int, bool, DisplayOptions] | None = None
        """What was drawn last: the number of the view, whether faded, and how."""
        self._views, self._shown, self._page_ms = 0, RateMeter(), Stopwatch().stage_ms

    @property
    def shown(self) -> Reading | None:
        """The reading on display."""
        return None if self._view is None else self._view.reading

    def run(self, display: _PageDisplay, display_hz: float = 15.0, until: Callable[[], bool] = lambda: False) -> None:
        """Show until interrupted or `until` says so, or until the sensor thread gives up, whose trouble is then raised."""
        due_at = time.monotonic()
        try:
            while not until():
                self.refresh(display)
                due_at = max(due_at + 1 / display_hz, time.monotonic())
                time.sleep(max(due_at - time.monotonic(), 0))
        finally:
            self.bring_to_an_end(display)

    def refresh(self, display: _PageDisplay) -> None:
        """Bring the display up to the present, once; raises what the sensor thread gave up with."""
        now_ns = time.monotonic_ns()
        moment = self._loop.moment(now_ns)
        if display.is_watched:
            self._take(moment.reading)
        self._present(display, moment, sensor_status(moment, self.shown, self.frozen, now_ns))
        if moment.phase is SensorPhase.FAILED and moment.trouble is not None:
            raise moment.trouble

    def bring_to_an_end(self, display: _PageDisplay) -> None:
        """Leave a page that nobody takes for the present: a browser keeps the last one that it got."""
        moment = self._loop.moment(time.monotonic_ns())
        self._present(display, moment, _final_status(moment))

    def take_reference(self) -> None:
        """Take the skin as it is now for untouched."""
        self._loop.take_reference()

    def save(self) -> list[Path]:
        """Write what is shown to files; raises `NothingToSave`, `FileNotWritten`."""
        if self.shown is None:
            raise NothingToSave(WITHOUT_READING)
        return _save_reading_files(self.shown, self._out)

    def _take(self, reading: Reading | None) -> None:
        held = self.frozen and self._view is not None
        if reading is None or reading is self.shown or held:
            return
        watch = Stopwatch()
        self._view, self._views = render_reading(reading, self.scale), self._views + 1
        watch.mark("draw")
        self._page_ms |= watch.stage_ms
        self._shown.tick(time.monotonic_ns(), self._views)

    def _present(self, display: _PageDisplay, moment: SensorSnapshot, status: SensorStatus) -> None:
        if display.is_watched and self._view is not None:
            self._draw(display, self._view, status.is_past)
        now_ns, at_ns = time.monotonic_ns(), None if self.shown is None else self.shown.frame.stamp_ns
        wrenches = tuple(loop.moment(at_ns, now_ns) for loop in self.wrenches)
        display.tell(PageReport(status, moment, self.shown, self._shown.hz(now_ns), dict(self._page_ms), wrenches))

    def _draw(self, display: _PageDisplay, view: ReadingView, is_past: bool) -> None:
        """Draw what differs from what was drawn last."""
        look = display.look()
        if (wanted := (self._views, is_past, look)) != self._displayed:
            watch = Stopwatch()
            display.show(view.faded() if is_past else view, look)
            watch.mark("send")
            self._page_ms |= watch.stage_ms
            self._displayed = wanted
