"""Numbers of which there is one for each contact of a batch.

Next to fields (…, rows, cols) they are shaped (…, 1, 1), next to vectors (…, 1, 1, 1), so that they scale them; without a
batch too, so that one contact is computed as many are. Each contact of a batch stops on its own, so that its answer does
not depend on who else is in the batch.

A batch that shrinks while it is solved.

Contacts of one batch need from ten to over a hundred iterations, and who waits for the others costs as much as they do. So as
soon as no more than half of a batch goes on, that half goes on alone. That is two fifths of the work of waiting for the slowest (of
256 steps of a data set). Halves, not just those that go on, so that few shapes occur: transforms are planned for each.
"""

from typing import Any

import numpy as np
from array_api_compat import device
from jaxtyping import Bool, Float, Int, Shaped
from numpy import ndarray as Array

from ninedtact.mechanics.array_namespace import array_namespace_of, to_numpy

PerContact = Float[Any, "... 1 1"]
ContactFlags = Bool[Any, "... 1 1"]
"""Contacts of a batch."""
ScalarPerContact = float | Float[Any, "batch"]
"""Of one contact, or of each in a batch."""
CountPerContact = int | Int[Any, "batch"]
"""Likewise."""


def sum_over_grid(field: Shaped[Any, "*batch rows cols"]) -> Shaped[Any, "*batch 1 1"]:
    """Sum over the grid; of points, their number."""
    return field.sum(axis=(-2, -1), keepdims=True)


def max_over_grid(field: Float[Any, "*batch rows cols"]) -> PerContact:
    """Largest value on the grid, or of vectors."""
    return array_namespace_of(field).max(field, axis=(-2, -1), keepdims=True)


def nonzero_divisor(divisor: Any) -> Any:
    """A divisor that is never zero: where it would be, what is divided is zero too."""
    return divisor + (divisor <= 0)


def expand_over_grid(number: float | Float[Any, "*batch"], field: Any) -> Any:
    """A number ready to meet a field: as it is, or an array of the field's kind, shaped (batch, 1, 1)."""
    values = np.array(number)
    if values.ndim == 0:
        return float(values)
    xp = array_namespace_of(field)
    return xp.asarray(values, dtype=field.dtype, device=device(field))[..., None, None]


def to_scalars(numbers: PerContact) -> ScalarPerContact:
    """Without the grid's axes: a float, or a NumPy array (batch,)."""
    values = to_numpy(numbers)[..., 0, 0]
    return float(values) if values.ndim == 0 else values


def to_counts(numbers: PerContact) -> CountPerContact:
    """Likewise of whole numbers."""
    values = to_scalars(numbers)
    return int(values) if isinstance(values, float) else np.asarray(values).astype(int)


MIN_CONTACTS_TO_SPLIT = 8
"""So few cost next to nothing beside the time that it takes to ask for their arithmetic."""
ContactIndices = Int[Array, " half"]
"""Numbers of contacts in a batch, ascending."""


def unconverged_half(going: ContactFlags) -> ContactIndices | None:
    """Half of the batch, rounded up, with all in it that go on; none where more do, or where there are few."""
    if going.ndim == 2 or len(going) <= MIN_CONTACTS_TO_SPLIT:
        return None
    goes = to_numpy(going)[:, 0, 0] > 0
    half = -(-len(goes) // 2)
    return np.sort(np.argsort(~goes, kind="stable")[:half]) if goes.sum() <= half else None


def take_contacts(values: Any, chosen: ContactIndices) -> Any:
    """Of the chosen contacts; what is no field or number of each in a batch is the same for all."""
    if getattr(values, "ndim", 0) < 3:
        return values
    xp = array_namespace_of(values)
    return xp.take(values, xp.asarray(chosen, device=device(values)), axis=0)


def put_contacts(values: Any, chosen: ContactIndices, found: Any) -> Any:
    """Those of all contacts, after something was found for the chosen ones."""
    xp = array_namespace_of(values)
    merged = xp.asarray(values, copy=True)
    merged[xp.asarray(chosen, device=device(values))] = found
    return merged
