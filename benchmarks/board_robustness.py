"""Whether the board is found with the defaults in altered real images, and refused where there is none.

Every sensor's real pair is altered in some forty ways (`trials.py`); a summary line says, per kind, in how many pairs
the board was found, in how many of them with every pin that is there, the worst left-out error, and how many pins were
claimed that had been taken away. With `--every` each pair has its own line. Images without a board, and boards with too
much missing, must all be refused.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import tyro
from figures import Figure, answer, holds
from tqdm import tqdm
from trials import BOARD, Trial, all_trials

from ninedtact.calibration.board.board_fit import fit_board
from ninedtact.calibration.board.detection import BoardNotFound


@dataclass(frozen=True)
class Outcome:
    """One pair and what came of it."""

    trial: Trial
    found: int = 0
    """Pins; 0 when refused."""
    left_out_mm: float = np.nan
    refusal: str = ""

    @property
    def in_words(self) -> str:
        return f"refused: {self.refusal}" if self.refusal else f"{self.found} pins, {self.left_out_mm:.4f} mm"


def board_robustness(every: bool = False, json: bool = False) -> None:
    """Try all, and print how many were found."""
    cv2.setNumThreads(1)
    outcomes = [outcome(trial) for trial in tqdm(list(all_trials()), unit=" pairs", disable=None)]
    figures = [Figure(f"{one.trial.kind}: {one.trial.name}", one.in_words) for one in outcomes] if every else []
    for kind in dict.fromkeys(one.trial.kind for one in outcomes):
        figures.append(summary(kind, [one for one in outcomes if one.trial.kind == kind]))
    answer("Finding the board in altered real images", figures, json)


def outcome(trial: Trial) -> Outcome:
    """Look for the board with the defaults."""
    try:
        fit = fit_board(*trial.pair, BOARD)
    except BoardNotFound as refusal:
        return Outcome(trial, refusal=str(refusal))
    return Outcome(trial, int(fit.found.sum()), fit.lens_fit.left_out_rms_mm)


def summary(kind: str, outcomes: Sequence[Outcome]) -> Figure:
    """All pairs of a kind in one line."""
    found = [one for one in outcomes if not one.refusal]
    if not outcomes[0].trial.to_be_found:
        refused = len(outcomes) - len(found)
        return holds(kind, f"{refused} of {len(outcomes)} refused", "all refused", not found)
    words = f"{len(found)} of {len(outcomes)} found, {in_detail(found)}"
    return holds(kind, words, "all found", len(found) == len(outcomes))


def in_detail(found: Sequence[Outcome]) -> str:
    """How well they were found."""
    whole = sum(one.found >= one.trial.pins_there for one in found)
    claimed = sum(max(one.found - one.trial.pins_there, 0) for one in found)
    worst = max((one.left_out_mm for one in found), default=np.nan)
    too_many = f", {claimed} claimed that is not there" if claimed else ""
    return f"{whole} with every pin, error at most {worst:.3f} mm{too_many}"


if __name__ == "__main__":
    tyro.cli(board_robustness)
