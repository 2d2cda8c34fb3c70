"""Examples → a force model in one file: learn, set the errors right, export, say how good it is on what was held out."""

from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path
from typing import Any

import numpy as np

from ninedtact.atomic_write import write_file_atomically
from ninedtact.force.evaluation import Evaluation
from ninedtact.force.model_file import ForceModel
from ninedtact.force.splits import Rows
from ninedtact.force.training.curves import curves
from ninedtact.force.training.examples import Examples, about_point, require_learnable
from ninedtact.force.training.export import write_model
from ninedtact.force.training.fit import fit
from ninedtact.force.training.folder import CURVES, MODEL, begin
from ninedtact.force.training.learner import Learner, labels_of
from ninedtact.force.training.lesson import Lesson
from ninedtact.force.training.settings import Machine, TrainingSettings


@dataclass(frozen=True)
class Trained:
    """A model, and how good it is on what was held out."""

    path: Path
    model: ForceModel
    evaluation: Evaluation


def train(
    examples: Examples,
    rows: Rows,
    settings: TrainingSettings,
    out: Path,
    *,
    name: str = "network",
    licence: str = "MIT",
    machine: Machine = Machine(),
    progress: bool = False,
) -> Trained | None:
    """Learn from `rows.train`, keep the epoch that is best on `rows.test`; begun again after a stop, it goes on.

    None on all processes of a training but the first. Raises `ExamplesUnusable`, `FolderTaken`, `TrainingStopped`,
    `CheckpointDamaged`, `FileNotWritten`.
    """
    require_learnable(examples, rows, settings.input)
    begin(out, {"settings": settings.as_table(), "examples": digest(examples, rows), "name": name})
    learnt = about_point(examples, settings.about_mm)
    learner = Learner(settings, labels_of(learnt.wrench[rows.train], settings))
    fitted = fit(learner, learnt, rows, out, machine, progress)
    if not fitted.trainer.is_global_zero:
        return None
    lesson = Lesson(learner.model.to(fitted.trainer.strategy.root_device).eval(), learnt, rows, settings)
    lesson.set_errors_right()
    evaluation = lesson.evaluation
    card = lesson.card(evaluation, fitted.history, name, licence)
    write_file_atomically(out / CURVES, curves(fitted.history.rows, lesson.median_mae, card.training.best_epoch))
    return Trained(out / MODEL, write_model(out / MODEL, lesson.network, card), evaluation)


def digest(examples: Examples, rows: Rows) -> dict[str, Any]:
    """By which a stopped training knows its examples again."""
    told = blake2b(digest_size=8)
    for part in (examples.wrench, rows.train, rows.test):
        told.update(np.ascontiguousarray(part).tobytes())
    return {"pairs": len(examples), "wrenches": told.hexdigest()}
