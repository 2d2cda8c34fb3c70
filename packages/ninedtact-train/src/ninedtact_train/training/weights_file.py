"""Reads files of weights (.pt) without running code in them, and without unpacking more than their size."""

from pathlib import Path
from pickle import UnpicklingError
from typing import Any
from zipfile import ZipFile

import torch


def load_weights(path: Path | str) -> Any:
    """Return the plain values and tensors of a file that `torch.save` wrote; raises many kinds of exception for another one.

    PyTorch stores tensors uncompressed; an archive that grows when it is unpacked, or shares bytes between entries, is of another
    origin. Its format before 1.6 states sizes that are allocated before anything is read.
    """
    if not Path(path).is_file():
        raise OSError(f"no file at {path}")
    with ZipFile(path) as archive:  # refuses the old format
        if sum(entry.file_size for entry in archive.infolist()) > Path(path).stat().st_size:
            raise ValueError("an archive whose content is larger than the file")
    try:
        return torch.load(path, map_location="cpu", weights_only=True)
    except UnpicklingError as refusal:  # whose advice is to run the code
        raise ValueError("other objects than numbers and tensors, or damaged ones") from refusal
