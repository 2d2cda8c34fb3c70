"""What the tests of data sets do again and again."""

import resource
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow.parquet as pq

from ninedtact_train.collecting.training_pair_rule import PairKindShares
from ninedtact_train.dataset.build import BuildResult, BuildSettings, build_dataset
from ninedtact_train.dataset.fault_report import QualityReport
from ninedtact_train.dataset.generation.settings import GenerationSettings
from ninedtact_train.dataset.sources.find_sources import find_sources
from ninedtact_train.dataset.sources.source import Source, SourceConventions

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
"""A small data set of the twin, as short as it can be."""


def sources_at(*words: Path | str, conventions: SourceConventions = SourceConventions()) -> Sequence[Source]:
    return find_sources([str(word) for word in words], conventions)


def built_from(
    out: Path,
    *words: Path | str,
    conventions: SourceConventions = SourceConventions(),
    settings: BuildSettings = BuildSettings(),
) -> BuildResult:
    return build_dataset(out, sources_at(*words, conventions=conventions), settings)


def rows_in(folder: Path) -> list[dict[str, Any]]:
    return [row for path in sorted((folder / "data").iterdir()) for row in pq.read_table(path).to_pylist()]


def references_in(folder: Path) -> dict[str, np.ndarray]:
    rows = pq.read_table(folder / "references.parquet").to_pylist()
    return {row["reference_id"]: decoded(row["image"]) for row in rows}


def decoded(image: dict[str, Any]) -> np.ndarray:
    return cv2.imdecode(np.frombuffer(image["bytes"], np.uint8), cv2.IMREAD_UNCHANGED)


@contextmanager
def full_disk(largest_file: int) -> Iterator[None]:
    """Files may grow to this number of bytes: what a full disk does, without one."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (largest_file, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def listed(report: QualityReport) -> set[tuple[str, str]]:
    """Fault and id of each finding."""
    return {(finding.fault.value, finding.id) for finding in report.findings}
