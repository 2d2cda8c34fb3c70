"""The deflection of the base below a gel, found from the gel's thickness alone."""

from dataclasses import replace

import numpy as np
import pytest

from ninedtact.design import DesignImpossible, Gel
from ninedtact.mechanics.base_deflection import BaseDeflection
from ninedtact.mechanics.contact_model import ContactModel
from ninedtact.mechanics.contact_result import Contact
from ninedtact.mechanics.finite_strain import correct_for_finite_strain
from ninedtact.mechanics.indenter import Ball, FlatPunch, Indenter
from ninedtact.mechanics.pose import Pose
from ninedtact.mechanics.skin import PeriodicGrid, gel_skin

GRID = PeriodicGrid(128, 128, 0.2)


def press_of(gel: Gel, depth_mm: float, drag_mm: float = 0.0, indenter: Indenter = Ball(4.0)) -> Contact:
    """An object pressed into the gel at finite strain, and dragged along x."""
    model = ContactModel(gel_skin(GRID, gel), friction=1.0)
    steps = [Pose(depth_mm=depth_mm * part) for part in (0.25, 0.5, 0.75, 1.0)]
    *_, last = model.follow(
        indenter, [*steps, *(Pose(drag_mm * part, 0.0, depth_mm) for part in (0.25, 0.5, 0.75, 1.0))]
    )
    return correct_for_finite_strain(last)


@pytest.mark.parametrize("ratio", [0.03, 0.1, 0.3])
@pytest.mark.parametrize("depth_mm", [0.4, 1.0, 1.5])
def test_thickness_and_deflection_add_up_to_the_height(ratio: float, depth_mm: float) -> None:
    gel = Gel(2.0, gel_to_base_modulus_ratio=ratio)
    contact = press_of(gel, depth_mm)
    thicker_mm = contact.thickness_change_mm.astype(np.float32)
    read_mm = thicker_mm + BaseDeflection(gel)(thicker_mm, GRID.pitch_mm)
    assert read_mm.min() == pytest.approx(contact.height_mm.min(), rel=0.055)
    near = np.hypot(*GRID.positions_mm) < 6
    ignored, left = (np.abs(each - contact.height_mm)[near].mean() for each in (thicker_mm, read_mm))
    assert left < 0.07 and left < 0.7 * ignored


@pytest.mark.parametrize("ratio", [0.05, 0.2])
@pytest.mark.parametrize("indenter", [Ball(4.0), Ball(8.0), FlatPunch(4.0)], ids=["ball 4", "ball 8", "punch"])
def test_skin_under_a_dragged_object_is_neither_tilted_nor_raised(ratio: float, indenter: Indenter) -> None:
    gel = Gel(2.0, gel_to_base_modulus_ratio=ratio)
    for drag_mm in (0.0, 0.5, 1.2):
        contact = press_of(gel, 0.6, drag_mm, indenter)
        thicker_mm = contact.thickness_change_mm.astype(np.float32)
        error_mm = thicker_mm + BaseDeflection(gel)(thicker_mm, GRID.pitch_mm) - contact.height_mm
        pressed = contact.pressure_mpa > 0
        x_mm, interface_mm = GRID.positions_mm[0][pressed], (contact.height_mm - thicker_mm)[pressed]
        assert abs(error_mm[pressed].mean()) < 0.28 * abs(interface_mm.mean())
        assert abs(np.degrees(np.polyfit(x_mm, error_mm[pressed], 1)[0])) < 0.3  # 3° if shear is left out


def test_a_rigid_base_does_not_move_and_untouched_gel_neither() -> None:
    rigid, soft = replace(Gel(), gel_to_base_modulus_ratio=0.0), replace(Gel(), gel_to_base_modulus_ratio=0.3)
    pressed = press_of(rigid, 1.0).thickness_change_mm.astype(np.float32)
    assert not BaseDeflection(rigid)(pressed, GRID.pitch_mm).any()
    assert not BaseDeflection(soft)(np.zeros_like(pressed), GRID.pitch_mm).any()


@pytest.mark.parametrize(
    "wrong", [{"gel_to_base_modulus_ratio": -0.1}, {"gel_to_base_modulus_ratio": 11.0}, {"base_thickness_mm": 0.0}]
)
def test_a_base_that_no_sensor_has_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(DesignImpossible, match=r"expected gel\.(gel_to_base|base_thickness)"):
        Gel(**wrong)
