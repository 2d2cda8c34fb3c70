"""Whether a calibration notices a wrong pitch of the board or radius of a ball, and whether it suspects right ones.

Real images are calibrated with right lengths, and with lengths wrong by 10, 15 and 20 % in both directions, by all steps of
`ninedtact calibrate`. Twins of six real sensors are fitted with right lengths and, where their board has a pitch of 3.1 mm, with
the usual one; sensors of the simulated population with right lengths only. On some of these a second ball is pressed, whose radius
is stated right or wrong. The lens of simulated sensors is that of the pins alone, which is done sooner. A wrong length is noticed
where the calibration is refused, where a check of lengths, contact or second ball does not pass, or where the ball would have been
pressed through the gel.

What a calibration could notice of the radius at best is printed, too: by how much a wrong radius explains the image of the ball
worse (chi-square, with light, gel, base and depth fitted to it), and which share of these wrong radii light and gel of other
sensors tell from a right one.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from time import perf_counter

import cv2
import numpy as np
import tyro
from figures import Figure, answer, at_least, at_most
from real_images import calibration_images, sensor_folders
from real_sensor_twins import twins_of_real_fits
from scipy.stats import norm
from second_press import images_with_second_ball

from ninedtact import CalibrationImages, SensorDesign, calibrate
from ninedtact.calibration.ball.ball_press import find_ball_press
from ninedtact.calibration.ball.second_press import find_second_presses
from ninedtact.calibration.board.board_fit import build_rectification, fit_board
from ninedtact.calibration.certificate.checks import compute_certificate_checks, press_through_gel_warnings
from ninedtact.calibration.certificate.length_evidence import assess_stated_lengths, relative_radius_std
from ninedtact.calibration.fits_to_sensor_toml import make_second_press_quality
from ninedtact.calibration.sensor_toml_schema import Certificate
from ninedtact.calibration.twin.ball_press_fit import TwinFit, fit_twin_to_ball_press
from ninedtact.design import BallGauge
from ninedtact.errors import NinedtactError
from ninedtact.simulation.calibration_images import simulate_calibration_images
from ninedtact_train.population.sensor_population import sample_sensor

FACTORS = (0.8, 0.85, 0.9, 1.1, 1.15, 1.2)
SECOND_FACTORS = (0.9, 1.1)
OF_LENGTHS = ("Lengths", "Contact", "Second ball")
PRESSED_THROUGH = "which is impossible"
NOTICED, SUSPECTED = 0.8, 1 / 13
"""Least share of wrong lengths that are noticed, and largest share of right ones that are suspected."""
SECOND_RADIUS_MM, FRAMES = 2.5, 4


@dataclass(frozen=True)
class Trial:
    """One calibration and what it said of its lengths."""

    kind: str
    """`right`, or the length that is wrong."""
    name: str
    remarks: tuple[str, ...]
    residual_grey_levels: float | None = None
    """Residual (RMS) of the ball's image; None where nothing was fitted to it."""
    observations: float = 0.0
    """Effective number of independent observations in it."""

    @property
    def noticed(self) -> bool:
        return bool(self.remarks)


def wrong_lengths(
    simulated: int = 12, second_balls: int = 4, seed: int = 613, quick: bool = False, json: bool = False
) -> None:
    """Calibrate with right and wrong lengths."""
    cv2.setNumThreads(1)
    if quick:
        answer("Wrong lengths", list(figures_of([next(real_trials(1, refines_lens=False))])), json)
        return
    of_twins = [*twin_trials(), *simulated_trials(simulated, seed), *second_ball_trials(second_balls, seed)]
    answer("Wrong lengths", list(figures_of([*real_trials(), *of_twins])), json)


def real_trials(
    sensors: int | None = None, factors: tuple[float, ...] = FACTORS, refines_lens: bool = True
) -> Iterator[Trial]:
    """Yield real sensors with right and wrong lengths; one whose ball is refused anyway has its board alone."""
    for folder in sensor_folders()[:sensors]:
        images = calibration_images(folder.name)
        right = trial("right", folder.name, images, SensorDesign(), refines_lens)
        if right.remarks[:1] == ("refused",):
            images = replace(images, ball_reference=None, ball=None)
            right = trial("right", f"{folder.name}, board alone", images, SensorDesign())
        yield right
        for factor in factors:
            yield trial("pitch", f"{right.name}, pitch × {factor:g}", images, with_lengths(pitch=factor), refines_lens)
        for factor in factors if images.ball_pair is not None else ():
            yield trial("radius", f"{right.name}, radius × {factor:g}", images, with_lengths(radius=factor))


def twin_trials() -> Iterator[Trial]:
    """Yield the twins of six real sensors with right lengths, and those of another pitch with the usual one."""
    for name, who in twins_of_real_fits().items():
        images = CalibrationImages(**vars(simulate_calibration_images(who.twin(), who.design, presses=who.presses)))
        stated = replace(SensorDesign(), pin_board=who.design.pin_board)
        yield trial("right, twin of a real fit", name, images, stated, refines_lens=False)
        if stated != SensorDesign():
            yield trial("pitch of a twin", f"{name}, usual pitch", images, SensorDesign(), refines_lens=False)


def simulated_trials(count: int, seed: int) -> Iterator[Trial]:
    """Yield sensors of the population with right lengths."""
    for number in range(count):
        who = sample_sensor(number, seed)
        made = simulate_calibration_images(who.twin(), who.design, presses=who.presses, frames=FRAMES)
        yield trial("right, simulated", who.name, CalibrationImages(**vars(made)), who.design, refines_lens=False)


