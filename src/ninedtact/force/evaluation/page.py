"""An evaluation → a folder: one page that needs nothing else, its figures as PNG, and all numbers as JSON."""

import json
from base64 import b64encode
from collections.abc import Iterator
from pathlib import Path

from ninedtact.atomic_write import write_file_atomically
from ninedtact.force.evaluation.drawn import figures
from ninedtact.force.evaluation.evaluation import Evaluation
from ninedtact.force.evaluation.published import OBJECT_MAE, OBJECT_STD, published_about
from ninedtact.force.evaluation.table import (
    HEADINGS,
    Row,
    about,
    counted,
    coverage_rows,
    part_rows,
    score_rows,
)

WORST = 10
"""Objects whose figures stand in the page; all are in the JSON."""


def write_report(out: Path, evaluation: Evaluation) -> Iterator[tuple[str, Path]]:
    """Write all files, each whole (`FileNotWritten`); kind and path of each."""
    out.mkdir(parents=True, exist_ok=True)
    drawn = dict(figures(evaluation))
    contents = {f"{name}.png": content for name, content in drawn.items()}
    contents["evaluation.json"] = json.dumps(evaluation.as_table(), indent=1, ensure_ascii=False).encode()
    contents["evaluation.html"] = page(evaluation, drawn).encode()
    for name, content in contents.items():
        write_file_atomically(out / name, content)
        yield name.removesuffix(".png"), out / name


def page(evaluation: Evaluation, drawn: dict[str, bytes]) -> str:
    """One HTML document: images are inside it, it loads and runs nothing."""
    # jinja2 is slow to import, and only this function needs it.
    from jinja2 import Environment, PackageLoader, StrictUndefined

    pages = Environment(
        loader=PackageLoader("ninedtact.force.evaluation", "."),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return pages.get_template("evaluation.html.jinja").render(
        evaluation=evaluation,
        counted=counted(evaluation),
        about=about(evaluation),
        published=published_about(evaluation.predictions.about_mm),
        headings=HEADINGS,
        scores=[*score_rows(evaluation)],
        unseen=[Row("MAE", OBJECT_MAE), Row("Std of |error|", OBJECT_STD)],
        loads=[*part_rows(evaluation.by_load)],
        coverage=[*coverage_rows(evaluation)],
        sensors=[*part_rows(evaluation.by_sensor)],
        worst=[*part_rows(sorted(evaluation.by_object, key=lambda part: -part.mae[:3].mean())[:WORST])],
        images={name: b64encode(content).decode() for name, content in drawn.items()},
    )
