"""ninedtact hardware guide: how to build the sensor, step by step, with images of its own parts."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from ninedtact.cli.hardware.described import Described
from ninedtact.cli.terminal import answer


@dataclass(frozen=True)
class Guide:
    """Write the fabrication guide of a design: a page in Markdown and an image of the parts after each step."""

    out: Path
    """Folder for fabrication.md and images/; other files there stay."""
    described: Annotated[Described, tyro.conf.arg(name="")] = Described()
    json: bool = False
    """Print the files as one JSON object."""

    def run(self) -> int:
        """Build, draw, write."""
        from tqdm import tqdm

        sensor = self.described.built()
        from ninedtact.hardware.guide.pages import write_guide

        progress = tqdm(write_guide(sensor, self.out), desc="drawing", unit="file", disable=None, leave=False)
        files = [str(path) for path in progress]
        return answer(self.json, {"files": files}, [f"{len(files)} files; read {files[-1]}"])
