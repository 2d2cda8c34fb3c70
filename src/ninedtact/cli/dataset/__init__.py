"""ninedtact dataset: pairs of image and wrench from any source, for training."""

from typing import Annotated

import tyro

from ninedtact.cli.dataset.build import Build
from ninedtact.cli.dataset.check import Check
from ninedtact.cli.dataset.show import Show

Dataset = (
    Annotated[Build, tyro.conf.subcommand("build")]
    | Annotated[Check, tyro.conf.subcommand("check")]
    | Annotated[Show, tyro.conf.subcommand("show")]
)
"""Its subcommands."""
DESCRIPTION = "Data sets for training force: built from any source, checked, shown."
