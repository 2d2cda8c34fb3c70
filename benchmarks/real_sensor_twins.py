"""Twins of six real sensors: the light, the gel and the ball press that `ninedtact calibrate` fitted to the images of four labs.

The fitted numbers are those of sensors that people built, so estimators are judged on them. The images belong to the labs; lens and
reference image of a twin are therefore drawn with a fixed seed. docs/datasets.md describes the sensors.
"""

from dataclasses import dataclass, replace

from ninedtact.design import Gel, PinBoard, SensingArea, SensorDesign
from ninedtact.simulation.calibration_images import GUIDED_BOARD_MM, HandPressImperfections
from ninedtact.simulation.gel_brightness import BrightnessModel
from ninedtact_train.population.sensor_population import (
    SampledSensor,
    sample_sensor,
)

_SEED = 613
"""Seed of lenses and reference images."""
_FRICTION = 0.9
_MAX_BALL_DEPTH_FRACTION = 0.9
"""Part of the gel's thickness to which the ball is pressed at most: the fit to sensor A is deeper than the gel that it finds."""


@dataclass(frozen=True)
class RealFit:
    """What the calibration found in the images of one real sensor."""

    name: str
    thickness_mm: float
    """The thickness with which the gel acts."""
    light: BrightnessModel
    noise_grey_levels: float
    ball_depth_mm: float
    ball_drag_mm: tuple[float, float]
    board_pitch_mm: float = 2.5


REAL_FITS = (
    RealFit("A", 1.89, BrightnessModel(0.095, 0.87, 0.369, 0.47, 1.18, 0.061), 0.63, 2.18, (0.07, -0.06)),
    RealFit("I", 1.90, BrightnessModel(0.079, 2.84, 0.425, 0.47, 1.36, 0.000), 0.65, 1.48, (0.48, 0.95)),
    RealFit("L", 1.97, BrightnessModel(0.139, 1.42, 0.546, 0.42, 0.96, 0.014), 0.66, 1.52, (0.39, -0.55)),
    RealFit("P", 2.61, BrightnessModel(0.122, 0.62, 0.365, 0.47, 0.97, 0.033), 0.57, 1.99, (-0.57, 0.23), 3.1),
    RealFit("Q", 3.20, BrightnessModel(0.120, 0.31, 0.438, 0.38, 2.20, 0.062), 0.57, 1.97, (-0.35, -0.19), 3.1),
    RealFit("R", 1.56, BrightnessModel(0.134, 4.90, 0.477, 0.49, 0.57, 0.020), 0.68, 0.99, (0.0, -0.15)),
)
"""The six sensors. The ball had a radius of 4 mm; the brightness law assumes the design's thickness."""


def twins_of_real_fits() -> dict[str, SampledSensor]:
    """Return the six sensors by name, with gels of the default modulus on rigid windows."""
    return {fit.name: _simulated_sensor(fit, number) for number, fit in enumerate(REAL_FITS)}


def _simulated_sensor(fit: RealFit, number: int) -> SampledSensor:
    drawn, area = sample_sensor(number, _SEED), SensingArea()
    wider = fit.board_pitch_mm / PinBoard().pitch_mm
    gel = Gel(thickness_mm=fit.thickness_mm, gel_to_base_modulus_ratio=0.0)
    deepest_mm = _MAX_BALL_DEPTH_FRACTION * gel.thickness_mm
    return SampledSensor(
        name=fit.name,
        kind="rigid_base",
        gel=gel,
        friction=_FRICTION,
        light=fit.light,
        lens=replace(drawn.lens, mm_per_unit=drawn.lens.mm_per_unit * wider),
        noise_grey_levels=fit.noise_grey_levels,
        reference_image=drawn.reference_image,
        design=SensorDesign(
            sensing_area=SensingArea(area.width_mm * wider, area.height_mm * wider),
            pin_board=PinBoard(pitch_mm=fit.board_pitch_mm),
        ),
        presses=HandPressImperfections(
            GUIDED_BOARD_MM, ball_depth_mm=min(fit.ball_depth_mm, deepest_mm), ball_drag_mm=fit.ball_drag_mm
        ),
    )
