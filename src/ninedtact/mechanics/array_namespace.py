"""Which array library an array belongs to: NumPy or torch, behind one set of names (the array API standard).

The two-dimensional Fourier transform of real fields, in the library that the array belongs to.

NumPy arrays go through scipy.fft, which keeps single precision and takes half the time of NumPy's own. A field smaller than
its transform has zeros beyond its last row and column; rows of nothing but zeros are not transformed.
"""

from functools import lru_cache
from typing import Any

import numpy as np
from array_api_compat import array_namespace, is_numpy_array, to_device
from jaxtyping import Float
from numpy import ndarray as Array

_NAMESPACES: dict[type, Any] = {}
"""By the arrays' type: asking costs more than adding two small arrays."""


def array_namespace_of(array: Any) -> Any:
    """Its functions."""
    kind = type(array)
    if kind not in _NAMESPACES:
        _NAMESPACES[kind] = array_namespace(array)
    return _NAMESPACES[kind]


def to_numpy(values: Any) -> Float[Array, "..."]:
    """As a NumPy array, double precision."""
    return np.asarray(to_device(values, "cpu"), dtype=np.float64)


def forward_transform(field: Any, shape: tuple[int, int]) -> Any:
    """Unscaled forward transform over the last two axes, the field filled up with zeros to this shape."""
    fft = _transform_module(field)
    return fft.fft(fft.rfft(field, shape[1]), shape[0], -2)


def inverse_transform(spectrum: Any, shape: tuple[int, int], field_shape: tuple[int, int]) -> Any:
    """Back again, scaled by 1/(rows·cols), and the zeros cut off."""
    fft, (rows, cols) = _transform_module(spectrum), field_shape
    return fft.irfft(fft.ifft(spectrum, shape[0], -2)[..., :rows, :], shape[1])[..., :cols]


def _transform_module(array: Any) -> Any:
    """The module that transforms this kind of array."""
    return _scipy_fft() if is_numpy_array(array) else array_namespace_of(array).fft


@lru_cache(maxsize=1)
def _scipy_fft() -> Any:
    """Loaded when a transform is first asked for."""
    import scipy.fft

    return scipy.fft
