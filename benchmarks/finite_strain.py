"""What the linear layer misses at finite strain: a ball pressed 0.1 to 1.9 mm into 2.5 mm of gel, beside finite elements.

"Measured" is the neo-Hookean, incompressible layer (neo_hookean.py, ball_in_layer.py), "peer" the linear one of
`ninedtact.mechanics`; shear modulus 1 in both, so that loads are in mm². Two skins: one slides freely, one sticks where it
touches (friction 1 in the linear model). Heights are compared within 8 mm of the ball's axis, where the skin is now: the
linear model's are read in space, at r; its other reading, each point drawn where it would have moved to, r + u_r, is also given.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro
from ball_in_layer import Press, RigidBall, follow
from figures import Figure, answer, at_most
from jaxtyping import Float
from neo_hookean import Layer, Parts
from numpy import ndarray as Array

from ninedtact.design import Gel
from ninedtact.mechanics.contact_model import ContactModel
from ninedtact.mechanics.contact_result import Contact
from ninedtact.mechanics.finite_strain import (
    GROWTH,
    REDISTRIBUTION,
    TRANSPORT,
    finite_strain_ball_change_mm,
    finite_strain_height_mm,
    finite_strain_height_terms_mm,
    finite_strain_load_factor,
    finite_strain_traction_mpa,
)
from ninedtact.mechanics.indenter import Ball
from ninedtact.mechanics.pose import Pose
from ninedtact.mechanics.skin import PeriodicGrid, Skin, gel_skin

GEL = Gel(thickness_mm=2.5, shear_modulus_mpa=1.0, poisson_ratio=0.5)
DEPTHS_MM = tuple(np.round(np.arange(0.1, 1.95, 0.1), 3).tolist())
SHOWN_MM = (0.1, 0.5, 1.0, 1.5, 1.9)
SHALLOW_MM = (0.01, 0.02, 0.05)
BALLS_MM = (4.0, 3.0, 5.0)
"""The constants of loads and tractions are fitted to the first."""
TABLED_RADII = (1.2, 1.6, 2.0, 2.5, 3.2)
"""Radii of the balls of the table, in thicknesses of the gel."""
SKINS = {"sticks": True, "slides": False}
WITHIN_MM = np.arange(0, 8, 0.02)


@dataclass(frozen=True)
class Pair:
    """One press in both models."""

    elements: Press
    linear: Contact

    @property
    def depth_mm(self) -> float:
        return self.elements.depth_mm

    @property
    def strain(self) -> float:
        """Depth over thickness."""
        return self.depth_mm / GEL.thickness_mm

    @property
    def linear_load(self) -> float:
        return float(self.linear.pressure_mpa.sum()) * self.linear.skin.grid.cell_area_mm2

    @property
    def load_ratio(self) -> float:
        return self.elements.load / self.linear_load

    @property
    def linear_radius_mm(self) -> float:
        return float(np.sqrt((self.linear.pressure_mpa > 0).sum() * self.linear.skin.grid.cell_area_mm2 / np.pi))

    @property
    def true_mm(self) -> Float[Array, " radii"]:
        """Height of the skin that is there."""
        r, across, up = self.elements.profile_mm
        return np.interp(WITHIN_MM, r + across, up)

    @property
    def half_row(self) -> tuple[Array, Array, Array]:
        """The linear model's r, u_r and u_z from the middle out."""
        middle = self.linear.skin.grid.rows // 2
        x = self.linear.skin.grid.positions_mm[0][middle, middle:]
        return x, self.linear.tangential_mm[0][middle, middle:], self.linear.height_mm[middle, middle:]

    @property
    def in_space_mm(self) -> Float[Array, " radii"]:
        r, _, up = self.half_row
        return np.interp(WITHIN_MM, r, up)

    @property
    def by_old_place_mm(self) -> Float[Array, " radii"]:
        r, across, up = self.half_row
        return np.interp(WITHIN_MM, r + across, up)

    @property
    def corrected_mm(self) -> Float[Array, " radii"]:
        """The linear height corrected as for an object of any shape."""
        return self.along_row(finite_strain_height_mm(self.linear, GEL.thickness_mm))

    @property
    def tabled_mm(self) -> Float[Array, " radii"]:
        """The linear height corrected by the table for balls."""
        radius_mm = self.elements.ball.radius_mm
        return self.in_space_mm + finite_strain_ball_change_mm(WITHIN_MM, radius_mm, self.depth_mm, GEL.thickness_mm)

    def along_row(self, field: Array) -> Float[Array, " radii"]:
        """A field of the linear model from the middle out."""
        middle = self.linear.skin.grid.rows // 2
        return np.interp(WITHIN_MM, self.half_row[0], field[middle, middle:])

    def difference_um(self, heights_mm: Float[Array, " radii"]) -> tuple[float, float]:
        """Largest and RMS."""
        difference = 1e3 * (heights_mm - self.true_mm)
        return float(np.abs(difference).max()), rms(difference)

    @property
    def stiffened_load(self) -> float:
        """Sum of the corrected pressure."""
        contact = self.linear
        pressure = finite_strain_traction_mpa(contact.pressure_mpa, contact.height_mm, GEL.thickness_mm)
        return float(pressure.sum()) * contact.skin.grid.cell_area_mm2


