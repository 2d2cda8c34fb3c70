"""How fast a data set is read in training: images of 460 x 345 px, read at 160 x 120, one core."""

from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter, process_time

import cv2
import numpy as np
import tyro
from figures import Figure, answer, at_least

from ninedtact_train.dataset.parquet_files import encode_png, write_pair_file, write_reference_images_file
from ninedtact_train.dataset.reader import TactileDataset, load_dataset
from ninedtact_train.dataset.schema import DatasetRow, ReferenceImage

WANTED_PER_S = 2000
BATCH = 64


def dataset_reading(pairs: int = 2000, quick: bool = False, json: bool = False) -> None:
    """Measure."""
    cv2.setNumThreads(1)
    pairs = 20 if quick else pairs
    with TemporaryDirectory() as folder:
        write_set(Path(folder), pairs)
        decoding, opening = opened(Path(folder)), opened(Path(folder))
        data = load_dataset(folder)
        figures = [
            at_least("images a second with wrench and reference, batches of 64", batched(data), WANTED_PER_S),
            Figure("the same, one by one", one_by_one(data)),
            Figure("first opening, images decoded a second of CPU time", pairs / decoding[0]),
            Figure("later opening, s", opening[1]),
        ]
    answer(f"Data set of {pairs} pairs, 460 x 345 px, read at 160 x 120", figures, json)


def write_set(folder: Path, pairs: int) -> None:
    """Smooth images with the noise of a camera: what costs PNG its time."""
    rng = np.random.default_rng(0)
    (folder / "data").mkdir()
    skin = np.linspace(130, 160, 460) + np.zeros((345, 1))

    def row(number: int) -> DatasetRow:
        noisy = (skin + rng.normal(0, 0.7, skin.shape)).astype(np.uint8)
        wrench = np.array([0, 0, -3, 0, 0, 0], np.float32)
        return DatasetRow(
            str(number), encode_png(noisy), "skin", wrench, "cup", "c", number, None, "s", "rule", "b", 0.052
        )

    half = pairs // 2
    for file, numbers in enumerate((range(half), range(half, pairs))):
        write_pair_file(folder / "data" / f"train-{file:05d}-of-00002.parquet", map(row, numbers))
    write_reference_images_file(
        folder / "references.parquet", [ReferenceImage("skin", encode_png(skin.astype(np.uint8)), "s")]
    )


def opened(folder: Path) -> tuple[float, float]:
    """CPU and wall time of opening."""
    began = process_time(), perf_counter()
    load_dataset(folder)
    return process_time() - began[0], perf_counter() - began[1]


def batched(data: TactileDataset) -> float:
    """Pairs a second of CPU time."""
    rng, began = np.random.default_rng(0), process_time()
    read = sum(len(batch.images) for _ in range(10) for batch in data.batches(BATCH, rng))
    return read / (process_time() - began)


def one_by_one(data: TactileDataset) -> float:
    """Pairs a second of CPU time."""
    order, began = np.random.default_rng(0).permutation(len(data)), process_time()
    for number in order:
        data.batch(np.array([number]))
    return len(order) / (process_time() - began)


if __name__ == "__main__":
    tyro.cli(dataset_reading)
