"""How force without training bears what is not as it assumes: the table of presses by wrong numbers, and by wrong mechanics.

Heights are given directly, with noise, so that light plays no part: a ball and a cylinder, 0.4 to 1.5 mm deep, a star and a
heap of pebbles under 2 to 11 N, dragged by up to 1 mm and twisted by up to 17°. The gel is told except for what the line
says is wrong. Skill is 1 − MAE / MAE of answering the median; torques are about the skin's centre.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from time import process_time

import cv2
import numpy as np
import tyro

from ninedtact.design import Gel
from ninedtact.force.traction.brightness_from_traction import COMPLIANT_BASE
from ninedtact.force.traction.estimator import TractionForce
from ninedtact.force.traction.observation import HeightObservationModel
from ninedtact.mechanics.contact_result import Contact
from ninedtact.mechanics.indenter import Ball, Indenter, LyingCylinder
from ninedtact.quantities import Frame, HeightMap, Rectified
from ninedtact.reading import Reading
from ninedtact.simulation.ground_truth import true_height_map
from ninedtact.simulation.objects.catalogue import generate_object
from ninedtact.simulation.trajectory import ScriptedPress
from ninedtact.simulation.twin import Twin, default_twin
from ninedtact_train.population.mechanics_shares import MechanicsKind
from ninedtact_train.population.sensor_population import (
    gel_on_base_compliance,
    sample_transparent_layer,
)

AXES = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")
SHAPE, PX_MM = (90, 120), 0.2
GEL = Gel()
OBJECTS: tuple[Indenter, ...] = (
    Ball(4.0),
    LyingCylinder(3.0, 8.0),
    generate_object("star_01"),
    generate_object("pebbles_01"),
)


@dataclass(frozen=True)
class Case:
    """One line of the table."""

    name: str
    noise_mm: float = 0.01
    gel: Gel = GEL
    """What the estimator believes."""
    seen: Callable[[np.ndarray], np.ndarray] = np.copy
    """What is done to the heights."""
    kind: MechanicsKind = "bonded"
    base: Gel | None = None
    """What the estimator believes to be below the gel."""


def bulges(gain: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda z: np.where(z > 0, z * gain, z)


def blurred(z: np.ndarray) -> np.ndarray:
    return np.asarray(cv2.GaussianBlur(z, (0, 0), 0.5 / PX_MM, borderType=cv2.BORDER_REPLICATE))


CASES = (
    Case("10 µm noise, right model"),
    Case("30 µm noise", noise_mm=0.03),
    Case("h 10 % too thick", gel=replace(GEL, thickness_mm=2.75)),
    Case("h 10 % too thin", gel=replace(GEL, thickness_mm=2.25)),
    Case("bulge gain +15 %", seen=bulges(1.15)),
    Case("bulge gain −15 %", seen=bulges(0.85)),
    Case("ν = 0.48 assumed, 0.50 true", gel=replace(GEL, poisson_ratio=0.48)),
    Case("0.5 mm blur not undone", seen=blurred),
    Case("compliant base", kind="compliant_base"),
    Case("compliant base, told", kind="compliant_base", base=COMPLIANT_BASE),
    Case("finite strain", kind="finite_strain"),
)


def traction_mismatch(presses: int = 60, seed: int = 0) -> None:
    """ScriptedPress, spoil, read, compare."""
    cv2.setNumThreads(1)
    contacts = {kind: list(pressed(kind, presses, seed)) for kind in ("bonded", "compliant_base", "finite_strain")}
    print(f"{'':30s}" + "".join(f"{axis:>7s}" for axis in AXES) + "   slopes" + " " * 36 + "covered  ms")
    for case in CASES:
        line(case, contacts[case.kind])


def pressed(kind: MechanicsKind, presses: int, seed: int) -> Iterator[Contact]:
    """The same presses on gel of this kind."""
    twin = twin_of(kind)
    rng = np.random.default_rng(seed)
    for number in range(presses):
        yield press(rng, number % len(OBJECTS) < 2).simulate(twin, OBJECTS[number % len(OBJECTS)], None)


def twin_of(kind: MechanicsKind) -> Twin:
    """The published gel, on a rigid base or not."""
    base = sample_transparent_layer(np.random.default_rng(0), GEL) if kind == "compliant_base" else None
    yields = GEL.thickness_mm + (base.thickness_mm if base else 0.0)
    return replace(
        default_twin(),
        compliance_of=gel_on_base_compliance(GEL, base),
        thickness_mm=yields,
        finite_strain=1.0 if kind == "finite_strain" else 0.0,
    )


def press(rng: np.random.Generator, to_depth: bool) -> ScriptedPress:
    """Somewhere, somehow."""
    along, angle = rng.uniform(0, 1.0), rng.uniform(0, 2 * np.pi)
    x, y = rng.uniform((-4, -2), (4, 2)).tolist()
    drag = float(along * np.cos(angle)), float(along * np.sin(angle))
    twist = float(np.radians(rng.uniform(-17, 17)))
    part = float(rng.uniform())
    how = {"depth_mm": 0.4 + 1.1 * part} if to_depth else {"load_n": 2 + 9 * part}
    return ScriptedPress(**how, at_mm=(x, y), drag_mm=drag, twist_rad=twist)


def line(case: Case, contacts: list[Contact]) -> None:
    """One row of the table."""
    rng, start = np.random.default_rng(1), process_time()
    estimator = TractionForce(HeightObservationModel(), case.gel, case.base)
    true, read, error = [], [], []
    for contact in contacts:
        estimator.forget()
        estimate = estimator.estimate(reading(case, contact, rng))
        true.append(contact.wrench().six)
        read.append(estimate.wrench.six)
        error.append(estimate.std)
    ms = (process_time() - start) * 1e3 / len(contacts)
    t, r, e = (np.array(rows) for rows in (true, read, error))
    skills = 1 - np.abs(t - r).mean(axis=0) / np.abs(t - np.median(t, axis=0)).mean(axis=0)
    slopes = [np.polyfit(a, b, 1)[0] for a, b in zip(t.T, r.T, strict=True)]
    numbers = "".join(f"{value:7.2f}" for value in skills) + "  " + "".join(f"{value:7.2f}" for value in slopes)
    print(f"{case.name:30s}{numbers}  {np.mean(np.abs(t - r) < 2 * e):6.0%} {ms:5.0f}", flush=True)


def reading(case: Case, contact: Contact, rng: np.random.Generator) -> Reading:
    """Heights alone, spoilt."""
    true: HeightMap = true_height_map(contact, SHAPE, PX_MM)
    noise = rng.normal(0, case.noise_mm, SHAPE)
    z_mm = np.asarray(case.seen(true.z_mm) + noise, np.float32)
    grey = Rectified(np.full(SHAPE, 150, np.float32), PX_MM)
    return Reading(Frame(np.zeros((1, 1, 3), np.uint8)), grey, replace(true, z_mm=z_mm), grey)


if __name__ == "__main__":
    tyro.cli(traction_mismatch)
