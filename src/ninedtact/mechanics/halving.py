"""A batch that shrinks while it is solved.

Contacts of one batch need from ten to over a hundred iterations, and who waits for the others costs as much as they do. So as
soon as no more than half of a batch goes on, that half goes on alone. That is two fifths of the work of waiting for the slowest (of
256 steps of a data set). Halves, not just those that go on, so that few shapes occur: transforms are planned for each.
"""

from typing import Any

import numpy as np
from array_api_compat import device
from jaxtyping import Int
from numpy import ndarray as Array

from ninedtact.mechanics.library import library_of
from ninedtact.mechanics.per_contact import Which, on_cpu

FEWEST = 8
"""So few cost next to nothing beside the time that it takes to ask for their arithmetic."""
Chosen = Int[Array, " half"]
"""Numbers of contacts in a batch, ascending."""


def half_of(going: Which) -> Chosen | None:
    """Half of the batch, rounded up, with all in it that go on; none where more do, or where there are few."""
    if going.ndim == 2 or len(going) <= FEWEST:
        return None
    goes = on_cpu(going)[:, 0, 0] > 0
    half = -(-len(goes) // 2)
    return np.sort(np.argsort(~goes, kind="stable")[:half]) if goes.sum() <= half else None


def some(values: Any, chosen: Chosen) -> Any:
    """Of the chosen contacts; what is no field or number of each in a batch is the same for all."""
    if getattr(values, "ndim", 0) < 3:
        return values
    xp = library_of(values)
    return xp.take(values, xp.asarray(chosen, device=device(values)), axis=0)


def put(values: Any, chosen: Chosen, found: Any) -> Any:
    """Those of all contacts, after something was found for the chosen ones."""
    xp = library_of(values)
    merged = xp.asarray(values, copy=True)
    merged[xp.asarray(chosen, device=device(values))] = found
    return merged
