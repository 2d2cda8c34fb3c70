"""What all guided procedures share: the camera that is chosen, the quality of its images, and the one state of a session.

`SwitchableCamera.images` opens the chosen camera and yields its images in the thread of the procedure. A camera that is absent or
lost is waited for, and gets back the exposure that a person has set. A `GuidedSession` evaluates these images in its thread and
holds the `GuidedState` that all viewers of its page show.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from threading import Condition, Event, RLock, Thread
from typing import Generic, TypeVar

import cv2

from ninedtact.calibration.brightness_change import overexposed_share
from ninedtact.calibration.guidance import exposure_advice
from ninedtact.capture.frame_pacing import LatestFrameSource
from ninedtact.capture.frame_source import ExposureWithLimits, FrameSource, SourceEnded
from ninedtact.errors import NinedtactError
from ninedtact.quantities import BgrImage
from ninedtact.shape.lens_and_rectification import to_grey_float

MAX_AGE_MS = 2000.0
"""Greatest age of an image that is used; still images need not be recent."""
RETRY_S = 0.5
"""Time between attempts to open a camera that is absent."""
_SHARPNESS_BLUR_PX = 1.5
"""Blur before the sharpness is measured, so that noise of the camera does not count as detail."""


@dataclass(frozen=True)
class ImageQuality:
    """Brightness and sharpness of a live image."""

    mean_grey: float
    overexposed_share: float
    """Share of the image that is too bright to measure."""
    sharpness: float
    """Standard deviation of the second derivative of the image, grey levels; larger is sharper."""
    best_sharpness: float
    """The largest sharpness of this preview."""
    advice: str
    """What to change of the exposure; empty where it is fine."""


def measure_image_quality(image: BgrImage, last: ImageQuality | None) -> ImageQuality:
    """Return brightness and sharpness of an image; `last` is that of the image before it."""
    grey = to_grey_float(image)
    curvature = cv2.Laplacian(cv2.GaussianBlur(grey, (0, 0), _SHARPNESS_BLUR_PX), cv2.CV_32F)
    sharpness = float(curvature.std())
    best = sharpness if last is None else max(sharpness, last.best_sharpness)
    return ImageQuality(float(grey.mean()), overexposed_share(image), sharpness, best, exposure_advice(image))


@dataclass
class SwitchableCamera:
    """Reads the chosen camera until it is closed; another may be chosen while it reads, and its exposure set, from any thread."""

    open_source: Callable[[str], FrameSource]
    """Returns the source of an address, not yet opened."""
    source: str
    is_recording: bool = field(default=False, init=False)
    """Whether the source that was opened last is a recording, which ends."""
    closing: Event = field(default_factory=Event, init=False)

    def __post_init__(self) -> None:
        self._lock, self._reopen = RLock(), False
        self._opened: FrameSource | None = None
        self._wanted_exposure_ms: dict[str, float] = {}

    def choose(self, source: str) -> None:
        """Read another source from the next image on."""
        with self._lock:
            self.source, self._reopen = source, True

    def restart_recording(self) -> None:
        """Begin a recording again with its first image; nothing happens with a camera."""
        self._reopen = self.is_recording

    @property
    def exposure(self) -> ExposureWithLimits | None:
        """The exposure of the camera that is open; None where none is open, or where it cannot be set."""
        with self._lock:
            return None if self._opened is None else self._opened.exposure

    def set_exposure(self, exposure_ms: float) -> None:
        """Set the exposure of the camera that is open, now and when it comes back; raises `CameraError`."""
        with self._lock:
            if self._opened is not None:
                self._opened.set_exposure(exposure_ms)
                self._wanted_exposure_ms[self.source] = exposure_ms

    def images(self, is_wanted: Callable[[], bool]) -> Iterator[BgrImage]:
        """Yield the images of the source while they are wanted, until another is chosen.

        Raises `SourceEnded` at the end of a recording, and what opening or reading another source raises.
        """
        with self._lock:
            self._reopen, source = False, self.source
        try:
            opened = self.open_source(source)
            self.is_recording = not opened.is_live
            with LatestFrameSource(opened, max_age_ms=MAX_AGE_MS) if opened.is_live else opened as camera:
                self._adopt(opened, source)
                while is_wanted() and not (self.closing.is_set() or self._reopen):
                    yield camera.read().image
        finally:
            with self._lock:
                self._opened = None

    def _adopt(self, opened: FrameSource, source: str) -> None:
        """Keep the source that was opened, and give it the exposure that was set before it was lost."""
        with self._lock:
            if source in self._wanted_exposure_ms:
                opened.set_exposure(self._wanted_exposure_ms[source])
            self._opened = opened


@dataclass(frozen=True, kw_only=True)
class GuidedState(ABC):
    """What the page of every guided procedure shows."""

    source: str = ""
    advice: str = "Waiting for the first image."
    camera_trouble: str = ""
    """Why no images arrive; empty while they do."""
    image: BgrImage | None = None
    quality: ImageQuality | None = None
    exposure: ExposureWithLimits | None = None
    """The camera's exposure; None where it cannot be set."""

    @property
    @abstractmethod
    def is_preview(self) -> bool:
        """Whether nothing has begun, so that the camera can be chosen and exposed."""


