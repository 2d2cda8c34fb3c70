"""The model card of a force model as a Markdown page: what it is, how good it is, how it was trained, and its limits."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from ninedtact.force.onnx_model import ModelCard
from ninedtact.quantities import DISPLAY_FACTORS, WRENCH_AXES
from ninedtact_train.evaluation.evaluation import PUBLISHED_SCORES

VALIDATION = "validation"
"""Name of the table of the held-out pairs by which training chose the epoch."""
ROWS: dict[str, tuple[str | tuple[str, ...], str]] = {
    "skill": ("skill", "{:.3f}"),
    "skill, torques 35 mm below the skin": ("skill_35_mm_below", "{:.3f}"),
    "slope": ("slope", "{:.3f}"),
    "R²": ("r2", "{:.3f}"),
    "MAE, N and N·mm": ("mae", "{:.3f}"),
    "Std of \\|error\\|, N and N·mm": ("std", "{:.3f}"),
    "in 50 % interval": (("coverage", "50"), "{:.2f}"),
    "in 90 % interval": (("coverage", "90"), "{:.2f}"),
}
"""Label of each row, its key or path in a table of the card, and the format of its numbers."""
WITH_UNITS = ("mae", "std")
_VALIDATED_ON = """\
Validated on simulated sensors and families of objects that had no part in the training. Every sensor was calibrated from its own
board and ball images, and its force with five known loads of 100 to 500 g (`ninedtact adapt`). Skill is 1 − MAE / MAE of
always predicting the median."""
_SIMULATED_ONLY = """\
- **Not yet tested against a real force/torque sensor.** All pairs are simulated: rendered images and computed wrenches."""
_HELD_OUT_ONLY = """\
- **Evaluated on its held-out pairs alone**, by which the epoch was chosen. `ninedtact evaluate --data`
  evaluates it on other data."""
LIMITS = """\
{evaluated}
- The gel's stiffness is not visible in an image. The wrench is for a gel with a shear modulus of {modulus:.3f} MPa and is scaled to
  that of the sensor's own gel. Without a force calibration (`ninedtact adapt`) the design's modulus is assumed, and its
  relative error is that of the wrench.
- A twist about z of a round contact is not visible in an image. The stated error of T_z contains it, as that of every estimator.
- Wrenches beyond {low} … {high} N and N·m, and images unlike those of the training, carry a warning.
- Heights are computed with the sensor's calibration: a bad calibration gives bad forces."""


def format_model_card(card: ModelCard) -> str:
    """Return the model card as a Markdown page."""
    return "\n".join(_format_card(card)) + "\n"


def _format_card(card: ModelCard) -> Iterator[str]:
    training = card.training
    yield f"# Force model `{card.name}`"
    yield ""
    shown = card.input
    size = f"{shown.cols} × {shown.rows} grid points at a pitch of {shown.mm_per_px:g} mm"
    yield f"Network `{card.network}` on {size}: {shown.channels}."
    yield f"Wrench of the object on the skin, N and N·m about {list(card.about_mm)} mm. Licence {card.licence}."
    if set(card.evaluation) - {VALIDATION}:
        yield from ("", _VALIDATED_ON)
    yield from (line for name, table in _evaluations_to_show(card) for line in format_evaluation_section(name, table))
    yield from ("", "## Training", "")
    yield (
        f"{training.pairs} pairs for training and {training.validation_pairs} for choosing the epoch ({training.best_epoch} of "
        f"{training.epochs}), {training.sensors} sensors, {training.objects} objects, seed {training.settings.get('seed')}, "
        f"{training.seconds / 60:.0f} minutes of training. "
        + ", ".join(f"{package} {version}" for package, version in training.versions.items())
        + "."
    )
    yield from ("", "## Limits", "", format_model_limits(card))


def _evaluations_to_show(card: ModelCard) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield name and table of each evaluation; the training's own table only where there is no independent one."""
    others = {name: table for name, table in card.evaluation.items() if name != VALIDATION}
    yield from (others or card.evaluation).items()


def format_evaluation_section(name: str, table: Mapping[str, Any]) -> Iterator[str]:
    """Yield the lines of the section on one evaluation, with the published network's skill on its own sensor for comparison."""
    yield from ("", f"## {name[:1].upper()}{name[1:]}: {table.get('pairs', '?')} pairs", "")
    yield from (f"| | {' | '.join(WRENCH_AXES)} |", "|---|" + "---|" * len(WRENCH_AXES))
    for words, (place, written) in ROWS.items():
        if (six := _six_numbers_at(table, place)) is not None:
            yield _markdown_row(words, six * (DISPLAY_FACTORS if place in WITH_UNITS else 1), written)
        if place == "skill_35_mm_below" and six is not None:
            yield _markdown_row("published network, its own sensor", np.array(PUBLISHED_SCORES.skill), "{:.3f}")
    yield from (line for line in format_light_contact_errors(table))


def format_light_contact_errors(table: Mapping[str, Any]) -> Iterator[str]:
    """Yield lines with the errors of light contacts and of pairs without contact."""
    for name, part in table.get("by_load", {}).items():
        if name.startswith("below"):
            yield from ("", f"F_z {name}: MAE {part['mae'][2]:.3f} N ({part['pairs']} pairs).")
    for words, key in (("", "no_contact"), (", the network without contact detection", "no_contact_without_detection")):
        if (nothing := table.get(key)) is not None:
            yield (
                f"No contact ({nothing['pairs']} pairs){words}: |F| {nothing['mean_force_n']:.3f} N on average, "
                f"{nothing['largest_force_n']:.3f} N at most."
            )


def _six_numbers_at(table: Mapping[str, Any], place: str | tuple[str, ...]) -> Any:
    value: Any = table
    for key in (place,) if isinstance(place, str) else place:
        value = value.get(key) if isinstance(value, Mapping) else None
    return None if value is None else np.array(value, float)


def _markdown_row(words: str, six: Any, written: str) -> str:
    """Return one row of a Markdown table; a dash stands for NaN."""
    cells = ("–" if np.isnan(value) else written.format(value) for value in six)
    return f"| {words} | {' | '.join(cells)} |"


def format_model_limits(card: ModelCard) -> str:
    """Return the section on the model's limits."""
    low, high = (", ".join(f"{value:.3g}" for value in six) for six in (card.wrench_min, card.wrench_max))
    evaluated = _SIMULATED_ONLY if set(card.evaluation) - {VALIDATION} else _HELD_OUT_ONLY
    return LIMITS.format(evaluated=evaluated, modulus=card.modulus_mpa, low=f"({low})", high=f"({high})")
