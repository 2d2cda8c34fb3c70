"""ninedtact hardware export: one folder for the print shop, the laser cutter and the board house."""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from ninedtact.cli.hardware.described import Described
from ninedtact.cli.terminal import answer


@dataclass(frozen=True)
class Export:
    """Write STEP, STL, DXF, drawings, circuit board, bill of materials and images of one sensor into a folder."""

    out: Path
    """Folder to write, whole or not at all; one that this command wrote before is replaced."""
    described: Annotated[Described, tyro.conf.arg(name="")] = Described()
    json: bool = False
    """Print the manifest as one JSON object."""

    def run(self) -> int:
        """Build, write, and say what is there."""
        from tqdm import tqdm

        from ninedtact.hardware.export.folder import require_replaceable

        require_replaceable(self.out)
        sensor = self.described.built()
        began = time.monotonic()
        from ninedtact.hardware.export.parts_folder import export_parts

        with tqdm(desc="writing parts", unit="file", disable=None, leave=False) as progress:
            manifest = export_parts(sensor, self.out, lambda _: progress.update() and None)
        return answer(self.json, manifest, lines(self.out, manifest, time.monotonic() - began))


def warnings(manifest: dict[str, Any]) -> Iterator[str]:
    """Why parts of this folder should not be made as they are; none for a sound design."""
    if faults := manifest["led_board_faults"]:
        yield f"  DO NOT ORDER led_board/: it breaks {len(faults)} rules, the first {faults[0]}; its notes name them"
    for pair in manifest["interferences"]:
        what = f"{pair['first']} and {pair['second']} claim the same {pair['shared_mm3']:.2f} mm³"
        yield f"  DO NOT MAKE these parts as they are: {what}"


def lines(out: Path, manifest: dict[str, Any], seconds: float) -> Iterator[str]:
    """For a person."""
    yield f"{len(manifest['files'])} files of the {manifest['variant']} design in {out}, in {seconds:.0f} s"
    for folder, use in (
        ("printed", "STL and STEP for the print shop"),
        ("cut", "DXF for the laser cutter, mm, 1:1; README.txt tells each sheet's thickness"),
        ("led_board", "Gerbers, drill, placement for the board house; the notes tell how thick (0.80 mm as published)"),
        ("drawings", "dimensions, SVG and PDF"),
    ):
        yield f"  {folder + '/':12}{use}"
    yield from warnings(manifest)
    yield f"  open {out / 'bom.html'}; {out / 'check.txt'} tells what was checked"
