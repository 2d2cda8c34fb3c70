"""Advice during a guided calibration, image by image, and the decision of when an image is good enough to keep.

There are four steps: reference image, board press, reference image, ball press, and two more for a second ball. A step ends when
its condition holds in several successive images that hardly differ; the step returns their mean.
"""

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from time import monotonic

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact.calibration.ball.contact_circle import BallPressUnusable, ContactCircle, spherical_cap_height_mm
from ninedtact.calibration.ball.second_press import PressedBall, PressedObject, second_object
from ninedtact.calibration.board.board_fit import build_rectification, fit_board
from ninedtact.calibration.board.detection import BoardNotFound
from ninedtact.calibration.brightness_change import flat_fielded_brightness_change, overexposed_share, smooth_gaussian
from ninedtact.calibration.certificate.checks import CONTRAST_TO_NOISE
from ninedtact.calibration.sensor_toml_schema import MAX_ASYMMETRY
from ninedtact.calibration.settings import CalibrationSettings
from ninedtact.design import SecondKind, SensorDesign
from ninedtact.quantities import BgrImage, Frame
from ninedtact.shape.calibrated_shape import MIN_LIT_GREY_LEVEL
from ninedtact.shape.lens_and_rectification import Rectification, to_grey_float

AVERAGED = 8
"""Number of images that are averaged, which reduces their noise to a third."""
STILL_LEVELS = 1.5
"""Largest change of the smoothed image, grey levels, within the images that are averaged."""
TOUCHED_LEVELS = 2.5
"""Change from the reference image, in grey levels, above which there is contact."""
BEST_DEPTH_MM = (1.0, 2.2)
STILL = "hold still"
"""Beginning of the advice while something touches and has not yet been still for long enough."""
PATIENCE = 4
"""Number of still presses of which the last one is taken even where a better one is possible."""


_OFF_CENTRE = 0.12
"""Distance from the middle of the image, as a fraction of half its width or height, from which a side of it is named."""


@dataclass(frozen=True)
class PinSearchResult:
    """The pins of the board in one image of a press."""

    expected: int
    """Number of pins of the board."""
    found_px: Float[Array, "found 2"]
    missing_px: Float[Array, "missing 2"]
    """Where the lens predicts the other pins, or where they are likely; empty where too few were found."""
    has_lens: bool
    """Whether enough pins were found for a lens."""
    side: str
    """Part of the image in which pins are missing, such as "lower left"; empty where none are missing."""
    contrast_grey_levels: float = 0.0
    noise_grey_levels: float = 0.0

    @property
    def found(self) -> int:
        """Number of pins found."""
        return len(self.found_px)

    @property
    def advice(self) -> str:
        """How many pins were found, and what to do for the others."""
        if self.found == self.expected:
            return f"pins {self.found} of {self.expected}"
        where = f"press harder in the {self.side} part of the image" if self.side else "press harder"
        flat = "" if self.has_lens else " and hold the board flat"
        return f"pins {self.found} of {self.expected}: {where}{flat}"


def search_board_pins(
    reference: BgrImage, press: BgrImage, design: SensorDesign, settings: CalibrationSettings
) -> PinSearchResult:
    """Return which pins a press shows and where others are missing; raises `CalibrationError`."""
    expected, half = design.pin_board.count, np.array(press.shape[1::-1]) / 2
    try:
        fit = fit_board(reference, press, design.pin_board, settings.camera_rotation_deg, settings.camera_mirrored)
    except BoardNotFound as refusal:
        found_px = np.asarray(refusal.detected_px, float).reshape(-1, 2)
        missing_px, side = refusal.missing_px, ""
        if len(missing_px) or len(found_px):
            towards = missing_px.mean(axis=0) / half - 1 if len(missing_px) else 1 - found_px.mean(axis=0) / half
            side = _side_in_words(towards)
        return PinSearchResult(expected, found_px, missing_px, has_lens=False, side=side)
    missing_px = fit.points_px[~fit.found]
    side = _side_in_words(missing_px.mean(axis=0) / half - 1) if len(missing_px) else ""
    contrast, noise = float(np.median(fit.contrast)), fit.camera_noise_grey_levels
    return PinSearchResult(expected, fit.points_px[fit.found], missing_px, True, side, contrast, noise)