Presses = dict[tuple[float, str], list[Pair]]
"""By ball and skin."""


def finite_strain(
    quick: bool = False,
    json: bool = False,
    element_mm: float = 0.15,
    table: Path | None = None,
) -> None:
    """Compare, and judge the corrections. table: file in which the table of balls is written anew; nothing else is done."""
    if table is not None:
        write_ball_table(table)
        return
    skin = linear_skin(points=385, pitch_mm=0.1)
    parts = Parts(Layer(element_mm=0.5 if quick else element_mm))
    if quick:
        (pair,) = pairs(parts, skin, RigidBall(BALLS_MM[0], sticks=True), SHOWN_MM[:1])
        answer("Finite strain: one shallow press", lines("sticks", pair), json)
        return
    presses = {
        (ball, name): pairs(parts, skin, RigidBall(ball, sticks), DEPTHS_MM)
        for ball in BALLS_MM
        for name, sticks in SKINS.items()
    }
    figures = [*shallow(), *trusted(presses, element_mm), *of_patch()]
    for name in SKINS:
        figures += [
            line for pair in presses[BALLS_MM[0], name] if pair.depth_mm in SHOWN_MM for line in lines(name, pair)
        ]
    figures += [line for ball in BALLS_MM for line in corrected(ball, presses[ball, "sticks"])]
    figures += [*best_height_constants(presses), *sliding(presses)]
    answer("Finite strain: a ball in a neo-Hookean layer (measured) and in the linear one (peer)", figures, json)


def linear_skin(points: int, pitch_mm: float, gel: Gel = GEL) -> Skin:
    return gel_skin(PeriodicGrid(points, points, pitch_mm), gel, np.zeros((), np.float64))


def write_ball_table(path: Path) -> None:
    """Write what finite strain adds to the height under balls, with the thickness as the unit of length; two minutes."""
    distance, depth = np.linspace(0, 8, 161), np.arange(1, 18) * 0.05
    parts = Parts(Layer(thickness_mm=1.0, radius_mm=12.0, element_mm=0.07, fine_to_mm=2.6))
    skin = linear_skin(points=321, pitch_mm=0.05, gel=Gel(1.0, 1.0, 0.5))
    height = np.zeros((len(TABLED_RADII), 1 + depth.size, distance.size))
    for row, radius in zip(height, TABLED_RADII, strict=True):
        for one, pair in zip(row[1:], pairs(parts, skin, RigidBall(radius, True), depth.tolist()), strict=True):
            (r, across, up), (x, _, linear) = pair.elements.profile_mm, pair.half_row
            one[:] = np.interp(distance, r + across, up) - np.interp(distance, x, linear)
    single = {"ball_radius": TABLED_RADII, "depth": [0.0, *depth], "distance": distance, "height": height}
    np.savez_compressed(path, **{name: np.asarray(values, np.float32) for name, values in single.items()})


