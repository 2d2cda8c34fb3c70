"""The substrate of the gel: a rigid base, or a compliant one, identified from its effect on the calibration.

A ball that is pressed in above a compliant base raises less gel around it. The calibration, which assumes a rigid base, then
explains a faint bright ring by skin that hardly brightens: by half the true slope. Dents are not affected; and in real sensors
bulges brighten 2.2 times as steeply as dents darken on average. A ratio far below that therefore identifies a compliant base, and
the light parameters that it spoilt are replaced by typical ones (docs/force_physics.md).
"""

from dataclasses import dataclass, replace

from ninedtact.design import Gel
from ninedtact.force.traction.observation import BrightnessObservationModel
from ninedtact.shape.depth import TYPICAL_GLOBAL_DIMMING, TYPICAL_POINT_SPREAD_MM, DepthCurve, LightLoss

TYPICAL_SLOPE_RATIO = 2.2
"""Slope of bulges over the mean slope of dents: eight real sensors of five labs, 1.8 to 2.9, geometric mean."""
COMPLIANT_BASE = Gel(6.0, 10.0)
"""A transparent layer of Shore A 45 as it is moulded under gel of Shore A 5; its modulus is over that of the gel."""

_MIN_RIGID_SLOPE_RATIO = 1.4
"""Three standard deviations of its logarithm (0.15) below."""


@dataclass(frozen=True)
class Substrate:
    """What the gel lies on, and the observation model that holds above it."""

    observation_model: BrightnessObservationModel
    base: Gel | None = None
    """None is rigid; its shear modulus is over that of the gel."""


def identify_substrate(observation_model: BrightnessObservationModel) -> Substrate:
    """Return a rigid base with the calibration as it is, or a compliant base with typical light parameters."""
    ratio = bulge_to_dent_slope_ratio(observation_model.curve)
    if ratio >= _MIN_RIGID_SLOPE_RATIO:
        return Substrate(observation_model)
    raised = TYPICAL_SLOPE_RATIO / ratio
    curve = observation_model.curve
    curve = replace(curve, brightening=tuple(raised * bright for bright in curve.brightening))
    return Substrate(
        BrightnessObservationModel(curve, LightLoss(TYPICAL_GLOBAL_DIMMING), TYPICAL_POINT_SPREAD_MM), COMPLIANT_BASE
    )


def bulge_to_dent_slope_ratio(curve: DepthCurve) -> float:
    """Return the slope of bulges over the mean slope of dents."""
    dents = curve.darkening[-1] / curve.indentation_mm[-1]
    return curve.brightening[-1] / curve.bulge_mm[-1] / dents
