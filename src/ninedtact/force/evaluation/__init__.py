"""How good an estimate of force is, by the paper's protocol and beyond it.

    CSV ──predictions_file──▶ Predictions ──evaluate──▶ Evaluation ──table, drawn, page──▶ lines, figures, one page
    model and data ─────────▶ Predictions

Whoever has wrenches and what was made of them makes `WrenchPredictions` and calls `evaluate_predictions`; the rest follows.
"""

from ninedtact.force.evaluation.evaluation import WrenchEvaluation, evaluate_predictions
from ninedtact.force.evaluation.predictions import ErrorDistribution, PredictionsUnusable, WrenchPredictions

__all__ = ["ErrorDistribution", "PredictionsUnusable", "WrenchEvaluation", "WrenchPredictions", "evaluate_predictions"]
"""What other rooms use."""
