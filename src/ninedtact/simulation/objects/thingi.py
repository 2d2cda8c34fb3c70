"""Models of Thingi10K by number (docs/objects.md), through the package `thingi10k`.

The first model downloads the whole set into the cache of Hugging Face; from then on it is read from there. The models are of
all sizes, so each is made to fit unless it is told otherwise. Their licences differ: see the entry of a model.
"""

from typing import Any

import numpy as np

from ninedtact.errors import NinedtactError
from ninedtact.simulation.objects.mesh import MeshObject, Placing, mesh_object
from ninedtact.simulation.objects.mesh_file import ObjectsNotInstalled

FITTING = Placing(fit_mm=16.0)


class ModelNotHere(NinedtactError):
    """A model that is not in the set, or a set that cannot be had."""


def thingi_object(number: int, placing: Placing = FITTING) -> MeshObject:
    """The model with this file number; raises `ModelNotHere`, `ObjectsNotInstalled` and `MeshUnusable`."""
    entry, library = found(number)
    vertices, faces = library.load_file(entry["file_path"])
    corners, triangles = np.asarray(vertices, float), np.asarray(faces, np.int64)
    return mesh_object(f"thingi10k_{number}", corners, triangles, placing)


def found(number: int) -> tuple[Any, Any]:
    """The entry of a model, and the library that reads it."""
    library = required_thingi10k()
    try:
        library.init()
    except Exception as failure:
        raise ModelNotHere(
            f"expected Thingi10K on this machine or the network to download it, got {first_line(failure)!r}; connect once, "
            "or give a mesh file of your own"
        ) from failure
    entries = list(library.dataset(file_id=number))
    if not entries:
        raise ModelNotHere(
            f"expected a file number of Thingi10K, got {number}, which is not in it; take another, as 32770"
        )
    return entries[0], library


def first_line(failure: Exception) -> str:
    """What went wrong, briefly."""
    return (str(failure).splitlines() or [type(failure).__name__])[0][:120]


def required_thingi10k() -> Any:
    """The library, or how to get it."""
    try:
        import thingi10k
    except ImportError as absence:
        raise ObjectsNotInstalled(
            "expected the library thingi10k, got an environment without it; run: pip install 'ninedtact[objects]'"
        ) from absence
    return thingi10k
