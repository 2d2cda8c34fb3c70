"""A training drawn: what was learnt and what held-out images say, epoch by epoch.

matplotlib is slow to import, so it is imported when the figure is drawn; its global state is never touched.
"""

from collections.abc import Sequence
from io import BytesIO
from typing import TYPE_CHECKING

import numpy as np

from ninedtact.force.evaluation.predictions import AXES
from ninedtact.force.training.history import Row
from ninedtact.force.training.learner import BEST

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS = ("#0072b2", "#d55e00", "#009e73")
"""x, y and z: Okabe and Ito's, which colour-blind readers can tell apart."""
INK, PALE_INK = "#22262b", "#6b7280"


def curves(rows: Sequence[Row], median_mae: Sequence[float], best_epoch: int) -> bytes:
    """A PNG. median_mae: by axis, of always answering the median of the held-out images."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 3.8), dpi=130, facecolor="white", layout="constrained")
    left, right = figure.subplots(1, 2)
    epochs = [row["epoch"] for row in rows]
    left.plot(epochs, [row["train_loss"] for row in rows], color=PALE_INK, label="learnt, as changed by chance")
    left.plot(epochs, [row[BEST] for row in rows], color=COLOURS[0], label="held out")
    dress(left, "mean absolute error (units of the labels)", best_epoch)
    for number, (axis, alone) in enumerate(zip(AXES, median_mae, strict=True)):
        error = np.array([row[f"mae_{axis}"] for row in rows]) / alone
        right.plot(epochs, error, "-" if number < 3 else "--", color=COLOURS[number % 3], label=axis)
    right.set_ylim(bottom=0)
    dress(right, "held out: error, of the median's (1 − skill)", best_epoch)
    buffer = BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()


def dress(axes: "Axes", words: str, best_epoch: int) -> None:
    """What is drawn, and where the best epoch was."""
    axes.axvline(best_epoch, color=PALE_INK, linewidth=0.8, linestyle=":", label=f"kept: epoch {best_epoch}")
    axes.set_xlabel("epoch", color=INK)
    axes.set_ylabel(words, color=INK)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, fontsize=8)
