"""Data sets for training force estimation: pairs of a rectified image and the wrench that acted when it was taken.

In go sources of pairs: recordings, folders of the original project, force episodes of other projects, other data sets
(`find_sources`, `build_dataset`) or simulated sensors (`generate_dataset`). Out comes one folder of Parquet files that Hugging Face
`datasets` opens (its columns: `schema.py`), checked (`check_dataset`) and read fast in training (`load_dataset`). The names
below are imported when they are first used.
"""

from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from ninedtact.errors import NinedtactError

if TYPE_CHECKING:
    from ninedtact.dataset.build import BuildSettings, build_dataset
    from ninedtact.dataset.checks import CheckSettings, check_dataset
    from ninedtact.dataset.generation.generate import generate_dataset
    from ninedtact.dataset.generation.settings import GenerationSettings
    from ninedtact.dataset.parquet_files import DatasetDamaged
    from ninedtact.dataset.reader import TactileDataset, load_dataset
    from ninedtact.dataset.sources.find_sources import find_sources
    from ninedtact.dataset.sources.source import SourceConventions

__all__ = [
    "BuildSettings",
    "CheckSettings",
    "DatasetDamaged",
    "GenerationSettings",
    "SourceConventions",
    "TactileDataset",
    "build_dataset",
    "check_dataset",
    "find_sources",
    "generate_dataset",
    "load_dataset",
]

_HOMES = {
    "BuildSettings": "build",
    "CheckSettings": "checks",
    "DatasetDamaged": "parquet_files",
    "GenerationSettings": "generation.settings",
    "SourceConventions": "sources.source",
    "TactileDataset": "reader",
    "build_dataset": "build",
    "check_dataset": "checks",
    "find_sources": "sources.find_sources",
    "generate_dataset": "generation.generate",
    "load_dataset": "reader",
}

for _library in ("joblib", "pyarrow"):
    if find_spec(_library) is None:
        raise NinedtactError(
            f"expected the libraries of data sets, got no {_library}; install them: pip install 'ninedtact[datasets]'"
        )


def __getattr__(name: str) -> Any:
    """Import a public name from its module."""
    if name not in _HOMES:
        raise AttributeError(f"module 'ninedtact.dataset' has no attribute {name!r}")
    return getattr(import_module(f"ninedtact.dataset.{_HOMES[name]}"), name)
