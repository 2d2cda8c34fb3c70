"""ninedtact hardware: the parts of a sensor, one subcommand per journey."""

from typing import Annotated

import tyro

from ninedtact.cli.hardware.bom import Bom
from ninedtact.cli.hardware.check import Check
from ninedtact.cli.hardware.explore import Explore
from ninedtact.cli.hardware.export import Export
from ninedtact.cli.hardware.guide import Guide

Hardware = (
    Annotated[Export, tyro.conf.subcommand("export")]
    | Annotated[Bom, tyro.conf.subcommand("bom")]
    | Annotated[Check, tyro.conf.subcommand("check")]
    | Annotated[Explore, tyro.conf.subcommand("explore")]
    | Annotated[Guide, tyro.conf.subcommand("guide")]
)
"""Its subcommands."""
DESCRIPTION = "The parts of a sensor: files to make them, bill of materials, checks, designs compared, how to build it."
