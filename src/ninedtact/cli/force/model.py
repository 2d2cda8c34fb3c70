"""ninedtact model card | make: print the model card of a force model, or make a force model from simulation alone."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from ninedtact.cli.force.train import require_training_packages
from ninedtact.cli.option_parser import DesignFileOption, read_design_or_default
from ninedtact.cli.result_and_interrupt import print_notice, print_result
from ninedtact.errors import ForceError

if TYPE_CHECKING:
    from ninedtact.workflows.force_model_from_simulation import ForceModelResult

DESCRIPTION = "Force models: print a model card, or make a model from simulation alone."


class ModelMakingStopped(ForceError):
    """Ctrl-C ended the command before there was a model."""


@dataclass(frozen=True)
class _ShowModelCard:
    """Print the card of a force model: its training, its scores and its limits."""

    model: Path | None = None
    """A force model (.onnx). By default the shipped one."""
    json: bool = False
    """Print the card as one JSON object."""

    def run(self) -> int:
        """Read and print the card; raises `ModelUnusable`."""
        import msgspec

        from ninedtact.force.model_card_page import format_model_card
        from ninedtact.force.onnx_model import SHIPPED_MODEL, read_force_model

        card = read_force_model(self.model or SHIPPED_MODEL).card
        return print_result(self.json, msgspec.to_builtins(card), [format_model_card(card)])


@dataclass(frozen=True)
class _MakeForceModel:
    """Make a force model from simulation alone: simulate sensors and contacts, train, validate on other sensors and objects, and
    estimate live on one more simulated sensor.

    Run again after a stop, it continues where it was.
    """

    out: Path
    """Folder for the model, its card, the data sets and the training: new, or begun with the same recipe."""
    recipe: Literal["small", "large"] = "small"
    """small: a few minutes, to see that it works. large: forty thousand pairs, hours."""
    name: str = "moments"
    """Name of the model."""
    design_file: DesignFileOption = None
    """Design file (TOML) of the sensors that the model is for. By default the published sensor."""
    workers: int = 2
    """Processes that simulate and calibrate."""
    json: bool = False
    """Print the result as one JSON object."""

    def run(self) -> int:
        """Do all steps that are not done yet; raises `ModelMakingStopped`."""
        require_training_packages()
        from ninedtact.workflows.force_model_from_simulation import RECIPES, make_force_model

        recipe = replace(RECIPES[self.recipe], design=read_design_or_default(self.design_file))
        try:
            made = make_force_model(
                self.out,
                recipe,
                name=self.name,
                workers=self.workers,
                progress=not self.json,
                notify=print_notice,
            )
        except KeyboardInterrupt:
            raise ModelMakingStopped(
                f"stopped by Ctrl-C; no file in {self.out} is incomplete; run the command again to continue"
            ) from None
        figures = {"model": str(made.model), "card": str(made.card_file), "evaluation": made.card.evaluation}
        return print_result(self.json, figures, _format_result(made))


Model = (
    Annotated[_ShowModelCard, tyro.conf.subcommand("card")] | Annotated[_MakeForceModel, tyro.conf.subcommand("make")]
)


def _format_result(made: "ForceModelResult") -> Iterator[str]:
    """Yield the card and the demonstration for a terminal."""
    from ninedtact.force.evaluation.predictions import AXES
    from ninedtact.force.model_card_page import format_model_card

    yield format_model_card(made.card)
    yield "Live on a simulated sensor, N and N·mm, true and estimated:"
    yield "        " + "".join(f"  {axis:>7} {'est.':>7}" for axis in AXES)
    for sample in made.demonstration:
        scale = (1, 1, 1, 1e3, 1e3, 1e3)
        pairs = zip(sample.true, sample.estimated, scale, strict=True)
        cells = (f"  {true * factor:+7.2f} {estimated * factor:+7.2f}" for true, estimated, factor in pairs)
        yield f"{sample.seconds:5.1f} s " + "".join(cells)
    yield f"model: {made.model}; card: {made.card_file}"
    yield f"try it: ninedtact live --source sim --sensor {made.sensor} --force {made.model}"
