"""ninedtact simulate press: press an object on a twin, and write image, heights, tractions and wrench."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from math import radians
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ninedtact.cli.option_parser import DesignFileOption, read_design_or_default, require_sensor_or_design
from ninedtact.cli.result_and_interrupt import load_sensor_with_notices, print_result
from ninedtact.design import SensingArea

if TYPE_CHECKING:
    import numpy as np

    from ninedtact.mechanics.contact_result import Contact
    from ninedtact.mechanics.indenter import Indenter
    from ninedtact.simulation import press_drag_twist as simulated
    from ninedtact.simulation.twin import Twin

Pair = tuple[float, float]


@dataclass(frozen=True)
class Press:
    """Press an object on the twin of a sensor; write its image, heights, pressure, shear, wrench and a figure of all."""

    object: str
    """Object: ball:4 (mm), cylinder, cone, punch, ellipsoid, gear_07, a mesh file (part.stl, part.stl@in), thingi10k:ID."""
    out: Path
    """Folder for the results."""
    depth_mm: float | None = None
    """Depth of the object's lowest point below the undeformed skin. Give either this or a load."""
    load_n: float | None = None
    """Load of the press. Give either this or a depth."""
    at_mm: Pair = (0.0, 0.0)
    """Position of the press, x and y."""
    drag_mm: Pair = (0.0, 0.0)
    """Drag while the object is pressed, x and y."""
    twist_deg: float = 0.0
    """Twist about z during the drag."""
    tilt_deg: Pair = (0.0, 0.0)
    """Tilts of the object about x and y, from the beginning."""
    sensor: Path | None = None
    """Sensor folder whose twin is pressed; without one, the twin of the published design."""
    design_file: DesignFileOption = None
    """Design file (TOML) of a sensor that is not built yet; its twin is pressed."""
    seed: int = 0
    """Seed of generated objects, and of the reference image where no sensor is given."""
    json: bool = False
    """Print the results as one JSON object."""

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
    def press(self) -> "simulated.Press":
        """The same in radians; raises `PressImpossible`."""
        from ninedtact.simulation import press_drag_twist as simulated

        tilt = radians(self.tilt_deg[0]), radians(self.tilt_deg[1])
        return simulated.ScriptedPress(
            self.depth_mm, self.load_n, self.at_mm, self.drag_mm, radians(self.twist_deg), tilt
        )

    @cached_property
    def twin(self) -> "Twin":
        """The twin of the sensor or of the design."""
        from ninedtact.simulation.twin import twin_from_design

        if self.sensor is None:
            return twin_from_design(read_design_or_default(self.design_file), self.seed)
        require_sensor_or_design(self.sensor, self.design_file)
        from ninedtact.calibration.twin.sensor_twin import build_sensor_twin

        return build_sensor_twin(load_sensor_with_notices(self.sensor))

    def write_files(self, indenter: "Indenter", contact: "Contact", found: dict[str, Any]) -> dict[str, str]:
        """Write all files, and return the path of each by its name."""
        import json

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
        from ninedtact.simulation.press_figures import PressFigure

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
        design = read_design_or_default(self.design_file)
        view, wider = design.field_of_view, design.sensing_area.width_mm / SensingArea().width_mm
        return (view.rows, view.cols), MM_PER_PX * wider

    @property
    def cut(self) -> Pair:
        """The direction of the cut in the figure, which is that of the drag."""
        x, y = self.drag_mm
        length = float(x**2 + y**2) ** 0.5
        return (x / length, y / length) if length else (1.0, 0.0)


MM_PER_PX = 0.0522
"""Scale of the published sensor: 24 mm over 460 pixels."""


def _press_to_json_dict(indenter: "Indenter", contact: "Contact", twin: "Twin", mm_per_px: float) -> dict[str, Any]:
    """Return the results of a press for JSON."""
    from dataclasses import asdict

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
    """Yield the lines that summarise a press."""
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
    """Return an image as the bytes of a .png file."""
    import cv2

    return cv2.imencode(".png", image)[1].tobytes()


def _encode_npy(field: "np.ndarray") -> bytes:
    """Return an array as the bytes of a .npy file."""
    from io import BytesIO

    import numpy as np

    buffer = BytesIO()
    np.save(buffer, field)
    return buffer.getvalue()
