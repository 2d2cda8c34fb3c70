"""One guided calibration for all viewers of a page: camera preview, the images, the fit and its result, without any HTML.

    camera ──image──▶ watcher of the step ──advice──▶ CalibrationState        in the thread of the session
    buttons ─────────▶ start, back, start_over, fit_again, choose_source       from any thread; each acts once

Viewers show `CalibrationSession.state`, so all of them, and a page that is loaded again, show the same. A camera that is lost is
waited for; the images that were taken stay.
"""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from threading import Event
from time import monotonic

import numpy as np

from ninedtact.calibration.brightness_change import require_same_image_size
from ninedtact.calibration.guidance import (
    TOUCHED_LEVELS,
    BoardPressWatcher,
    CaptureStep,
    ImageWatcher,
    PinSearchResult,
    guided_capture_steps,
    peak_local_brightness_change,
    search_board_pins,
)
from ninedtact.calibration.procedure import CalibrationImages, calibrate
from ninedtact.calibration.save import require_replaceable_sensor_folder, save_sensor
from ninedtact.calibration.sensor_folder import SENSOR_FILE, SensorFolder
from ninedtact.calibration.settings import CalibrationSettings
from ninedtact.design import SecondKind, SensorDesign
from ninedtact.errors import NinedtactError, OutputError
from ninedtact.quantities import BgrImage
from ninedtact.studio.guided_session import GuidedSession, GuidedState

_PIN_COUNT_PAUSE = 1.0
"""Pause between two searches for pins while the board moves, in durations of a search, so that the images are not slowed."""
ONCE_S = 0.7
"""Time within which a second step back counts as the same one, pressed by another person."""
FIT_STEPS = 6
"""Usual number of steps that a fit reports."""


class CalibrationPhase(Enum):
    """What a guided calibration is doing."""

    PREVIEW = "preview"
    CAPTURE = "capture"
    FIT = "fit"
    RESULT = "result"
    REFUSED = "refused"


@dataclass(frozen=True)
class CalibrationState(GuidedState):
    """All that a page shows of a guided calibration."""

    phase: CalibrationPhase = CalibrationPhase.PREVIEW
    step: int = 0
    """Number of images taken."""
    instruction: str = ""
    pins: PinSearchResult | None = None
    """The pins in the latest image that was searched for them."""
    fit_progress: float = 0.0
    """Share of the usual number of steps of a fit that are done."""
    result: SensorFolder | None = None
    """The calibrated sensor."""

    @property
    def is_preview(self) -> bool:
        """Whether nothing has begun."""
        return self.phase is CalibrationPhase.PREVIEW


@dataclass
class _StepProgress:
    """The step whose images are watched."""

    step: CaptureStep
    watch: ImageWatcher
    search: "Future[tuple[PinSearchResult, float]] | None" = None
    """The search for pins in an earlier image, and how long it takes, s."""
    searched_until_s: float = -np.inf


