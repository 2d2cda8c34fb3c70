"""What the gel lies on: a rigid base, or one that yields, and what a calibration that knew of none makes of that.

A ball that is pressed in above a base that yields raises less gel around it. The calibration, which assumes a rigid base, then
explains a faint bright ring by skin that hardly brightens: by half the true slope. It does not mistake dents so; and in real
sensors bulges brighten 2.2 times as steeply as dents darken on the whole. So a ratio far below that tells the base, and the
light that it spoilt is set to what is usual (docs/force_physics.md).
"""

from dataclasses import dataclass, replace

from ninedtact.design import Gel
from ninedtact.force.traction.evidence import ByLight
from ninedtact.shape.depth import DepthCurve
from ninedtact.shape.loss import Loss

USUAL_RATIO = 2.2
"""Slope of bulges over the mean slope of dents: eight real sensors of five labs, 1.8 to 2.9, geometric mean."""
LEAST_RATIO = 1.4
"""Three standard deviations of its logarithm (0.15) below."""
USUAL_SHADE = 0.7
"""Light lost everywhere per mean darkening of the view, of the same sensors."""
USUAL_SCATTERING_MM = 0.55
"""Standard deviation of their point-spread."""
YIELDING = Gel(6.0, 10.0)
"""A transparent layer of Shore A 45 as it is moulded under gel of Shore A 5; its modulus is over that of the gel."""


@dataclass(frozen=True)
class Ground:
    """What light is read with, and what lies below."""

    evidence: ByLight
    base: Gel | None = None
    """None is rigid; its shear modulus is over that of the gel."""


def ground_of(evidence: ByLight) -> Ground:
    """A calibration on a rigid base as it is; on one that yields with the light that is usual."""
    if ratio(evidence.curve) >= LEAST_RATIO:
        return Ground(evidence)
    curve = brightening_as_usual(evidence.curve)
    return Ground(ByLight(curve, Loss(USUAL_SHADE), USUAL_SCATTERING_MM), YIELDING)


def ratio(curve: DepthCurve) -> float:
    """Slope of bulges over the mean slope of dents."""
    dents = curve.darkening[-1] / curve.indentation_mm[-1]
    return curve.brightening[-1] / curve.bulge_mm[-1] / dents


def brightening_as_usual(curve: DepthCurve) -> DepthCurve:
    """The same dents; bulges in the usual ratio to them."""
    raised = USUAL_RATIO / ratio(curve)
    return replace(curve, brightening=tuple(raised * bright for bright in curve.brightening))
