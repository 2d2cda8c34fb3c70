"""Checkpoints: written whole, read without running anything in them."""

from io import BytesIO
from pathlib import Path
from typing import Any

import torch
from lightning.fabric.plugins.io.torch_io import TorchCheckpointIO

from ninedtact.atomic_write import write_file_atomically
from ninedtact.errors import NinedtactError


class CheckpointDamaged(NinedtactError):
    """What an earlier run left cannot be gone on with."""


class WholeFiles(TorchCheckpointIO):
    """Checkpoints appear whole or not at all."""

    def save_checkpoint(self, checkpoint: dict[str, Any], path: Any, storage_options: Any = None) -> None:
        """Raises `FileNotWritten`."""
        content = BytesIO()
        torch.save(checkpoint, content)
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        write_file_atomically(path, content.getbuffer())


def resumable(path: Path) -> str | None:
    """The last checkpoint of an earlier run; raises `CheckpointDamaged`."""
    if not path.is_file():
        return None
    checkpoint(path)
    return str(path)


def checkpoint(path: Path) -> dict[str, Any]:
    """What a checkpoint holds: plain values and weights alone; raises `CheckpointDamaged`."""
    try:
        return dict(torch.load(path, map_location="cpu", weights_only=True))
    except Exception as trouble:  # whatever torch meets in a damaged file
        said = (str(trouble).splitlines() or [""])[0]
        raise CheckpointDamaged(
            f"expected a checkpoint of this program in {path}, got: {said}; remove it to begin again"
        ) from trouble