def _side_in_words(towards: Float[Array, " 2"]) -> str:
    """Return the part of the image in a direction from its middle, columns to the right and rows down."""
    column, row = (0 if abs(part) < _OFF_CENTRE else int(np.sign(part)) for part in towards.tolist())
    return " ".join(filter(None, (("upper", "", "lower")[row + 1], ("left", "", "right")[column + 1]))) or "middle"


@dataclass(frozen=True)
class CalibrationStepAdvice:
    """Advice about the latest image, and the image to keep once the step is done."""

    sentence: str
    image: BgrImage | None = None
    pins: PinSearchResult | None = None
    """The pins of the board, where this image was searched for them."""


@dataclass
class _StillFrameAverager:
    """Collects images that hardly differ, and starts over when something moves."""

    images: deque[BgrImage] = field(default_factory=lambda: deque(maxlen=AVERAGED))

    def add(self, image: BgrImage) -> BgrImage | None:
        """Add an image; return the mean once enough successive images are alike."""
        if self.images:
            change = smooth_gaussian(to_grey_float(image) - to_grey_float(self.images[0]), 3.0)
            if np.abs(change).max() > STILL_LEVELS:
                self.images.clear()
        self.images.append(image)
        if len(self.images) < AVERAGED:
            return None
        return np.asarray(np.round(np.mean(np.stack(self.images), axis=0)), np.uint8)

    def __len__(self) -> int:
        return len(self.images)


ImageWatcher = Callable[[BgrImage], CalibrationStepAdvice]


@dataclass(frozen=True)
class CaptureStep:
    """One of the images: its instruction, and the watcher that evaluates frames."""

    name: str
    """Name of the image among those of a calibration."""
    instruction: str
    watch: Callable[[dict[str, BgrImage]], ImageWatcher]
    """Builds the watcher from the images taken so far."""


def guided_capture_steps(
    design: SensorDesign, settings: CalibrationSettings, second: Sequence[SecondKind] = ()
) -> Iterator[CaptureStep]:
    """Yield the steps in order: four, and two more for every second object; raises `InputError` for one too deep for the gel."""
    objects = [second_object(kind, design) for kind in second]
    yield CaptureStep("board_reference", "Do not touch the gel.", lambda taken: make_untouched_skin_watcher(None))
    yield CaptureStep(
        "board",
        f"Press the pin board ({design.pin_board.cols} x {design.pin_board.rows} pins) evenly on the skin and hold it.",
        lambda taken: BoardPressWatcher(taken["board_reference"], design, settings),
    )
    yield CaptureStep(
        "ball_reference", "Take the board away.", lambda taken: make_untouched_skin_watcher(taken["board_reference"])
    )
    yield CaptureStep(
        "ball",
        f"Press the ball (radius {design.ball.radius_mm:g} mm) straight down near the middle, 1 to 2 mm deep, and hold it.",
        _press_watcher("ball_reference", PressedBall(design.ball.radius_mm), design, settings),
    )
    for pressed in objects:
        yield CaptureStep(
            f"{pressed.kind}_reference",
            "Take it away.",
            lambda taken: make_untouched_skin_watcher(taken["ball_reference"]),
        )
        yield CaptureStep(
            pressed.kind,
            f"{_press_instruction(pressed)}, and hold it.",
            _press_watcher(f"{pressed.kind}_reference", pressed, design, settings),
        )


def _press_instruction(pressed: PressedObject) -> str:
    """Return how a second object is pressed."""
    name = f"Press the {pressed.name} (radius {pressed.radius_mm:g} mm) straight down near the middle"
    if pressed.known_depth is not None:
        return f"{name} to its stop, {pressed.known_depth[0]:g} mm deep"
    least_mm, most_mm = _best_depth_mm(pressed)
    return f"{name}, {least_mm:.1f} to {most_mm:.1f} mm deep"


