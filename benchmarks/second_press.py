"""The depth of the calibration's ball on bases from soft to rigid: from one ball, and with a second press on the same gel, of a
ball of another radius, of the flat end of a rod at a known depth, or both.

Every sensor of the population is put on bases of several moduli and calibrated from its own images, lens included, with both second
objects. The first ball is then fitted alone and with each of them through the same lens. The flat end is tilted and dragged a
little, its edge is rounder than the fit takes it to be, and its stop errs as stated. The truth is that of the simulation. Beside it
stand the errors that `ninedtact calibrate --plan` predicts for the fitted sensor.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import radians

import cv2
import numpy as np
import tyro
from figures import Figure, answer, at_most, holds

from ninedtact import CalibrationImages, SensorDesign, calibrate
from ninedtact.calibration.ball.ball_press import find_ball_press
from ninedtact.calibration.ball.contact_circle import BallPressUnusable
from ninedtact.calibration.ball.second_press import ObjectPress, find_second_presses
from ninedtact.calibration.board.board_fit import build_rectification, fit_board
from ninedtact.calibration.procedure import second_image_names
from ninedtact.calibration.second_press_plan import CandidatePress, KnownPress, errors_with_candidate
from ninedtact.calibration.twin.ball_press_fit import TwinFit, fit_twin_to_ball_press
from ninedtact.capture.strict_image_reading import average_images
from ninedtact.design import BallGauge, FlatEndGauge, Gel, SecondKind
from ninedtact.mechanics.indenter import Ball, FlatPunch, Indenter
from ninedtact.quantities import BgrImage
from ninedtact.shape.lens_and_rectification import Rectification
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
TILT_DEG, EDGE_MM = (1.0, -0.6), 0.35
"""Tilt of the flat end, and radius of its edge, of which the fit knows nothing."""
ONE, BALLS, FLAT, ALL = "one ball", "second ball", "flat end", "both"
OBJECTS: dict[str, tuple[SecondKind, ...]] = {
    ONE: (),
    BALLS: ("second_ball",),
    FLAT: ("flat_end",),
    ALL: ("second_ball", "flat_end"),
}


@dataclass(frozen=True)
class DepthFound:
    """The depth of the first ball, of one sensor on one base."""

    true_mm: float
    found_mm: float
    std_mm: float
    planned_mm: float | None = None

    @property
    def relative_error(self) -> float:
        return self.found_mm / self.true_mm - 1

    @property
    def deviation(self) -> float:
        return abs(self.found_mm - self.true_mm) / self.std_mm


def second_press(
    sensors: int = 2,
    radius_mm: float = 2.5,
    flat_end: FlatEndGauge = FlatEndGauge(),
    seed: int = 32,
    quick: bool = False,
    json: bool = False,
) -> None:
    """Calibrate sensors on every base."""
    cv2.setNumThreads(1)
    design = SensorDesign(ball=BallGauge(second_radius_mm=radius_mm), flat_end=flat_end)
    cases: list[dict[str, DepthFound]] = []
    figures: list[Figure] = []
    for base, ratio in list(BASES.items())[-1:] if quick else BASES.items():
        for number in range(1 if quick else sensors):
            who = sample_sensor(number, seed, LAYERED)
            who = replace(who, gel=replace(who.gel, gel_to_base_modulus_ratio=ratio))
            rng = np.random.default_rng((seed, number, round(100 * ratio)))
            cases.append(depths(who, design, rng, quick))
            for name, one in cases[-1].items():
                figures.append(Figure(f"base {base}, sensor {number}: {name}, error", in_words(one)))
                if not json:
                    print(f"{figures[-1].figure} {figures[-1].measured}", flush=True)
    title = (
        f"Depth of the calibration's ball, with a second ball of radius {radius_mm:g} mm and a flat end of radius "
        f"{flat_end.radius_mm:g} mm, {flat_end.depth_mm:g} mm deep"
    )
    answer(title, [*figures, *summary(cases)], json)


def in_words(one: DepthFound) -> str:
    """Errors in per cent, and the ± in mm."""
    planned = "" if one.planned_mm is None else f"; planned ± {one.planned_mm:.3f}"
    return f"{one.relative_error:+.1%} (± {one.std_mm:.3f} of {one.true_mm:.2f} mm{planned})"


def summary(cases: list[dict[str, DepthFound]]) -> Iterator[Figure]:
    """The largest error, and how often the truth is within the stated ±; a press that is refused does not count."""
    for name in OBJECTS:
        found = [case[name] for case in cases if name in case]
        error = max(abs(one.relative_error) for one in found)
        label = f"{name}: largest error of {len(found)}"
        yield Figure(label, error) if name == ONE else at_most(label, error, MAX_RELATIVE_ERROR)
        for times, (least, most) in ((1, WITHIN_ONE), (2, WITHIN_TWO)):
            share = float(np.mean([one.deviation < times for one in found]))
            yield holds(f"{name}: truth within {times} σ", share, f"{least:g} to {most:g}", least <= share <= most)
    for name in (BALLS, FLAT):
        pairs = [(case[ONE], case[name]) for case in cases if name in case]
        share = float(np.mean([abs(one.found_mm - two.found_mm) < 2 * one.std_mm for one, two in pairs]))
        yield Figure(f"what the {name} says is within 2 σ of one ball", share)


def depths(who: SampledSensor, design: SensorDesign, rng: np.random.Generator, quick: bool) -> dict[str, DepthFound]:
    """The depth of the first ball alone, with each second object and with both, and the ± that was planned.

    quick: by the lens of the pins alone, on a base that is known to be rigid.
    """
    true_mm = who.presses.for_gel(who.design.gel).ball_depth_mm
    design = replace(design, gel=who.gel if quick else Gel())
    images = images_of_all_presses(who, design, true_mm, rng)
    assert images.board_pair is not None and images.ball_pair is not None
    rectify = build_rectification(fit_board(*images.board_pair, design.pin_board), design)
    images = without_unusable(images, rectify, design)
    fit, priors = None, ()
    if not quick:
        made = calibrate(images, design)
        fit, rectify = made.fits.twin, made.rectify
        priors = () if made.fits.board_press is None else made.fits.board_press.priors
    press = find_ball_press(rectify, *images.ball_pair, design.ball, "physics")
    seconds = find_second_presses(rectify, images.second_pairs, design, "physics")
    alone = fit_twin_to_ball_press(press, design, priors)
    known = KnownPress(
        design, alone.press, alone.light, alone.uncertainty.effective_observations, alone.image_rmse_grey_levels
    )

    def depth_with(some: tuple[ObjectPress, ...]) -> DepthFound:
        whole = fit if len(some) == len(seconds) else None
        one = alone if not some else whole or fit_twin_to_ball_press(press, design, priors, further=some)
        planned_mm = planned_error_mm(known, some[0], one) if len(some) == 1 else None
        return DepthFound(true_mm, one.press.depth_mm, one.uncertainty.standard_deviations["depth_mm"], planned_mm)

    usable = {one.object.kind for one in seconds}
    return {
        name: depth_with(tuple(one for one in seconds if one.object.kind in kinds))
        for name, kinds in OBJECTS.items()
        if usable >= {*kinds}
    }


def without_unusable(images: CalibrationImages, rectify: Rectification, design: SensorDesign) -> CalibrationImages:
    """The images without those of second presses that are refused, such as of a ball that is pressed too deep for its radius."""
    for kind, pair in images.second_pairs.items():
        try:
            find_second_presses(rectify, {kind: pair}, design, "physics")
        except BallPressUnusable as refusal:
            print(refusal)
            images = replace(images, **dict.fromkeys(second_image_names(kind)))
    return images


def planned_error_mm(known: KnownPress, second: ObjectPress, fit: TwinFit) -> float:
    """The ± of the first ball's depth with a second press, as it is planned."""
    candidate = CandidatePress.of(second.object, fit.further[0].press.depth_mm)
    return errors_with_candidate(known, candidate).depth_mm


