"""Gel on a base at finite strain: a ball, or the flat end of a rod, pressed into axisymmetric finite elements, beside the corrected
linear contact.

The finite elements (neo_hookean.py, ball_in_layer.py) are neo-Hookean and incompressible in both layers; the skin sticks where it
touches, and friction is 1 in the linear contact. The shear modulus of the gel is 1, so that loads are in mm². The base has 9.2 mm.
Printed are load and greatest thinning over those of the finite elements, and the differences of the skin's height and of the gel's
thickness beside the ball, within 8 mm of the axis, with and without the correction. `--fit` prints the constants of
`finite_strain_thickening_mm` that fit each base best.
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
from ninedtact.mechanics.finite_strain import correct_for_finite_strain, finite_strain_thickening_terms_mm
from ninedtact.mechanics.indenter import Ball, FlatPunch
from ninedtact.mechanics.pose import Pose
from ninedtact.mechanics.skin import PeriodicGrid, gel_skin

BASE_MM = 9.2
BASE_RATIOS = (0.0, 20.0, 10.0, 5.0, 3.0)
"""Modulus of the base over that of the gel; zero is a rigid base."""
FLAT_END = FlatPunch(3.0, 0.3)
CASES: tuple[tuple[float, Ball | FlatPunch, float], ...] = (
    *((2.0, Ball(4.0), ratio) for ratio in BASE_RATIOS),
    (2.5, Ball(4.0), 10.0),
    (2.0, Ball(2.0), 10.0),
    *((2.5, FLAT_END, ratio) for ratio in (0.0, 10.0, 5.0)),
)
"""Thickness of the gel, object and ratio; only the first five were used to find the constants."""
GRID = PeriodicGrid(160, 160, 0.2)
STEP_MM = 0.1
DEEPEST = 1.2
"""Depth over thickness; 0.8 on a rigid base, and 0.32 (0.8 mm) under the flat end."""
RIM_MM = 0.7
"""Distance from the rim of a flat end within which the calibration fits nothing."""
WITHIN_MM = 8.0


@dataclass(frozen=True)
class Pair:
    """One press in both models."""

    elements: Press
    linear: Contact

    @property
    def is_flat(self) -> bool:
        return self.elements.face_mm > 0

    def corrected_thinning_mm(self, corrected: Contact) -> float:
        """Thinning in the middle of the corrected contact."""
        rows, cols = corrected.thickness_change_mm.shape
        middle = corrected.thickness_change_mm[rows // 2 - 1 : rows // 2 + 1, cols // 2 - 1 : cols // 2 + 1]
        return float(-middle.mean()) if self.is_flat else float(-corrected.thickness_change_mm.min())

    @property
    def thinning_mm(self) -> float:
        """Thinning of the finite elements in the middle."""
        parts, moved = self.elements.parts, self.elements.moved
        (_, _, up), (_, _, below) = parts.skin_nodes, parts.nodes_at(parts.layer.base_thickness_mm)
        return float(moved[below[0]] - moved[up[0]])


def finite_strain(
    quick: bool = False, json: bool = False, fit: bool = False, only_flat: bool = False, element_mm: float = 0.2
) -> None:
    """Print the figures of all cases, a quarter of an hour; quick: two cases, coarse and shallow; only_flat: of the flat end."""
    figures: list[Figure] = []
    some = [CASES[3], CASES[-2]] if quick else [case for case in CASES if not only_flat or case[1] == FLAT_END]
    for thickness_mm, pressed, ratio in some:
        is_flat = isinstance(pressed, FlatPunch)
        share = 0.32 if is_flat else 0.3 if quick else 0.8 if ratio == 0 else DEEPEST
        pairs = list(press_both(thickness_mm, pressed, ratio, thickness_mm * share, 0.4 if quick else element_mm))
        base = f"{ratio:g} times as stiff" if ratio else "rigid"
        kind = "flat end" if is_flat else "ball"
        name = f"{thickness_mm:g} mm of gel, {kind} {pressed.radius_mm:g} mm, base {base}"
        figures += figures_of(name, pairs)
        if fit:
            figures += best_constants(name, pairs)
    answer("finite strain", figures, json)


def press_both(
    thickness_mm: float, pressed: Ball | FlatPunch, ratio: float, deepest_mm: float, element_mm: float
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
        for press in follow(Parts(layer), *meridian_of(pressed, depths_mm)):
            contact = model.step(contact, pressed, Pose(depth_mm=press.depth_mm))
            yield Pair(press, contact)
    except PressFailed:
        return


def meridian_of(pressed: Ball | FlatPunch, depths_mm: list[float]) -> tuple[float, list[float], float]:
    """Return radius of the ball or of the edge, the depths, and the radius of the flat face."""
    if isinstance(pressed, Ball):
        return pressed.radius_mm, depths_mm, 0.0
    return pressed.edge_mm, depths_mm, pressed.radius_mm - pressed.edge_mm


def figures_of(name: str, pairs: list[Pair]) -> list[Figure]:
    """Return the worst errors over all depths from a fifth of the deepest on."""
    loads, thinnings = [], []
    errors_um: dict[str, list[tuple[float, float]]] = {"height": [], "thickness": []}
    radius_mm = np.hypot(*GRID.positions_mm)
    for pair in pairs[len(pairs) // 5 :]:
        corrected = correct_for_finite_strain(pair.linear)
        loads.append(float(corrected.pressure_mpa.sum()) * GRID.cell_area_mm2 / pair.elements.load - 1)
        thinnings.append(pair.corrected_thinning_mm(corrected) / pair.thinning_mm - 1)
        beside = (pair.linear.pressure_mpa <= 0) & (radius_mm < WITHIN_MM)
        if pair.is_flat:
            beside &= radius_mm > FLAT_END.radius_mm + RIM_MM
        height_mm, thickness_mm = pair.elements.height_mm(radius_mm), pair.elements.thickness_change_mm(radius_mm)
        both = corrected, pair.linear
        for each, found, true_mm in (
            ("height", [one.height_mm for one in both], height_mm),
            ("thickness", [one.thickness_change_mm for one in both], thickness_mm),
        ):
            rms_um = (1e3 * float(np.sqrt(np.mean((one - true_mm)[beside] ** 2))) for one in found)
            errors_um[each].append((next(rms_um), next(rms_um)))
    return [
        at_most(f"{name}: load, largest error, %", 100 * max(map(abs, loads)), 4.0),
        at_most(f"{name}: thinning in the middle, largest error, %", 100 * max(map(abs, thinnings)), 4.0),
        *(
            Figure(
                f"{name}: {each} beside it, largest RMS, µm",
                max(corrected for corrected, _ in errors),
                peer=round(max(linear for _, linear in errors), 1),
            )
            for each, errors in errors_um.items()
        ),
    ]


def best_constants(name: str, pairs: list[Pair]) -> list[Figure]:
    """Return growth, redistribution and transport that fit the thickness beside the ball best."""
    radius_mm = np.hypot(*GRID.positions_mm)
    rows, wanted = [], []
    for pair in pairs[1::2]:
        free = (pair.linear.pressure_mpa <= 0) & (radius_mm < WITHIN_MM)
        weight = 1 / np.sqrt(np.maximum(radius_mm[free], 1.0))
        linear = pair.linear
        pressure = linear.pressure_mpa
        change_by_pressure_mm = -linear.skin.operators.indentation_from_pressure_mm(pressure)
        change_by_pressure_mm = change_by_pressure_mm - linear.skin.interface_height_mm(pressure, 0 * linear.shear_mpa)
        greatest_thinning_mm = -linear.thickness_change_mm.min()
        terms = finite_strain_thickening_terms_mm(
            change_by_pressure_mm, greatest_thinning_mm, linear.skin.gel, GRID, linear.tangential_mm
        )
        rows.append(np.stack([term[free] * weight for term in terms], axis=1))
        wanted.append((pair.elements.thickness_change_mm(radius_mm) - linear.thickness_change_mm)[free] * weight)
    found = np.linalg.lstsq(np.concatenate(rows), np.concatenate(wanted), rcond=None)[0]
    names = ("growth", "redistribution", "transport")
    return [Figure(f"{name}: best {one}", float(value)) for one, value in zip(names, found, strict=True)]


if __name__ == "__main__":
    tyro.cli(finite_strain)
