from pathlib import Path

import pytest
from little_sources import LittleTree, little_tree

from ninedtact_train.dataset.generation.generate import generate_dataset
from ninedtact_train.dataset.generation.settings import GenerationSettings, PairKindShares

TWINS = GenerationSettings(
    pairs=18,
    size=(64, 48),
    sensors=2,
    object_names=("ball:3", "cylinder:2,5", "cone"),
    shares=PairKindShares(0.12, 0.12),
    pitch_mm=0.5,
    session_pairs=3,
    sessions_per_file=2,
)


@pytest.fixture(scope="session")
def twins(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small data set of the twin; not to be changed."""
    folder = tmp_path_factory.mktemp("twins") / "twins"
    generate_dataset(folder, TWINS)
    return folder


@pytest.fixture
def tree(tmp_path: Path) -> LittleTree:
    """A small Dataset folder of the original project; to be damaged at will."""
    return little_tree(tmp_path / "Dataset")
