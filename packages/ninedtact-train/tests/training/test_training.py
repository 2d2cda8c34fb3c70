"""A training ends in one file that says all about itself, goes on after a stop as if there had been none, and refuses what
it cannot learn from."""

import csv
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from toy import IMAGES, PAIRS, ROWS, of_heights, of_images, toy_settings

from ninedtact.errors import DatasetError, FileFormatError, ForceEstimationError, OutputError
from ninedtact.force.onnx_model import read_force_model
from ninedtact_train.dataset.folder import begin_or_resume_folder, interrupt_as_stopped
from ninedtact_train.dataset.split import SplitRows
from ninedtact_train.training.examples import TrainingBatch, TrainingExamples, move_torques_from_skin_centre
from ninedtact_train.training.networks import WrenchNetwork
from ninedtact_train.training.onnx_export import rewrite_card
from ninedtact_train.training.settings import (
    NO_AUGMENTATION,
    PAPER_TRAINING,
    ComputeSettings,
    GeometricAugmentation,
    TrainingSettings,
)
from ninedtact_train.training.train import TrainingResult, train_network
from ninedtact_train.training.trained_network import TrainedNetwork
from ninedtact_train.training.training_loop import (
    CHECKPOINT_FOLDER,
    ForceTraining,
    TrainingHistory,
    fit_label_scaling,
    fit_network,
    launch_fabric,
    load_checkpoint,
)

CPU = ComputeSettings(accelerator="cpu")


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> TrainingResult:
    done = train_network(of_heights(), ROWS, toy_settings(), tmp_path_factory.mktemp("training") / "out", machine=CPU)
    assert done is not None
    return done


