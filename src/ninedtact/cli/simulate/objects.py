"""ninedtact simulate objects: list the objects that can press a twin."""

from collections.abc import Iterator
from dataclasses import dataclass

from ninedtact.cli.result_and_interrupt import print_result


@dataclass(frozen=True)
class Objects:
    """List the objects that can press a twin: primitives, families of generated objects, mesh files."""

    json: bool = False
    """Print the list as one JSON object."""

    def run(self) -> int:
        """Print the list."""
        from ninedtact.simulation.objects.catalogue import FAMILIES_BY_KIND, PRIMITIVES
        from ninedtact.simulation.objects.mesh_objects import MESH_FILE_SUFFIXES

        solids = {kind: dimensions for kind, (dimensions, _) in PRIMITIVES.items()}
        generated = {kind: list(families) for kind, families in FAMILIES_BY_KIND.items()}
        found = {"solids": solids, "generated": generated, "mesh_files": list(MESH_FILE_SUFFIXES)}
        return print_result(self.json, found, _format_object_list(solids, generated, MESH_FILE_SUFFIXES))


def _format_object_list(
    solids: dict[str, str], generated: dict[str, list[str]], endings: tuple[str, ...]
) -> Iterator[str]:
    """Yield the lines of the list."""
    yield "primitives, with dimensions in mm and degrees; dimensions that are left out have defaults:"
    yield from (f"  {kind}:{dimensions}" for kind, dimensions in solids.items())
    yield "generated objects, any number of each family (gear_07; --seed for others):"
    yield from (f"  {kind:18}{', '.join(families)}" for kind, families in generated.items())
    yield f"mesh files ({', '.join(endings)}), with unit, side and size if need be: part.stl, part.stl@in@+x, part.stl@fit:16"
    yield "models of Thingi10K by number: thingi10k:32770"
