"""Skins, objects and moves that the tests of this room share."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from ninedtact.design import Gel
from ninedtact.mechanics.contact_model import ContactModel, SolverSettings
from ninedtact.mechanics.contact_result import Contact
from ninedtact.mechanics.indenter import Ball, Heights, Indenter
from ninedtact.mechanics.pose import Pose
from ninedtact.mechanics.skin import PeriodicGrid, gel_skin

GEL = Gel(thickness_mm=2.5, shear_modulus_mpa=0.1, poisson_ratio=0.5, finite_strain=0.0, gel_to_base_modulus_ratio=0.0)
"""A linear gel on a rigid base, of which closed forms are known."""
BALL = Ball(4.0)
DOUBLE = np.zeros((), np.float64)
SMALL = PeriodicGrid(64, 72, 0.3)
EXACT = SolverSettings(tolerance=1e-7, min_tolerance_mm=1e-10)


@dataclass(frozen=True)
class Paraboloid(Indenter):
    """What Hertz meant by a ball."""

    radius_mm: float = 4.0
    name: str = "paraboloid"

    def underside_mm(self, x_mm: Heights, y_mm: Heights) -> Heights:
        return (x_mm**2 + y_mm**2) / (2 * self.radius_mm)


@dataclass(frozen=True)
class Punch(Indenter):
    """Flat and round, with a sharp edge."""

    radius_mm: float = 2.0
    name: str = "punch"

    def underside_mm(self, x_mm: Heights, y_mm: Heights) -> Heights:
        return np.where(x_mm**2 + y_mm**2 < self.radius_mm**2, 0.0, 50.0)


@dataclass(frozen=True)
class Plate(Indenter):
    """Flat and larger than any grid."""

    name: str = "plate"

    def underside_mm(self, x_mm: Heights, y_mm: Heights) -> Heights:
        return 0 * x_mm


def model(
    gel: Gel = GEL,
    grid: PeriodicGrid = SMALL,
    friction: float = 1.0,
    settings: SolverSettings = EXACT,
    like: Any = DOUBLE,
):
    return ContactModel(gel_skin(grid, gel, like), friction, settings)


def pressed(model: ContactModel, *poses: Pose, indenter: Indenter = BALL) -> Contact:
    """The contact after these poses."""
    return list(model.follow(indenter, poses))[-1]
