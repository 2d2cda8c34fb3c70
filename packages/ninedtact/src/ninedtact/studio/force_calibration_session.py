"""One force calibration with known loads for all viewers of a page: presses, scale so far and its file, without any HTML.

    camera ──image──▶ watcher of the phase ──press──▶ reader (estimate) ──▶ scale so far      in the thread of the session
    buttons ─────────▶ start, set_load, remove, take_another, save, start_over                from any thread

Before every press an image without contact becomes the reference. A camera that is lost is waited for; the presses stay. The gel,
or the factor of a network, is fitted and saved by the functions of the command `ninedtact adapt`; "scale" means either.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from pathlib import Path

import numpy as np

from ninedtact.calibration.force_calibration import (
    KnownLoadCalibration,
    PressImage,
    weight_of_grams_n,
)
from ninedtact.calibration.gel_fit_to_known_loads import ForceScaleImpossible, KnownLoadFit, KnownLoadPress
from ninedtact.calibration.guidance import (
    STILL,
    CalibrationStepAdvice,
    ImageWatcher,
    make_still_press_watcher,
    make_untouched_skin_watcher,
)
from ninedtact.errors import NinedtactError
from ninedtact.force.estimator_and_scale import WIDEST_FACTOR
from ninedtact.quantities import BgrImage, Frame
from ninedtact.reading import Reading
from ninedtact.studio.guided_session import GuidedSession, GuidedState

USUAL_LOADS_G = (50.0, 100.0, 200.0, 400.0)
"""Loads that are suggested one after the other; enough for a curve, and light enough for the range in which the gel is linear."""
HOLD_S = 1.5
"""Time for which a press is held still, so that a pause of a hand that presses on is not taken."""
_MAX_OFF_CENTRE_MM = 4.0
"""Greatest distance of a contact from the middle of the skin; nearer to the edge the gel is stiffer and the light weaker."""
_ALIKE = 0.25
"""Difference of the logarithms of two loads up to which they count as the same suggested load."""
_FEWEST_FOR_OUTLIER = 3
"""Number of presses from which one that contradicts the others can be named."""
FEWEST_WEIGHED = 2
"""Number of presses from which the page offers to save: two show whether they agree."""


class ForceCalibrationPhase(Enum):
    """What a force calibration is doing."""

    PREVIEW = "preview"
    REFERENCE = "reference"
    PRESS = "press"
    LIFT = "lift"
    COMPLETE = "complete"
    SAVED = "saved"


@dataclass(frozen=True)
class TakenPress:
    """A press that was taken: its load, its images, and the estimates of its load."""

    grams: float
    estimate: KnownLoadPress
    image: PressImage | None = None

    @property
    def estimated_n(self) -> float:
        """The load that the estimator states before the calibration with known loads."""
        return self.estimate.calibrated_n

    @property
    def warnings(self) -> tuple[str, ...]:
        """Reasons to distrust the estimate."""
        return tuple(map(str, self.estimate.warnings))

    def numbered(self, number: int) -> KnownLoadPress:
        """Return the press as the fit takes it, named by its number and load; raises `ForceScaleImpossible`."""
        name = f"press {number} ({self.grams:g} g)"
        return replace(self.estimate, name=name, weighed_n=weight_of_grams_n(self.grams))


@dataclass(frozen=True)
class LoadScaleSoFar:
    """What the presses so far say about the force scale."""

    fit: KnownLoadFit | None = None
    """None for too few presses, or for presses that are refused."""
    refusal: str = ""
    """Why the presses determine no scale."""
    doubtful: int | None = None
    """Number of the press to take again first, from 0; None without presses."""


@dataclass(frozen=True)
class ForceCalibrationState(GuidedState):
    """All that a page shows of a force calibration."""

    phase: ForceCalibrationPhase = ForceCalibrationPhase.PREVIEW
    load_g: float = USUAL_LOADS_G[0]
    """The load of the press that is awaited, or of the one that was just taken."""
    presses: tuple[TakenPress, ...] = ()
    scale: LoadScaleSoFar = LoadScaleSoFar()
    saved: Path | None = None
    """The file that was written."""

    @property
    def is_preview(self) -> bool:
        """Whether nothing has begun."""
        return self.phase is ForceCalibrationPhase.PREVIEW


def fit_scale_so_far(
    presses: Sequence[TakenPress], fit: Callable[[Sequence[KnownLoadPress]], KnownLoadFit]
) -> LoadScaleSoFar:
    """Return the scale of the presses so far, or why there is none, and the press that is the most doubtful.

    fit: fits the gel, or a factor, to presses (`KnownLoadCalibration.fit`).
    """
    known = [press.numbered(number) for number, press in enumerate(presses, 1)]
    doubtful = _most_doubtful(presses)
    if len(known) < FEWEST_WEIGHED:
        return LoadScaleSoFar(doubtful=doubtful)
    try:
        return LoadScaleSoFar(fit(known), doubtful=doubtful)
    except ForceScaleImpossible as refusal:
        return LoadScaleSoFar(None, str(refusal), doubtful)


def _most_doubtful(presses: Sequence[TakenPress]) -> int | None:
    """Return the press whose factor is farthest from the median one, or the last of too few; None without presses."""
    factors = np.log([weight_of_grams_n(press.grams) / press.estimated_n for press in presses])
    if len(presses) < _FEWEST_FOR_OUTLIER:
        wrong_unit = np.flatnonzero(np.abs(factors) > np.log(WIDEST_FACTOR))
        return int(wrong_unit[0]) if len(wrong_unit) else len(presses) - 1 if presses else None
    return int(np.abs(factors - np.median(factors)).argmax())


@dataclass
class ForceCalibrationSession(GuidedSession[ForceCalibrationState]):
    """Calibrates the force of one sensor for all viewers of a page."""

    sensor: Path
    """Sensor folder, in which the scale is kept."""
    calibration: KnownLoadCalibration
    loads_g: Sequence[float] = USUAL_LOADS_G
    on_load: Callable[[float], None] = lambda grams: None
    """Called with the load of each press that is awaited, g, and with 0 where nothing may touch."""
    hold_s: float = HOLD_S
    saved: Path | None = field(default=None, init=False)
    """The file that was written last, also after somebody has started over."""
    _watch: ImageWatcher | None = field(default=None, init=False, repr=False)
    _reference: BgrImage | None = field(default=None, init=False, repr=False)
    _references: tuple[Frame, ...] = field(default=(), init=False, repr=False)
    _refusal: str = field(default="", init=False, repr=False)

    def _first_state(self) -> ForceCalibrationState:
        return ForceCalibrationState(source=self.camera.source, load_g=self.loads_g[0])

    def start(self) -> None:
        """Take the first reference image; once started, nothing happens."""
        with self._changed:
            if self._state.phase is ForceCalibrationPhase.PREVIEW:
                self.camera.restart_recording()
                self._enter(ForceCalibrationPhase.REFERENCE)

    def set_load(self, grams: float) -> None:
        """State the load of the press that is awaited, or correct that of the press just taken; raises `ForceScaleImpossible`."""
        if not 0 < grams < np.inf:
            raise ForceScaleImpossible(expected="a load above zero", got=f"{grams:g} g", remedy="read the scale again")
        with self._changed:
            phase, presses = self._state.phase, self._state.presses
            if phase is ForceCalibrationPhase.LIFT:
                self._set_presses((*presses[:-1], replace(presses[-1], grams=grams)))
            if phase in (ForceCalibrationPhase.PRESS, ForceCalibrationPhase.LIFT):
                self._set(load_g=grams)
            if phase is ForceCalibrationPhase.PRESS:
                self.on_load(grams)

    def remove(self, press: TakenPress) -> None:
        """Drop a press; its load is asked for again. A press that is gone already does nothing, as where two people drop it."""
        with self._changed:
            presses, phase = self._state.presses, self._state.phase
            if any(one is press for one in presses) and phase is not ForceCalibrationPhase.SAVED:
                self._set_presses(tuple(one for one in presses if one is not press))
                self._set(load_g=press.grams)
                # What rests on the skin now is another load, which must not be taken for this one.
                is_untouched = phase is ForceCalibrationPhase.COMPLETE
                self._enter(ForceCalibrationPhase.PRESS if is_untouched else ForceCalibrationPhase.REFERENCE)

    def take_another(self) -> None:
        """Wait for one more press than was suggested."""
        with self._changed:
            if self._state.phase is ForceCalibrationPhase.COMPLETE:
                self._enter(ForceCalibrationPhase.PRESS)

    def save(self) -> None:
        """Keep the scale in the sensor folder; raises `ForceScaleImpossible` where there is none, and what writing raises."""
        with self._changed:
            scale = self._state.scale
            if self._state.phase is ForceCalibrationPhase.SAVED:
                return
            if scale.fit is None:
                raise ForceScaleImpossible(
                    scale.refusal
                    or f"expected at least {FEWEST_WEIGHED} presses with known loads, got fewer; take another press"
                )
            presses = self._state.presses
            known = [press.numbered(number) for number, press in enumerate(presses, 1)]
            images = [
                replace(press.image, name=each.name)
                for press, each in zip(presses, known, strict=True)
                if press.image is not None
            ]
            sensor = self.calibration.adapted_sensor(scale.fit, known, images)
            try:
                file = self.calibration.save(scale.fit, sensor)
            except OSError as trouble:
                raise ForceScaleImpossible(
                    f"expected to write the force scale into {self.sensor}, got: {trouble}; make room or change its permissions"
                ) from trouble
            self.saved = file
            self._enter(ForceCalibrationPhase.SAVED)
            self._set(saved=file)

    def start_over(self) -> None:
        """Give up the presses and go back to the choice of the camera; a file that was written stays."""
        with self._changed:
            self._state = self._first_state()
            self.camera.restart_recording()
            self._watch, self._reference, self._refusal = None, None, ""
            self.on_load(0.0)

    def _set_presses(self, presses: tuple[TakenPress, ...]) -> None:
        self._set(presses=presses, scale=fit_scale_so_far(presses, self.calibration.fit))

    def _enter(self, phase: ForceCalibrationPhase) -> None:
        with self._changed:
            self._watch, self._refusal = None, ""
            self._set(phase=phase, advice="")
            self.on_load(self._state.load_g if phase is ForceCalibrationPhase.PRESS else 0.0)

    def _run(self) -> None:
        while not self.camera.closing.is_set():
            self._watch_camera(lambda: True)

    def _end_recording(self) -> None:
        """Say that a recording has ended; the presses that it showed stay."""
        if self.state.phase not in (ForceCalibrationPhase.PREVIEW, ForceCalibrationPhase.SAVED):
            ended = "expected further images, got the end of the recording; save the scale, or start over"
            self._set(camera_trouble=ended)

    def _evaluate(self, image: BgrImage) -> None:
        before = self._show_image(image, "Check the brightness, then start.")
        if before.phase not in (
            ForceCalibrationPhase.REFERENCE,
            ForceCalibrationPhase.PRESS,
            ForceCalibrationPhase.LIFT,
        ):
            return
        with self._changed:
            if self._state.phase is not before.phase:
                return  # somebody has pressed a button meanwhile
            watch = self._watch = self._watch or self._watcher(before.phase)
        seen = CalibrationStepAdvice("")
        try:
            seen = watch(image)
            done = None if seen.image is None else self._done_with(before, seen.image)
            refusal = self._refusal if seen.sentence.startswith(STILL) else ""
        except (NinedtactError, OSError) as trouble:
            done, refusal = None, str(trouble)
        with self._changed:
            if self._watch is not watch:
                return
            self._refusal = refusal  # which stays while the same press is held on
            self._set(advice=refusal or seen.sentence)
            if done is not None:
                done()
            elif seen.image is not None:
                self._watch = None  # this press is refused, and another one is awaited

    def _watcher(self, phase: ForceCalibrationPhase) -> ImageWatcher:
        if phase is ForceCalibrationPhase.PRESS:
            assert self._reference is not None
            return make_still_press_watcher(self._reference, self.hold_s)
        return make_untouched_skin_watcher(self._reference)

    def _done_with(self, before: ForceCalibrationState, image: BgrImage) -> Callable[[], None]:
        """Return what follows from the image with which a phase ends; raises why it cannot be used."""
        if before.phase is not ForceCalibrationPhase.PRESS:
            self.calibration.require_references([Frame(image)])
            return lambda: self._go_on(image)
        press = PressImage(f"the press with {before.load_g:g} g", Frame(image), self._references)
        _require_in_middle(self.calibration.read(press))
        estimate = self.calibration.estimate(press, before.load_g)
        return lambda: self._take(TakenPress(self._state.load_g, estimate, press))

    def _go_on(self, reference: BgrImage) -> None:
        """Wait for the next load, or for a person once all are taken."""
        was_lift, taken = self._state.phase is ForceCalibrationPhase.LIFT, len(self._state.presses)
        self._reference, self._references = reference, (Frame(reference),)
        if taken < len(self.loads_g) or not was_lift:  # a press that was dropped is asked for again
            if was_lift:
                self._set(load_g=self._next_load_g())
            self._enter(ForceCalibrationPhase.PRESS)
        else:
            self._enter(ForceCalibrationPhase.COMPLETE)

    def _next_load_g(self) -> float:
        taken = [press.grams for press in self._state.presses]
        left = [load for load in self.loads_g if all(abs(np.log(load / each)) > _ALIKE for each in taken)]
        return left[0] if left else self.loads_g[-1]

    def _take(self, press: TakenPress) -> None:
        """Keep a press and wait until its load is taken away."""
        self._set_presses((*self._state.presses, press))
        self._enter(ForceCalibrationPhase.LIFT)


def _require_in_middle(reading: Reading) -> None:
    """Raise `ForceScaleImpossible` for a press that the image does not show, or that is far from the middle."""
    centre_mm = reading.summary.contact_centre_mm
    if reading.force is None or not reading.force.touching or centre_mm is None:
        raise ForceScaleImpossible(
            expected="a press that the image shows", got="none", remedy="let the object rest on the skin"
        )
    if np.hypot(*centre_mm) > _MAX_OFF_CENTRE_MM:
        raise ForceScaleImpossible(
            expected=f"a press within {_MAX_OFF_CENTRE_MM:g} mm of the middle",
            got=f"one at x {round(centre_mm[0])}, y {round(centre_mm[1])} mm",
            remedy="press in the middle",
        )
