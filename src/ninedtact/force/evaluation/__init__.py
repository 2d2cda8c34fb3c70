"""How good an estimate of force is, by the paper's protocol and beyond it.

    CSV ──predictions_file──▶ Predictions ──evaluate──▶ Evaluation ──table, drawn, page──▶ lines, figures, one page
    model and data ─────────▶ Predictions

Whoever has wrenches and what was made of them makes `Predictions` and calls `evaluate`; the rest follows.
"""

from ninedtact.force.evaluation.evaluation import Evaluation, evaluate
from ninedtact.force.evaluation.predictions import Distribution, Predictions, PredictionsUnusable

__all__ = ["Distribution", "Evaluation", "Predictions", "PredictionsUnusable", "evaluate"]
"""What other rooms use."""
