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
        from ninedtact.simulation.objects.catalogue import FAMILIES_BY_KIND, PRIMITIVES
        from ninedtact.simulation.objects.mesh_objects import MESH_FILE_SUFFIXES

        solids = {kind: dimensions for kind, (dimensions, _) in PRIMITIVES.items()}
        generated = {kind: list(families) for kind, families in FAMILIES_BY_KIND.items()}
        found = {"solids": solids, "generated": generated, "mesh_files": list(MESH_FILE_SUFFIXES)}
        return print_result(self.json, found, _format_object_list(solids, generated, MESH_FILE_SUFFIXES))


def _format_object_list(
    solids: dict[str, str], generated: dict[str, list[str]], endings: tuple[str, ...]
) -> Iterator[str]:
    """The list for a person."""
    yield "solids, dimensions in mm and degrees; those left out have a default:"
    yield from (f"  {kind}:{dimensions}" for kind, dimensions in solids.items())
    yield "generated, any number of each (gear_07; --seed for others):"
    yield from (f"  {kind:16}{', '.join(families)}" for kind, families in generated.items())
    yield f"mesh files ({', '.join(endings)}), with unit, side and size if need be: part.stl, part.stl@in@+x, part.stl@fit:16"
    yield "models of Thingi10K by number: thingi10k:32770"
