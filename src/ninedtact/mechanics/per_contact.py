"""Numbers of which there is one for each contact of a batch.

Next to fields (…, rows, cols) they are shaped (…, 1, 1), next to vectors (…, 1, 1, 1), so that they scale them; without a
batch too, so that one contact is computed as many are. Each contact of a batch stops on its own, so that its answer does
not depend on who else is in the batch.
"""

from typing import Any

import numpy as np
from array_api_compat import device, to_device
from jaxtyping import Bool, Float, Int, Shaped
from numpy import ndarray as Array

from ninedtact.mechanics.library import library_of

PerContact = Float[Any, "... 1 1"]
Which = Bool[Any, "... 1 1"]
"""Contacts of a batch."""
Number = float | Float[Any, "batch"]
"""Of one contact, or of each in a batch."""
Count = int | Int[Any, "batch"]
"""Likewise."""


def total(field: Shaped[Any, "*batch rows cols"]) -> Shaped[Any, "*batch 1 1"]:
    """Sum over the grid; of points, their number."""
    return field.sum(axis=(-2, -1), keepdims=True)


def largest(field: Float[Any, "*batch rows cols"]) -> PerContact:
    """Largest value on the grid, or of vectors."""
    return library_of(field).max(field, axis=(-2, -1), keepdims=True)


def positive(divisor: Any) -> Any:
    """A divisor that is never zero: where it would be, what is divided is zero too."""
    return divisor + (divisor <= 0)


def over_grid(number: float | Float[Any, "*batch"], field: Any) -> Any:
    """A number ready to meet a field: as it is, or an array of the field's kind, shaped (batch, 1, 1)."""
    values = np.array(number)
    if values.ndim == 0:
        return float(values)
    xp = library_of(field)
    return xp.asarray(values, dtype=field.dtype, device=device(field))[..., None, None]


def on_cpu(values: Any) -> Float[Array, "..."]:
    """As a NumPy array, double precision."""
    return np.asarray(to_device(values, "cpu"), dtype=np.float64)


def plain(numbers: PerContact) -> Number:
    """Without the grid's axes: a float, or a NumPy array (batch,)."""
    values = on_cpu(numbers)[..., 0, 0]
    return float(values) if values.ndim == 0 else values


def counted(numbers: PerContact) -> Count:
    """Likewise of whole numbers."""
    values = plain(numbers)
    return int(values) if isinstance(values, float) else np.asarray(values).astype(int)