State = TypeVar("State", bound=GuidedState)


@dataclass
class GuidedSession(ABC, Generic[State]):
    """One guided procedure for all viewers of a page; used in a `with` statement, and from any thread."""

    camera: SwitchableCamera
    live_requested: Event = field(default_factory=Event, init=False)
    """Set when somebody wants to see the sensor live."""

    def __post_init__(self) -> None:
        self._changed, self._state = Condition(), self._first_state()
        self._failure: BaseException | None = None
        self._thread = Thread(target=self._run_until_closed, name=type(self).__name__, daemon=True)

    @abstractmethod
    def _first_state(self) -> State:
        """Return the state of the preview."""

    @abstractmethod
    def _run(self) -> None:
        """Do what is to be done, until the camera is closed."""

    @abstractmethod
    def _evaluate(self, image: BgrImage) -> None:
        """Update the state by one image."""

    @abstractmethod
    def _end_recording(self) -> None:
        """Update the state at the end of a recording."""

    def __enter__(self) -> "GuidedSession[State]":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.camera.closing.set()
        with self._changed:
            self._changed.notify_all()
        self._thread.join()

    @property
    def state(self) -> State:
        """What all viewers show; raises an error of the program that has ended the session."""
        with self._changed:
            if self._failure is not None:
                raise self._failure
            return self._state

    def choose_source(self, source: str) -> None:
        """Show another camera; nothing happens once the procedure has begun, since all its images must be of one camera."""
        with self._changed:
            if self._state.is_preview and source != self.camera.source:
                self.camera.choose(source)
                self._set(
                    source=source,
                    image=None,
                    quality=None,
                    exposure=None,
                    camera_trouble="",
                    advice="Opening the camera.",
                )

    def set_exposure(self, exposure_ms: float) -> None:
        """Set the camera's exposure; nothing happens once the procedure has begun, since all its images must be of one exposure.

        Raises `CameraError`.
        """
        if self.state.is_preview:
            self.camera.set_exposure(exposure_ms)
            self._set(exposure=self.camera.exposure)

    def _set(self, **changes: object) -> None:
        with self._changed:
            self._state = replace(self._state, **changes)  # type: ignore[arg-type]
            self._changed.notify_all()

    def _show_image(self, image: BgrImage, hint: str) -> State:
        """Show an image and its quality, in the preview with advice: hint where its exposure is fine. Return the state before."""
        quality = measure_image_quality(image, self.state.quality)
        with self._changed:
            before = self._state
            exposure = self.camera.exposure if before.image is None else before.exposure
            advice = {"advice": quality.advice or hint} if before.is_preview else {}
            self._set(image=image, quality=quality, exposure=exposure, camera_trouble="", **advice)
            return before

    def _watch_camera(self, is_wanted: Callable[[], bool]) -> None:
        """Evaluate the images of the chosen source while they are wanted, until another is chosen or it is lost."""
        source = self.camera.source
        try:
            for image in self.camera.images(is_wanted):
                self._evaluate(image)
            return
        except SourceEnded:
            self._end_recording()
        except (NinedtactError, OSError) as trouble:
            if source == self.camera.source:
                self._set(camera_trouble=str(trouble))
        self.camera.closing.wait(RETRY_S)

    def _run_until_closed(self) -> None:
        """Run, and hand an error that is no refusal to whoever asks for the state."""
        try:
            self._run()
        except BaseException as error:
            self._failure = error
