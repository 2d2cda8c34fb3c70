"""Arrays of contacts in NumPy or torch: the array API namespace of an array, Fourier transforms, one number for each contact of a
batch, and batches that shrink while they are solved.

The transforms are two-dimensional, of real fields, over the last two axes. NumPy arrays go through scipy.fft, which keeps single
precision and takes half the time of NumPy's own. A field smaller than its transform is padded with zeros after its last row and
column; rows that hold nothing but padding are not transformed.

A number of each contact is shaped (…, 1, 1) beside fields (…, rows, cols) and (…, 1, 1, 1) beside vector fields, so that it
scales them. A single contact has the same shapes without the batch axis and is computed by the same code. Each contact of a
batch stops on its own, so its result does not depend on the other contacts of the batch.

Contacts of one batch need different numbers of rounds, and a contact that has converged costs as much as one that has not. As soon
as no more than half of a batch is still being solved, that half is solved alone. Halves are taken rather than exactly the
unconverged contacts so that few array shapes occur: Fourier transforms are planned, and CUDA graphs recorded, for each shape.
"""

from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from array_api_compat import array_namespace, device, to_device
from jaxtyping import Bool, Float, Int, Shaped
from numpy import ndarray as Array

_NAMESPACES: dict[type, Any] = {}
"""Namespaces by array type: finding one costs more than the addition of two small arrays."""


def array_namespace_of(array: Any) -> Any:
    """Return the array API namespace (the functions `where`, `sqrt`, `stack`, …) of the library that made this array."""
    kind = type(array)
    if kind not in _NAMESPACES:
        _NAMESPACES[kind] = array_namespace(array)
    return _NAMESPACES[kind]


def to_numpy(values: Any) -> Float[Array, "..."]:
    """Return the values as a NumPy array in double precision, copied from their device if necessary."""
    return np.asarray(to_device(values, "cpu"), dtype=np.float64)


def to_numpy_together(*values: Any) -> tuple[Float[Array, "..."], ...]:
    """Return arrays of one library as NumPy arrays in double precision; the processor waits only once for a device."""
    if isinstance(values[0], np.ndarray):
        return tuple(map(to_numpy, values))
    xp = array_namespace_of(values[0])
    together = to_numpy(xp.concat([xp.astype(xp.reshape(value, (-1,)), xp.float64) for value in values]))
    ends = np.cumsum([np.prod(value.shape, dtype=int) for value in values])
    parts = np.split(together, ends[:-1])
    return tuple(part.reshape(value.shape) for part, value in zip(parts, values, strict=True))


def forward_transform(field: Any, shape: tuple[int, int]) -> Any:
    """Return the unscaled forward transform of a real field, (…, rows, cols), zero-padded to this shape: (…, rows, half)."""
    fft = _transform_module(field)
    return fft.fft(fft.rfft(field, shape[1]), shape[0], -2)


def inverse_transform(spectrum: Any, shape: tuple[int, int], field_shape: tuple[int, int]) -> Any:
    """Return the field, scaled by 1/(rows·cols), whose transform of this shape is given; the padding is cut off."""
    fft, (rows, cols) = _transform_module(spectrum), field_shape
    return fft.irfft(fft.ifft(spectrum, shape[0], -2)[..., :rows, :], shape[1])[..., :cols]


def _transform_module(array: Any) -> Any:
    return _scipy_fft() if isinstance(array, np.ndarray) else array_namespace_of(array).fft


@lru_cache(maxsize=1)
def _scipy_fft() -> Any:
    """Import scipy.fft when a transform is first needed, so that importing this module stays cheap."""
    import scipy.fft

    return scipy.fft


PerContact = Float[Any, "... 1 1"]
"""A number for each contact, shaped to combine with fields."""
ContactFlags = Bool[Any, "... 1 1"]
"""A truth value for each contact, shaped to combine with fields."""
ScalarPerContact = float | Float[Any, "batch"]
"""The number of a single contact, or one for each contact of a batch, without the grid's axes."""
CountPerContact = int | Int[Any, "batch"]
"""The whole number of a single contact, or one for each contact of a batch."""
ContactIndices = Int[Array, " half"]
"""Positions of contacts in a batch, ascending."""