def second_ball_trials(count: int, seed: int) -> Iterator[Trial]:
    """Yield sensors of the population with a second ball of a right or wrong radius; those that are refused anyway are left out."""
    for number in range(count):
        who = sample_sensor(number, seed)
        images = images_with_second_ball(who, SECOND_RADIUS_MM, who.presses.for_gel(who.design.gel).ball_depth_mm)
        right = trial("right, second ball", who.name, images, with_lengths(), refines_lens=False)
        if right.remarks[:1] == ("refused",):
            continue
        yield right
        for factor in SECOND_FACTORS:
            design = with_lengths(second=factor)
            name = f"{who.name}, second radius × {factor:g}"
            yield trial("second radius", name, images, design, refines_lens=False)


def with_lengths(pitch: float = 1.0, radius: float = 1.0, second: float = 1.0) -> SensorDesign:
    """The published design with lengths multiplied."""
    design = SensorDesign()
    board = replace(design.pin_board, pitch_mm=design.pin_board.pitch_mm * pitch)
    return replace(design, pin_board=board, ball=BallGauge(design.ball.radius_mm * radius, SECOND_RADIUS_MM * second))


def trial(kind: str, name: str, images: CalibrationImages, design: SensorDesign, refines_lens: bool = True) -> Trial:
    """Calibrate, and keep what is said of lengths."""
    start_s = perf_counter()
    try:
        certificate, twin = fit_all(images, design) if refines_lens else fit_once(images, design)
    except NinedtactError:
        found = Trial(kind, name, ("refused",))
    else:
        lines = [
            line.text.partition(":")[0] for line in compute_certificate_checks(certificate) if line.level != "pass"
        ]
        remarks = tuple(name for name in lines if name in OF_LENGTHS)
        remarks += ("pressed through",) if any(PRESSED_THROUGH in text for text in certificate.warnings) else ()
        found = Trial(kind, name, remarks)
        if twin is not None:
            observations = twin.uncertainty.effective_observations
            found = replace(found, residual_grey_levels=twin.image_rmse_grey_levels, observations=observations)
    print(f"{kind}: {name}: {', '.join(found.remarks) or 'silent'} [{perf_counter() - start_s:.0f} s]", flush=True)
    return found


def fit_all(images: CalibrationImages, design: SensorDesign) -> tuple[Certificate, TwinFit | None]:
    """Certificate and twin by all steps of a calibration."""
    made = calibrate(images, design)
    assert made.record.certificate is not None
    return made.record.certificate, made.fits.twin


def fit_once(images: CalibrationImages, design: SensorDesign) -> tuple[Certificate, TwinFit]:
    """The checks of lengths, and the twin, after one fit of the board and one of the balls."""
    assert images.board_pair is not None and images.ball_pair is not None
    board = fit_board(*images.board_pair, design.pin_board)
    rectify = build_rectification(board, design)
    second = find_second_presses(rectify, images.second_pairs, design, "physics")
    twin = fit_twin_to_ball_press(
        find_ball_press(rectify, *images.ball_pair, design.ball, "physics"), design, (), (), second
    )
    certificate = Certificate(
        second_ball=make_second_press_quality(twin, twin) if twin.further else None,
        lengths=assess_stated_lengths(board, twin, design),
        warnings=press_through_gel_warnings(twin.press.depth_mm, design.gel),
    )
    return certificate, twin


def figures_of(trials: list[Trial]) -> Iterator[Figure]:
    """The table of what was noticed, for each kind of trial."""
    for kind in dict.fromkeys(one.kind for one in trials):
        some = [one for one in trials if one.kind == kind]
        noticed = [one for one in some if one.noticed]
        by = {
            remark: sum(remark in one.remarks for one in some) for remark in ("refused", *OF_LENGTHS, "pressed through")
        }
        words = ", ".join(f"{name} {count}" for name, count in by.items() if count) or "nothing"
        yield Figure(f"{kind}: {len(some)} calibrations, said", words)
        share = len(noticed) / len(some)
        if kind.startswith("right"):
            yield at_most(f"{kind}: suspected", share, SUSPECTED)
        else:
            yield at_least(f"{kind} wrong: noticed", share, NOTICED)
    if wrong := [one for one in trials if one.kind in ("pitch", "radius")]:
        yield at_least("pitch or radius wrong: noticed", sum(one.noticed for one in wrong) / len(wrong), NOTICED)
    yield from figures_of_radius(trials)


def figures_of_radius(trials: list[Trial]) -> Iterator[Figure]:
    """What the image of a ball tells of its radius, and what light and gel of other sensors do."""
    for right in (one for one in trials if one.kind == "right" and one.residual_grey_levels):
        texts = []
        for one in trials:
            if one.kind == "radius" and one.name.startswith(right.name) and one.residual_grey_levels:
                excess = right.observations * ((one.residual_grey_levels / right.residual_grey_levels) ** 2 - 1)
                texts.append(f"{one.name.rpartition(' ')[2]}: {excess:+.1f}")
        if texts:
            yield Figure(f"radius of {right.name}: chi-square by stated over right radius", ", ".join(texts))
    std, limit = relative_radius_std(), float(norm.isf(SUSPECTED / 2))
    yield Figure("radius: ± by light and gel of other sensors", std)
    share = float(np.mean(norm.sf(limit - np.abs(np.log(FACTORS)) / std)))
    yield Figure("radius: share of these wrong ones that this ± can tell from a right one", share)


if __name__ == "__main__":
    tyro.cli(wrong_lengths)
