"""ninedtact simulate: the twin, one subcommand per journey."""

from typing import Annotated

import tyro

from ninedtact.cli.simulate.dataset import SimulateDatasetCommand
from ninedtact.cli.simulate.fit_and_objects import Fit, Objects
from ninedtact.cli.simulate.press import Press

Simulate = (
    Annotated[Fit, tyro.conf.subcommand("fit")]
    | Annotated[Press, tyro.conf.subcommand("press")]
    | Annotated[SimulateDatasetCommand, tyro.conf.subcommand("dataset")]
    | Annotated[Objects, tyro.conf.subcommand("objects")]
)
"""Its subcommands."""
DESCRIPTION = "The twin of a sensor: make it, press it, list what can be pressed."
