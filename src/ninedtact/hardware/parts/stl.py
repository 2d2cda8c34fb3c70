"""A solid as triangles, in the binary form that printers take."""

from pathlib import Path
from tempfile import TemporaryDirectory

from build123d import Part, export_stl


def stl(solid: Part, flat_mm: float, turn_rad: float) -> bytes:
    """Triangles in mm, which stand off curved faces and turn from one to the next by no more than this."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "part.stl"
        export_stl(solid, path, flat_mm, turn_rad)
        return path.read_bytes()
