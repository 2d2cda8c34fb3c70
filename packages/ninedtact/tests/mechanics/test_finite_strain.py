"""The corrections for finite strain against finite elements of a ball to which the skin sticks (`benchmarks/finite_strain.py`)."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch

from ninedtact.design import Gel
from ninedtact.mechanics.contact_model import ContactModel
from ninedtact.mechanics.contact_result import Contact
from ninedtact.mechanics.finite_strain import (
    correct_for_finite_strain,
    finite_strain_stiffening,
)
from ninedtact.mechanics.indenter import Ball
from ninedtact.mechanics.pose import Pose
from ninedtact.mechanics.skin import PeriodicGrid, gel_skin

GRID = PeriodicGrid(128, 128, 0.2)
BESIDE_MM = np.array([4.0, 5.0, 6.0, 7.0])
DOUBLE = np.zeros(())


@dataclass(frozen=True)
class ElementPress:
    """A press of finite elements with a shear modulus of one, on 9.2 mm of a base."""

    thickness_mm: float
    gel_over_base: float
    ball_mm: float
    depth_mm: float
    load_mm2: float
    thinning_mm: float
    """Under the middle of the ball."""
    skin_mm: tuple[float, ...]
    """Height of the skin at `BESIDE_MM` from the axis."""


PRESSES = [
    ElementPress(2.0, 0, 4.0, 1.0, 67.99, 1.000, (0.1274, 0.0642, 0.0326, 0.0196)),
    ElementPress(2.0, 0.025, 4.0, 2.0, 350.01, 1.617, (0.2362, 0.2237, 0.1038, 0.0522)),
    ElementPress(2.0, 0.05, 4.0, 1.0, 51.94, 0.861, (0.0722, 0.0352, 0.0171, 0.0105)),
    ElementPress(2.0, 0.05, 4.0, 2.0, 266.26, 1.436, (0.1474, 0.1453, 0.0644, 0.0322)),
    ElementPress(2.5, 0.1, 4.0, 1.0, 32.35, 0.844, (0.0413, 0.0291, 0.0160, 0.0095)),
    ElementPress(2.5, 0.1, 4.0, 1.6, 88.29, 1.231, (0.0583, 0.0680, 0.0390, 0.0216)),
    ElementPress(2.5, 0.1, 4.0, 2.4, 212.63, 1.614, (-0.0410, 0.1051, 0.0761, 0.0406)),
    ElementPress(2.0, 0.1, 2.0, 1.0, 18.81, 0.865, (0.0165, 0.0062, 0.0030, 0.0023)),
    ElementPress(2.0, 0.2, 4.0, 0.8, 20.74, 0.564, (-0.0018, -0.0033, -0.0028, -0.0011)),
]


def contact_of(press: ElementPress) -> Contact:
    """The same press of the linear gel."""
    gel = Gel(press.thickness_mm, 1.0, 0.5, 1.0, gel_to_base_modulus_ratio=press.gel_over_base)
    model = ContactModel(gel_skin(GRID, gel, DOUBLE), friction=1.0)
    steps = np.append(np.arange(0.2, press.depth_mm, 0.2), press.depth_mm)
    *_, last = model.follow(Ball(press.ball_mm), [Pose(depth_mm=float(depth)) for depth in steps])
    return last


@pytest.mark.parametrize("press", PRESSES, ids=lambda press: f"{press.gel_over_base:g} {press.depth_mm:g} mm")
def test_load_thinning_and_skin_are_those_of_the_finite_elements(press: ElementPress) -> None:
    linear = contact_of(press)
    corrected = correct_for_finite_strain(linear)
    load = float(corrected.pressure_mpa.sum()) * GRID.cell_area_mm2
    assert load == pytest.approx(press.load_mm2, rel=0.04)
    # The grid has no point under the lowest point of the ball.
    between_points_mm = press.depth_mm + float(linear.height_mm.min())
    assert -corrected.thickness_change_mm.min() == pytest.approx(
        press.thinning_mm, abs=0.03 * press.thinning_mm + between_points_mm
    )
    skin_mm, straight_mm = (height_beside_mm(contact) for contact in (corrected, linear))
    assert np.abs(skin_mm - press.skin_mm).max() < 0.06 * press.depth_mm / press.thickness_mm
    assert np.linalg.norm(skin_mm - press.skin_mm) < np.linalg.norm(straight_mm - press.skin_mm)


def height_beside_mm(contact: Contact) -> np.ndarray:
    """Height of the skin at `BESIDE_MM` from the axis."""
    x, y = GRID.positions_mm
    row = np.argmin(np.abs(y[:, 0]))
    return np.interp(np.sqrt(BESIDE_MM**2 - y[row, 0] ** 2), x[row], contact.height_mm[row])


@pytest.mark.parametrize("ratio", [0.0, 0.12])
def test_nothing_changes_for_small_strain_and_without_contact(ratio: float) -> None:
    model = ContactModel(gel_skin(GRID, replace(Gel(), gel_to_base_modulus_ratio=ratio), DOUBLE))
    shallow, flat = model.follow(Ball(4.0), [Pose(depth_mm=0.01), Pose(depth_mm=-1.0)])
    corrected = correct_for_finite_strain(shallow)
    assert corrected.pressure_mpa == pytest.approx(shallow.pressure_mpa, rel=1e-3)
    assert corrected.height_mm == pytest.approx(shallow.height_mm, abs=1e-4)
    untouched = correct_for_finite_strain(flat)
    assert not untouched.pressure_mpa.any() and not untouched.height_mm.any()


def test_a_linear_gel_is_left_as_it_is() -> None:
    model = ContactModel(gel_skin(GRID, replace(Gel(), finite_strain=0.0)))
    contact = model.step(model.initial_contact(), Ball(4.0), Pose(depth_mm=1.0))
    assert correct_for_finite_strain(contact) is contact


@pytest.mark.parametrize("ratio", [0.0, 0.12])
def test_tractions_stiffen_with_thinning_alone_and_torch_says_the_same(ratio: float) -> None:
    gel = replace(Gel(), gel_to_base_modulus_ratio=ratio)
    heights = np.linspace(-2.0, 1.0, 31)[None]
    thinner = 0.7 * heights if ratio else heights
    stiffening = finite_strain_stiffening(heights, thinner, gel)
    assert (np.diff(stiffening) <= 0).all() and (stiffening[heights >= 0] == 1).all()
    by_torch = finite_strain_stiffening(torch.from_numpy(heights), torch.from_numpy(thinner), gel)
    assert by_torch.numpy() == pytest.approx(stiffening)


def test_a_batch_is_its_contacts() -> None:
    model = ContactModel(gel_skin(GRID, Gel(), DOUBLE))
    two = list(model.follow(Ball(4.0), [Pose(depth_mm=0.8), Pose(0.5, 0.0, 1.2)]))
    both = correct_for_finite_strain(Contact.stack(two))
    for found, one in zip(both.height_mm, two, strict=True):
        assert found == pytest.approx(correct_for_finite_strain(one).height_mm, abs=1e-6)
