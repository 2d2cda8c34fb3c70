"""Where the real images are: the folder in NINEDTACT_REAL_DATA, or ../shared/real beside the repository."""

import os
import sys
from pathlib import Path

PRESSES = ("board_reference", "board", "ball_reference", "ball")


def sensor_folders() -> list[Path]:
    """The folders of all sensors that have the four images; ends the program with a sentence when there are none."""
    beside = Path(__file__).resolve().parents[2] / "shared" / "real"
    folder = Path(os.environ.get("NINEDTACT_REAL_DATA", beside))
    found = [path for path in sorted(folder.glob("sensor_*")) if all((path / f"{p}.png").is_file() for p in PRESSES)]
    if not found:
        sys.exit(f"expected folders sensor_a and so on with real images in {folder}, got none; set NINEDTACT_REAL_DATA")
    return found


def sensor_folder(name: str) -> Path:
    """One sensor's folder; ends the program with a sentence when it is not there."""
    found = {path.name: path for path in sensor_folders()}
    if name not in found:
        sys.exit(f"expected {name} among the real images, got {', '.join(found)}; set NINEDTACT_REAL_DATA")
    return found[name]
