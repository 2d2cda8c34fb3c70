"""Evaluation of force estimates by the paper's protocol and beyond it.

True and predicted wrenches (`WrenchPredictions`) go in, read from a CSV file or made by an estimator on a data set
(`ninedtact_train.workflows`). `evaluate_predictions` computes scores by axis, load, object and sensor and the coverage of claimed
intervals (`WrenchEvaluation`). A terminal table or a folder with an HTML page, figures and JSON comes out (`report`).
"""

from ninedtact.errors import FileFormatError
from ninedtact_train.evaluation.evaluation import WrenchEvaluation, evaluate_predictions
from ninedtact_train.evaluation.predictions import ErrorDistribution, WrenchPredictions

__all__ = ["ErrorDistribution", "FileFormatError", "WrenchEvaluation", "WrenchPredictions", "evaluate_predictions"]
