"""What the tests of data sets do again and again."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow.parquet as pq

from ninedtact.dataset.build import BuildSettings, Built, build
from ninedtact.dataset.report import Report
from ninedtact.dataset.sources.detect import Finder
from ninedtact.dataset.sources.source import Source, Statements
from ninedtact.shape.rectification import Rectification


def no_sensor(folder: Path) -> Rectification:
    raise AssertionError(f"no sensor is read here, got {folder}")


def sources_at(*words: Path | str, statements: Statements = Statements()) -> Sequence[Source]:
    return Finder(no_sensor, statements).sources([str(word) for word in words])


def built_from(
    out: Path, *words: Path | str, statements: Statements = Statements(), settings: BuildSettings = BuildSettings()
) -> Built:
    return build(out, sources_at(*words, statements=statements), settings)


def rows_in(folder: Path) -> list[dict[str, Any]]:
    return [row for path in sorted((folder / "data").iterdir()) for row in pq.read_table(path).to_pylist()]


def references_in(folder: Path) -> dict[str, np.ndarray]:
    rows = pq.read_table(folder / "references.parquet").to_pylist()
    return {row["reference"]: decoded(row["image"]) for row in rows}


def decoded(image: dict[str, Any]) -> np.ndarray:
    return cv2.imdecode(np.frombuffer(image["bytes"], np.uint8), cv2.IMREAD_UNCHANGED)


def listed(report: Report) -> set[tuple[str, str]]:
    """Fault and id of each finding."""
    return {(finding.fault.value, finding.id) for finding in report.listed}
