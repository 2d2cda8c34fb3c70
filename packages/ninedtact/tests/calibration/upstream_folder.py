"""A calibration folder of the original project, made up."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy import ndarray as Array

from ninedtact.calibration.original_9dtact.folder_format import COL_INDEX, PIXEL_TO_DEPTH, POSITION_SCALE, ROW_INDEX

ROWS, COLS = 480, 640


def enlarged(size: int) -> Array:
    """Source of an image that shows the middle nine tenths."""
    return np.floor((np.arange(size) - size / 2) * 0.9 + size / 2).astype(np.int32)


@dataclass
class UpstreamFolder:
    """The four arrays, to be spoiled before they are written."""

    row_index: Array = field(default_factory=lambda: np.repeat(enlarged(ROWS)[:, None], COLS, axis=1))
    col_index: Array = field(default_factory=lambda: np.repeat(enlarged(COLS)[None], ROWS, axis=0))
    position_scale: Array = field(default_factory=lambda: np.array([240.0, 318.0, 0.0511]))
    pixel_to_depth: Array = field(default_factory=lambda: np.array([-0.9, *np.linspace(0.02, 1.8, 60)]))

    def write(self, folder: Path) -> Path:
        """Write them as `np.save` does."""
        arrays = {
            ROW_INDEX: self.row_index,
            COL_INDEX: self.col_index,
            POSITION_SCALE: self.position_scale,
            PIXEL_TO_DEPTH: self.pixel_to_depth,
        }
        for file, array in arrays.items():
            (folder / file).parent.mkdir(parents=True, exist_ok=True)
            np.save(folder / file, array, allow_pickle=True)
        return folder