def _press_watcher(
    reference: str, pressed: PressedObject, design: SensorDesign, settings: CalibrationSettings
) -> "Callable[[dict[str, BgrImage]], _RoundPressWatcher]":
    """Return what builds the watcher of a press. reference: name of the image of the skin before it."""
    return lambda taken: _RoundPressWatcher(
        taken[reference], _rectification_from_board(taken, design, settings), pressed, settings
    )


def make_untouched_skin_watcher(like: BgrImage | None) -> ImageWatcher:
    """Return a watcher for still, well-lit skin without contact; `like` is an earlier image of it, where there is one."""
    still = _StillFrameAverager()

    def watch(image: BgrImage) -> CalibrationStepAdvice:
        hint = exposure_advice(image)
        if hint:
            return CalibrationStepAdvice(hint)
        if like is not None and (change := peak_local_brightness_change(like, image)) > 2 * TOUCHED_LEVELS:
            still.images.clear()
            return CalibrationStepAdvice(f"something still touches the skin ({change:.0f} grey levels); wait")
        mean = still.add(image)
        return CalibrationStepAdvice(
            "reference image taken" if mean is not None else f"hold still {len(still)}/{AVERAGED}", mean
        )

    return watch


def make_still_press_watcher(reference: BgrImage, hold_s: float) -> ImageWatcher:
    """Return a watcher for anything that is pressed on the skin and held still for a time."""
    still, began_s = _StillFrameAverager(), monotonic()

    def watch(image: BgrImage) -> CalibrationStepAdvice:
        nonlocal began_s
        if peak_local_brightness_change(reference, image) < TOUCHED_LEVELS:
            still.images.clear()
            return CalibrationStepAdvice("nothing touches the skin yet")
        mean, now_s = still.add(image), monotonic()
        began_s = now_s if len(still) == 1 else began_s
        left_s = hold_s - (now_s - began_s)
        if mean is None or left_s > 0:
            return CalibrationStepAdvice(STILL + (f", {left_s:.1f} s more" if left_s > 0 else ""))
        return CalibrationStepAdvice("taken", mean)

    return watch


def exposure_advice(image: BgrImage) -> str:
    """Return advice about the exposure, or an empty text."""
    grey = to_grey_float(image)
    if grey.mean() < 4 * MIN_LIT_GREY_LEVEL:
        return f"too dark (mean {grey.mean():.0f} of 255): switch the light on, raise the exposure"
    if (share := overexposed_share(image)) > 0.02:
        return f"overexposed ({share:.0%} of the image): lower exposure or gain"
    return ""


def peak_local_brightness_change(reference: BgrImage, image: BgrImage) -> float:
    """Return the largest change of brightness that is wider than a few pixels, in grey levels."""
    change = smooth_gaussian(flat_fielded_brightness_change(reference, image), 4.0)
    return float(np.abs(change - np.median(change)).max())


@dataclass
class BoardPressWatcher:
    """Counts pins; accepts a press with all pins, or after several still presses one with as many as a lens needs."""

    reference: BgrImage
    design: SensorDesign
    settings: CalibrationSettings
    still: _StillFrameAverager = field(default_factory=_StillFrameAverager)
    patience: int = PATIENCE
    pins: PinSearchResult | None = None
    """The pins in the latest image of this press that was searched for them, here or by whoever shows them."""

    def __call__(self, image: BgrImage) -> CalibrationStepAdvice:
        """Evaluate one image."""
        if peak_local_brightness_change(self.reference, image) < TOUCHED_LEVELS:
            self.still.images.clear()
            self.pins = None
            return CalibrationStepAdvice("nothing touches the skin yet")
        mean = self.still.add(image)
        if mean is not None:
            return self._evaluate_press(mean)
        counted = "" if self.pins is None else f"{self.pins.advice}; "
        return CalibrationStepAdvice(f"{counted}hold still {len(self.still)}/{AVERAGED}")

    def _evaluate_press(self, mean: BgrImage) -> CalibrationStepAdvice:
        """Return the advice about a still press, and the image where it is good enough."""
        self.pins = pins = search_board_pins(self.reference, mean, self.design, self.settings)
        self.patience -= pins.has_lens
        if not pins.has_lens or (pins.found < pins.expected and self.patience > 0):
            self.still.images.clear()
            return CalibrationStepAdvice(pins.advice, pins=pins)
        faint = pins.contrast_grey_levels <= CONTRAST_TO_NOISE.good * pins.noise_grey_levels
        focus = "; faint: press harder next time, check the focus" if faint else ""
        return CalibrationStepAdvice(
            f"board taken: {pins.found} of {pins.expected} pins, {pins.contrast_grey_levels:.0f} grey levels deep{focus}",
            mean,
            pins,
        )


