"""Scores of the published network on its own sensor, for comparison (docs/references.md)."""

from dataclasses import dataclass, replace

_SixNumbers = tuple[float, float, float, float, float, float]


@dataclass(frozen=True)
class PublishedScores:
    """Scores of one network, N and N·m, named as in `AxisScores`, and what they are of."""

    what: str
    mae: _SixNumbers
    std: _SixNumbers
    rmse: _SixNumbers
    r2: _SixNumbers
    slope: _SixNumbers
    skill: _SixNumbers


PUBLISHED_SCORES = PublishedScores(
    "published: DenseNet-169, 10,000 pairs of its own sensor, standard split; torques about 35 mm below the skin",
    mae=(0.2956, 0.3483, 0.2778, 0.00899, 0.00784, 0.00123),
    std=(0.2570, 0.3028, 0.3310, 0.00923, 0.00813, 0.00160),
    rmse=(0.3917, 0.4615, 0.4321, 0.01289, 0.01129, 0.00202),
    r2=(0.722, 0.717, 0.971, 0.884, 0.903, 0.815),
    slope=(0.758, 0.774, 1.003, 0.900, 0.917, 0.872),
    skill=(0.475, 0.484, 0.862, 0.691, 0.718, 0.636),
)
"""Computed by this program from the published predictions; torques about the paper's point."""
PUBLISHED_SCORES_AT_SKIN = replace(
    PUBLISHED_SCORES,
    what="published: DenseNet-169, 10,000 pairs of its own sensor, standard split; torques moved up by 35 mm to the skin",
    mae=(*PUBLISHED_SCORES.mae[:3], 0.00502, 0.00424, 0.00123),
    std=(*PUBLISHED_SCORES.std[:3], 0.00906, 0.00501, 0.00160),
    rmse=(*PUBLISHED_SCORES.rmse[:3], 0.01036, 0.00657, 0.00202),
    r2=(*PUBLISHED_SCORES.r2[:3], 0.732, 0.940, 0.815),
    slope=(*PUBLISHED_SCORES.slope[:3], 0.925, 0.965, 0.872),
    skill=(*PUBLISHED_SCORES.skill[:3], 0.677, 0.797, 0.636),
)
"""The same predictions with their torques about the skin's centre, the force/torque sensor taken to be 35 mm below it."""
PAPER_OBJECT_SPLIT_MAE = ("0.35", "0.40", "0.41", "11", "10", "2")
PAPER_OBJECT_SPLIT_STD = ("0.31", "0.36", "0.44", "15", "14", "3")
"""N and N·mm as the paper prints them for held-out objects; its single predictions of those were not published."""


def published_scores_about(point_mm: tuple[float, float, float] | None) -> PublishedScores:
    """Return the published scores with torques about the skin's centre for (0, 0, 0), else about the paper's point."""
    return PUBLISHED_SCORES_AT_SKIN if point_mm == (0.0, 0.0, 0.0) else PUBLISHED_SCORES
