"""The depth of the calibration's ball on bases from soft to rigid: from one ball, and with a second one of another radius.

Every sensor of the population is put on bases of several moduli and calibrated from its own images, lens included, with a second
ball pressed on the same gel. The first ball is then fitted alone through the same lens. The truth is that of the simulation. Beside
it stand the errors that `ninedtact calibrate --plan` predicts for the fitted sensor.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np
import tyro
from figures import Figure, answer, at_most, holds

from ninedtact import CalibrationImages, SensorDesign, calibrate
from ninedtact.calibration.ball.ball_press import find_ball_press
from ninedtact.calibration.ball.contact_circle import BallPressUnusable
from ninedtact.calibration.board.board_fit import build_rectification, fit_board
from ninedtact.calibration.second_press_plan import (
    CandidatePress,
    KnownPress,
    errors_with_candidate,
)
from ninedtact.calibration.twin.ball_press_fit import TwinFit, fit_twin_to_ball_press
from ninedtact.capture.strict_image_reading import average_images
from ninedtact.design import BallGauge, Gel
from ninedtact.mechanics.indenter import Ball
from ninedtact.simulation.calibration_images import (
    CALIBRATION_SOLVER_SETTINGS,
    SECOND_BALL_DEPTH,
    simulate_calibration_images,
)
from ninedtact.simulation.trajectory import ScriptedPress
from ninedtact_train.population.mechanics_shares import MechanicsShares
from ninedtact_train.population.sensor_population import SampledSensor, sample_sensor

BASES = {"3": 1 / 3, "5": 0.2, "10": 0.1, "25": 0.04, "rigid": 0.0}
"""Modulus of the base over that of the gel, and the ratio as the calibration has it."""
LAYERED = MechanicsShares(rigid_base=0.0, linear=0.0)
FRAMES = 4
MAX_RELATIVE_ERROR = 0.03
WITHIN_ONE, WITHIN_TWO = (0.60, 0.78), (0.90, 0.98)
AT_MM, DRAG_MM = (1.0, -0.5), (-0.1, 0.15)


@dataclass(frozen=True)
class DepthFound:
    """The depth of the first ball, of one sensor on one base."""

    true_mm: float
    found_mm: float
    std_mm: float

    @property
    def relative_error(self) -> float:
        return self.found_mm / self.true_mm - 1

    @property
    def deviation(self) -> float:
        return abs(self.found_mm - self.true_mm) / self.std_mm


def second_ball(
    sensors: int = 2, radius_mm: float = 2.5, seed: int = 32, quick: bool = False, json: bool = False
) -> None:
    """Calibrate sensors on every base."""
    cv2.setNumThreads(1)
    bases = {"rigid": BASES["rigid"]} if quick else BASES
    alone: list[DepthFound] = []
    both: list[DepthFound] = []
    figures: list[Figure] = []
    for base, ratio in bases.items():
        for number in range(1 if quick else sensors):
            who = sample_sensor(number, seed, LAYERED)
            who = replace(who, gel=replace(who.gel, gel_to_base_modulus_ratio=ratio))
            name = f"base {base}, sensor {number}"
            try:
                one, two, planned_mm = depths(who, radius_mm, quick)
            except BallPressUnusable as refusal:
                figures.append(Figure(f"{name}: refused", str(refusal)))
                continue
            alone.append(one)
            both.append(two)
            figures += list(of_one_sensor(name, one, two, planned_mm))
    answer(
        f"Depth of the calibration's ball, with a second ball of radius {radius_mm:g} mm",
        [*figures, *summary(alone, both)],
        json,
    )


def of_one_sensor(name: str, one: DepthFound, two: DepthFound, planned_mm: float) -> Iterator[Figure]:
    """Errors in per cent, and the ± in mm."""
    yield Figure(f"{name}: one ball, error", f"{one.relative_error:+.1%} (± {one.std_mm:.3f} of {one.true_mm:.2f} mm)")
    yield Figure(
        f"{name}: two balls, error", f"{two.relative_error:+.1%} (± {two.std_mm:.3f}; planned ± {planned_mm:.3f})"
    )


def summary(alone: list[DepthFound], both: list[DepthFound]) -> Iterator[Figure]:
    """The largest error, and how often the truth is within the stated ±."""
    yield Figure("one ball: largest error", max(abs(one.relative_error) for one in alone))
    yield at_most("two balls: largest error", max(abs(one.relative_error) for one in both), MAX_RELATIVE_ERROR)
    for name, found in (("one ball", alone), ("two balls", both)):
        for times, (least, most) in ((1, WITHIN_ONE), (2, WITHIN_TWO)):
            share = float(np.mean([one.deviation < times for one in found]))
            yield holds(f"{name}: truth within {times} σ", share, f"{least:g} to {most:g}", least <= share <= most)


def depths(who: SampledSensor, radius_mm: float, quick: bool) -> tuple[DepthFound, DepthFound, float]:
    """The depth from the first ball alone and from both, and the ± that was planned for both.

    quick: by the lens of the pins alone, on a base that is known to be rigid.
    """
    true_mm = who.presses.for_gel(who.design.gel).ball_depth_mm
    design = SensorDesign(ball=BallGauge(second_radius_mm=radius_mm), gel=who.gel if quick else Gel())
    images = images_with_second_ball(who, radius_mm, true_mm)
    assert images.board_pair is not None and images.ball_pair is not None and images.second_ball_pair is not None
    if not quick:
        made = calibrate(images, design)
        fit, rectify = made.fits.twin, made.rectify
        priors = () if made.fits.board_press is None else made.fits.board_press.priors
    else:
        fit, rectify = None, build_rectification(fit_board(*images.board_pair, design.pin_board), design)
        priors = ()
    press = find_ball_press(rectify, *images.ball_pair, design.ball, "physics")
    if fit is None:
        second = find_ball_press(rectify, *images.second_ball_pair, design.ball.second, "physics")
        fit = fit_twin_to_ball_press(press, design, further=(second,))
    alone = fit_twin_to_ball_press(press, design, priors)
    known = KnownPress(
        design, alone.press, alone.light, alone.uncertainty.effective_observations, alone.image_rmse_grey_levels
    )
    candidate = CandidatePress("second ball", Ball(radius_mm), fit.further[0].press.depth_mm)
    return found(alone, true_mm), found(fit, true_mm), errors_with_candidate(known, candidate).depth_mm


def found(fit: TwinFit, true_mm: float) -> DepthFound:
    return DepthFound(true_mm, fit.press.depth_mm, fit.uncertainty.standard_deviations["depth_mm"])


def images_with_second_ball(who: SampledSensor, radius_mm: float, first_mm: float) -> CalibrationImages:
    """The images of a sensor, with those of a second ball: a contact of the same area, or as deep as a small ball can be."""
    twin = who.twin()
    images = simulate_calibration_images(twin, who.design, presses=who.presses, frames=FRAMES)
    depth_mm = min(first_mm, SECOND_BALL_DEPTH * radius_mm, first_mm * who.design.ball.radius_mm / radius_mm)
    press = ScriptedPress(depth_mm, at_mm=AT_MM, drag_mm=DRAG_MM)
    contact = press.simulate(twin, Ball(radius_mm), CALIBRATION_SOLVER_SETTINGS)
    before, after = (
        average_images([twin.renderer(one, first + n) for n in range(FRAMES)])
        for one, first in ((None, 500), (contact, 600))
    )
    return CalibrationImages(**vars(images), second_ball_reference=before, second_ball=after)


if __name__ == "__main__":
    tyro.cli(second_ball)
