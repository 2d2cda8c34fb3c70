"""The camera of a simulated sensor that is calibrated: a person, or a script, presses the pin board and the ball on it.

It is a camera like any other. `hold` presses a gauge, as sliders of a page do; with `plays_by_itself`, `follow` presses what
each step of a guided calibration needs.
"""

import time
from dataclasses import dataclass, replace
from math import radians
from threading import Event, Lock
from typing import Literal

import numpy as np
from jaxtyping import Float32
from numpy import ndarray as Array

from ninedtact.capture.frame_source import ExposureWithLimits, FrameSource, SourceNotOpen
from ninedtact.design import SecondKind, SensorDesign
from ninedtact.errors import CameraError, NinedtactError
from ninedtact.mechanics.indenter import Ball, FlatPunch, Indenter
from ninedtact.quantities import Frame
from ninedtact.simulation.calibration_images import (
    CALIBRATION_SOLVER_SETTINGS,
    FLAT_END_EDGE_MM,
    GUIDED_PRESSES,
    SECOND_BALL_DEPTH,
    refine_twin_grid_for_board,
)
from ninedtact.simulation.calibration_press_models import pin_board_indenter
from ninedtact.simulation.trajectory import ScriptedPress
from ninedtact.simulation.twin import Twin

_LOOSER_SOLVER_SETTINGS = replace(CALIBRATION_SOLVER_SETTINGS, tolerance=2 * CALIBRATION_SOLVER_SETTINGS.tolerance)


@dataclass(frozen=True)
class HeldCalibrationObject:
    """What is held on the skin, and how."""

    gauge: Literal["nothing", "board", "ball"] | SecondKind = "nothing"
    depth_mm: float = 0.0
    load_n: float | None = None
    """Load instead of a depth."""
    tilt_deg: tuple[float, float] = (0.0, 0.0)
    """Tilts about x and y."""
    drag_mm: tuple[float, float] = (0.0, 0.0)
    at_mm: tuple[float, float] = (0.0, 0.0)
    """Position on the skin."""


_EXPOSURE = ExposureWithLimits(10.0, 1.0, 40.0)
"""The exposure at which the twin's images are as bright as its reference image, and the limits that the camera pretends to have."""


