"""ninedtact simulate objects: what can be pressed."""

from collections.abc import Iterator
from dataclasses import dataclass

from ninedtact.cli.terminal import print_result


@dataclass(frozen=True)
class Objects:
    """List what can press a twin: solids with their dimensions, families of generated objects, mesh files."""

    json: bool = False
    """Print the list as one JSON object."""

    def run(self) -> int:
        """Say it."""
        from ninedtact.simulation.objects.families import KINDS
        from ninedtact.simulation.objects.mesh_file import ENDINGS
        from ninedtact.simulation.objects.named import SIMPLE

        solids = {kind: dimensions for kind, (dimensions, _) in SIMPLE.items()}
        generated = {kind: [family.__name__ for family in families] for kind, families in KINDS.items()}
        found = {"solids": solids, "generated": generated, "mesh_files": list(ENDINGS)}
        return print_result(self.json, found, lines(solids, generated, ENDINGS))


def lines(solids: dict[str, str], generated: dict[str, list[str]], endings: tuple[str, ...]) -> Iterator[str]:
    """The list for a person."""
    yield "solids, dimensions in mm and degrees; those left out have a default:"
    yield from (f"  {kind}:{dimensions}" for kind, dimensions in solids.items())
    yield "generated, any number of each (gear_07; --seed for others):"
    yield from (f"  {kind:16}{', '.join(families)}" for kind, families in generated.items())
    yield f"mesh files ({', '.join(endings)}), with unit, side and size if need be: part.stl, part.stl@in@+x, part.stl@fit:16"
    yield "models of Thingi10K by number: thingi10k:32770"