def pairs(parts: Parts, skin: Skin, ball: RigidBall, depths_mm: Iterable[float]) -> list[Pair]:
    """The same presses in both models, step by step."""
    poses = [Pose(depth_mm=depth) for depth in depths_mm]
    linear = ContactModel(skin, friction=float(ball.sticks)).follow(Ball(ball.radius_mm), poses)
    return [Pair(*both) for both in zip(follow(parts, ball, depths_mm), linear, strict=True)]


def shallow() -> list[Figure]:
    """Where strain is small both must agree."""
    parts, skin = Parts(Layer(element_mm=0.08, fine_to_mm=1.2)), linear_skin(points=801, pitch_mm=0.04)
    return [
        at_most(
            f"4 mm ball, {name}, {pair.depth_mm:g} mm deep: load differs from the linear one, %",
            100 * abs(pair.load_ratio - 1),
            2.0,
        )
        for name, sticks in SKINS.items()
        for pair in pairs(parts, skin, RigidBall(BALLS_MM[0], sticks), SHALLOW_MM)
    ]


def trusted(presses: Presses, element_mm: float) -> list[Figure]:
    """Whether the finite elements have converged, and what their rim does."""
    every = [pair.elements for together in presses.values() for pair in together]
    coarse = compared(presses, Layer(element_mm=1.5 * element_mm))
    rolling = compared(presses, Layer(element_mm=element_mm, rolling_rim=True, radius_mm=16.0))
    return [
        at_most("largest force left at a node, mm² (shear modulus 1)", max(press.residual for press in every), 1e-9),
        at_most("mean of |det F − 1|, largest of all presses", max(press.volume_error for press in every), 1e-3),
        at_most("elements half as wide again: largest change of load, %", coarse[0], 1.0),
        at_most("elements half as wide again: largest RMS change of height, µm", coarse[1], 3.0),
        at_most("rim at 16 mm that cannot move outward: largest change of load, %", rolling[0], 0.5),
        at_most("rim at 16 mm that cannot move outward: largest RMS change of height, µm", rolling[1], 3.0),
    ]


def compared(presses: Presses, layer: Layer) -> tuple[float, float]:
    """Load in % and height in µm by which another layer differs, largest of the presses shown, both skins."""
    changes = []
    for name, sticks in SKINS.items():
        known = presses[BALLS_MM[0], name]
        for pair, press in zip(known, follow(Parts(layer), RigidBall(BALLS_MM[0], sticks), DEPTHS_MM), strict=True):
            if pair.depth_mm in SHOWN_MM[1:]:
                _, change_um = pair.difference_um(Pair(press, pair.linear).true_mm)
                changes.append((100 * abs(press.load / pair.elements.load - 1), change_um))
    return tuple(np.max(changes, axis=0).tolist())


def of_patch() -> list[Figure]:
    """What the linear model's periodic images do: the same press on smaller patches."""
    sides = {points * 0.1: linear_skin(points, 0.1) for points in (641, 385, 281, 201, 161, 121)}
    pressed = {
        side: next(ContactModel(skin, 0.0).follow(Ball(BALLS_MM[0]), [Pose(depth_mm=1.0)]))
        for side, skin in sides.items()
    }
    (_, alone), *others = pressed.items()
    return [
        Figure(
            f"linear, 1 mm deep, periodic patch of {side:.0f} mm: load, bulge against one of 64 mm",
            f"{100 * (contact.pressure_mpa.sum() / alone.pressure_mpa.sum() - 1):+.2f} %, "
            f"{1e3 * (contact.height_mm.max() - alone.height_mm.max()):+.1f} µm",
        )
        for side, contact in others
    ]


