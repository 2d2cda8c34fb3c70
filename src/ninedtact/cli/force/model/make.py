"""ninedtact model make: from nothing to a force model with its card, and a look at it at work."""

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from ninedtact.cli.force.model.recipe import RECIPES, Recipe
from ninedtact.cli.options import DesignFileOption, read_design_or_default
from ninedtact.cli.terminal import print_result
from ninedtact.errors import NinedtactError

if TYPE_CHECKING:
    from ninedtact.cli.force.model.live_proof import Shown
    from ninedtact.dataset.generation.settings import GenerationSettings
    from ninedtact.force.model_file import ModelCard

LEARN, JUDGE, TRAINING, SENSOR = "learn", "judge", "training", "sensor"
"""Folders."""
MODEL, PAGE = "model.onnx", "model_card.md"


class MakingStopped(NinedtactError):
    """Ctrl-C ended the command before there was a model."""


@dataclass(frozen=True)
class Make:
    """Make a force model from nothing: simulate twins, train, judge on other twins and objects, and estimate live on a twin.

    Run again after a stop, it goes on where it was.
    """

    out: Path
    """Folder for the model, its card, the data sets and the training: new, or begun with the same recipe."""
    recipe: Literal["small", "shipped"] = "small"
    """small: a few minutes, to see that it works; shipped: the model of the package."""
    name: str = "moments"
    """What the model is called."""
    design_file: DesignFileOption = None
    """Design file (TOML) of the sensors that the model is for; the published sensor if not given."""
    workers: int = 2
    """Processes that simulate and calibrate."""
    json: bool = False
    """Print the figures as one JSON object."""

    def run(self) -> int:
        """All steps, those that are done already apart; raises `MakingStopped`."""
        from ninedtact.cli.force.train import require_libraries

        require_libraries()
        try:
            recipe = replace(RECIPES[self.recipe], design=read_design_or_default(self.design_file))
            self.out.mkdir(parents=True, exist_ok=True)
            return self.made(recipe)
        except KeyboardInterrupt:
            raise MakingStopped(
                f"stopped by Ctrl-C; nothing in {self.out} was written half; run the command again to go on where it stopped"
            ) from None

    def made(self, recipe: Recipe) -> int:
        """The steps."""
        from ninedtact.cli.force.model.live_proof import live

        self.say(f"1 of 4: {recipe.pairs} pairs to learn from, {recipe.judged_pairs} to judge on")
        self.simulated(LEARN, recipe.to_learn)
        self.simulated(JUDGE, recipe.to_judge)
        self.say("2 of 4: every twin calibrates itself; a network learns")
        self.trained(recipe)
        self.say("3 of 4: judged on sensors and objects that it never saw")
        card = self.carded()
        self.say("4 of 4: live on one more twin")
        shown = list(live(self.model, self.out / SENSOR, recipe.design))
        figures = {"model": str(self.model), "card": str(self.out / PAGE), "evaluation": card.evaluation}
        return print_result(self.json, figures, self.lines(card, shown))

    def simulated(self, name: str, settings: "GenerationSettings") -> None:
        """One data set, whole."""
        from ninedtact.dataset.generation.generate import generate_dataset

        generate_dataset(self.out / name, settings, self.workers, progress=not self.json, device="auto")

    def trained(self, recipe: Recipe) -> None:
        """A model that knows how good it is on what it was checked with."""
        from ninedtact.cli.force.train import Hardware, Train

        Train(
            self.out / LEARN,
            self.out / TRAINING,
            epochs=recipe.epochs,
            held_out=recipe.held_out,
            hardware=Hardware(precision=recipe.precision),
            name=self.name,
            reading_workers=self.workers,
            json=self.json,
        ).trained()

    def carded(self) -> "ModelCard":
        """The model with what it was judged to be, and its card to read."""
        from ninedtact.atomic_write import write_file_atomically
        from ninedtact.cli.force.model.judgement import judged
        from ninedtact.force.model_card_page import format_model_card
        from ninedtact.force.model_file import read_force_model
        from ninedtact.force.training.onnx_export import rewrite_card
        from ninedtact.force.training.train import MODEL_FILE as LEARNT

        learnt = self.out / TRAINING / LEARNT
        card = read_force_model(learnt).card
        tables = judged(learnt, self.out / JUDGE, self.workers, not self.json).tables()
        card = replace_evaluation(card, tables)
        rewrite_card(learnt, card, self.model)
        write_file_atomically(self.out / PAGE, format_model_card(card).encode())
        return card

    @property
    def model(self) -> Path:
        """Where it is left."""
        return self.out / MODEL

    def say(self, sentence: str) -> None:
        """What is under way."""
        print(f"ninedtact: {sentence}", file=sys.stderr, flush=True)

    def lines(self, card: "ModelCard", shown: "list[Shown]") -> Iterator[str]:
        """For a person."""
        from ninedtact.cli.force.model.live_proof import HEADINGS
        from ninedtact.force.model_card_page import format_model_card

        yield format_model_card(card)
        yield "Live on a twin, N and mN·m, true and estimated:"
        yield "        " + "".join(f"  {heading:>7} {'found':>7}" for heading in HEADINGS)
        yield from (one.line() for one in shown)
        yield f"model: {self.model}; card: {self.out / PAGE}"
        yield f"at work: ninedtact live --source sim --sensor {self.out / SENSOR} --force {self.model}"


def replace_evaluation(card: "ModelCard", tables: dict[str, dict[str, object]]) -> "ModelCard":
    """The card with these tables beside the one of its training."""
    from msgspec.structs import replace as replaced

    return replaced(card, evaluation={**card.evaluation, **tables})