class SimulatedCalibrationCamera(FrameSource):
    """Delivers the images of a twin on which the pin board or the ball is held; `hold` and `follow` work from any thread."""

    name = "simulated sensor"
    is_simulated = True

    def __init__(self, twin: Twin, design: SensorDesign, plays_by_itself: bool = True, rate_hz: float = 15.0) -> None:
        self.refusal = ""
        """Why the mechanics refused the last press, which is then not shown; empty where it did not."""
        self._twin, self._design, self._fine_twin = twin, design, refine_twin_grid_for_board(twin, design)
        self._plays_by_itself, self._offered, self._rate_hz = plays_by_itself, HeldCalibrationObject(), rate_hz
        self._lock, self._is_closed, self._due_at, self._number = Lock(), Event(), 0.0, 0
        self._held = self._rendered = HeldCalibrationObject()
        self._clean: Float32[Array, "rows cols 3"] = twin.renderer.reference
        self._exposure_ms = _EXPOSURE.now_ms
        self._is_closed.set()

    @property
    def exposure(self) -> ExposureWithLimits:
        """The exposure, which brightens or darkens the images in proportion."""
        return replace(_EXPOSURE, now_ms=self._exposure_ms)

    def set_exposure(self, exposure_ms: float) -> None:
        """Set the exposure; raises `CameraError` beyond its limits."""
        if not _EXPOSURE.least_ms <= exposure_ms <= _EXPOSURE.most_ms:
            raise CameraError(
                expected=f"an exposure of {_EXPOSURE.least_ms:g} to {_EXPOSURE.most_ms:g} ms for {self.name}",
                got=f"{exposure_ms:g} ms",
                remedy="choose one of these",
            )
        self._exposure_ms = exposure_ms

    @property
    def plays_by_itself(self) -> bool:
        """Whether each step of the calibration is pressed without a person."""
        return self._plays_by_itself

    @plays_by_itself.setter
    def plays_by_itself(self, wanted: bool) -> None:
        self._plays_by_itself = wanted
        self.offer(self._offered)

    @property
    def held(self) -> HeldCalibrationObject:
        """What is held on the skin."""
        with self._lock:
            return self._held

    def hold(self, press: HeldCalibrationObject) -> None:
        """Hold a gauge on the skin from the next image on."""
        with self._lock:
            self._held = press

    def follow(self, step: str) -> None:
        """Press what a step needs ("board", "ball", a `SecondKind`; nothing in any other), where the camera plays by itself."""
        self.offer(self.good_press(step))

    def offer(self, press: HeldCalibrationObject) -> None:
        """Hold a press where the camera plays by itself, now or once it does."""
        self._offered = press
        if self._plays_by_itself:
            self.hold(press)

    def good_press(self, gauge: str) -> HeldCalibrationObject:
        """Return a press of the board or of another object that calibrates well; nothing for any other name."""
        presses = GUIDED_PRESSES.for_gel(self._design.gel)
        if gauge == "board":
            return HeldCalibrationObject("board", presses.board_depth_mm)
        if gauge == "second_ball":
            depth_mm = presses.ball_depth_mm * min(
                1.0, self._design.ball.radius_mm / self._design.ball.second_radius_mm
            )
            depth_mm = min(depth_mm, SECOND_BALL_DEPTH * self._design.ball.second_radius_mm)
            return HeldCalibrationObject("second_ball", depth_mm, drag_mm=presses.ball_drag_mm)
        if gauge == "flat_end":
            return HeldCalibrationObject("flat_end", self._design.flat_end.depth_mm)
        return (
            HeldCalibrationObject("ball", presses.ball_depth_mm, drag_mm=presses.ball_drag_mm)
            if gauge == "ball"
            else HeldCalibrationObject()
        )

    def open(self) -> None:
        """Begin to deliver images."""
        self._is_closed.clear()
        self._due_at = time.monotonic()

    def read(self) -> Frame:
        """Wait until the next image is due and return it; raises `SourceNotOpen`."""
        if self._is_closed.wait(max(0.0, self._due_at - time.monotonic())):
            raise SourceNotOpen(self.name)
        self._due_at = max(self._due_at + 1 / self._rate_hz, time.monotonic())
        if (held := self.held) != self._rendered:
            self._rendered = held
            self._press(held)
        self._number += 1
        exposed = self._clean * np.float32(self._exposure_ms / _EXPOSURE.now_ms)
        noisy = self._twin.renderer.noise.add_to(exposed, self._number)
        return Frame(np.asarray(noisy, np.uint8), time.monotonic_ns(), self._number - 1)

    def close(self) -> None:
        """Stop."""
        self._is_closed.set()

    def _indenter(self, gauge: str) -> Indenter:
        """Return what is held on the skin."""
        design = self._design
        if gauge == "board":
            return pin_board_indenter(design.pin_board)
        if gauge == "flat_end":
            return FlatPunch(design.flat_end.radius_mm, FLAT_END_EDGE_MM)
        return Ball(design.ball.second_radius_mm if gauge == "second_ball" else design.ball.radius_mm)

    def _press(self, held: HeldCalibrationObject) -> None:
        """Solve the contact of a press and render it; a press that the mechanics refuse leaves the image as it was."""
        self.refusal = ""
        if held.gauge == "nothing" or (held.depth_mm <= 0 and not held.load_n):
            self._clean = self._twin.renderer.reference
            return
        is_board, tilt = held.gauge == "board", (radians(held.tilt_deg[0]), radians(held.tilt_deg[1]))
        indenter = self._indenter(held.gauge)
        twin = self._fine_twin if is_board else self._twin
        depth_mm = held.depth_mm if held.load_n is None else None
        press = ScriptedPress(depth_mm, held.load_n, held.at_mm, held.drag_mm, tilt_rad=tilt)
        # A few light presses miss the tolerance by a hair; a person who practises is shown them nevertheless.
        for settings in (CALIBRATION_SOLVER_SETTINGS, _LOOSER_SOLVER_SETTINGS):
            try:
                contact = press.simulate(twin, indenter, settings)
            except NinedtactError as refusal:
                self.refusal = str(refusal)
            else:
                self.refusal, self._clean = "", self._twin.renderer.render_without_noise(contact)
                return
