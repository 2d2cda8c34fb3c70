"""From surface to force: what is darker and brighter, tractions on the skin, and the wrench."""

from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np
from jaxtyping import Bool, Float32, Float64
from numpy import ndarray as Array

from ninedtact.quantities.shape import centred_axis_mm


@dataclass(frozen=True)
class Wrench:
    """Force and torque that the object applies to the skin, sensor frame: pressing gives F_z < 0."""

    force_n: Float64[Array, "3"]
    torque_nm: Float64[Array, "3"]
    about_mm: Float64[Array, "3"] = field(default_factory=lambda: np.zeros(3))
    """The point that the torque is about; the skin's centre unless said otherwise."""
    stamp_ns: int = 0

    def about(self, point_mm: Float64[Array, "3"]) -> "Wrench":
        """The same wrench with its torque about another point: τ' = τ + (old − new) × F."""
        arm_m = (self.about_mm - point_mm) / 1e3
        return replace(self, torque_nm=self.torque_nm + np.cross(arm_m, self.force_n), about_mm=point_mm)

    @property
    def six(self) -> Float64[Array, "6"]:
        """F_x, F_y, F_z in N and T_x, T_y, T_z in N·m."""
        return np.concatenate([self.force_n, self.torque_nm])


@dataclass(frozen=True)
class Deformation:
    """What the touch did to the rectified image: the three channels of the paper's network (docs/references.md).

    Grey levels, 0 to 255, as floating numbers: nothing wraps.
    """

    darker: Float32[Array, "rows cols"]
    """max(reference − image, 0)."""
    brighter: Float32[Array, "rows cols"]
    """max(image − reference, 0)."""
    reference: Float32[Array, "rows cols"]
    """The untouched skin of this session."""
    mm_per_px: float
    stamp_ns: int = 0


@dataclass(frozen=True)
class Traction:
    """What the object does to every place of the skin, force per area."""

    pressure_mpa: Float32[Array, "rows cols"]
    """Inwards, never below zero."""
    shear_mpa: Float32[Array, "2 rows cols"]
    """Along x and along y."""
    mm_per_px: float
    stamp_ns: int = 0
    height_mm: Float32[Array, "rows cols"] | None = None
    """Of the skin that they act on, where it is known: shear has an arm there."""

    @property
    def is_touched(self) -> Bool[Array, "rows cols"]:
        """Where the object presses."""
        return self.pressure_mpa > 0

    def wrench(self) -> Wrench:
        """Their sum, its torque about the skin's centre: arms lie on the skin, in its untouched plane where no height is known."""
        rows, cols = self.pressure_mpa.shape
        x_mm, y_mm = (centred_axis_mm(side, self.mm_per_px).astype(float) for side in (cols, rows))
        parts_n = self.parts_mpa * self.mm_per_px**2
        with_x, with_y = parts_n.sum(1) @ x_mm, parts_n.sum(2) @ y_mm
        with_z = np.zeros(3) if self.height_mm is None else (parts_n * self.height_mm).sum((1, 2))
        torque_nmm = np.array([with_y[2] - with_z[1], with_z[0] - with_x[2], with_x[1] - with_y[0]])
        return Wrench(parts_n.sum((1, 2)), torque_nmm / 1e3, stamp_ns=self.stamp_ns)

    @property
    def parts_mpa(self) -> Float64[Array, "3 rows cols"]:
        """Along x, along y and outwards."""
        return np.concatenate([self.shear_mpa, -self.pressure_mpa[None]]).astype(float)


class EstimateWarning(StrEnum):
    """Why an estimate should not be believed as it is."""

    OUT_OF_RANGE = "out of range"
    """The force is larger than anything that the estimator was made for."""
    UNLIKE_TRAINING = "unlike training"
    """The image is not like those that the estimator knows."""
    NOT_CONVERGED = "not converged"
    """The answer was taken before it had settled."""
    PART_UNSEEN = "part unseen"
    """The touch reaches beyond what the camera sees."""


@dataclass(frozen=True)
class WrenchEstimate:
    """A wrench that was read from an image, and how far to believe it."""

    wrench: Wrench
    error: Float64[Array, "6"]
    """Standard deviation of each of `wrench.six`, N and N·m."""
    touching: bool
    """Without contact the wrench is zero, exactly."""
    warnings: tuple[EstimateWarning, ...] = ()
    traction: Traction | None = None
    """Where the estimator knows it."""
