"""Heights, pressure and shear of a simulated contact on the pixel grid of a sensor, to compare estimates with."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float32
from numpy import ndarray as Array

from ninedtact.mechanics.contact_result import Contact
from ninedtact.mechanics.numpy_or_torch_arrays import to_numpy
from ninedtact.quantities import HeightMap, HeightSource, skin_grid_mm
from ninedtact.simulation.pixel_to_skin_map import SightlineGrid, grid_indices_at_positions, sample_periodic


def true_height_map(
    contact: Contact, shape: tuple[int, int], mm_per_px: float, inverse_distance_per_mm: float = 0.0
) -> HeightMap:
    """Return the height of the skin on a grid of (rows, cols) about the sensor's centre.

    With an inverse viewing distance k > 0 per mm, pixels are lines of sight, as those of a reconstruction are: pixel P shows the
    skin at P(1 + k·z). With zero, pixels are positions.
    """
    sight = SightlineGrid(*skin_grid_mm(shape, mm_per_px), inverse_distance_per_mm)
    height_mm = to_numpy(contact.height_mm).astype(np.float32)
    z_mm = sight.sample(contact.skin.grid, contact.centre_mm, height_mm, height_mm)
    source = np.full(shape, HeightSource.MEASURED, np.uint8)
    return HeightMap(
        z_mm, source, mm_per_px, camera_distance_mm=1 / inverse_distance_per_mm if inverse_distance_per_mm else np.inf
    )


def true_height_map_like(contact: Contact, seen: HeightMap, inverse_distance_per_mm: float) -> HeightMap:
    """Return the heights that an exact reconstruction would have given, pixel by pixel."""
    true = true_height_map(contact, seen.z_mm.shape, seen.mm_per_px, inverse_distance_per_mm)
    return replace(true, source=seen.source, stamp_ns=seen.stamp_ns)


def true_pressure_map_mpa(contact: Contact, shape: tuple[int, int], mm_per_px: float) -> Float32[Array, "rows cols"]:
    """Return the pressure in MPa at the pixels of a grid about the sensor's centre."""
    return resample_skin_field(contact, contact.pressure_mpa, shape, mm_per_px)


def true_shear_map_mpa(contact: Contact, shape: tuple[int, int], mm_per_px: float) -> Float32[Array, "rows cols 2"]:
    """Return the shear traction (x, y) in MPa that the object applies to the skin, at the pixels of a grid."""
    return np.stack([resample_skin_field(contact, part, shape, mm_per_px) for part in contact.shear_mpa], axis=-1)


def resample_skin_field(
    contact: Contact, field: Array, shape: tuple[int, int], mm_per_px: float
) -> Float32[Array, "rows cols"]:
    """Interpolate a field of the simulated skin linearly at the pixels of a grid."""
    at = grid_indices_at_positions(contact.skin.grid, contact.centre_mm, *skin_grid_mm(shape, mm_per_px))
    return sample_periodic(to_numpy(field).astype(np.float32), *at)
