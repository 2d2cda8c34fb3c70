"""ninedtact evaluate: how good predictions of force are."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from ninedtact.cli.force.estimators import BOTH
from ninedtact.cli.force.judged_data import Modulus
from ninedtact.cli.terminal import print_result
from ninedtact.errors import NinedtactError

if TYPE_CHECKING:
    from ninedtact.force.evaluation import WrenchEvaluation, WrenchPredictions

Point = tuple[float, float, float]


class NothingToJudge(NinedtactError):
    """Neither predictions nor a data set to make them on, or both."""


@dataclass(frozen=True)
class Evaluate:
    """Judge wrenches by the paper's table and beyond it, beside the published network's: those in a file, or an
    estimator's on a data set."""

    predictions: Path | None = None
    """CSV: Fx_N … Tz_Nm, predicted pFx … pTz, if claimed standard deviations eFx … eTz, object, sensor."""
    data: Path | None = None
    """Data set to judge an estimator on, in place of --predictions."""
    force: str = BOTH
    """The estimator: network (the one that ships), physics, both, a force model (.onnx) or the original's weights (.pt)."""
    sensors: Path | None = None
    """Folder with a sensor folder for each sensor of the data, by name. Twins calibrate themselves."""
    modulus: Modulus = "true"
    """How stiff the gels of twins are taken for: as they are, as designed, or as five presses of 100 to 500 g tell, by which
    every twin's force is adapted as `ninedtact adapt` does it."""
    ungated: bool = False
    """Ask a network about untouched skin too, which otherwise is zero without being asked about."""
    every: int = 1
    """Judge every so many-th pair."""
    workers: int = 2
    """Processes that calibrate twins."""
    out: Path | None = None
    """Folder for a page to read (evaluation.html), its figures and all numbers."""
    about_mm: Point | None = None
    """Point that torques are judged about; as given where nothing is said."""
    predictions_about_mm: Point | None = None
    """Point that torques in the file are about: 0 0 0 is the skin's centre, 0 0 -35 the paper's force/torque sensor."""
    distribution: Literal["gaussian", "laplace"] = "gaussian"
    """What the claimed errors are distributed like."""
    trust_units: bool = False
    """Go on where numbers do not look like N and N·m."""
    json: bool = False
    """Print all figures as one JSON object."""

    def run(self) -> int:
        """Judge, and say how it compares."""
        from ninedtact.force.evaluation import evaluate_predictions
        from ninedtact.force.evaluation.report import format_evaluation_report

        evaluation = evaluate_predictions(self.judged)
        files = {} if self.out is None else self.written(evaluation, self.out)
        figures = {**evaluation.to_json_dict(), "files": files}
        told = (*format_evaluation_report(evaluation), *(f"  {kind}: {path}" for kind, path in files.items()))
        return print_result(self.json, figures, told)

    @property
    def judged(self) -> "WrenchPredictions":
        """What is judged, its torques about the point that was asked for; raises `PredictionsUnusable`."""
        found = self.made if self.data is not None else self.stored
        return found if self.about_mm is None else found.about(self.about_mm)

    @property
    def made(self) -> "WrenchPredictions":
        """The estimator's, on the data set; raises `NothingToJudge`."""
        from ninedtact.cli.force.judged_data import JudgedData
        from ninedtact.force.evaluation.predictions_csv import write_predictions

        if self.predictions is not None or self.data is None:
            raise NothingToJudge("expected --predictions or --data, got both; name one of them")
        if self.every < 1:
            raise NothingToJudge(f"expected --every of at least 1, got {self.every}; drop it")
        made = JudgedData(
            *(self.data, self.force, self.sensors, self.modulus, self.every, self.workers),
            progress=not self.json,
            gate=not self.ungated,
        ).predictions()
        if self.out is not None:
            self.out.mkdir(parents=True, exist_ok=True)
            write_predictions(self.out / "predictions.csv", made)
        return made

    @property
    def stored(self) -> "WrenchPredictions":
        """Those of the file; raises `PredictionsUnusable`, `NothingToJudge`."""
        from ninedtact.force.evaluation import ErrorDistribution
        from ninedtact.force.evaluation.predictions import require_si_units
        from ninedtact.force.evaluation.predictions_csv import read_predictions

        if self.predictions is None:
            raise NothingToJudge("expected --predictions or --data, got neither; name a CSV file or a data set")
        found = read_predictions(self.predictions, ErrorDistribution(self.distribution), self.predictions_about_mm)
        if not self.trust_units:
            require_si_units(found)
        return found

    def written(self, evaluation: "WrenchEvaluation", out: Path) -> dict[str, str]:
        """Page, figures and numbers; kind and path of each."""
        from ninedtact.force.evaluation.report import write_evaluation_report

        return {kind: str(path) for kind, path in write_evaluation_report(out, evaluation)}