@dataclass
class CalibrationSession(GuidedSession[CalibrationState]):
    """Calibrates one sensor for all viewers of a page."""

    out: Path
    """Sensor folder to write."""
    design: SensorDesign = SensorDesign()
    settings: CalibrationSettings = CalibrationSettings()
    sensor_id: str = "9dtact"
    second: tuple[SecondKind, ...] = ()
    """What is pressed too, which tells the base of the gel."""
    on_step: Callable[[str], None] = lambda step: None
    """Called with the name of each step that begins, and with an empty text when the images are complete or given up."""
    force_requested: Event = field(default_factory=Event, init=False)
    """Set when somebody wants to calibrate its force with known loads."""
    saved: SensorFolder | None = field(default=None, init=False)
    """The sensor that was written last, also after somebody has started over."""
    _taken: dict[str, BgrImage] = field(default_factory=dict, init=False, repr=False)
    _progress: _StepProgress | None = field(default=None, init=False, repr=False)
    _last_back_s: float = field(default=-np.inf, init=False, repr=False)
    _agreed: bytes | None = field(default=None, init=False, repr=False)

    @property
    def _steps(self) -> list[CaptureStep]:
        return list(guided_capture_steps(self.design, self.settings, self.second))

    def _first_state(self) -> CalibrationState:
        return CalibrationState(source=self.camera.source)

    @property
    def would_replace(self) -> bool:
        """Whether the folder to write holds a sensor already, other than the one just calibrated."""
        return (self.out / SENSOR_FILE).is_file() and self.state.result is None

    def start(self, replace_sensor: bool = False, second: tuple[SecondKind, ...] | None = None) -> None:
        """Take the first image; raises `OutputError`, `SensorFolderNotReplaceable`. Once started, nothing happens.

        second: what is pressed too, where that is chosen now.
        """
        with self._changed:
            if self._state.phase is CalibrationPhase.PREVIEW:
                self._agree(replace_sensor)
                self.second = self.second if second is None else second
                self.camera.restart_recording()
                self._begin_step(0)

    def back(self) -> None:
        """Take the latest image again, also after a refusal."""
        with self._changed:
            has_images = self._state.phase in (CalibrationPhase.CAPTURE, CalibrationPhase.REFUSED)
            if not has_images or monotonic() - self._last_back_s < ONCE_S:
                return
            self._last_back_s = monotonic()
            # The reference image of a press is taken again with it, since the skin has been touched meanwhile.
            kept = max(0, (len(self._taken) - 1) // 2 * 2)
            self._taken = dict(list(self._taken.items())[:kept])
            self._begin_step(kept)

    def start_over(self) -> None:
        """Give up the images and go back to the choice of the camera; a sensor that was written stays.

        Nothing happens while a fit runs, and once somebody wants to see the sensor live, or to calibrate its force.
        """
        with self._changed:
            is_left = self.live_requested.is_set() or self.force_requested.is_set()
            if self._state.phase not in (CalibrationPhase.PREVIEW, CalibrationPhase.FIT) and not is_left:
                self._taken, self._progress = {}, None
                self._state = self._first_state()
                self.camera.restart_recording()
                self.on_step("")
                self._changed.notify_all()

    def fit_again(self, replace_sensor: bool = False) -> None:
        """Repeat the fit of the images after a refusal; raises what `start` raises."""
        with self._changed:
            if self._state.phase is CalibrationPhase.REFUSED and len(self._taken) == len(self._steps):
                self._agree(replace_sensor)
                self._begin_step(len(self._steps))

    def request_live(self) -> None:
        """Show the calibrated sensor live; nothing happens without one, as where another person has just started over."""
        with self._changed:
            if self._state.result is not None:
                self.live_requested.set()

    def request_force(self) -> None:
        """Calibrate the force of the calibrated sensor; nothing happens without one, or where its images determine no force."""
        with self._changed:
            if self._state.result is not None and self._state.result.record.twin is not None:
                self.force_requested.set()

    def _agree(self, replace_sensor: bool) -> None:
        """Remember which sensor may be replaced; raises `OutputError`, `SensorFolderNotReplaceable`."""
        require_replaceable_sensor_folder(self.out)
        there = _read_sensor_file(self.out)
        if there is not None and not replace_sensor:
            raise _replacement_refusal(self.out)
        self._agreed = there

    def _require_agreement(self) -> None:
        """Raise `OutputError` where another sensor than the agreed one has appeared meanwhile."""
        if _read_sensor_file(self.out) not in (None, self._agreed):
            raise _replacement_refusal(self.out)

    def _begin_step(self, number: int) -> None:
        """Watch the images of a step, or fit once all are taken."""
        self._progress = None
        if number == len(self._steps):
            self.on_step("")
            self._set(
                phase=CalibrationPhase.FIT,
                step=number,
                instruction="Calibrating.",
                advice="",
                pins=None,
                fit_progress=0.0,
            )
            return
        step = self._steps[number]
        self.on_step(step.name)
        self._set(phase=CalibrationPhase.CAPTURE, step=number, instruction=step.instruction, advice="", pins=None)

    def _run(self) -> None:
        """Fit when all images are taken; else read images, and wait for a source that is absent."""

        def needs_images() -> bool:
            return self.state.phase not in (CalibrationPhase.FIT, CalibrationPhase.RESULT)

        with ThreadPoolExecutor(1, "pins") as self._searches:
            while not self.camera.closing.is_set():
                if needs_images():
                    self._watch_camera(needs_images)
                elif self.state.phase is CalibrationPhase.FIT:
                    self._fit()
                else:
                    with self._changed:
                        self._changed.wait_for(
                            lambda: self.camera.closing.is_set() or self._state.phase is not CalibrationPhase.RESULT
                        )

    def _end_recording(self) -> None:
        """Begin a recording again in the preview; refuse one that has ended before all images were taken."""
        if self.state.phase is CalibrationPhase.CAPTURE:
            missing = self._steps[self.state.step].instruction
            self._set(
                phase=CalibrationPhase.REFUSED,
                advice=f"expected images until the step '{missing}' was done, got the end of the recording; start over",
            )

    def _evaluate(self, image: BgrImage) -> None:
        self._show_image(image, "Check brightness and focus, then start.")
        with self._changed:
            if self._state.phase is not CalibrationPhase.CAPTURE:
                return
            step, taken, progress = self._steps[self._state.step], dict(self._taken), self._progress
        try:
            for earlier in taken.values():
                require_same_image_size("image", earlier, image)
            progress = progress or _StepProgress(step, step.watch(taken))
            pins = self._count_pins(image, progress, taken)
            seen = progress.watch(image)
        except (NinedtactError, OSError) as refusal:
            self._set(advice=str(refusal))
            return
        with self._changed:
            if self._state.phase is not CalibrationPhase.CAPTURE or self._taken.keys() != taken.keys():
                return  # somebody has gone back meanwhile
            self._progress = progress
            self._set(advice=seen.sentence, pins=seen.pins or pins or self._state.pins)
            if seen.image is not None:
                self._taken[step.name] = seen.image
                self._last_back_s = -np.inf  # the next wish to go back is a new one
                self._begin_step(len(self._taken))

    def _count_pins(
        self, image: BgrImage, progress: _StepProgress, taken: dict[str, BgrImage]
    ) -> PinSearchResult | None:
        """Return the pins in a recent image of the board, which may still move; None where there is no news of them.

        They are searched in a thread of their own, because a search takes up to seconds.
        """
        if not isinstance(progress.watch, BoardPressWatcher):
            return None
        reference = taken["board_reference"]
        if peak_local_brightness_change(reference, image) < TOUCHED_LEVELS:
            progress.search = None
            return PinSearchResult(self.design.pin_board.count, np.empty((0, 2)), np.empty((0, 2)), False, "")
        if progress.search is None:
            if monotonic() > progress.searched_until_s:
                progress.search = self._searches.submit(self._search_pins, reference, image)
            return None
        if not progress.search.done():
            return None
        search, progress.search = progress.search, None  # also where it was refused: the next image is searched again
        pins, duration_s = search.result()
        progress.watch.pins = pins  # so that its sentence says the same
        progress.searched_until_s = monotonic() + _PIN_COUNT_PAUSE * duration_s
        return pins

    def _search_pins(self, reference: BgrImage, image: BgrImage) -> tuple[PinSearchResult, float]:
        began_s = monotonic()
        return search_board_pins(reference, image, self.design, self.settings), monotonic() - began_s

    def _fit(self) -> None:
        """Fit the images and write the sensor folder; a refusal keeps the images."""
        steps = 0

        def report(step: str) -> None:
            nonlocal steps
            self._set(advice=step, fit_progress=min(steps / FIT_STEPS, 0.95))
            steps += 1

        try:
            self._require_agreement()
            images = CalibrationImages(**self._taken)
            made = calibrate(images, self.design, self.settings, self.sensor_id, report)
            report("drawing the certificate")
            self._require_agreement()
            folder = save_sensor(self.out, made)
        except (NinedtactError, OSError) as refusal:
            self._last_back_s = -np.inf
            self._set(phase=CalibrationPhase.REFUSED, advice=str(refusal))
        else:
            self.saved = folder
            self._set(phase=CalibrationPhase.RESULT, result=folder, fit_progress=1.0, advice="")


def _read_sensor_file(out: Path) -> bytes | None:
    """Return the sensor file at a folder; None where there is none."""
    try:
        return (out / SENSOR_FILE).read_bytes()
    except OSError:
        return None


def _replacement_refusal(out: Path) -> OutputError:
    return OutputError(
        expected="a new folder",
        got=f"{out}, which holds a calibrated sensor",
        remedy="check 'replace the sensor', or end the program and choose another --out",
    )
