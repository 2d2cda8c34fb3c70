from pathlib import Path

import pytest
from built_sets import TWINS
from little_sources import LittleTree, little_tree

from ninedtact_train.dataset.generation.generate import generate_dataset


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
