"""How good a model is on twins and objects that it never saw, by the mechanics of the twins."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ninedtact.cli.force.judged_data import JudgedData

if TYPE_CHECKING:
    from ninedtact.force.evaluation import Evaluation, Predictions

PAPERS_POINT = (0.0, 0.0, -35.0)
KINDS = {
    "bonded": "rigid base, small strains (what the calibration assumes)",
    "finite_strain": "rigid base, gel stiffens as it thins",
    "compliant_base": "base yields",
}
"""Mechanics of the twins, in words."""
LEFT_OUT = ("published", "by_object", "by_sensor", "axes", "units")
"""Of the tables that a card holds."""


@dataclass(frozen=True)
class Judgement:
    """Predictions for a data set of twins, with and without the gate that answers nothing to no contact."""

    gated: "Predictions"
    ungated: "Predictions"
    kinds: dict[str, str]
    """Mechanics of each sensor."""

    def evaluations(self) -> "Iterator[tuple[str, Evaluation]]":
        """Of each kind of mechanics that occurs, then all; torques about the skin's centre."""
        from ninedtact.force.evaluation import evaluate

        assert self.gated.sensors is not None
        each = [self.kinds[name] for name in self.gated.sensors]
        for kind, words in KINDS.items():
            if kind in each:
                yield words, evaluate(self.gated.those([one == kind for one in each]))
        yield "all", evaluate(self.gated)

    def tables(self) -> dict[str, dict[str, Any]]:
        """For the card: every evaluation, its skill about the paper's point beside it, and the network without its gate."""
        from ninedtact.force.evaluation import evaluate

        told = {}
        for words, evaluation in self.evaluations():
            table = {key: value for key, value in evaluation.as_table().items() if key not in LEFT_OUT}
            below = evaluate(evaluation.predictions.about(PAPERS_POINT))
            told[words] = {**table, "skill_35_mm_below": below.scores.skill.tolist()}
        told["all"]["untouched_without_gate"] = evaluate(self.ungated).as_table()["untouched"]
        return told


def judged(model: Path, data: Path, workers: int, progress: bool) -> Judgement:
    """The model on a data set of twins, each of which calibrates itself."""
    from ninedtact.cli.force.own_sensors import members_of

    gated, ungated = (
        JudgedData(data, str(model), workers=workers, progress=progress, gate=gate).predictions()
        for gate in (True, False)
    )
    return Judgement(gated, ungated, {name: member.kind for name, member in members_of(data).items()})
