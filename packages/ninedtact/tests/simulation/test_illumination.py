"""The law of light: no height, no change; deeper is darker, higher is brighter; what is lost is lost because something is dark."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ninedtact.mechanics.skin import PeriodicGrid
from ninedtact.simulation.gel_brightness import BrightnessModel
from ninedtact.simulation.pixel_to_skin_map import REFINEMENT, SightlineGrid, blur_and_refine_fields

lights = st.builds(
    BrightnessModel,
    darkening_per_mm=st.floats(0.01, 0.5),
    saturation=st.floats(0, 5),
    brightening_per_mm=st.floats(0.01, 2),
    thickness_mm=st.floats(1, 5),
)


@given(lights)
def test_deeper_is_darker_and_higher_is_brighter(light: BrightnessModel) -> None:
    change = light.brightness_change(np.linspace(-light.thickness_mm, 1.0, 301))
    assert (np.diff(change) > 0).all()
    assert light.brightness_change(np.zeros(1)) == 0
    step = 1e-6
    assert light.brightness_change(np.array([-step]))[0] == pytest.approx(-light.darkening_per_mm * step, rel=1e-4)
    assert light.brightness_change(np.array([step]))[0] == pytest.approx(light.brightening_per_mm * step, rel=1e-9)


@pytest.mark.parametrize("shape", [(40, 48), (41, 49)], ids=["even", "odd"])
def test_a_finer_grid_goes_through_the_same_points(shape: tuple[int, int]) -> None:
    patch = PeriodicGrid(*shape, 0.2)
    field = np.random.default_rng(0).normal(size=shape).astype(np.float32)
    (calm,) = blur_and_refine_fields(patch, 0.4, field)
    (fine,) = blur_and_refine_fields(patch, 0.0, np.ascontiguousarray(calm[::REFINEMENT, ::REFINEMENT]))
    assert np.abs(fine - calm).max() < 1e-4 * np.abs(calm).max() + 1e-5
    assert calm.mean() == pytest.approx(field.mean(), abs=1e-5)


def test_a_line_of_sight_meets_the_skin_where_it_is() -> None:
    patch, nearness = PeriodicGrid(100, 120, 0.2), 0.06
    x, y = (axis.astype(np.float32) for axis in patch.positions_mm)
    height = -1.5 * np.exp(-((x - 4) ** 2 + (y + 2) ** 2) / 8)
    through = np.array([[4.2, 3.0, 5.5]], np.float32), np.array([[-2.1, -1.0, -3.0]], np.float32)
    height = height.astype(np.float32)
    seen = SightlineGrid(*through, nearness).sample(patch, (0.0, 0.0), height, height)
    met = [place * (1 + nearness * seen) for place in through]
    assert seen == pytest.approx(-1.5 * np.exp(-((met[0] - 4) ** 2 + (met[1] + 2) ** 2) / 8), abs=0.01)