def images_of_all_presses(
    who: SampledSensor, design: SensorDesign, first_mm: float, rng: np.random.Generator
) -> CalibrationImages:
    """The images of a sensor, with those of a second ball and of a flat end."""
    images = images_with_second_ball(who, design.ball.second_radius_mm, first_mm)
    depth_mm, error_mm = design.flat_end.depth_mm, design.flat_end.depth_error_mm
    tilt_rad = radians(TILT_DEG[0]), radians(TILT_DEG[1])
    # The first touch is between that of the rim's lowest point and that of the middle.
    middle_mm = rng.normal(depth_mm, error_mm) - rng.uniform() * design.flat_end.radius_mm * np.hypot(*tilt_rad)
    press = ScriptedPress(float(middle_mm), at_mm=AT_MM, drag_mm=DRAG_MM, tilt_rad=tilt_rad)
    before, after = pair_of_press(who, press, FlatPunch(design.flat_end.radius_mm, EDGE_MM), 700)
    return replace(images, flat_end_reference=before, flat_end=after)


def images_with_second_ball(who: SampledSensor, radius_mm: float, first_mm: float) -> CalibrationImages:
    """The images of a sensor, with those of a second ball: a contact of the same area, or as deep as a small ball can be."""
    images = simulate_calibration_images(who.twin(), who.design, presses=who.presses, frames=FRAMES)
    depth_mm = min(first_mm, SECOND_BALL_DEPTH * radius_mm, first_mm * who.design.ball.radius_mm / radius_mm)
    before, after = pair_of_press(who, ScriptedPress(depth_mm, at_mm=AT_MM, drag_mm=DRAG_MM), Ball(radius_mm), 500)
    return CalibrationImages(**vars(images), second_ball_reference=before, second_ball=after)


def pair_of_press(
    who: SampledSensor, press: ScriptedPress, indenter: Indenter, number: int
) -> tuple[BgrImage, BgrImage]:
    """The mean image of the untouched skin, and that of a press; number: picks the noise."""
    twin = who.twin()
    contact = press.simulate(twin, indenter, CALIBRATION_SOLVER_SETTINGS)
    before, after = (
        average_images([twin.renderer(one, first + n) for n in range(FRAMES)])
        for one, first in ((None, number), (contact, number + 100))
    )
    return before, after


if __name__ == "__main__":
    tyro.cli(second_press)
