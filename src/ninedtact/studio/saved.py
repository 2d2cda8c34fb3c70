"""One reading as files, for whoever wants to keep what they just saw."""

from datetime import datetime
from pathlib import Path

import cv2

from ninedtact.atomic_write import write_file_atomically
from ninedtact.reading import Reading
from ninedtact.shape.export import export

FORMATS = ("npy", "png", "ply")


def save_reading(reading: Reading, folder: Path) -> list[Path]:
    """Write the camera's image and the heights (mm) under a name made of the time; raises `FileNotWritten`."""
    folder.mkdir(parents=True, exist_ok=True)
    name = f"reading_{datetime.now():%Y%m%d_%H%M%S_%f}"
    image, heights = folder / f"{name}_image.png", [folder / f"{name}_height.{ending}" for ending in FORMATS]
    write_file_atomically(image, cv2.imencode(".png", reading.frame.image)[1].tobytes())
    for path in heights:
        export(reading.height, path)
    return [image, *heights]
