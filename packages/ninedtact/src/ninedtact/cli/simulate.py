"""ninedtact simulate fit | press | dataset | objects: the twin of a sensor, one subcommand per journey: fit it to the sensor's
calibration images; press an object on it, and write image, heights, tractions and wrench; make pairs of image and wrench from
many simulated sensors, as a folder that Hugging Face opens; list the objects that can press it.
"""

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import cached_property
from io import BytesIO
from math import hypot, radians
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import msgspec
import tyro
from msgspec import Meta

from ninedtact.cli.result_and_interrupt import load_sensor_with_notices, print_notices, print_result, sensor_replacement
from ninedtact.cli.shared_options import (
    AboveZero,
    DesignFileOption,
    JsonOption,
    read_design_or_default,
    refuse_design_beside_sensor,
)

if TYPE_CHECKING:
    import numpy as np

    from ninedtact.calibration.sensor_folder import SensorFolder
    from ninedtact.calibration.sensor_toml_schema import TwinFitQuality, TwinTable
    from ninedtact.mechanics.contact_result import Contact
    from ninedtact.mechanics.indenter import Indenter
    from ninedtact.simulation.trajectory import ScriptedPress
    from ninedtact.simulation.twin import Twin

Pair = tuple[float, float]


@dataclass(frozen=True)
class _Fit:
    """Fit the twin of a calibrated sensor to its four calibration images, and write it into the sensor folder.

    The lens is fitted to the board, mechanics and brightness to the ball. Depth is then read by the physics method.
    """

    sensor: Path
    """Sensor folder that `ninedtact calibrate` wrote; it is replaced by the new calibration, as by `calibrate`."""
    json: JsonOption = False

    def run(self) -> int:
        """Fit and save the twin, and print the quality of the fit; return 1 where its calibration failed its checks."""
        from ninedtact.calibration.certificate.checks import has_failed_checks
        from ninedtact.calibration.procedure import repeat_calibration
        from ninedtact.calibration.save import failed_calibration_notices, save_sensor

        calibrated = load_sensor_with_notices(self.sensor)
        with sensor_replacement(self.sensor):
            folder = save_sensor(self.sensor, repeat_calibration(calibrated, "physics"))
        twin = folder.record.twin
        assert twin is not None, "the physics method makes a twin"
        print_notices(failed_calibration_notices(self.sensor, folder))
        found = {"sensor": str(folder.path), **msgspec.to_builtins(twin)}
        print_result(self.json, found, self._format_fit(twin, folder.path))
        return 1 if has_failed_checks(folder.record.certificate) else 0

    def _format_fit(self, twin: "TwinTable", written: Path) -> Iterator[str]:
        fit = twin.fit
        yield f"twin of {self.sensor} fitted in {fit.duration_s:.1f} s"
        yield (
            f"  residual     {fit.image_rmse_grey_levels:.2f} grey levels over the image, {fit.radial_rmse_grey_levels:.2f} of the "
            "radial profile"
        )
        yield f"  press        {fit.depth_mm:.2f} mm deep, dragged by ({fit.drag_mm[0]:+.2f}, {fit.drag_mm[1]:+.2f}) mm"
        yield "  parameters, ± one standard deviation:"
        yield from _format_parameters(fit)
        yield f"  written to {written}; open {written / 'certificate.html'} in a browser"


def _format_parameters(fit: "TwinFitQuality") -> Iterator[str]:
    """Yield each parameter with its standard deviation and the parameter with which it correlates most."""
    for name, found in fit.parameters.items():
        other = found.most_correlated_with
        sure = "" if found.std is None else f" ± {found.std:.3f}"
        beside = "" if other is None else f"  (correlation with {other} {found.correlation:+.2f})"
        yield f"  {name:16s} {found.value:8.3f}{sure}{beside}"


@dataclass(frozen=True)
class _Objects:
    """List the objects that can press a twin: primitives, families of generated objects, mesh files."""

    json: JsonOption = False

    def run(self) -> int:
        """Print the list."""
        from ninedtact.simulation.objects.catalogue import FAMILIES_BY_KIND, PRIMITIVES
        from ninedtact.simulation.objects.mesh_objects import MESH_FILE_SUFFIXES

        solids = {kind: dimensions for kind, (dimensions, _) in PRIMITIVES.items()}
        generated = {kind: list(families) for kind, families in FAMILIES_BY_KIND.items()}
        found = {"solids": solids, "generated": generated, "mesh_files": list(MESH_FILE_SUFFIXES)}
        return print_result(self.json, found, _format_object_list(solids, generated, MESH_FILE_SUFFIXES))


