"""Arrays of the original project's folders, read with suspicion and written whole."""

import re
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from tokenize import TokenError

import numpy as np
from jaxtyping import Float, Shaped
from numpy import ndarray as Array

from ninedtact.errors import NinedtactError
from ninedtact.whole_file import write_whole

NAME = re.compile(r"sensor_\w+")


class UpstreamFolderDamaged(NinedtactError):
    """The folder is not a calibration of the original project, or something in it is missing or wrong."""


def sensor_folder_in(folder: Path, files: Sequence[str]) -> Path:
    """The folder itself where it holds one of the files, or the only `sensor_N` in it."""
    if any((folder / file).exists() for file in files):
        return folder
    inside = sorted(path for path in folder.glob("sensor_*") if path.is_dir() and NAME.fullmatch(path.name))
    if len(inside) == 1:
        return inside[0]
    got = ", ".join(path.name for path in inside) if inside else "none" if folder.is_dir() else "no such folder"
    raise UpstreamFolderDamaged(
        f"expected {folder} to be a sensor_N folder of the original project, or to hold one, got {got}; "
        "name the folder that holds camera_calibration and depth_calibration"
    )


def read_numbers(path: Path, dimensions: int) -> Float[Array, "..."]:
    """The finite numbers of a .npy file with so many dimensions; raises `UpstreamFolderDamaged`."""
    array = read_array(path)
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "iuf":
        raise damaged(path, "an array of numbers", f"{getattr(array, 'dtype', 'an archive')}")
    if array.ndim != dimensions or not array.size:
        raise damaged(path, f"{dimensions} dimension{'s' if dimensions > 1 else ''}", f"shape {array.shape}")
    numbers = np.array(array, float)
    if not np.isfinite(numbers).all():
        raise damaged(path, "finite numbers", f"{int((~np.isfinite(numbers)).sum())} that are not")
    return numbers


def read_array(path: Path) -> object:
    """Whatever numpy finds in a file, mapped and not loaded, so that a damaged header cannot ask for all the memory."""
    if not path.is_file():
        raise UpstreamFolderDamaged(
            f"expected {path}, got no such file; copy the whole sensor_N folder of the original project"
        )
    try:
        return np.load(path, mmap_mode="r", allow_pickle=False)
    except (ValueError, EOFError, TypeError, OverflowError, SyntaxError, TokenError, MemoryError) as trouble:
        raise damaged(path, "a whole .npy file without Python objects", first_line(trouble)) from trouble


def require_whole_numbers(path: Path, numbers: Float[Array, "..."]) -> None:
    """Refuse fractions of a pixel."""
    if (numbers != np.rint(numbers)).any():
        raise damaged(path, "whole numbers", "fractions")


def write_numbers(path: Path, numbers: Shaped[Array, "..."]) -> None:
    """Write a .npy file; raises `FileNotWritten`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    content = BytesIO()
    np.save(content, numbers, allow_pickle=False)
    write_whole(path, content.getbuffer())


def first_line(trouble: Exception) -> str:
    """What numpy said, short."""
    return (str(trouble).splitlines() or [type(trouble).__name__])[0]


def damaged(path: Path, expected: str, got: str) -> UpstreamFolderDamaged:
    """The refusal of one file."""
    return UpstreamFolderDamaged(f"expected {expected} in {path}, got {got}; copy the file again or calibrate again")