@dataclass
class _RoundPressWatcher:
    """Measures the disc; accepts a still, even press of useful depth, or after several still presses any that can be calibrated."""

    reference: BgrImage
    rectify: Rectification
    pressed: PressedObject
    settings: CalibrationSettings
    still: _StillFrameAverager = field(default_factory=_StillFrameAverager)
    patience: int = PATIENCE

    def __call__(self, image: BgrImage) -> CalibrationStepAdvice:
        """Evaluate one image."""
        try:
            before, after = self.rectify(Frame(self.reference)), self.rectify(Frame(image))
            circle = self.pressed.find_contact(before, after, self.settings.method)
        except BallPressUnusable as refusal:
            self.still.images.clear()
            return CalibrationStepAdvice(str(refusal).partition(", got ")[2])
        seen, advice = _press_advice(self.pressed, circle, circle.radius_px * self.rectify.mm_per_px)
        mean = self.still.add(image)
        if mean is None or (advice and self._awaits_better_press()):
            return CalibrationStepAdvice(f"{seen}, {advice or f'hold still {len(self.still)}/{AVERAGED}'}")
        name = "ball" if self.pressed.known_depth is None else self.pressed.name
        return CalibrationStepAdvice(f"{name} taken: {seen}, uneven by {circle.asymmetry:.0%}", mean)

    def _awaits_better_press(self) -> bool:
        """Return whether a better press is still awaited; this one counts, and the next must be held still again."""
        self.still.images.clear()
        self.patience -= 1
        return self.patience > 0


def _best_depth_mm(ball: PressedObject) -> tuple[float, float]:
    """Return the least and the largest depth of a good press of a ball; a small one is soon as wide as its disc."""
    least_mm, most_mm = BEST_DEPTH_MM
    return min(least_mm, 0.25 * ball.radius_mm), min(most_mm, 0.55 * ball.radius_mm)


def _press_advice(pressed: PressedObject, circle: ContactCircle, disc_mm: float) -> tuple[str, str]:
    """Return what is seen of a press, and advice that would improve it; a flat end is as deep as its stop lets it go."""
    sheared = "press straight down, it is sheared" if circle.asymmetry > MAX_ASYMMETRY else ""
    if pressed.known_depth is not None:
        return f"a disc of {disc_mm:.2f} mm", ""
    depth_mm = spherical_cap_height_mm(pressed.radius_mm, min(disc_mm, pressed.radius_mm))
    least_mm, most_mm = _best_depth_mm(pressed)
    too = "press deeper" if depth_mm < least_mm else "press less deep" if depth_mm > most_mm else ""
    return f"{depth_mm:.2f} mm deep", too or sheared


def _rectification_from_board(
    taken: dict[str, BgrImage], design: SensorDesign, settings: CalibrationSettings
) -> Rectification:
    """Return the rectification from the board image just taken."""
    board = fit_board(
        taken["board_reference"],
        taken["board"],
        design.pin_board,
        settings.camera_rotation_deg,
        settings.camera_mirrored,
    )
    return build_rectification(board, design, settings.lens)
