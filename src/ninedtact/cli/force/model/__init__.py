"""ninedtact model: the force model that ships: its card, and how to make it."""

from typing import Annotated

import tyro

from ninedtact.cli.force.model.make import Make
from ninedtact.cli.force.model.show import Show

Model = Annotated[Show, tyro.conf.subcommand("card")] | Annotated[Make, tyro.conf.subcommand("make")]
"""Its subcommands."""
DESCRIPTION = "A force model: what its card says, and how one is made from nothing."