def _format_object_list(solids: dict[str, str], made: dict[str, list[str]], endings: tuple[str, ...]) -> Iterator[str]:
    yield "primitives, with dimensions in mm and degrees; dimensions that are left out have defaults:"
    yield from (f"  {kind}:{dimensions}" for kind, dimensions in solids.items())
    yield "generated objects, any number of each family (gear_07; --seed for others):"
    yield from (f"  {kind:18}{', '.join(families)}" for kind, families in made.items())
    yield f"mesh files ({', '.join(endings)}), with unit, side and size if need be: part.stl, part.stl@in@+x, part.stl@fit:16"


@dataclass(frozen=True)
class _Press:
    """Press an object on the twin of a sensor; write its image, heights, pressure, shear, wrench and a figure of all."""

    object: str
    """Object: ball:4 (mm), cylinder, cone, punch, ellipsoid, gear_07, or a mesh file (part.stl, part.stl@in)."""
    out: Path
    """Folder for the results."""
    depth_mm: AboveZero | None = None
    """Depth of the object's lowest point below the undeformed skin. Give either this or a load."""
    load_n: AboveZero | None = None
    """Load of the press. Give either this or a depth."""
    at_mm: Pair = (0.0, 0.0)
    """Position of the press, x and y."""
    drag_mm: Pair = (0.0, 0.0)
    """Drag while the object is pressed, x and y."""
    twist_deg: float = 0.0
    """Twist about z during the drag."""
    tilt_deg: Pair = (0.0, 0.0)
    """Tilts of the object about x and y, from the beginning."""
    hold_s: float = 0.0
    """Time in s for which the object is then held, while the gel relaxes: the load falls, or under a load the object sinks in."""
    sensor: Path | None = None
    """Sensor folder whose twin is pressed; without one, the twin of the published design."""
    design_file: DesignFileOption = None
    """Design file (TOML) with what differs from the published sensor; its twin is pressed."""
    seed: Annotated[int, Meta(ge=0)] = 0
    """Seed of generated objects, and of the reference image where no sensor is given."""
    json: JsonOption = False

    def run(self) -> int:
        """Simulate the press, write its files and print a summary."""
        from ninedtact.simulation.objects.catalogue import indenter_from_name

        press, twin = self.press, self.twin
        indenter = indenter_from_name(self.object, self.seed)
        contact = press.simulate(twin, indenter)
        found = _press_to_json_dict(indenter, contact, twin, self.grid[1])
        return print_result(
            self.json, {**found, "files": self.write_files(indenter, contact, found)}, _format_press(found, self.out)
        )

    @property
    def press(self) -> "ScriptedPress":
        """The same in radians; raises `InputError`."""
        from ninedtact.simulation.trajectory import ScriptedPress

        tilt = radians(self.tilt_deg[0]), radians(self.tilt_deg[1])
        twist = radians(self.twist_deg)
        return ScriptedPress(self.depth_mm, self.load_n, self.at_mm, self.drag_mm, twist, tilt, self.hold_s)

    @cached_property
    def twin(self) -> "Twin":
        """The twin of the sensor or of the design."""
        from ninedtact.simulation.twin import twin_from_design

        if self.folder is None:
            return twin_from_design(read_design_or_default(self.design_file), self.seed)
        return self.folder.twin()

    @cached_property
    def folder(self) -> "SensorFolder | None":
        """The sensor that is pressed, where one is given; raises `InputError`, and what `load_sensor` raises."""
        refuse_design_beside_sensor(self.sensor, self.design_file)
        return None if self.sensor is None else load_sensor_with_notices(self.sensor)

    def write_files(self, indenter: "Indenter", contact: "Contact", found: dict[str, Any]) -> dict[str, str]:
        """Write all files, and return the path of each by its name."""
        from ninedtact.atomic_write import write_file_atomically
        from ninedtact.shape.export import export_shape
        from ninedtact.simulation.ground_truth import true_height_map

        self.out.mkdir(parents=True, exist_ok=True)
        contents = self.contents(indenter, contact)
        contents["wrench.json"] = json.dumps(found, indent=2, ensure_ascii=False).encode()
        for name, content in contents.items():
            write_file_atomically(self.out / name, content)
        height = true_height_map(contact, *self.grid)
        for ending in ("npy", "png"):
            export_shape(height, self.out / f"height.{ending}")
        return {name: str(self.out / name) for name in (*contents, "height.npy", "height.png")}

    def contents(self, indenter: "Indenter", contact: "Contact") -> dict[str, bytes]:
        """Return the contents of all files but the heights, by name."""
        from ninedtact.simulation.ground_truth import true_pressure_map_mpa, true_shear_map_mpa
        from ninedtact.simulation.press_drawing import PressFigure

        image = self.twin.renderer(contact, 1)
        drawn = PressFigure(contact, indenter, image, self.twin.renderer.pixel_map.reach_mm, self.cut)
        return {
            "image.png": _encode_png(image),
            "reference.png": _encode_png(self.twin.renderer(None, 0)),
            "pressure.npy": _encode_npy(true_pressure_map_mpa(contact, *self.grid)),
            "shear.npy": _encode_npy(true_shear_map_mpa(contact, *self.grid)),
            "figure.png": drawn.to_png(),
        }

    @cached_property
    def grid(self) -> tuple[tuple[int, int], float]:
        """The (rows, cols) and the mm per pixel of heights and tractions, as in the rectified image."""
        if self.folder is not None:
            rectify = self.folder.rectification
            return rectify.height_source.shape, rectify.mm_per_px
        from ninedtact.design import rectified_grid_of_design

        return rectified_grid_of_design(read_design_or_default(self.design_file))

    @property
    def cut(self) -> Pair:
        """The direction of the cut in the figure, which is that of the drag."""
        (x, y), length = self.drag_mm, hypot(*self.drag_mm)
        return (x / length, y / length) if length else (1.0, 0.0)


