"""ninedtact evaluate: how good predictions of force are."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from ninedtact.cli.answer import answer

if TYPE_CHECKING:
    from ninedtact.force.evaluation import Evaluation, Predictions

Point = tuple[float, float, float]


@dataclass(frozen=True)
class Evaluate:
    """Judge predicted wrenches by the paper's table and beyond it, beside the published network's."""

    predictions: Path
    """CSV: Fx_N … Tz_Nm, predicted pFx … pTz, if claimed standard deviations eFx … eTz, object, sensor."""
    out: Path | None = None
    """Folder for a page to read (evaluation.html), its figures and all numbers."""
    about_mm: Point | None = None
    """Point that torques are judged about; as given where nothing is said."""
    given_about_mm: Point | None = None
    """Point that torques in the file are about: 0 0 0 is the skin's centre, 0 0 -35 the paper's force/torque sensor."""
    distribution: Literal["gaussian", "laplace"] = "gaussian"
    """What the claimed errors are distributed like."""
    trust_units: bool = False
    """Go on where numbers do not look like N and N·m."""
    json: bool = False
    """Print all figures as one JSON object."""

    def run(self) -> int:
        """Judge, and say how it compares."""
        from ninedtact.force.evaluation import evaluate
        from ninedtact.force.evaluation.table import lines

        evaluation = evaluate(self.judged)
        files = {} if self.out is None else self.written(evaluation, self.out)
        figures = {**evaluation.as_table(), "files": files}
        told = (*lines(evaluation), *(f"  {kind}: {path}" for kind, path in files.items()))
        return answer(self.json, figures, told)

    @property
    def judged(self) -> "Predictions":
        """What is judged, its torques about the point that was asked for; raises `PredictionsUnusable`."""
        from ninedtact.force.evaluation import Distribution
        from ninedtact.force.evaluation.predictions_file import read_predictions
        from ninedtact.force.evaluation.units import require_units

        found = read_predictions(self.predictions, Distribution(self.distribution), self.given_about_mm)
        if not self.trust_units:
            require_units(found)
        return found if self.about_mm is None else found.about(self.about_mm)

    def written(self, evaluation: "Evaluation", out: Path) -> dict[str, str]:
        """Page, figures and numbers; kind and path of each."""
        from ninedtact.force.evaluation.page import write_report

        return {kind: str(path) for kind, path in write_report(out, evaluation)}
