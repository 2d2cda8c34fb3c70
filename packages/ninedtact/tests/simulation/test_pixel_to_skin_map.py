"""Fields are refined exactly: the finer grid has the values of the coarse one, and none of its axes is special."""

from itertools import product

import numpy as np
import pytest
import torch

from ninedtact.mechanics.numpy_or_torch_arrays import forward_transform, inverse_transform
from ninedtact.mechanics.skin import PeriodicGrid
from ninedtact.simulation.pixel_to_skin_map import REFINEMENT, blur_and_refine_fields, zero_pad_spectrum

GRIDS = [PeriodicGrid(rows, cols, 0.2) for rows, cols in product((9, 10, 12), (11, 12, 15))]


@pytest.mark.parametrize("grid", GRIDS, ids=lambda grid: f"{grid.rows}x{grid.cols}")
def test_a_refined_field_goes_through_the_coarse_one(grid: PeriodicGrid) -> None:
    """All waves of a random field are present, also the highest one of an even side."""
    field = np.random.default_rng(0).standard_normal(grid.shape).astype(np.float32)
    (fine,) = blur_and_refine_fields(grid, 0.0, field)
    assert fine[::REFINEMENT, ::REFINEMENT] == pytest.approx(field, abs=1e-5)
    shape = (grid.rows * REFINEMENT, grid.cols * REFINEMENT)
    wave = zero_pad_spectrum(forward_transform(torch.from_numpy(field), grid.shape), grid)
    assert (inverse_transform(wave, shape, shape) * REFINEMENT**2).numpy() == pytest.approx(fine, abs=1e-5)
