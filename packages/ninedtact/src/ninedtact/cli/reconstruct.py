"""ninedtact reconstruct: images of a calibrated sensor → heights in millimetres, as files and figures."""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import tyro

from ninedtact.cli.result_and_interrupt import count_images, load_sensor_with_notices, print_notice, print_result
from ninedtact.cli.shared_options import ReferenceOption, SensorOption
from ninedtact.errors import InputError

if TYPE_CHECKING:
    from ninedtact.quantities import HeightMap
    from ninedtact.reading import Reading
    from ninedtact.shape.calibrated_shape import DepthReader

_HeightFormat = Literal["npy", "png", "ply", "stl", "obj"]


@dataclass(frozen=True)
class ReconstructCommand:
    """Reconstruct the shape of what touches the gel, from images."""

    sensor: SensorOption
    reference: ReferenceOption
    images: tyro.conf.Positional[tuple[Path, ...]]
    """Images of the pressed gel, one or more."""
    out: Path
    """Folder for the results."""
    formats: tuple[_HeightFormat, ...] = ("npy", "png", "ply", "stl")
    """npy: heights in mm; png: 16 bits, 1 level = 1 µm; ply: points with normals and triangles; stl, obj: triangles."""
    drawings: bool = True
    """Also draw a colour image and a shaded one."""
    json: bool = False
    """Print the result as one JSON object; it has the figures of every image."""

    def run(self) -> int:
        """Reconstruct every image and write its files; the first bad image ends the command, with 1 after the images before it."""
        from ninedtact.calibration.drift.reference_check import load_reference_image_checker
        from ninedtact.capture.strict_image_reading import read_image
        from ninedtact.errors import FileFormatError
        from ninedtact.quantities import Frame
        from ninedtact.reading import read_frame
        from ninedtact.shape.image_plausibility import ImageImplausible

        if not self.images:
            raise InputError(
                expected="at least one image of the pressed skin", got="none", remedy="name it after the options"
            )
        folder = load_sensor_with_notices(self.sensor)
        shape = folder.shape
        check = load_reference_image_checker(folder)
        references = check.read_images(self.reference)
        depth = shape.depth_reader(*references)
        results: list[dict[str, Any]] = []
        damage: FileFormatError | ImageImplausible | None = None
        try:
            for path, name in zip(self.images, _output_names(self.images), strict=True):
                reading = read_frame(Frame(read_image(path)), shape, depth)
                check.require_press(str(path), reading, references)
                results.append(self.result(path, name, reading, depth))
        except (FileFormatError, ImageImplausible) as error:
            if not results:
                raise
            damage = error
        found: dict[str, Any] = {"sensor": str(self.sensor), "images": results}
        print_result(self.json, found, _format_results(results))
        if damage is not None:
            after = count_images(len(self.images) - len(results) - 1)
            print_notice(f"{damage} ({count_images(len(results))} reconstructed before, {after} not read)")
        return 0 if damage is None else 1

    def result(self, path: Path, name: str, reading: "Reading", depth: "DepthReader") -> dict[str, Any]:
        """Write one image's files and return its figures."""
        from ninedtact.shape.surface import summarise_shape

        measured = summarise_shape(reading.height)
        return {
            "image": str(path),
            **asdict(measured),
            "max_indentation_error_mm": inf
            if measured.is_deepest_clipped
            else depth.max_indentation_error_mm(reading.height),
            "warnings": (*measured.warnings, *reading.light_sentences),
            "files": {kind: str(file) for kind, file in self._write_files(name, reading.height)},
        }

    def _write_files(self, name: str, height: "HeightMap") -> Iterator[tuple[str, Path]]:
        """Write the files of one height map; kind and path of each."""
        from ninedtact.atomic_write import write_file_atomically
        from ninedtact.shape.coloured_height_map import draw_height_map_figure, render_relief
        from ninedtact.shape.export import export_shape

        with _folder_for_files(self.out):
            for ending in self.formats:
                path = self.out / f"{name}_height.{ending}"
                export_shape(height, path)
                yield ending, path
            if self.drawings:
                for kind, draw in (("colour", draw_height_map_figure), ("shaded", render_relief)):
                    path = self.out / f"{name}_{kind}.png"
                    write_file_atomically(path, draw(height))
                    yield f"{kind}_image", path


@contextmanager
def _folder_for_files(folder: Path) -> Iterator[None]:
    """Create a folder and its parents; where the block fails, those of them that are still empty are removed."""
    missing = [each for each in (folder, *folder.parents) if not each.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    try:
        yield
    except BaseException:
        with suppress(OSError):
            for each in missing:
                each.rmdir()
        raise


def _output_names(images: tuple[Path, ...]) -> list[str]:
    """Return a name of its own for every image's files: that of the image, with its number where two have the same."""
    stems = [path.stem for path in images]
    taken = {stem for stem in stems if stems.count(stem) == 1}
    names = []
    for number, stem in enumerate(stems, start=1):
        name = stem
        if stems.count(stem) > 1:
            name = f"{stem}_{number}"
            while name in taken:  # another image is called so
                name += f"_{number}"
            taken.add(name)
        names.append(name)
    return names


def _format_results(results: list[dict[str, Any]]) -> Iterator[str]:
    for result in results:
        indentation = _format_max_indentation(result)
        yield f"{result['image']}: maximum indentation {indentation}, contact {result['contact_area_mm2']:.1f} mm²"
        yield from (f"  {warning}" for warning in result["warnings"])
        yield from (f"  {kind}: {path}" for kind, path in result["files"].items())


def _format_max_indentation(result: dict[str, Any]) -> str:
    """The maximum indentation with its error, or as the lower limit that it is."""
    depth, error = f"{result['max_indentation_mm']:.3f}", f"{result['max_indentation_error_mm']:.3f}"
    return f"at least {depth} mm" if result["is_deepest_clipped"] else f"{depth} ± {error} mm"