def test_the_folder_holds_all_that_was_learnt_and_noted(trained: TrainingResult) -> None:
    names = {path.name for path in trained.path.parent.iterdir()}
    assert names == {"model.onnx", "settings.json", "metrics.csv", "curves.png", "tensorboard", "checkpoints"}
    with (trained.path.parent / "metrics.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["epoch"] for row in rows] == ["1", "2", "3", "4"]
    assert float(rows[-1]["train_loss"]) < 0.7 * float(rows[0]["train_loss"])
    assert (trained.path.parent / "curves.png").read_bytes().startswith(b"\x89PNG")


def test_the_file_says_all_about_itself(trained: TrainingResult) -> None:
    card = read_force_model(trained.path).card
    wrench = of_heights().wrench[ROWS.train]
    assert card == trained.model.card
    assert (card.input, card.about_mm, card.modulus_mpa) == (toy_settings().input, (0.0, 0.0, 0.0), 0.093)
    np.testing.assert_allclose([card.wrench_min, card.wrench_max], [wrench.min(0), wrench.max(0)])
    assert (card.training.pairs, card.training.validation_pairs) == (128, 32)
    assert (card.training.objects, card.training.sensors) == (5, 2)
    assert card.training.settings == toy_settings().to_json_dict() and card.training.versions["torch"]
    low, high = card.input_ranges["max_indentation"]
    assert 0 <= low < 0.1 < high < 0.6
    assert len(card.evaluation["validation"]["skill"]) == 6


def test_the_graph_answers_as_the_network_does(trained: TrainingResult) -> None:
    settings = toy_settings()
    network = WrenchNetwork(
        settings.network, settings.input, fit_label_scaling(of_heights().wrench[ROWS.train], settings)
    )
    state = load_checkpoint(trained.path.parent / "checkpoints" / "best.ckpt")["network"]
    network.load_state_dict(state)
    shown = torch.randn(7, *settings.input.shape) * 0.1
    with torch.no_grad():
        wrench, _ = network.eval()(shown)
    np.testing.assert_allclose(trained.model(shown.numpy()).wrench, wrench.double().numpy(), atol=1e-5)


def test_its_intervals_cover_what_they_claim_where_they_were_set_right(trained: TrainingResult) -> None:
    half, most = trained.evaluation.coverage.values()
    assert np.abs(half - 0.5).max() < 0.15 and np.abs(most - 0.9).max() < 0.1


def test_an_evaluation_is_added_to_the_card_and_the_graph_stays(trained: TrainingResult, tmp_path: Path) -> None:
    import msgspec

    copy = tmp_path / "model.onnx"
    copy.write_bytes(trained.path.read_bytes())
    assert b".py" not in copy.read_bytes(), "no path of the machine on which it was trained"
    rewrite_card(copy, msgspec.structs.replace(trained.model.card, evaluation={"test": {"skill": [0.9]}}), copy)
    again, shown = read_force_model(copy), np.zeros((1, *toy_settings().input.shape), np.float32)
    assert again.card.evaluation == {"test": {"skill": [0.9]}}
    np.testing.assert_array_equal(again(shown).wrench, trained.model(shown).wrench)


def weights_of(learner: ForceTraining) -> dict[str, torch.Tensor]:
    return {name: part.clone() for name, part in learner.model.state_dict().items()}


def run(
    learner: ForceTraining, out: Path, examples: TrainingExamples | None = None, precision: str = "32-true"
) -> TrainingHistory:
    machine = ComputeSettings(accelerator="cpu", precision=precision)
    with interrupt_as_stopped(out):
        return fit_network(launch_fabric(machine), learner, examples or of_heights(), ROWS, out)


def fitted(
    out: Path, settings: TrainingSettings, kind: type[ForceTraining] = ForceTraining
) -> tuple[ForceTraining, list[dict[str, float]]]:
    learner = kind(settings, fit_label_scaling(of_heights().wrench[ROWS.train], settings))
    history = run(learner, out)
    return learner, [{name: value for name, value in row.items() if name != "seconds"} for row in history.epochs]


class Counting(ForceTraining):
    """Counts its steps, four in each epoch."""

    steps = 0

    def loss(self, *given: object) -> tuple[torch.Tensor, torch.Tensor]:
        self.steps += 1
        return super().loss(*given)


class Interrupted(Counting):
    """Somebody presses Ctrl-C in the middle of the third epoch."""

    def loss(self, *given: object) -> tuple[torch.Tensor, torch.Tensor]:
        if self.steps == 9:
            raise KeyboardInterrupt
        return super().loss(*given)


class Watched(ForceTraining):
    """Keeps the wrenches that were learnt."""

    def augment(self, batch: TrainingBatch, generator: torch.Generator) -> TrainingBatch:
        changed = super().augment(batch, generator)
        self.seen = [*getattr(self, "seen", []), changed.wrench]
        return changed


def test_gone_on_with_after_a_stop_it_learns_the_same(tmp_path: Path) -> None:
    settings = toy_settings()
    whole, rows = fitted(tmp_path / "whole", settings)
    with pytest.raises(DatasetError, match="run the command again"):
        fitted(tmp_path / "stopped", settings, Interrupted)
    again, rows_again = fitted(tmp_path / "stopped", settings)
    assert rows_again == rows
    for name, part in weights_of(whole).items():
        assert torch.equal(part, weights_of(again)[name]), name


def test_examples_are_mirrored_about_the_centre_of_the_skin_wherever_their_torques_are_about(
    tmp_path: Path,
) -> None:
    about_mm = (10.0, -5.0, -35.0)
    mirrored = replace(NO_AUGMENTATION, geometric=GeometricAugmentation(transformed_share=0))
    settings = replace(toy_settings(augmentation=mirrored, about_mm=about_mm), epochs=1)
    module = Watched(settings, fit_label_scaling(of_heights().wrench[ROWS.train], settings))
    run(module, tmp_path)
    six = torch.cat(module.seen).numpy()
    at_centre = move_torques_from_skin_centre(six, (-10.0, 5.0, 35.0))
    # The force of a dent is proportional to its place, in a mirror image too: T_y = −x F_z = 20 mm F_x, T_x = y F_z = −10 mm F_y.
    assert np.ptp(np.sign(six[:, 0])) == 2
    np.testing.assert_allclose(at_centre[:, 4], 0.02 * at_centre[:, 0], atol=1e-6)
    np.testing.assert_allclose(at_centre[:, 3], -0.01 * at_centre[:, 1], atol=1e-6)


def test_a_damaged_checkpoint_is_refused(tmp_path: Path) -> None:
    folder = tmp_path / CHECKPOINT_FOLDER
    folder.mkdir()
    (folder / "last.ckpt").write_bytes(b"half of a file")
    with pytest.raises(FileFormatError, match="remove it to begin again"):
        fitted(tmp_path, toy_settings())


def test_the_papers_labels_are_parts_of_ranges_below_the_skin(tmp_path: Path) -> None:
    settings = replace(PAPER_TRAINING, network="moments", input=IMAGES, epochs=1, batch=32)
    examples = of_images()
    labels = fit_label_scaling(examples.wrench[ROWS.train], settings)
    learner = ForceTraining(settings, labels)
    below = move_torques_from_skin_centre(examples.wrench[ROWS.train], settings.about_mm)
    parts = (below - np.array(labels.offset)) / np.array(labels.unit)
    assert parts.min() == pytest.approx(0, abs=1e-5) and parts.max() == pytest.approx(1, abs=1e-5)
    run(learner, tmp_path, examples)
    evaluation = TrainedNetwork(learner.model.eval(), examples, ROWS, settings).evaluate_held_out()
    np.testing.assert_allclose(evaluation.predictions.truth, of_images().wrench[ROWS.test], atol=1e-6)
    assert not evaluation.coverage and evaluation.predictions.about_mm == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("examples", "rows", "says"),
    [
        (of_heights(), SplitRows(np.arange(0), np.arange(4)), "got 0 and 4"),
        (of_heights(), SplitRows(np.arange(4), np.arange(0)), "got 4 and 0"),
        (of_images(), ROWS, "got images with references"),
        (replace(of_heights(), images=np.zeros((PAIRS, 8, 8))), ROWS, "got 8 x 8"),
    ],
)
def test_what_cannot_be_learnt_from_is_refused(
    examples: TrainingExamples, rows: SplitRows, says: str, tmp_path: Path
) -> None:
    with pytest.raises(ForceEstimationError, match=says):
        train_network(examples, rows, toy_settings(), tmp_path / "out", machine=CPU)
    assert not (tmp_path / "out").exists()