ITERATIONS_UNSEEN = 8
"""Iterations of a batch between two looks at what has converged."""
MIN_CONTACTS_TO_SPLIT = 8
"""Batches of up to this size are not split: their arithmetic costs next to nothing beside the overhead of each call."""


def sum_over_grid(field: Shaped[Any, "*batch rows cols"]) -> Shaped[Any, "*batch 1 1"]:
    """Return the sum of each field over its grid; of a mask, the number of its points."""
    return field.sum(axis=(-2, -1), keepdims=True)


def max_over_grid(field: Float[Any, "*batch rows cols"]) -> PerContact:
    """Return the largest value of each field on its grid."""
    return array_namespace_of(field).max(field, axis=(-2, -1), keepdims=True)


def nonzero_divisor(divisor: Any) -> Any:
    """Return a divisor without zeros; where it was zero, the dividend must be zero too."""
    return divisor + (divisor <= 0)


def expand_over_grid(number: float | Float[Any, "*batch"], field: Any) -> Any:
    """Return a number in a form that combines with a field: a float, or an array of the field's kind, (batch, 1, 1)."""
    values = np.array(number)
    if values.ndim == 0:
        return float(values)
    xp = array_namespace_of(field)
    return xp.asarray(values, dtype=field.dtype, device=device(field))[..., None, None]


def drop_grid_axes(numbers: PerContact) -> ScalarPerContact:
    """Return numbers without the grid's axes: a float, or a NumPy array (batch,)."""
    values = to_numpy(numbers)[..., 0, 0]
    return float(values) if values.ndim == 0 else values


def may_stop_after(iterations: int, unconverged: ContactFlags) -> bool:
    """Return whether it is time to look if all contacts have converged: always for a single contact and in NumPy.

    A device must finish all its work before the processor can see its flags, so those of a batch are seen now and then.
    Contacts that have converged do not change meanwhile.
    """
    at_once = unconverged.ndim == 2 or isinstance(unconverged, np.ndarray)
    return at_once or (iterations > 0 and iterations % ITERATIONS_UNSEEN == 0)


def half_with_all_unconverged(flags: Bool[Array, " batch"]) -> ContactIndices | None:
    """Return the indices of half of the batch, rounded up, which contains all unconverged contacts.

    None where more than half have not converged, and where the batch is small.
    """
    if len(flags) <= MIN_CONTACTS_TO_SPLIT:
        return None
    half = -(-len(flags) // 2)
    return np.sort(np.argsort(~flags, kind="stable")[:half]) if flags.sum() <= half else None


def take_contacts(values: Any, indices: ContactIndices) -> Any:
    """Return the values of these contacts; a value without a batch axis is the same for all contacts and is returned unchanged."""
    if getattr(values, "ndim", 0) < 3:
        return values
    xp = array_namespace_of(values)
    return xp.take(values, xp.asarray(indices, device=device(values)), axis=0)


def put_contacts(indices: ContactIndices, values: Any, found: Any) -> Any:
    """Return a copy of the values of all contacts in which those of these contacts are replaced."""
    xp = array_namespace_of(values)
    merged = xp.asarray(values, copy=True)
    merged[xp.asarray(indices, device=device(values))] = found
    return merged


def map_arrays(function: Callable[..., Any], value: Any, *others: Any) -> Any:
    """Return a value in which the arrays, also those inside tuples and dataclasses, are replaced by those that a function returns.

    function: is called with an array of the value and those at the same place in the others.
    """
    if is_dataclass(value):
        parts = [[getattr(one, name.name) for one in (value, *others)] for name in fields(value)]
        return type(value)(*(map_arrays(function, *part) for part in parts))  # type: ignore[misc]
    if isinstance(value, tuple):
        return tuple(map_arrays(function, *part) for part in zip(value, *others, strict=True))
    return function(value, *others) if hasattr(value, "ndim") else value


def flatten(value: Any) -> Iterator[Any]:
    """Yield the arrays and plain values inside nested tuples and dataclasses, in the order in which `map_arrays` finds them."""
    if is_dataclass(value):
        for name in fields(value):
            yield from flatten(getattr(value, name.name))
    elif isinstance(value, tuple):
        for part in value:
            yield from flatten(part)
    else:
        yield value
