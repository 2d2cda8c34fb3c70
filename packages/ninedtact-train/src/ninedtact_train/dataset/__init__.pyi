from .build import BuildSettings, build_dataset
from .checks import PairCheckSettings, check_dataset
from .generation.generate import generate_dataset
from .generation.settings import GenerationSettings
from .reader import TactileDataset, load_dataset
from .sources.find_sources import find_sources
from .sources.source import SourceConventions

__all__ = [
    "BuildSettings",
    "GenerationSettings",
    "PairCheckSettings",
    "SourceConventions",
    "TactileDataset",
    "build_dataset",
    "check_dataset",
    "find_sources",
    "generate_dataset",
    "load_dataset",
]
