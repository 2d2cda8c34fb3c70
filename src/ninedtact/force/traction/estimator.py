"""Force without training: pressure and shear under the contact, read out of the image by the gel's compliance.

    reading ──observation──▶ light on cells ──gate──▶ touched? ──inversion──▶ tractions ──sums──▶ wrench and its error

An incompressible gel that is bonded below rises in front of a dragged object and sinks behind it; how much says what shear the
object applies. Nothing here was trained; what is known of presses beforehand is four numbers (`prior`).
"""

from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool
from numpy import ndarray as Array

from ninedtact.design import Gel
from ninedtact.force.estimator import ForceEstimator, untouched
from ninedtact.force.traction.cells import Cells, cells_over
from ninedtact.force.traction.certainty import Certainty
from ninedtact.force.traction.evidence import Evidence, by_light
from ninedtact.force.traction.explained import Effort, Explained
from ninedtact.force.traction.forward import Forward
from ninedtact.force.traction.gate import Gate, border_pressed
from ninedtact.force.traction.ground import ground_of
from ninedtact.force.traction.inversion import Inversion
from ninedtact.force.traction.observation import Observation
from ninedtact.force.traction.prior import Prior
from ninedtact.force.traction.refusals import required_gel
from ninedtact.quantities import Doubt, HeightMap, Traction, WrenchEstimate
from ninedtact.reading import Reading
from ninedtact.shape.calibrated import CalibratedShape

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController

NOTHING = np.array([0.01, 0.01, 0.03, 2e-4, 2e-4, 5e-5])
"""Error of saying that nothing touches: half of all touches of 0.05 N show (docs/force_physics.md)."""

DEEPEST_PART = 0.7
"""Of the gel's thickness: gel that stiffens as it gets thin bears a quarter more than is read there (docs/force_physics.md)."""


@dataclass
class TractionForce(ForceEstimator):
    """Reads pressure and shear maps, and the wrench that they add up to; remembers the last to begin the next from."""

    evidence: Evidence
    gel: Gel
    """Thickness as the calibration found it; the shear modulus scales all forces."""
    base: Gel | None = None
    """What the gel lies on, its shear modulus over that of the gel; none is rigid."""
    prior: Prior = Prior()
    gate: Gate = Gate()
    effort: Effort = Effort()
    certainty: Certainty = Certainty()
    name: str = "force by physics"
    last: Explained | None = field(default=None, init=False, repr=False)
    inversions: dict[Cells, Inversion] = field(default_factory=dict, init=False, repr=False)
    """One for each size of image met."""

    def estimate(self, reading: Reading) -> WrenchEstimate:
        """The wrench about the skin's centre; raises `TractionImpossible` for a reading that cannot be used."""
        with blas().limit(limits=1, user_api="blas"):  # its matrices are small: threads would wait for each other
            return self.read(reading)

    def read(self, reading: Reading) -> WrenchEstimate:
        """The same, on as many threads as there are."""
        inversion = self.inversion_for(reading.height)
        seen = self.evidence.observed(reading, inversion.forward.cells)
        touched = self.gate.touched(seen)
        if touched is None:
            self.forget()
            return WrenchEstimate(untouched(reading.frame.stamp_ns), NOTHING.copy(), touching=False)
        self.last = inversion.explain(seen, touched, self.last)
        return self.told(reading, seen, self.last)

    def told(self, reading: Reading, seen: Observation, found: Explained) -> WrenchEstimate:
        """What was found, in MPa, N and N·m."""
        mpa = self.gel.shear_modulus_mpa
        rows, cols = seen.z_mm.shape
        traction = Traction(
            found.tractions[0] * np.float32(mpa),
            found.tractions[1:] * np.float32(mpa),
            found.round.kernels.forward.cells.pitch_mm,
            reading.frame.stamp_ns,
            found.skin_mm[:rows, :cols].copy(),
        )
        wrench = traction.wrench()
        error = self.certainty.error(found, wrench.six, mpa)
        return WrenchEstimate(wrench, error, True, tuple(self.doubts(seen, found)), traction)

    def doubts(self, seen: Observation, found: Explained) -> list[Doubt]:
        """Why this may not be so."""
        pressed = found.tractions[0] > 0
        doubtful = {
            Doubt.OUT_OF_RANGE: bool((self.too_deep(seen) & pressed).any()),
            Doubt.PART_UNSEEN: border_pressed(found.tractions[0], seen.in_view),
            Doubt.NOT_CONVERGED: found.off > self.effort.settled,
        }
        return [doubt for doubt, holds in doubtful.items() if holds]

    def too_deep(self, seen: Observation) -> Bool[Array, "rows cols"]:
        """Where the depth curve, or the linear gel, is no longer to be trusted."""
        return (seen.beyond > 0.5) | (seen.z_mm < -DEEPEST_PART * self.gel.thickness_mm)

    def inversion_for(self, height: HeightMap) -> Inversion:
        """For images of this size, made when the first is met."""
        cells = cells_over(height.z_mm.shape, height.mm_per_px)
        if cells not in self.inversions:
            self.forget()
            gel = self.gel
            forward = Forward(cells, gel.thickness_mm, gel.poisson_ratio, self.evidence.point_spread_mm, self.base)
            self.inversions[cells] = Inversion(forward, self.evidence.law, self.prior, self.effort)
        return self.inversions[cells]

    def forget(self) -> None:
        """Begin the next from its own image."""
        self.last = None


@cache
def blas() -> "ThreadpoolController":
    """The linear algebra that is loaded; looking for it takes longer than an estimate, so it is done once."""
    import scipy.linalg  # noqa: F401  (SciPy brings its own, which is not found before it is loaded)
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


def traction_force(calibrated: CalibratedShape, gel: Gel | None) -> TractionForce:
    """The estimator of a calibrated sensor; raises `TractionImpossible` where its calibration knows no light or no gel."""
    ground = ground_of(by_light(calibrated))
    return TractionForce(ground.evidence, required_gel(gel), ground.base)
