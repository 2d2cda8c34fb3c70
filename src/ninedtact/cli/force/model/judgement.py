"""How good a model is on twins and objects that it never saw, by the mechanics of the twins."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ninedtact.cli.force.estimators import BOTH
from ninedtact.cli.force.judged_data import JudgedData

if TYPE_CHECKING:
    from ninedtact.force.evaluation import WrenchPredictions

PAPERS_POINT = (0.0, 0.0, -35.0)
KINDS = {
    "bonded": "rigid substrate, small strains (as the calibration assumes)",
    "finite_strain": "rigid substrate, finite-strain (neo-Hookean) gel",
    "compliant_base": "compliant substrate",
}
"""Mechanics of the twins, in words."""
LEFT_OUT = ("published", "by_object", "by_sensor", "axes", "units")
"""Of the tables that a card holds."""


TOGETHER = ", network and physics fused"
"""What is added to a table's name."""


@dataclass(frozen=True)
class Judgement:
    """Predictions for a data set of twins: the network's, with and without the gate, and those of network and physics together."""

    network: "WrenchPredictions"
    ungated: "WrenchPredictions"
    together: "WrenchPredictions"
    kinds: dict[str, str]
    """Mechanics of each sensor."""

    def tables(self) -> dict[str, dict[str, Any]]:
        """For the card."""
        from ninedtact.force.evaluation import evaluate_predictions

        told = {
            words + suffix: table(part)
            for suffix, predictions in (("", self.network), (TOGETHER, self.together))
            for words, part in self.parts(predictions)
        }
        told["all"]["no_contact_without_detection"] = evaluate_predictions(self.ungated).to_json_dict()["no_contact"]
        return told

    def parts(self, predictions: "WrenchPredictions") -> "Iterator[tuple[str, WrenchPredictions]]":
        """Of each kind of mechanics that occurs, then all."""
        assert predictions.sensors is not None
        each = [self.kinds[name] for name in predictions.sensors]
        for kind, words in KINDS.items():
            if kind in each:
                yield words, predictions.select([one == kind for one in each])
        yield "all", predictions


def table(predictions: "WrenchPredictions") -> dict[str, Any]:
    """All figures about the skin's centre, the skill about the paper's point beside them."""
    from ninedtact.force.evaluation import evaluate_predictions

    whole = evaluate_predictions(predictions).to_json_dict()
    below = evaluate_predictions(predictions.about(PAPERS_POINT)).scores.skill
    return {**{key: value for key, value in whole.items() if key not in LEFT_OUT}, "skill_35_mm_below": below.tolist()}


def judged(model: Path, data: Path, workers: int, progress: bool) -> Judgement:
    """The model on a data set of twins, each of which calibrates itself and is weighed with five presses."""
    from ninedtact.cli.force.own_sensors import members_of

    network, together = (
        JudgedData(data, force, modulus="weighed", workers=workers, progress=progress).predictions()
        for force in (str(model), f"{BOTH}:{model}")
    )
    ungated = JudgedData(data, str(model), workers=workers, progress=progress, gate=False).predictions()
    return Judgement(network, ungated, together, {name: member.kind for name, member in members_of(data).items()})
