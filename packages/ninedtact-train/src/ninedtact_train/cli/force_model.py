"""ninedtact model card | make: print the model card of a force model, or make a force model from simulation alone."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from ninedtact.cli.result_and_interrupt import print_notice, print_result
from ninedtact.cli.shared_options import DesignFileOption, JsonOption, read_design_or_default
from ninedtact_train.cli.train import require_training_packages

if TYPE_CHECKING:
    from ninedtact_train.workflows.force_model_from_simulation import ForceModelResult

DESCRIPTION = "Force models: print a model card, or make a model from simulation alone."


@dataclass(frozen=True)
class _ShowModelCard:
    """Print the card of a force model: its training, its scores and its limits."""

    model: Path
    """A force model (.onnx)."""
    json: JsonOption = False

    def run(self) -> int:
        """Read and print the card; raises `ModelUnusable`."""
        import msgspec

        from ninedtact.force.onnx_model import read_force_model
        from ninedtact_train.evaluation.model_card_markdown import format_model_card

        card = read_force_model(self.model).card
        return print_result(self.json, msgspec.to_builtins(card), [format_model_card(card)])


@dataclass(frozen=True)
class _MakeForceModel:
    """Make a force model from simulation alone: simulate sensors and contacts, train, and validate on other sensors and objects.

    Run again after a stop, it continues where it was.
    """

    out: Path
    """Folder for the model, its card, the data sets and the training: new, or begun with the same recipe."""
    recipe: Literal["small", "large"] = "small"
    """small: a few minutes, to see that it works. large: forty thousand pairs, hours."""
    name: str = "moments"
    """Name of the model."""
    design_file: DesignFileOption = None
    """Design file (TOML) with what differs from the published sensor. The model is for such sensors."""
    workers: int = 2
    """Number of processes; they simulate and calibrate."""
    json: JsonOption = False

    def run(self) -> int:
        """Do all steps that are not done yet; raises `DatasetError`."""
        require_training_packages()
        from ninedtact_train.dataset.folder import interrupt_as_stopped
        from ninedtact_train.workflows.force_model_from_simulation import RECIPES, make_force_model

        recipe = replace(RECIPES[self.recipe], design=read_design_or_default(self.design_file))
        with interrupt_as_stopped(self.out):
            made = make_force_model(
                *(self.out, recipe),
                name=self.name,
                workers=self.workers,
                progress=not self.json,
                notify=print_notice,
            )
        figures = {"model": str(made.model), "card": str(made.card_file), "evaluation": made.card.evaluation}
        return print_result(self.json, figures, _format_made_model(made))


ModelCommand = (
    Annotated[_ShowModelCard, tyro.conf.subcommand("card")] | Annotated[_MakeForceModel, tyro.conf.subcommand("make")]
)


def _format_made_model(made: "ForceModelResult") -> Iterator[str]:
    from ninedtact_train.evaluation.model_card_markdown import format_model_card

    yield format_model_card(made.card)
    yield f"model: {made.model}; card: {made.card_file}"
    yield f"try it: ninedtact live --source sim --sensor {made.sensor} --force {made.model}"
