"""Pressure, shear and slip over the skin as the page shows them: of the estimate, or on a twin of the simulation.

Fields are on a grid of pixels of the height map, one of every `EVERY_PX`, which is finer than any estimate.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from jaxtyping import Bool, Float32, UInt8
from numpy import ndarray as Array

from ninedtact.mechanics.numpy_or_torch_arrays import to_numpy
from ninedtact.quantities import HeightMap, Traction, centred_axis_mm
from ninedtact.shape.coloured_height_map import round_up_to_1_2_5
from ninedtact.simulation.ground_truth import resample_skin_field, true_pressure_map_mpa, true_shear_map_mpa
from ninedtact.simulation.press import Press

EVERY_PX = 2
LEAST_MPA = 0.005
"""Smallest end of a scale, so that noise stays pale."""
STICK, SLIP, NO_CONTACT = (178, 114, 0), (0, 159, 230), (230, 230, 230)
"""Blue and orange of Okabe and Ito, which colour-blind readers can distinguish, and light grey; in BGR."""
_ARROWS_EVERY_MM = 1.5
_LONGEST_ARROW_MM = 3.0


@dataclass(frozen=True)
class SkinTractions:
    """Pressure and shear in MPa that the object applies to the skin, on the grid of the page."""

    pressure_mpa: Float32[Array, "rows cols"]
    shear_mpa: Float32[Array, "rows cols 2"]
    mm_per_px: float
    slips: Bool[Array, "rows cols"] | None = None
    """Where the skin slips under the object; None where that is not known."""

    @cached_property
    def shear_magnitude_mpa(self) -> Float32[Array, "rows cols"]:
        """The magnitude of the shear traction."""
        return np.asarray(np.hypot(self.shear_mpa[..., 0], self.shear_mpa[..., 1]), np.float32)

    def sticking_image(self) -> UInt8[Array, "rows cols 3"]:
        """Return where the contact sticks (blue) and slips (orange), in BGR."""
        image = np.full((*self.pressure_mpa.shape, 3), NO_CONTACT, np.uint8)
        touched = self.pressure_mpa > 0
        image[touched] = STICK
        if self.slips is not None:
            image[touched & self.slips] = SLIP
        return image

    def arrows_mm(self, height: HeightMap, with_pressure: bool, with_shear: bool) -> Float32[Array, "n 2 3"]:
        """Return arrows from start to end in mm: along the traction, ending on the skin where it presses."""
        step = max(round(_ARROWS_EVERY_MM / self.mm_per_px), 1)
        first = step // 2
        sample = np.s_[first::step, first::step]
        pressure, shear = self.pressure_mpa[sample], self.shear_mpa[sample]
        traction = np.dstack([shear * with_shear, -pressure * with_pressure])
        x, y = (centred_axis_mm(count, self.mm_per_px)[first::step] for count in self.pressure_mpa.shape[::-1])
        z_mm = height.z_mm[::EVERY_PX, ::EVERY_PX][sample]
        ends = np.dstack([*np.meshgrid(x, y), z_mm])
        longest = max(float(np.linalg.norm(traction, axis=-1).max(initial=0.0)), LEAST_MPA)
        lengths = traction * np.float32(_LONGEST_ARROW_MM / round_up_to_1_2_5(longest))
        kept = np.linalg.norm(lengths, axis=-1) > 0.05 * _LONGEST_ARROW_MM
        # Pressure arrows come from outside and end on the skin; a shear without pressure starts on it.
        starts, tips = (ends - lengths, ends) if with_pressure else (ends, ends + lengths)
        return np.asarray(np.stack([starts[kept], tips[kept]], axis=1), np.float32)


def interpolate_estimated_tractions(traction: Traction, height: HeightMap) -> SkinTractions:
    """Return the tractions of an estimate, interpolated linearly from its cells."""
    (rows, cols), mm_per_px = _page_grid(height)
    cell_rows, cell_cols = traction.pressure_mpa.shape
    scale = mm_per_px / traction.mm_per_px
    to_cells = np.array(
        [
            [scale, 0.0, (cell_cols - 1) / 2 - scale * (cols - 1) / 2],
            [0.0, scale, (cell_rows - 1) / 2 - scale * (rows - 1) / 2],
        ]
    )
    pressure, shear_x, shear_y = (
        cv2.warpAffine(field, to_cells, (cols, rows), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
        for field in (traction.pressure_mpa, *traction.shear_mpa)
    )
    return SkinTractions(np.asarray(pressure), np.dstack([shear_x, shear_y]), mm_per_px)


def true_tractions(press: Press, height: HeightMap) -> SkinTractions:
    """Return the tractions of the simulated contact, with where it slips."""
    shape, mm_per_px = _page_grid(height)
    contact = press.corrected
    slips = ((to_numpy(contact.stick_mask) == 0) & (to_numpy(contact.pressure_mpa) > 0)).astype(np.float32)
    return SkinTractions(
        np.maximum(true_pressure_map_mpa(contact, shape, mm_per_px), 0),
        true_shear_map_mpa(contact, shape, mm_per_px),
        mm_per_px,
        resample_skin_field(contact, slips, shape, mm_per_px) > 0.5,
    )


def colourise_magnitudes(
    field_mpa: Float32[Array, "rows cols"],
) -> tuple[UInt8[Array, "rows cols 3"], float]:
    """Return a field from zero in the colours of cividis (BGR), and the MPa at the end of the scale: a round number."""
    end_mpa = round_up_to_1_2_5(max(float(field_mpa.max(initial=0.0)), LEAST_MPA) * (1 - 1e-9))
    levels = cv2.convertScaleAbs(field_mpa, alpha=255 / end_mpa)
    return np.asarray(cv2.applyColorMap(levels, cv2.COLORMAP_CIVIDIS)), end_mpa


def _page_grid(height: HeightMap) -> tuple[tuple[int, int], float]:
    """Return rows and columns of the grid of the page, and its mm per pixel."""
    rows, cols = (math.ceil(count / EVERY_PX) for count in height.z_mm.shape)
    return (rows, cols), height.mm_per_px * EVERY_PX
