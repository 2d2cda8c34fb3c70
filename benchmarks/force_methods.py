"""One table of force methods on equal terms: the same pairs, the same splits and the same number of training steps for all.

    raw image CNN         the small network on the image alone, without the reference
    gel-flow DenseNet     the paper's darker, brighter and reference channels, on smaller images and with fewer layers and epochs
    height CNN            the small network on the height map
    moments               ridge regression on the volume, the first and the second moments of the height map
    physics               tractions by inversion of the gel's compliance, without training
    physics corrected     physics, corrected by the small network

Splits: `standard` holds out random pairs, `object` objects, `sensor` sensors. Skill is one less the mean absolute error over that
of always answering the median. Heights and physics use each sensor's calibration from its own four images; labels are those of a
gel of the design's modulus. Time is that of one image on one thread, without the heights. Run it with `make
benchmarks/force_methods`; the data are kept in out/force_methods and made once.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from time import process_time

import numpy as np
import tyro
from matplotlib.figure import Figure

from ninedtact.force.network_input import InputChannels, NetworkInputSettings, scale_input_settings_to_width
from ninedtact.quantities import WRENCH_AXES
from ninedtact_train.dataset.generation.generate import generate_dataset
from ninedtact_train.dataset.generation.settings import GenerationSettings
from ninedtact_train.dataset.split import Kind, SplitKeys, SplitRows, SplitSettings, split_dataset
from ninedtact_train.evaluation import WrenchPredictions, evaluate_predictions
from ninedtact_train.training.compute_settings import ComputeSettings
from ninedtact_train.training.examples import TrainingExamples
from ninedtact_train.training.settings import CORRECTOR_TRAINING, DEFAULT_TRAINING, PAPER_TRAINING
from ninedtact_train.training.train import train_network
from ninedtact_train.workflows.dataset_training import read_training_examples

SPLITS: tuple[Kind, ...] = ("standard", "object", "sensor")
HELD_OUT = 0.2
RIDGE = 1e-3
TIMED = 20


@dataclass(frozen=True)
class Method:
    """Predictions of one method on the test pairs of one split."""

    name: str
    predictions: WrenchPredictions
    parameters: int
    ms: float


def force_methods(
    pairs: int = 4000,
    sensors: int = 16,
    epochs: int = 8,
    size: tuple[int, int] = (80, 60),
    densenet: str = "densenet121",
    densenet_epochs: int = 2,
    out: Path = Path("out/force_methods"),
    data: Path | None = None,
    workers: int = 2,
) -> None:
    """Print the table for every split, and draw a figure of all axes.

    size: columns and rows of the networks' images. densenet_epochs: fewer than those of the others, because one costs as much as
    ten of them. data: a generated data set to use in place of a new one.
    """
    if data is None:
        data = out / "data"
        generate_dataset(data, GenerationSettings(pairs, sensors=sensors), workers, progress=True)
    tables: dict[str, list[Method]] = {}
    heights = examples_of(data, CORRECTOR_TRAINING.input, workers)
    images = examples_of(data, NetworkInputSettings(InputChannels.DEFORMATION, size[1], size[0]), workers)
    for split in SPLITS:
        rows = split_rows(heights[0], heights[1], split)
        image_rows = matching_rows(rows, heights[1], images[1])
        folder = out / split
        tables[split] = [
            network("raw image CNN", without_reference(images[0]), image_rows, folder, epochs, size),
            network("gel-flow DenseNet", images[0], image_rows, folder, densenet_epochs, size, densenet),
            network("height CNN", replace(heights[0], tractions=None, physics=None), rows, folder, epochs, None),
            moments(heights[0], rows),
            physics(heights[0], rows),
            network("physics corrected", heights[0], rows, folder, epochs, None),
        ]
        show(split, tables[split])
    draw(tables, out / "force_methods.png")


def examples_of(data: Path, grid: NetworkInputSettings, workers: int) -> tuple[TrainingExamples, list[str]]:
    """Return the examples of a data set and their ids; of images, those of all pairs, of physics, those with a contact."""
    examples, ids = read_training_examples(data, grid, None, workers, True, print)
    return examples, list(ids)


def split_rows(examples: TrainingExamples, ids: list[str], kind: Kind) -> SplitRows:
    """Return the training and test rows of a split that holds out a fifth."""
    labels = SplitKeys(ids, list(examples.objects), list(examples.sensors))
    amount = SplitSettings(kind, pairs=HELD_OUT, objects=HELD_OUT, sensors=HELD_OUT)
    return split_dataset(labels, amount).rows(ids)


def matching_rows(rows: SplitRows, ids: list[str], others: list[str]) -> SplitRows:
    """Return the rows of the same pairs among other examples."""
    place = {name: row for row, name in enumerate(others)}
    return SplitRows(*(np.array([place[ids[row]] for row in part]) for part in (rows.train, rows.test)))


def without_reference(examples: TrainingExamples) -> TrainingExamples:
    """Return examples with black references: the network's channels are then nothing, the image and nothing."""
    assert examples.references is not None
    return replace(examples, references=np.zeros_like(examples.references))


