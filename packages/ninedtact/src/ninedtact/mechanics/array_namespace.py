"""One set of names for NumPy and torch arrays: the array API namespace of an array, conversion to NumPy, and Fourier transforms.

The transforms are two-dimensional, of real fields, over the last two axes. NumPy arrays go through scipy.fft, which keeps single
precision and takes half the time of NumPy's own. A field smaller than its transform is padded with zeros after its last row and
column; rows that hold nothing but padding are not transformed.
"""

from functools import lru_cache
from typing import Any

import numpy as np
from array_api_compat import array_namespace, is_numpy_array, to_device
from jaxtyping import Float
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


def forward_transform(field: Any, shape: tuple[int, int]) -> Any:
    """Return the unscaled forward transform of a real field, (…, rows, cols), zero-padded to this shape: (…, rows, half)."""
    fft = _transform_module(field)
    return fft.fft(fft.rfft(field, shape[1]), shape[0], -2)


def inverse_transform(spectrum: Any, shape: tuple[int, int], field_shape: tuple[int, int]) -> Any:
    """Return the field, scaled by 1/(rows·cols), whose transform of this shape is given; the padding is cut off."""
    fft, (rows, cols) = _transform_module(spectrum), field_shape
    return fft.irfft(fft.ifft(spectrum, shape[0], -2)[..., :rows, :], shape[1])[..., :cols]


def _transform_module(array: Any) -> Any:
    """Return the module whose transforms take this kind of array."""
    return _scipy_fft() if is_numpy_array(array) else array_namespace_of(array).fft


@lru_cache(maxsize=1)
def _scipy_fft() -> Any:
    """Import scipy.fft when a transform is first needed, so that importing this module stays cheap."""
    import scipy.fft

    return scipy.fft