def _press_to_json_dict(indenter: "Indenter", contact: "Contact", twin: "Twin", mm_per_px: float) -> dict[str, Any]:
    import numpy as np

    wrench, pressed = contact.wrench(), np.asarray(contact.pressure_mpa) > 0
    cell_mm2 = contact.skin.grid.cell_area_mm2
    return {
        "object": indenter.name,
        "twin": twin.name,
        "pose": {name: float(value) for name, value in asdict(contact.pose).items()},
        "wrench": {
            "force_n": wrench.force_n.tolist(),
            "torque_nm": wrench.torque_nm.tolist(),
            "about_mm": wrench.about_mm.tolist(),
        },
        "max_indentation_mm": float(-contact.height_mm.min()),
        "max_bulge_mm": float(contact.height_mm.max()),
        "contact_area_mm2": float(pressed.sum() * cell_mm2),
        "sticking_area_mm2": float(np.asarray(contact.stick_mask).sum() * cell_mm2),
        "largest_pressure_mpa": float(contact.pressure_mpa.max()),
        "mm_per_px": mm_per_px,
        "residual_mm": float(contact.residual_mm),
        "iterations": int(contact.iterations),
    }


def _format_press(found: dict[str, Any], out: Path) -> Iterator[str]:
    force, torque = found["wrench"]["force_n"], found["wrench"]["torque_nm"]
    area = found["contact_area_mm2"]
    yield (
        f"{found['object']} on twin {found['twin']}: {found['pose']['depth_mm']:.3f} mm deep, contact {area:.1f} mm², of which "
        f"{found['sticking_area_mm2'] / area if area else 0:.0%} sticks, bulge {found['max_bulge_mm']:.3f} mm"
    )
    yield "  force  ({:+.3f}, {:+.3f}, {:+.3f}) N, on the skin".format(*force)
    yield "  torque ({:+.3f}, {:+.3f}, {:+.3f}) N·mm, about the skin's centre".format(*(1e3 * part for part in torque))
    yield f"  open {out / 'figure.png'}"


def _encode_png(image: "np.ndarray") -> bytes:
    import cv2

    return cv2.imencode(".png", image)[1].tobytes()


def _encode_npy(field: "np.ndarray") -> bytes:
    import numpy as np

    buffer = BytesIO()
    np.save(buffer, field)
    return buffer.getvalue()


SimulateCommand = (
    Annotated[_Fit, tyro.conf.subcommand("fit")]
    | Annotated[_Press, tyro.conf.subcommand("press")]
    | Annotated[_Objects, tyro.conf.subcommand("objects")]
)
"""Its subcommands."""
DESCRIPTION = "The twin of a sensor: make it, press it, list what can be pressed."