def network(
    name: str,
    examples: TrainingExamples,
    rows: SplitRows,
    folder: Path,
    epochs: int,
    size: tuple[int, int] | None,
    architecture: str = "moments",
) -> Method:
    """Train a network and return its predictions on the test pairs, by which the best epoch is chosen, alike for all networks."""
    usual = CORRECTOR_TRAINING if name == "physics corrected" else DEFAULT_TRAINING
    if size is not None:
        grid = NetworkInputSettings(InputChannels.DEFORMATION, size[1], size[0])
        usual = replace(usual, input=scale_input_settings_to_width(grid, 24.0))
    if architecture != "moments":
        usual = replace(PAPER_TRAINING, network=architecture, input=usual.input)
    settings = replace(usual, epochs=epochs)
    out = folder / name.replace(" ", "_").lower()
    trained = train_network(examples, rows, settings, out, name=name, machine=ComputeSettings(accelerator="cpu"))
    assert trained is not None
    inputs = np.zeros((1, *settings.input.shape), np.float32)
    parameters = int(sum(np.prod(one.shape) for one in weights_of(trained.path)))
    return Method(name, trained.evaluation.predictions, parameters, milliseconds(lambda: trained.model(inputs)))


def weights_of(model: Path) -> Iterator[np.ndarray]:
    """Yield the weights of an ONNX file."""
    import onnx
    from onnx import numpy_helper

    yield from (numpy_helper.to_array(one) for one in onnx.load(str(model)).graph.initializer)


def moments(examples: TrainingExamples, rows: SplitRows) -> Method:
    """Return the predictions of a ridge regression on moments of the height map."""
    features = moments_of(np.asarray(examples.images, np.float32), CORRECTOR_TRAINING.input)
    features = features / np.maximum(np.abs(features[rows.train]).mean(0), 1e-9)
    train, truth = features[rows.train], examples.wrench[rows.train].astype(float)
    unit = np.abs(truth).mean(0)
    normal = train.T @ train + RIDGE * len(train) * np.eye(train.shape[1])
    weights = np.linalg.solve(normal, train.T @ (truth / unit)) * unit
    ms = milliseconds(
        lambda: moments_of(np.asarray(examples.images[:1], np.float32), CORRECTOR_TRAINING.input) @ weights
    )
    return Method("moments", predictions(examples, rows, features[rows.test] @ weights), weights.size, ms)


def moments_of(z_mm: np.ndarray, grid: NetworkInputSettings) -> np.ndarray:
    """Return one, and the moments up to the second order of indentations and of bulges."""
    x, y = (grid.mm_per_px * (np.arange(side) - (side - 1) / 2) for side in (grid.cols, grid.rows))
    fields = np.stack([np.maximum(-z_mm, 0), np.maximum(-z_mm, 0) ** 2, np.maximum(z_mm, 0)], 1)
    of_x, of_y = (np.stack([axis**0, axis, axis**2]) for axis in (x, y))
    all_moments = np.einsum("nfyx,ay,bx->nfab", fields, of_y, of_x)
    return np.concatenate([np.ones((len(z_mm), 1)), all_moments.reshape(len(z_mm), -1)], 1)


def physics(examples: TrainingExamples, rows: SplitRows) -> Method:
    """Return what physics finds in the test pairs; its time is that of benchmarks/force_speed."""
    assert examples.physics is not None
    return Method("physics", predictions(examples, rows, examples.physics[rows.test].astype(float)), 0, np.nan)


def predictions(examples: TrainingExamples, rows: SplitRows, six: np.ndarray) -> WrenchPredictions:
    """Return predictions beside the truth of the test pairs."""
    return WrenchPredictions(examples.wrench[rows.test].astype(float), six, about_mm=(0.0, 0.0, 0.0))


def milliseconds(call: object) -> float:
    """Return the processor time of one call."""
    start = process_time()
    for _ in range(TIMED):
        call()  # type: ignore[operator]
    return (process_time() - start) / TIMED * 1e3


def show(split: str, methods: list[Method]) -> None:
    """Print the table of one split."""
    print(
        f"\nheld out: {split}; skill of {' '.join(WRENCH_AXES)} | MAE, Std of |error| (N, N·mm) | slope of Fz | weights | ms"
    )
    for one in methods:
        scores = evaluate_predictions(one.predictions).scores
        units = np.array([1, 1, 1, 1e3, 1e3, 1e3])
        skill, mae, std = (
            " ".join(f"{v:5.2f}" for v in six) for six in (scores.skill, scores.mae * units, scores.std * units)
        )
        slope = scores.slope_with_offset[2]
        ms = "–" if np.isnan(one.ms) else f"{one.ms:.1f}"
        print(f"  {one.name:18s} {skill} | {mae} | {std} | {slope:.2f} | {one.parameters:9,d} | {ms}", flush=True)


def draw(tables: dict[str, list[Method]], path: Path) -> None:
    """Draw the skill of every method on every axis, one panel for each split."""
    figure = Figure(figsize=(10, 3.2 * len(tables)), layout="constrained")
    for panel, (split, methods) in zip(
        figure.subplots(len(tables), 1, squeeze=False)[:, 0], tables.items(), strict=True
    ):
        for at, one in enumerate(methods):
            skill = evaluate_predictions(one.predictions).scores.skill
            panel.bar(np.arange(6) + 0.13 * (at - 2.5), np.maximum(skill, 0), 0.12, label=one.name)
        panel.set_xticks(range(6), WRENCH_AXES)
        panel.set(title=f"held out: {split}", ylabel="skill", ylim=(0, 1))
    panel.legend(ncols=3, loc="upper center", bbox_to_anchor=(0.5, -0.12))
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)
    print(path)


if __name__ == "__main__":
    tyro.cli(force_methods)
