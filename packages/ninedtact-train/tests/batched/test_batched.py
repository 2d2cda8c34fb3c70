"""Many sessions at once, on torch: the pairs of the processor, in any batch, and in smaller ones when memory runs out."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest
import torch

from ninedtact._version import installation_command
from ninedtact.cli import main
from ninedtact.errors import DeviceError, InputError, NinedtactError
from ninedtact.mechanics import skin
from ninedtact.mechanics.height_grid_indenter import DeviceHeightGrids
from ninedtact.mechanics.indenter import Ball, FlatPunch
from ninedtact.mechanics.pose import InvalidPose, Pose
from ninedtact.parallel_jobs import DaskCluster
from ninedtact.recording.attached_sensor import read_folder_files
from ninedtact.simulation.objects.catalogue import generate_object
from ninedtact.simulation.press import Press
from ninedtact.simulation.twin import PoseOutOfView
from ninedtact_train.batched import session_requests
from ninedtact_train.batched.executor import BatchExecutor
from ninedtact_train.batched.session_requests import Device, RenderRequest, StepRequest, choose_compute_device
from ninedtact_train.collecting.training_pair_rule import PairKindShares
from ninedtact_train.dataset.generation.generate import GenerationResult, generate_dataset, make_simulated_sensor
from ninedtact_train.dataset.generation.settings import GenerationSettings
from ninedtact_train.population.mechanics_shares import MechanicsShares

SMALL = GenerationSettings(
    pairs=18,
    size=(48, 36),
    sensors=3,
    object_names=("ball:3", "gear_07", "cylinder:2,5", "screw_02"),
    shares=PairKindShares(0.1, 0.15),
    mechanics=MechanicsShares(0.34, 0.33),
    pitch_mm=0.5,
    session_pairs=3,
    sessions_per_file=2,
)
"""Six sessions in three files; one sensor of each kind."""
OBJECTS = (Ball(3.0), generate_object("gear_07"), generate_object("screw_02"), Ball(3.0), FlatPunch(2.0))
TILTED = [Pose(0.5 * k, -0.2, 0.3 + 0.1 * k, 0.4 * k, 0.03 + 0.04 * k, -0.02 * k) for k in range(5)]


@pytest.fixture(scope="module", autouse=True)
def one_thread() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="module")
def by_processor(tmp_path_factory: pytest.TempPathFactory) -> GenerationResult:
    return generate_dataset(tmp_path_factory.mktemp("dataset") / "processor", SMALL)


@pytest.fixture(scope="module")
def together(tmp_path_factory: pytest.TempPathFactory) -> GenerationResult:
    return generate_dataset(tmp_path_factory.mktemp("dataset") / "together", SMALL, workers=2, device="torch-cpu")


@pytest.fixture(scope="module")
def room() -> BatchExecutor:
    benches = {number: make_simulated_sensor(number, SMALL) for number in range(SMALL.sensors)}
    return BatchExecutor(benches, Device("torch-cpu"), 8, print)


def rows(folder: Path) -> list[dict[str, Any]]:
    return [row for path in sorted((folder / "data").iterdir()) for row in pq.read_table(path).to_pylist()]


def assert_same_pairs(found: Path, wanted: Path) -> None:
    ours, theirs = rows(found), rows(wanted)
    assert len(ours) == len(theirs)
    for row, other in zip(ours, theirs, strict=True):
        told = {name: (row[name], other[name]) for name in row if name not in ("image", "wrench")}
        assert all(one == another for one, another in told.values()), told
        np.testing.assert_allclose(row["wrench"], other["wrench"], rtol=1e-4, atol=1e-5)
        shown, expected = (
            cv2.imdecode(np.frombuffer(one["image"]["bytes"], np.uint8), cv2.IMREAD_UNCHANGED).astype(int)
            for one in (row, other)
        )
        assert np.abs(shown - expected).max() <= 1
        assert (shown != expected).mean() < 0.01


def test_the_pairs_are_those_of_the_processor(together: GenerationResult, by_processor: GenerationResult) -> None:
    assert together.statistics.kinds == by_processor.statistics.kinds
    assert_same_pairs(together.folder, by_processor.folder)
    assert {row["sensor"] for row in rows(together.folder)} == {f"twin_0_{number:03d}" for number in range(3)}


def test_what_is_missing_is_made_again_with_the_same_bytes(tmp_path: Path, together: GenerationResult) -> None:
    before = read_folder_files(together.folder)
    path = together.folder / "data" / "train-00001-of-00003.parquet"
    path.unlink()
    other = together.folder / "data" / "train-00000-of-00003.parquet"
    age = other.stat().st_mtime_ns
    again = generate_dataset(together.folder, SMALL, device="torch-cpu")
    assert again.new_files == 1
    assert read_folder_files(together.folder) == before
    assert other.stat().st_mtime_ns == age


def test_workers_with_a_card_each_make_the_bytes_of_one(tmp_path: Path) -> None:
    settings = replace(SMALL, pairs=6, session_pairs=1, sessions_per_file=2)
    with ThreadPoolExecutor(2) as pool:
        for name, workers in (("one", 1), ("many", DaskCluster("two cards", 2, pool.submit))):
            generate_dataset(tmp_path / name, settings, workers, device="torch-cpu", sessions_per_batch=2)
    assert read_folder_files(tmp_path / "many") == read_folder_files(tmp_path / "one")
    with pytest.raises(InputError, match="expected --device cpu or cuda together with --cluster, got cuda:1; let each"):
        generate_dataset(tmp_path / "other", settings, DaskCluster("", 1, print), device="cuda:1")


class FullMemory:
    """BatchExecutor for the fields of so many contacts."""

    def __init__(self, contacts: int, trouble: Exception) -> None:
        self.contacts, self.trouble, self.spectrum = contacts, trouble, skin.forward_transform

    def __call__(self, field: Any, shape: tuple[int, int]) -> Any:
        if field.shape[0] > self.contacts:
            raise self.trouble
        return self.spectrum(field, shape)


def test_a_full_memory_halves_the_batch_and_is_told(
    tmp_path: Path, together: GenerationResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    trouble = RuntimeError("cuFFT error: CUFFT_INTERNAL_ERROR")
    monkeypatch.setattr(skin, "forward_transform", FullMemory(2, trouble))
    said: list[str] = []
    generate_dataset(tmp_path / "pairs", SMALL, device="torch-cpu", notify=said.append)
    assert said == [
        "the memory of torch-cpu is too small for 6 contacts at once; continuing with 3",
        "the memory of torch-cpu is too small for 3 contacts at once; continuing with 1",
    ]
    assert_same_pairs(tmp_path / "pairs", together.folder)


def test_a_memory_too_small_for_one_contact_ends_in_a_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(skin, "forward_transform", FullMemory(0, torch.OutOfMemoryError("CUDA out of memory.")))
    options = "--pairs 2 --sensors 2 --size 32 24 --object-names ball:3 --pitch-mm 0.5 --device torch-cpu"
    assert main(["simulate", "dataset", "--out", str(tmp_path / "pairs"), *options.split()]) == 1
    told = capsys.readouterr().err
    assert "ninedtact: the memory of torch-cpu is too small for 2 contacts at once; continuing with 1\n" in told
    assert (
        "expected room for one contact in the memory of torch-cpu, got 'CUDA out of memory.'; end other programs"
        in told
    )


def answers(room: BatchExecutor, steps: list[StepRequest]) -> list[Any]:
    """The answers to all steps, those in larger regions too."""
    told = room.execute(steps)
    while again := [index for index, one in enumerate(told) if isinstance(one, StepRequest)]:
        for index, answer in zip(again, room.execute([told[index] for index in again]), strict=True):
            told[index] = answer
    return told


def test_a_press_that_leaves_no_gel_is_refused_alone(room: BatchExecutor) -> None:
    """On a base that hardly yields an object can be deeper than the gel is thick, but not without gel under it."""
    gel = replace(room.setups[0].twin.gel, finite_strain=1.0, gel_to_base_modulus_ratio=0.002)
    bench = replace(room.setups[0], twin=replace(room.setups[0].twin, gel=gel))
    alone = BatchExecutor({0: bench}, room.device, 2, print)
    deep, shallow = (StepRequest(bench, None, Ball(), Pose(depth_mm=part * gel.thickness_mm)) for part in (1.15, 0.3))
    refused, answered = answers(alone, [deep, shallow])
    assert isinstance(refused, InvalidPose) and "thinner by less than that" in str(refused)
    with pytest.raises(InvalidPose, match="thinner by less than that"):
        deep.respond()
    assert isinstance(answered, Press) and answered.touches


def test_one_of_a_batch_is_refused_as_it_would_be_alone(room: BatchExecutor) -> None:
    bench = room.setups[0]
    assert isinstance(room.execute([StepRequest(bench, None, Ball(), Pose(depth_mm=0.02), 3.0)])[0], StepRequest), (
        "its window was too small"
    )
    steps = [
        StepRequest(bench, None, Ball(), Pose(depth_mm=0.5)),
        StepRequest(bench, None, Ball(), Pose(x_mm=40.0), 1.0),
        StepRequest(bench, None, Ball(1.5), Pose(), 60.0),
        StepRequest(bench, None, Ball(), Pose(depth_mm=50.0)),
        StepRequest(bench, None, FlatPunch(13.0), Pose(depth_mm=0.2)),
        StepRequest(bench, None, Ball(), Pose(depth_mm=-0.5)),
        StepRequest(bench, None, FlatPunch(5.0), Pose(tilt_y_rad=0.25), 90.0),
    ]
    told = answers(room, steps)
    for step, answer in zip(steps, told, strict=True):
        try:
            alone: Press | NinedtactError = step.respond()
        except NinedtactError as refusal:
            alone = refusal
        assert type(answer) is type(alone)
        if isinstance(alone, Press):
            assert answer.touches == alone.touches
            np.testing.assert_allclose(answer.wrench.six, alone.wrench.six, rtol=1e-4, atol=1e-6)
            assert answer.max_indentation_mm == pytest.approx(alone.max_indentation_mm, rel=1e-4)
            assert answer.contact_area_mm2 == alone.contact_area_mm2
            assert answer.stiffening == pytest.approx(alone.stiffening)
    assert isinstance(told[1], PoseOutOfView)
    assert isinstance(told[2], InvalidPose)
    assert isinstance(told[3], InvalidPose)
    assert isinstance(told[6], InvalidPose), "its edge is below the base, its middle is not"


def test_untouched_skin_is_shown_as_it_is(room: BatchExecutor) -> None:
    assert room.execute([RenderRequest(room.setups[1], None)]) == [None]


@pytest.mark.parametrize("poses", [TILTED, [Pose(pose.x_mm, twist_rad=pose.twist_rad) for pose in TILTED]])
def test_objects_side_by_side_are_each_their_own(poses: list[Pose]) -> None:
    axis = np.linspace(-12, 12, 60)
    places = tuple(np.float32(place) for place in np.meshgrid(axis, axis))
    several = DeviceHeightGrids(np.zeros((), np.float32)).batch(OBJECTS)
    found = several.height_over_skin_mm(Pose.stack(poses), *places)
    for height, indenter, pose in zip(found, OBJECTS, poses, strict=True):
        np.testing.assert_allclose(height, indenter.height_over_skin_mm(pose, *places), atol=2e-5)


@pytest.mark.parametrize("name", ["tpu", "cuda:x", "CPU", "cpu:0", ""])
def test_devices_go_by_their_names(name: str) -> None:
    with pytest.raises(DeviceError, match="expected a device named auto, cpu, cuda, cuda:N or torch-cpu"):
        choose_compute_device(name)


@pytest.mark.parametrize(
    ("name", "there", "said"),
    [("cuda", 0, "got none"), ("cuda:0", 0, "got none"), ("cuda:2", 2, "got 2, cuda:0 to cuda:1")],
)
def test_a_gpu_that_is_not_there_is_one_sentence(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    name: str,
    there: int,
    said: str,
) -> None:
    monkeypatch.setattr(session_requests, "_gpu_count", lambda: there)
    assert main(["simulate", "dataset", "--out", str(tmp_path / "pairs"), "--device", name]) == 1
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert line.startswith(f"ninedtact: expected {name}, a GPU that torch sees, {said}; give --device cpu")
    assert not (tmp_path / "pairs").exists()


@pytest.mark.parametrize("name", ["cuda", "torch-cpu"])
def test_without_torch_the_extra_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    monkeypatch.setattr(session_requests, "find_spec", lambda module: None)
    monkeypatch.setattr(session_requests, "_gpu_driver_exists", lambda: True)
    assert main(["simulate", "dataset", "--out", str(tmp_path / "pairs"), "--device", name]) == 1
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert f"got no such package; run {installation_command('train')}" in line
    assert choose_compute_device("auto") == Device("cpu")


def test_no_session_at_once_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="1 session per batch"):
        generate_dataset(tmp_path / "pairs", SMALL, sessions_per_batch=0)
