"""The two-dimensional Fourier transform of real fields, in the library that the array belongs to.

NumPy arrays go through scipy.fft, which keeps single precision and takes half the time of NumPy's own. A field smaller than
its transform has zeros beyond its last row and column; rows of nothing but zeros are not transformed.
"""

from functools import lru_cache
from typing import Any

from array_api_compat import is_numpy_array

from ninedtact.mechanics.library import library_of


def spectrum(field: Any, shape: tuple[int, int]) -> Any:
    """Unscaled forward transform over the last two axes, the field filled up with zeros to this shape."""
    fft = transforms_of(field)
    return fft.fft(fft.rfft(field, shape[1]), shape[0], -2)


def field_of(spectrum: Any, shape: tuple[int, int], field_shape: tuple[int, int]) -> Any:
    """Back again, scaled by 1/(rows·cols), and the zeros cut off."""
    fft, (rows, cols) = transforms_of(spectrum), field_shape
    return fft.irfft(fft.ifft(spectrum, shape[0], -2)[..., :rows, :], shape[1])[..., :cols]


def transforms_of(array: Any) -> Any:
    """The module that transforms this kind of array."""
    return scipy_fft() if is_numpy_array(array) else library_of(array).fft


@lru_cache(maxsize=1)
def scipy_fft() -> Any:
    """Loaded when a transform is first asked for."""
    import scipy.fft

    return scipy.fft
