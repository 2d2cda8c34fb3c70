"""ninedtact evaluate: scores of predicted wrenches, from a file or of an estimator on a data set."""

from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from ninedtact.cli.result_and_interrupt import print_notice, print_result
from ninedtact.cli.shared_options import ClusterOption, JsonOption
from ninedtact.errors import InputError
from ninedtact_train.workflows.dataset_evaluation import DatasetEvaluationSettings

if TYPE_CHECKING:
    from ninedtact_train.evaluation import WrenchPredictions

_Point = tuple[float, float, float]
_DATA_OPTIONS = ("estimator", "workers", "cluster")
"""Options of the evaluation of an estimator on a data set."""
_PREDICTIONS_OPTIONS = ("predictions_about_mm", "distribution", "trust_units")
"""Options of the evaluation of a file with predictions."""


@dataclass(frozen=True)
class EvaluateCommand:
    """Evaluate predicted wrenches by the paper's scores and more, beside the published network's: predictions in a file, or an
    estimator on a data set."""

    predictions: Path | None = None
    """CSV file with columns Fx_N … Tz_Nm (true) and pFx … pTz (predicted).
    Optional columns: eFx … eTz (claimed standard deviations), object, sensor."""
    data: Path | None = None
    """Data set on which an estimator is evaluated, in place of --predictions."""
    estimator: Annotated[DatasetEvaluationSettings, tyro.conf.arg(name="")] = DatasetEvaluationSettings()
    workers: int = 2
    """Number of processes; they calibrate simulated sensors and estimate."""
    cluster: ClusterOption = None
    out: Path | None = None
    """Folder for the report: evaluation.html, its figures and evaluation.json."""
    about_mm: _Point | None = None
    """Point of the torques in the evaluation; by default that of the predictions."""
    predictions_about_mm: _Point | None = None
    """Point of the torques in the predictions file: 0 0 0 is the skin's centre, 0 0 -35 the paper's force/torque sensor."""
    distribution: Literal["gaussian", "laplace"] = "gaussian"
    """Distribution of the errors whose standard deviations the file claims."""
    trust_units: bool = False
    """Continue where numbers do not look like N and N·m."""
    json: JsonOption = False

    def run(self) -> int:
        """Evaluate, print the scores, and write the report."""
        from ninedtact_train.evaluation import evaluate_predictions
        from ninedtact_train.evaluation.report import format_evaluation_report, write_evaluation_report

        predictions = self._load_predictions()
        evaluation = evaluate_predictions(predictions if self.about_mm is None else predictions.about(self.about_mm))
        written = [] if self.out is None else write_evaluation_report(self.out, evaluation)
        files = {kind: str(path) for kind, path in written}
        lines = (*format_evaluation_report(evaluation), *(f"  {kind}: {path}" for kind, path in files.items()))
        return print_result(self.json, {**evaluation.to_json_dict(), "files": files}, lines)

    def _load_predictions(self) -> "WrenchPredictions":
        if self.data is not None:
            return self._predict(self.data)
        if self.predictions is None:
            raise InputError(expected="--predictions or --data", got="neither", remedy="name a CSV file or a data set")
        self._refuse_given(_DATA_OPTIONS, "--predictions")
        from ninedtact_train.evaluation import ErrorDistribution
        from ninedtact_train.evaluation.predictions import read_predictions, require_si_units

        found = read_predictions(self.predictions, ErrorDistribution(self.distribution), self.predictions_about_mm)
        if not self.trust_units:
            require_si_units(found)
        return found

    def _predict(self, data: Path) -> "WrenchPredictions":
        """Run the estimator on the data set, and keep its predictions beside the report."""
        from ninedtact_train.evaluation.predictions import write_predictions
        from ninedtact_train.workflows.dataset_evaluation import predict_dataset

        if self.predictions is not None:
            raise InputError(expected="--predictions or --data", got="both", remedy="name one of them")
        self._refuse_given(_PREDICTIONS_OPTIONS, "--data")
        from ninedtact.parallel_jobs import connect_workers

        if self.out is not None:  # refused before the work rather than after it
            self.out.mkdir(parents=True, exist_ok=True)
        with connect_workers(self.workers, self.cluster) as workers:
            predictions = predict_dataset(data, self.estimator, workers, progress=not self.json, notify=print_notice)
        if self.out is not None:
            write_predictions(self.out / "predictions.csv", predictions)
        return predictions

    def _refuse_given(self, options: tuple[str, ...], beside: str) -> None:
        """Raise `InputError` where one of the options that have no effect beside another has been given."""
        given = []
        for one in fields(self):
            value = getattr(self, one.name)
            changed = [(one.name, one.default, value)]
            if is_dataclass(value):
                changed = [(part.name, part.default, getattr(value, part.name)) for part in fields(value)]
            if one.name in options:
                given += [f"--{name.replace('_', '-')}" for name, default, now in changed if now != default]
        if given:
            raise InputError(
                expected=f"options that have an effect with {beside}",
                got=f"{' and '.join(given)}",
                remedy="drop what does not apply",
            )