def test_another_training_in_the_same_folder_is_refused(trained: TrainingResult, tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="another seed"):
        train_network(of_heights(), ROWS, toy_settings(seed=1), trained.path.parent, machine=CPU)
    heights = of_heights()
    features = np.full((PAIRS, 5), 0.1, np.float32)
    for other in (replace(heights, images=2 * heights.images), replace(heights, sensor_features=features)):
        with pytest.raises(OutputError, match="another examples"):
            train_network(other, ROWS, toy_settings(), trained.path.parent, machine=CPU)
    (tmp_path / "something").write_text("else")
    with pytest.raises(OutputError, match="something else"):
        train_network(of_heights(), ROWS, toy_settings(), tmp_path, machine=CPU)


def test_processes_of_one_training_open_its_folder_at_once(tmp_path: Path) -> None:
    """Each of them writes the same settings, or finds them, also while another one writes."""
    (tmp_path / "begun").mkdir()
    (tmp_path / "begun" / ".settings.partial").touch()
    for out in (tmp_path / "begun", *(tmp_path / f"new_{number}" for number in range(10))):
        with ThreadPoolExecutor(8) as ranks:
            list(ranks.map(begin_or_resume_folder, [out] * 8, [{"name": "one"}] * 8))
        with pytest.raises(OutputError, match="another name"):
            begin_or_resume_folder(out, {"name": "other"})
        (out / "settings.json").write_text("[1]")
        with pytest.raises(OutputError, match="another name"):
            begin_or_resume_folder(out, {"name": "one"})
