"""The original project's weights load strictly, answer in newtons about the skin, and are read without running anything."""

import os
from pathlib import Path
from zipfile import ZIP_DEFLATED, ZipFile

import numpy as np
import pytest
import torch

from ninedtact.errors import FileFormatError
from ninedtact.quantities import EstimateWarning, Frame, HeightMap, HeightSource, Rectified, Wrench
from ninedtact.reading import Reading
from ninedtact_train.training.networks import DenseNet
from ninedtact_train.training.original_network import (
    WRENCH_MAX,
    WRENCH_MIN,
    OriginalNetworkForce,
    read_original_network,
)

ROWS, COLS, MM_PER_PX = 345, 460, 0.0522


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Random ones; names and shapes as torchvision's densenet169 with a classifier of six."""
    torch.manual_seed(0)
    state = DenseNet("densenet169", 3, 6).state_dict()
    assert len(state) == 1015
    assert state["features.denseblock4.denselayer32.conv2.weight"].shape == (32, 128, 3, 3)
    assert state["features.transition3.norm.running_var"].shape == (1280,)
    assert state["classifier.weight"].shape == (6, 1664)
    path = tmp_path_factory.mktemp("original") / "weights.pt"
    torch.save(state, path)
    return path


def reading(depth_mm: float) -> Reading:
    grey = np.full((ROWS, COLS), 140, np.float32)
    z_mm = np.zeros((ROWS, COLS), np.float32)
    z_mm[100:180, 200:300] = -depth_mm
    height = HeightMap(z_mm, np.full(z_mm.shape, HeightSource.MEASURED, np.uint8), MM_PER_PX)
    darker = Rectified(grey + 30 * z_mm, MM_PER_PX)
    return Reading(Frame(np.zeros((4, 4, 3), np.uint8), 5), darker, height, reference=Rectified(grey, MM_PER_PX))


@pytest.fixture(scope="module")
def original(weights: Path) -> OriginalNetworkForce:
    return read_original_network(weights)


class Fixed(DenseNet):
    """Answers the same whatever it is shown, which it keeps."""

    def __init__(self, answer: list[float]) -> None:
        torch.nn.Module.__init__(self)
        self.answer = torch.tensor([answer], dtype=torch.float64)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        self.shown = x
        return self.answer


def test_numbers_become_newtons_about_the_centre_of_the_skin(original: OriginalNetworkForce) -> None:
    pressed = reading(1.0)
    parts = original.parts(pressed)
    assert parts.shape == (6,) and np.isfinite(parts).all()
    found = OriginalNetworkForce(Fixed([0.5, 0.75, 0.4, 0.5, 1.2, 0.5])).estimate(pressed)
    force, torque = np.array([0.0, 1.5, -7.2]), np.array([0.0, 0.2, 0.0])
    below = Wrench(force, torque, np.array([0.0, 0.0, -35.0]))
    np.testing.assert_allclose(found.wrench.six, below.about(np.zeros(3)).six, atol=1e-12)
    assert found.warnings == (EstimateWarning.OUT_OF_RANGE,) and found.wrench.stamp_ns == 5
    assert (found.wrench.about_mm == 0).all() and (WRENCH_MIN < WRENCH_MAX).all()


def test_untouched_skin_has_no_force_whatever_the_network_says(original: OriginalNetworkForce) -> None:
    found = original.estimate(reading(0.0))
    assert not found.touching and not found.wrench.six.any()


class Bomb:
    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return os.system, (f"touch {self.path}",)


def test_a_file_that_would_run_code_is_refused_and_not_run(tmp_path: Path) -> None:
    gone_off = tmp_path / "gone_off"
    torch.save({"classifier.weight": Bomb(gone_off)}, tmp_path / "bomb.pt")
    told(tmp_path / "bomb.pt")
    torch.save({"classifier.weight": Bomb(gone_off)}, tmp_path / "old.pt", _use_new_zipfile_serialization=False)
    told(tmp_path / "old.pt")
    assert not gone_off.exists()


def test_what_are_not_these_weights_is_refused(weights: Path, tmp_path: Path) -> None:
    whole = weights.read_bytes()
    for part in (0, 10, 5000, len(whole) // 2, len(whole) - 20):
        (tmp_path / "cut.pt").write_bytes(whole[:part])
        told(tmp_path / "cut.pt")
    torch.save(DenseNet("densenet121", 3, 6).state_dict(), tmp_path / "other.pt")
    assert "Missing" in told(tmp_path / "other.pt")
    torch.save(DenseNet("densenet169", 3, 5).state_dict(), tmp_path / "five.pt")
    assert "size mismatch" in told(tmp_path / "five.pt")
    torch.save([1, 2, 3], tmp_path / "list.pt")
    told(tmp_path / "list.pt")
    told(tmp_path / "none.pt")


def test_an_archive_that_grows_is_refused_before_it_is_unpacked(tmp_path: Path) -> None:
    torch.save({"classifier.weight": torch.zeros(5_000_000)}, tmp_path / "zeros.pt")
    with ZipFile(tmp_path / "zeros.pt") as whole, ZipFile(tmp_path / "small.pt", "w", ZIP_DEFLATED) as small:
        for entry in whole.infolist():
            small.writestr(entry.filename, whole.read(entry))
    assert (tmp_path / "small.pt").stat().st_size < 100_000
    assert "larger than the file" in told(tmp_path / "small.pt")


def told(path: Path) -> str:
    with pytest.raises(FileFormatError) as refusal:
        read_original_network(path)
    sentence = str(refusal.value)
    assert (
        sentence.startswith("expected the weights of torchvision's densenet169")
        and str(path) in sentence
        and "\n" not in sentence
    )
    return sentence
