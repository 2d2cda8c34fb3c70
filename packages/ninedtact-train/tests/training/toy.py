"""A touch that is learnt in seconds: round dents, pressed by their volume where they are."""

from dataclasses import replace

import numpy as np

from ninedtact.force.network_input import InputChannels, NetworkInputSettings
from ninedtact.quantities import centred_axis_mm
from ninedtact_train.dataset.split import SplitRows
from ninedtact_train.training.examples import TrainingExamples
from ninedtact_train.training.settings import DEFAULT_TRAINING, TrainingSettings

GRID = NetworkInputSettings(rows=16, cols=24, mm_per_px=0.6)
PAIRS = 160
ROWS = SplitRows(np.arange(128), np.arange(128, PAIRS))


def toy_settings(**changes: object) -> TrainingSettings:
    return replace(DEFAULT_TRAINING, input=GRID, epochs=4, batch=32, **changes)


def dents(n: int = PAIRS) -> tuple[np.ndarray, np.ndarray]:
    """Heights in mm, and the wrench of each."""
    rng = np.random.default_rng(0)
    x, y = (centred_axis_mm(side, GRID.mm_per_px) for side in (GRID.cols, GRID.rows))
    at, depth = rng.uniform((-4, -2), (4, 2), (n, 2)), rng.uniform(0, 1, n)
    away = (x - at[:, :1, None]) ** 2 + (y[:, None] - at[:, 1:, None]) ** 2
    z_mm = -depth[:, None, None] * np.exp(-away / 2)
    force = np.stack([depth * at[:, 0] / 4, depth * at[:, 1] / 2, -5 * depth], 1)
    torque = np.cross(np.pad(at, ((0, 0), (0, 1))), force) / 1e3
    return z_mm, np.concatenate([force, torque], 1).astype(np.float32)


def of_heights() -> TrainingExamples:
    z_mm, wrench = dents()
    names = [f"object_{number % 5}" for number in range(PAIRS)], [f"sensor_{number % 2}" for number in range(PAIRS)]
    return TrainingExamples(z_mm.astype(np.float16), wrench, *names)


def of_images() -> TrainingExamples:
    """Two sensors with a reference each."""
    heights = of_heights()
    references = np.stack([np.full((GRID.rows, GRID.cols), grey, np.uint8) for grey in (120, 150)])
    of = np.arange(PAIRS) % 2
    images = np.rint(references[of] * (1 + 0.3 * heights.images.astype(float))).astype(np.uint8)
    return replace(heights, images=images, references=references, reference_of=of)


IMAGES = replace(GRID, channels=InputChannels.DEFORMATION)
