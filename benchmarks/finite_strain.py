"""Gel on a base at finite strain: a ball pressed into axisymmetric finite elements, beside the corrected linear contact.

The finite elements (neo_hookean.py, ball_in_layer.py) are neo-Hookean and incompressible in both layers; the skin sticks where it
touches, and friction is 1 in the linear contact. The shear modulus of the gel is 1, so that loads are in mm². The base has 9.2 mm.
Printed are load and greatest thinning over those of the finite elements, and the difference of the skin's height within 8 mm of the
axis with and without the correction. `--fit` prints the constants of `finite_strain_height_mm` that fit each base best.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import tyro
from ball_in_layer import Press, PressFailed, follow
from figures import Figure, answer, at_most
from neo_hookean import Layer, Parts

from ninedtact.design import Gel
from ninedtact.mechanics.contact_model import ContactModel, SolverSettings
from ninedtact.mechanics.contact_result import Contact
from ninedtact.mechanics.finite_strain import correct_for_finite_strain, finite_strain_height_terms_mm
from ninedtact.mechanics.indenter import Ball
from ninedtact.mechanics.pose import Pose
from ninedtact.mechanics.skin import PeriodicGrid, gel_skin

BASE_MM = 9.2
BASE_RATIOS = (0.0, 40.0, 20.0, 10.0, 5.0)
"""Modulus of the base over that of the gel; zero is a rigid base."""
CASES = (*((2.0, 4.0, ratio) for ratio in BASE_RATIOS), (2.5, 4.0, 10.0), (2.0, 2.0, 10.0))
"""Thickness of the gel, radius of the ball and ratio; the last two were not used to find the constants."""
GRID = PeriodicGrid(160, 160, 0.2)
STEP_MM = 0.1
DEEPEST = 1.2
"""Depth over thickness; 0.8 on a rigid base."""
WITHIN_MM = 8.0


@dataclass(frozen=True)
class Pair:
    """One press in both models."""

    elements: Press
    linear: Contact

    @property
    def thinning_mm(self) -> float:
        """Greatest thinning of the finite elements."""
        parts, moved = self.elements.parts, self.elements.moved
        (_, _, up), (_, _, below) = parts.skin_nodes, parts.nodes_at(parts.layer.base_thickness_mm)
        return float(moved[below[0]] - moved[up[0]])

    def height_mm(self, radius_mm: np.ndarray) -> np.ndarray:
        """Height of the skin of the finite elements at distances from the axis."""
        r, across, up = self.elements.profile_mm
        return np.interp(radius_mm, r + across, up)


def finite_strain(quick: bool = False, json: bool = False, fit: bool = False, element_mm: float = 0.2) -> None:
    """Print the figures of all cases, a quarter of an hour; quick: one case, coarse and shallow."""
    figures: list[Figure] = []
    for thickness_mm, ball_mm, ratio in CASES[3:4] if quick else CASES:
        deepest_mm = thickness_mm * (0.3 if quick else 0.8 if ratio == 0 else DEEPEST)
        pairs = list(press_both(thickness_mm, ball_mm, ratio, deepest_mm, 0.4 if quick else element_mm))
        name = (
            f"{thickness_mm:g} mm of gel, ball {ball_mm:g} mm, base {f'{ratio:g} times as stiff' if ratio else 'rigid'}"
        )
        figures += figures_of(name, pairs)
        if fit:
            figures += best_constants(name, pairs)
    answer("finite strain", figures, json)


def press_both(
    thickness_mm: float, ball_mm: float, ratio: float, deepest_mm: float, element_mm: float
) -> Iterator[Pair]:
    """Press both models step by step, as deep as the finite elements find a balance."""
    layer = Layer(
        thickness_mm,
        radius_mm=24.0,
        element_mm=element_mm,
        base_thickness_mm=BASE_MM if ratio else 0.0,
        base_modulus=ratio or 1.0,
    )
    gel = Gel(thickness_mm, 1.0, 0.5, 1.0, BASE_MM, 1 / ratio if ratio else 0.0)
    model = ContactModel(gel_skin(GRID, gel, np.zeros(())), 1.0, SolverSettings(3e-4, must_converge=False))
    contact = model.initial_contact()
    depths_mm = np.round(np.arange(STEP_MM, deepest_mm + 1e-9, STEP_MM), 3).tolist()
    try:
        for press in follow(Parts(layer), ball_mm, depths_mm):
            contact = model.step(contact, Ball(ball_mm), Pose(depth_mm=press.depth_mm))
            yield Pair(press, contact)
    except PressFailed:
        return


def figures_of(name: str, pairs: list[Pair]) -> list[Figure]:
    """Return the worst errors over all depths from a fifth of the deepest on."""
    loads, thinnings, heights_um, straight_um = [], [], [], []
    radius_mm = np.hypot(*GRID.positions_mm)
    near = radius_mm < WITHIN_MM
    for pair in pairs[len(pairs) // 5 :]:
        corrected = correct_for_finite_strain(pair.linear)
        loads.append(float(corrected.pressure_mpa.sum()) * GRID.cell_area_mm2 / pair.elements.load - 1)
        thinnings.append(float(-corrected.thickness_change_mm.min()) / pair.thinning_mm - 1)
        true_mm = pair.height_mm(radius_mm)
        for found, contact in ((heights_um, corrected), (straight_um, pair.linear)):
            found.append(1e3 * float(np.sqrt(np.mean((contact.height_mm - true_mm)[near] ** 2))))
    return [
        at_most(f"{name}: load, largest error, %", 100 * max(map(abs, loads)), 4.0),
        at_most(f"{name}: greatest thinning, largest error, %", 100 * max(map(abs, thinnings)), 4.0),
        Figure(f"{name}: height, largest RMS, µm", max(heights_um), peer=round(max(straight_um), 1)),
    ]


def best_constants(name: str, pairs: list[Pair]) -> list[Figure]:
    """Return growth, redistribution and transport that fit the heights beside the ball best."""
    radius_mm = np.hypot(*GRID.positions_mm)
    rows, wanted = [], []
    for pair in pairs[1::2]:
        free = (pair.linear.pressure_mpa <= 0) & (radius_mm < WITHIN_MM)
        weight = 1 / np.sqrt(np.maximum(radius_mm[free], 1.0))
        terms = finite_strain_height_terms_mm(pair.linear)
        rows.append(np.stack([term[free] * weight for term in terms], axis=1))
        wanted.append((pair.height_mm(radius_mm) - pair.linear.height_mm)[free] * weight)
    found = np.linalg.lstsq(np.concatenate(rows), np.concatenate(wanted), rcond=None)[0]
    names = ("growth", "redistribution", "transport")
    return [Figure(f"{name}: best {one}", float(value)) for one, value in zip(names, found, strict=True)]


if __name__ == "__main__":
    tyro.cli(finite_strain)