def lines(name: str, pair: Pair) -> list[Figure]:
    """One press: load, contact radius, bulge, and how far the heights are apart."""
    press, start = pair.elements, f"4 mm ball, {name}, {pair.depth_mm:g} mm deep: "
    _, _, up = press.profile_mm
    bulge = float(pair.linear.height_mm.max())
    return [
        Figure(start + "load, mm²", press.load, peer=pair.linear_load),
        Figure(start + "load over the linear one", pair.load_ratio),
        Figure(start + "contact radius, mm", press.contact_radius_mm, peer=pair.linear_radius_mm),
        Figure(start + "bulge, mm", float(up.max()), peer=bulge),
        Figure(start + "linear heights read at r, max (RMS), µm", worst_and_rms(pair, pair.in_space_mm)),
        Figure(start + "the same read at r + u_r, max (RMS), µm", worst_and_rms(pair, pair.by_old_place_mm)),
    ]


def worst_and_rms(pair: Pair, heights_mm: Float[Array, " radii"]) -> str:
    return "{:.0f} ({:.1f})".format(*pair.difference_um(heights_mm))


def corrected(ball_mm: float, together: list[Pair]) -> list[Figure]:
    """What is left after the corrections of `ninedtact.mechanics.finite_strain`; the linear model's own error as peer."""
    name, plain = f"{ball_mm:g} mm ball, sticks, all depths: ", [1 / pair.load_ratio for pair in together]
    by_factor = [finite_strain_load_factor(np.float64(pair.strain)) / pair.load_ratio for pair in together]
    by_field = [pair.stiffened_load / pair.elements.load for pair in together]
    return [
        at_most(name + "load_factor, largest error, %", worst_percent(by_factor), 3.0, peer=worst_percent(plain)),
        at_most(name + "stiffened_mpa, largest error of the load, %", worst_percent(by_field), 4.0),
        *(
            figure
            for kind, heights in (("any shape", "corrected_mm"), ("table of balls", "tabled_mm"))
            for figure in height_errors(f"{name}heights, {kind}", together, heights)
        ),
    ]


def height_errors(name: str, together: list[Pair], heights: str) -> list[Figure]:
    """RMS of corrected heights, largest and mean over all depths; the linear model's own error as peer."""
    left, plain = (
        [pair.difference_um(getattr(pair, kind))[1] for pair in together] for kind in (heights, "in_space_mm")
    )
    return [
        at_most(f"{name}, largest RMS, µm", max(left), 15.0, peer=max(plain)),
        Figure(f"{name}, mean RMS, µm", float(np.mean(left)), peer=float(np.mean(plain))),
    ]


def worst_percent(ratios: Iterable[float]) -> float:
    return float(100 * max(abs(ratio - 1) for ratio in ratios))


def rms(values: Iterable[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def best_height_constants(presses: Presses) -> list[Figure]:
    """The three constants of the heights that fit all balls best, beside those in use, which were fitted to other balls."""
    terms, missing = [], []
    for ball in BALLS_MM:
        for pair in presses[ball, "sticks"]:
            beside = (pair.linear_radius_mm < WITHIN_MM) & (WITHIN_MM > 0)
            fields = finite_strain_height_terms_mm(pair.linear, GEL.thickness_mm)
            terms.append(np.column_stack([pair.along_row(field)[beside] for field in fields]))
            missing.append((pair.true_mm - pair.in_space_mm)[beside])
    found = np.linalg.lstsq(np.concatenate(terms), np.concatenate(missing), rcond=None)[0]
    return [
        Figure(f"{name} of finite_strain_height_mm that fits all balls best (in use: {used:g})", float(value))
        for name, used, value in zip(
            ("growth", "redistribution", "transport"), (GROWTH, REDISTRIBUTION, TRANSPORT), found, strict=True
        )
    ]


def sliding(presses: Presses) -> list[Figure]:
    """A skin that slides needs no correction of its load, up to which depth?"""
    ratios = [pair.load_ratio for (_, name), together in presses.items() if name == "slides" for pair in together[:17]]
    return [
        at_most("all balls, slides, to 1.7 mm: load without correction, largest error, %", worst_percent(ratios), 5.0)
    ]


if __name__ == "__main__":
    tyro.cli(finite_strain)
