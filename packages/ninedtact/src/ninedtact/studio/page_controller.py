"""The controller of the live page: makes one consistent moment of each refresh, reports the sensor's status, saves readings.

A `PageMoment` is everything that the page shows at one refresh: a `SensorMoment` of each of its sensors, of which there is usually
one. Each viewer shows a whole moment, the newest or the one that this viewer has frozen, so that images, surface, wrenches and
plots always belong together.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import compress
from pathlib import Path
from threading import Event
from typing import Literal, Protocol, runtime_checkable

import numpy as np

from ninedtact.errors import InputError
from ninedtact.live.sensor_poller import RateMeter, SensorPhase, SensorPoller, SensorSnapshot
from ninedtact.live.wrench_history import WrenchHistory, WrenchSourceSnapshot, WrenchWithUncertainty
from ninedtact.quantities import EstimateWarning
from ninedtact.reading import Reading, Stopwatch
from ninedtact.shape.calibrated_shape import ReferenceUnusable
from ninedtact.shape.coloured_height_map import ColourScale
from ninedtact.studio.followed_object import FollowedObject, ObjectFollower
from ninedtact.studio.press_control import TwinPressController
from ninedtact.studio.reading_view import ReadingView, full_range_colour_scale
from ninedtact.studio.saved_files import SaveQuota, save_moment_files

SILENT_AFTER_MS = 1000.0
"""Time without images after which the page no longer counts as current: ten images of the slowest camera in use."""

Tone = Literal["live", "busy", "held", "lost", "warned"]


@dataclass(frozen=True)
class SensorStatusMessage:
    """The status of the sensor as one sentence and one colour."""

    tone: Tone
    sentence: str

    @property
    def is_past(self) -> bool:
        """Whether what is shown is out of date although it was not frozen."""
        return self.tone == "lost"


WAITING_STATUS = SensorStatusMessage("busy", "waiting for the first image…")


def most_urgent_status(moment: SensorSnapshot, shown: Reading | None, frozen: bool, now_ns: int) -> SensorStatusMessage:
    """Return the most urgent state of the sensor."""
    behind_ms = (now_ns - moment.heard_ns) / 1e6
    silent_ms = min(behind_ms, (now_ns - moment.arrived_ns) / 1e6)
    reading, late = shown or moment.reading, f"this computer is {_format_duration(behind_ms)} behind"
    age_ms = reading.age_ms(now_ns) if reading is not None else 0.0
    if moment.phase is SensorPhase.FAILED:
        return SensorStatusMessage("lost", f"stopped: {moment.trouble}")
    if moment.phase is SensorPhase.ENDED:
        return SensorStatusMessage("held", f"recording ended, its last image is shown ({_format_duration(age_ms)} old)")
    if silent_ms > SILENT_AFTER_MS and moment.may_be_unplugged:
        return SensorStatusMessage("lost", f"no image for {_format_duration(silent_ms)}: unplugged? reconnecting…")
    if behind_ms > SILENT_AFTER_MS and not frozen and moment.may_be_unplugged:
        remedy = "lower the camera's rate or size, or use --force none"
        return SensorStatusMessage("warned", f"images arrive, but {late}: {remedy}")
    if behind_ms > SILENT_AFTER_MS and not frozen:
        return SensorStatusMessage("warned", f"{late}: end other programs, or use --force none")
    if moment.phase is SensorPhase.REFERENCE:
        refusal = f"{moment.trouble}; trying again…" if isinstance(moment.trouble, ReferenceUnusable) else ""
        sentence = refusal or "taking the reference: do not touch the gel…"
        return SensorStatusMessage("lost" if refusal else "busy", sentence)
    if reading is None:
        return WAITING_STATUS
    if frozen:
        return SensorStatusMessage("held", f"frozen: the moment shown is {_format_duration(age_ms)} old")
    if warning := _warning_sentence(reading):
        return SensorStatusMessage("warned", warning)
    return SensorStatusMessage("live", "; ".join((f"live, {age_ms:.0f} ms old", *reading.light_sentences)))


def _warning_sentence(reading: Reading) -> str:
    """Return the warnings of a reading and what to do; empty for none."""
    of_reference = ", ".join(reading.reference_warnings)
    if EstimateWarning.CALIBRATION_EDITED in reading.reference_warnings:
        return f"{of_reference}; calibrate again if you did not edit it"
    if of_reference:
        return f"{of_reference}; take it again, or name the right sensor"
    of_image = ", ".join(reading.image_warnings)
    return f"{of_image}: nothing is estimated; check light and sensor" if of_image else ""


def _format_duration(ms: float) -> str:
    return f"{ms:.0f} ms" if ms < 1000 else f"{ms / 1000:.1f} s" if ms < 60_000 else f"{ms / 60_000:.0f} min"


WITHOUT_READING = "expected a reading on the page, got none yet; wait for the first image"


@dataclass(frozen=True)
class SensorMoment:
    """Everything that the page shows of one sensor at one refresh."""

    status: SensorStatusMessage
    snapshot: SensorSnapshot
    view: ReadingView | None
    """The newest reading with what is drawn of it, dimmed where it is not current; None before the first reading."""
    wrenches: tuple[WrenchSourceSnapshot, ...] = ()
    """State of each wrench source at the time of the reading."""
    shown_hz: float = 0.0
    name: str = ""
    """Name of the sensor among several."""
    followed: FollowedObject = FollowedObject()
    """Path, turn and slip of what touches."""

    @property
    def reading(self) -> Reading | None:
        """The reading of this moment."""
        return None if self.view is None else self.view.reading

    def frozen_copy(self, now: "SensorMoment", now_ns: int) -> "SensorMoment":
        """Return this moment as a viewer who has frozen it is shown it while the sensor is in another moment now."""
        if self.view is None:
            return now
        if now.snapshot.phase is SensorPhase.RECORDED:
            status = SensorStatusMessage("held", "frozen: a moment of a recording is shown")
        else:
            status = most_urgent_status(now.snapshot, self.reading, True, now_ns)
        return replace(self, status=status, view=self.view.with_past(status.is_past))


@dataclass(frozen=True)
class PageMoment:
    """Everything that the page shows at one refresh."""

    sensors: tuple[SensorMoment, ...]
    """The moment of each sensor; those of a recording may be fewer than those of the page."""
    page_ms: dict[str, float] = field(default_factory=dict)
    """Time that drawing and sending the last moment took."""

    def frozen_copy(self, now: "PageMoment", now_ns: int) -> "PageMoment":
        """Return this moment as a viewer who has frozen it is shown it; a moment of other sensors replaces it."""
        if len(now.sensors) != len(self.sensors):
            return now
        sensors = zip(self.sensors, now.sensors, strict=True)
        return replace(self, sensors=tuple(kept.frozen_copy(newest, now_ns) for kept, newest in sensors))


@runtime_checkable
class PageMomentDisplay(Protocol):
    """The interface of a display of moments. No reading is drawn while no browser is connected."""

    @property
    def is_watched(self) -> bool:
        """Whether at least one browser is connected."""

    def show(self, moment: PageMoment) -> None:
        """Show a moment, whose parts may be those of the last one."""


MAX_LOST_SHARE = 0.02
"""Share of lost images above which the page is drawn more rarely."""
MAX_SLOWDOWN = 3.0


def next_drawing_slowdown(slowdown: float, moment: SensorSnapshot) -> float:
    """Return the next factor, from 1 to `MAX_SLOWDOWN`, by which the page is drawn more rarely than it may be.

    The sensor comes first: drawing and sending for many browsers takes processor time, which grows with their number.
    """
    lost_share = 1 - moment.read_hz / moment.delivered_hz if moment.delivered_hz > 0 else 0.0
    return float(np.clip(slowdown * (1.1 if lost_share > MAX_LOST_SHARE else 0.97), 1.0, MAX_SLOWDOWN))


RECHECK_S = 0.1


class DisplayedSensor:
    """One sensor of the page: its poller, the histories of its wrenches, and the view of its newest reading."""

    def __init__(
        self,
        poller: SensorPoller,
        wrenches: Sequence[WrenchHistory] = (),
        press: TwinPressController | None = None,
        name: str = "",
        follower: ObjectFollower | None = None,
    ) -> None:
        """press: what people do with a twin; None for a sensor that is no twin. name: of the sensor among several. follower: is
        given every reading of the poller; without one, no object is followed.
        """
        self.follower = follower or ObjectFollower()
        self.poller, self.wrenches, self.press, self.name = poller, tuple(wrenches), press, name
        self._view: ReadingView | None = None
        self._views, self._shown = 0, RateMeter()

    @property
    def shown_reading(self) -> Reading | None:
        """The newest reading on the page; None before the first."""
        return None if self._view is None else self._view.reading

    def take(self, reading: Reading | None, scale: ColourScale) -> None:
        """Show a reading from now on, with its heights in these colours."""
        if reading is None or reading is self.shown_reading:
            return
        press = None if self.press is None else self.press.simulation.press_at(reading.stamp_ns)
        self._view, self._views = ReadingView(reading, scale, press), self._views + 1
        self._shown.tick(time.monotonic_ns(), self._views)

    def status(self, snapshot: SensorSnapshot, now_ns: int) -> SensorStatusMessage:
        """Return the most urgent state of the sensor, or why the object that presses a twin does not go where it is held."""
        status = most_urgent_status(snapshot, self.shown_reading, False, now_ns)
        refusal = "" if self.press is None else self.press.simulation.hand.refusal
        if refusal and status.tone == "live":
            return SensorStatusMessage("busy", f"object not moved: {refusal}")
        return status

    def moment(self, snapshot: SensorSnapshot, status: SensorStatusMessage) -> SensorMoment:
        """Return the newest view with everything that belongs to its moment."""
        if self._view is not None:
            self._view = self._view.with_past(status.is_past)
        now_ns = time.monotonic_ns()
        wrenches = tuple(self._wrench_of_moment(history, now_ns) for history in self.wrenches)
        shown_hz = self._shown.hz(now_ns)
        reading = self.shown_reading
        followed = self.follower.at(0 if reading is None else reading.stamp_ns)
        return SensorMoment(status, snapshot, self._view, wrenches, shown_hz, self.name, followed)

    def _wrench_of_moment(self, history: WrenchHistory, now_ns: int) -> WrenchSourceSnapshot:
        """Return the wrench at the time of the shown reading: its own estimate, of which the history has not every one."""
        reading = self.shown_reading
        snapshot = history.snapshot(None if reading is None else reading.frame.stamp_ns, now_ns)
        if not history.states_errors or reading is None or reading.force is None:
            return snapshot
        return replace(snapshot, sample=WrenchWithUncertainty.of_estimate(reading.force))


class PageController:
    """Connects the sensors of a page with a display, and saves their readings."""

    def __init__(
        self,
        sensors: Sequence[DisplayedSensor],
        out: Path,
        quota: SaveQuota | None = None,
        recheck_s: float = RECHECK_S,
    ) -> None:
        """recheck_s: longest time between two refreshes while no new reading arrives."""
        self.sensors, self.out, self.quota, self._recheck_s = tuple(sensors), out, quota or SaveQuota(), recheck_s
        scales = [full_range_colour_scale(one.poller.sensor.shape) for one in self.sensors]
        self.scale: ColourScale = max(scales, key=lambda scale: scale.pressed_mm)
        """The colours of the heights of all sensors."""
        self._changed, self._page_ms = Event(), dict[str, float]()
        for one in self.sensors:
            one.poller.changed = self._changed

    def run(
        self, display: PageMomentDisplay, display_hz: float = 15.0, until: Callable[[], bool] = lambda: False
    ) -> None:
        """Show readings until interrupted or `until` is true; raises the error with which the sensor thread failed."""
        due_at, slowdown = time.monotonic(), 1.0
        # A folder of images is read faster than anybody needs.
        is_live = [one.poller.sensor.source.is_live for one in self.sensors]
        try:
            while not until():
                live = compress(self.refresh(display), is_live)
                slowdown = max((next_drawing_slowdown(slowdown, snapshot) for snapshot in live), default=1.0)
                due_at = max(due_at + slowdown / display_hz, time.monotonic())
                time.sleep(max(due_at - time.monotonic(), 0))
                self._changed.wait(self._recheck_s)
                self._changed.clear()
        finally:
            self.show_final_state(display)

    def refresh(self, display: PageMomentDisplay) -> list[SensorSnapshot]:
        """Update the display once and return the states of the sensors; raises the error with which the sensor thread failed, of
        several when all have failed."""
        now_ns = time.monotonic_ns()
        snapshots = [one.poller.snapshot(now_ns) for one in self.sensors]
        moments = []
        for one, snapshot in zip(self.sensors, snapshots, strict=True):
            one.follower.is_wanted = display.is_watched
            if display.is_watched:
                one.take(snapshot.reading, self.scale)
            moments.append(one.moment(snapshot, one.status(snapshot, now_ns)))
        self._present(display, moments)
        troubles = [snapshot.trouble for snapshot in snapshots if snapshot.phase is SensorPhase.FAILED]
        if len(troubles) == len(self.sensors) and troubles[0] is not None:
            raise troubles[0]
        return snapshots

    def show_final_state(self, display: PageMomentDisplay) -> None:
        """Mark the page as ended, because a browser keeps the last page that it received."""
        moments = []
        for one in self.sensors:
            snapshot = one.poller.snapshot(time.monotonic_ns())
            reason = snapshot.trouble if snapshot.phase is SensorPhase.FAILED else "the program has ended"
            moments.append(one.moment(snapshot, SensorStatusMessage("lost", f"stopped: {reason}")))
        self._present(display, moments)

    def save(self, moments: Sequence[SensorMoment]) -> list[Path]:
        """Write the moments of sensors that have been read to files, with their wrenches, errors and warnings.

        Raises `InputError`, `OutputError` and `FileNotWritten`.
        """
        paths: list[Path] = []
        for one in moments:
            if one.reading is not None:
                status = one.status.sentence
                paths += save_moment_files(one.reading, status, one.wrenches, self.out, self.quota, one.name)
        if not paths:
            raise InputError(WITHOUT_READING)
        return paths

    def _present(self, display: PageMomentDisplay, moments: Sequence[SensorMoment]) -> None:
        watch = Stopwatch()
        display.show(PageMoment(tuple(moments), self._page_ms))
        watch.mark("page")
        self._page_ms = dict(watch.stage_ms)
