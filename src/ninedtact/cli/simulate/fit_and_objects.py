"""ninedtact simulate fit | objects: fit the twin of a sensor to its calibration images; list the objects that can press a twin."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from ninedtact.cli.result_and_interrupt import load_sensor_with_notices, print_result

if TYPE_CHECKING:
    from ninedtact.calibration.sensor_toml_schema import TwinFitQuality, TwinTable


@dataclass(frozen=True)
class Fit:
    """Fit the twin of a calibrated sensor to its four calibration images, and write it into the sensor folder.

    The lens is fitted to the board, mechanics and brightness to the ball. Depth is then read by the physics method.
    """

    sensor: Path
    """Sensor folder that `ninedtact calibrate` wrote; its record and its certificate are updated."""
    json: bool = False
    """Print the twin as one JSON object."""

    def run(self) -> int:
        """Fit and save the twin, and print the quality of the fit."""
        from ninedtact.calibration.procedure import repeat_calibration
        from ninedtact.calibration.save import save_sensor

        folder = save_sensor(self.sensor, repeat_calibration(load_sensor_with_notices(self.sensor), "physics"))
        twin = folder.record.twin
        assert twin is not None, "the physics method makes a twin"
        found = {"sensor": str(self.sensor), **msgspec.to_builtins(twin)}
        return print_result(self.json, found, self._format_fit(twin))

    def _format_fit(self, twin: "TwinTable") -> Iterator[str]:
        """Yield the lines that describe the fit."""
        fit = twin.fit
        yield f"twin of {self.sensor} fitted in {fit.duration_s:.1f} s"
        yield (
            f"  residual     {fit.image_rmse_grey_levels:.2f} grey levels over the image, {fit.radial_rmse_grey_levels:.2f} of the "
            "radial profile"
        )
        yield f"  press        {fit.depth_mm:.2f} mm deep, dragged by ({fit.drag_mm[0]:+.2f}, {fit.drag_mm[1]:+.2f}) mm"
        yield "  parameters, ± one standard deviation:"
        yield from _format_parameters(fit)
        yield f"  written to {self.sensor}; open {self.sensor / 'certificate.html'} in a browser"


def _format_parameters(fit: "TwinFitQuality") -> Iterator[str]:
    """Yield each parameter with its standard deviation and the parameter with which it correlates most."""
    for name, found in fit.parameters.items():
        other = found.most_correlated_with
        sure = "" if found.std is None else f" ± {found.std:.3f}"
        beside = "" if other is None else f"  (correlation with {other} {found.correlation:+.2f})"
        yield f"  {name:16s} {found.value:8.3f}{sure}{beside}"


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
