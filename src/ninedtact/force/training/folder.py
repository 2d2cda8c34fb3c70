"""The folder of a training: begun once, and known again.

settings.json    what was asked for     metrics.csv, curves.png    every epoch     tensorboard/    the same for TensorBoard
checkpoints/     best and last epoch    model.onnx                 what comes of it, last of all
"""

import json
from pathlib import Path
from typing import Any

from ninedtact.atomic_write import FileNotWritten, write_file_atomically
from ninedtact.errors import NinedtactError

SETTINGS, MODEL, CURVES = "settings.json", "model.onnx", "curves.png"


class FolderTaken(NinedtactError):
    """A folder that holds something else, or another training."""


def begin(out: Path, asked: dict[str, Any]) -> None:
    """Make the folder, or see that it holds an earlier run of the same; raises `FolderTaken`, `FileNotWritten`."""
    wanted = json.loads(json.dumps(asked))
    if (out / SETTINGS).is_file():
        require_same(out, wanted)
        return
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise FolderTaken(
            f"expected an empty folder or a training to go on with, got {out}, which holds something else; give another"
        )
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as trouble:
        raise FileNotWritten(
            f"expected to make the folder {out}, got: {trouble.strerror or trouble}; correct the path or its permissions"
        ) from trouble
    write_file_atomically(out / SETTINGS, json.dumps(wanted, indent=1).encode())


def require_same(out: Path, wanted: dict[str, Any]) -> None:
    """Refuse to go on with something else."""
    try:
        found = json.loads((out / SETTINGS).read_text())
    except (OSError, ValueError):
        found = {}
    differing = sorted(name for name in {*found, *wanted} if found.get(name) != wanted.get(name))
    if differing:
        raise FolderTaken(
            f"expected the training that {out} was begun with, got another {', '.join(differing)}; give the same data and "
            "options to go on, or another folder"
        )
