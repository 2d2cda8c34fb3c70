"""What is learnt from: images or heights with the wrench of each, in memory or mapped from a file."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float32, Float64, Int, Shaped
from numpy import ndarray as Array

from ninedtact.design import Gel
from ninedtact.errors import NinedtactError
from ninedtact.force.inputs import InputSettings
from ninedtact.force.splits import Rows

AXES = 6
FEWEST = 2


class ExamplesUnusable(NinedtactError):
    """Examples that nothing can be learnt from."""


@dataclass(frozen=True)
class Examples:
    """Pairs at the size of the network's input; raises `ExamplesUnusable`. What is large may be mapped from a file."""

    images: Shaped[Array, "n rows cols"]
    """Heights in mm on the network's grid (`inputs.heights_at_places`), or grey levels; of any type of number."""
    wrench: Float32[Array, "n 6"]
    """N and N·m about the skin's centre."""
    objects: Sequence[str]
    sensors: Sequence[str]
    references: Shaped[Array, "m rows cols"] | None = None
    """Untouched images; none for heights."""
    reference_of: Int[Array, " n"] | None = None
    """Which of them each image is held against."""
    traits: Float32[Array, "n traits"] | None = None
    """Of the sensor of each (`Traits.row`); usual ones where nothing is said."""

    def __post_init__(self) -> None:
        n = len(self.images)
        columns = (self.wrench, self.objects, self.sensors, self.reference_of, self.traits)
        if any(column is not None and len(column) != n for column in columns) or self.wrench.shape != (n, AXES):
            raise ExamplesUnusable(
                f"expected a wrench of six, object, sensor and the rest for each of {n} images, got columns of other "
                "lengths; give one of each for every image"
            )
        if not np.isfinite(self.wrench).all():
            bad = ~np.isfinite(self.wrench).all(1)
            raise ExamplesUnusable(
                f"expected wrenches of six finite numbers, got {bad.sum()} of {n} that are not, the first in row "
                f"{int(bad.argmax())}; leave those pairs out"
            )

    def at_modulus(self, of_each_mpa: Float64[Array, " n"]) -> "Examples":
        """Wrenches as a gel of the design's modulus would have given them, those of each sensor's gel given."""
        softer = (Gel().shear_modulus_mpa / of_each_mpa)[:, None]
        return replace(self, wrench=(self.wrench * softer).astype(np.float32))

    def __len__(self) -> int:
        return len(self.images)


def require_learnable(examples: Examples, rows: Rows, settings: InputSettings) -> None:
    """Refuse what would train nothing, or something else; raises `ExamplesUnusable`."""
    if min(len(rows.train), len(rows.test)) < FEWEST:
        raise ExamplesUnusable(
            f"expected at least {FEWEST} pairs to learn from and others to check with, got {len(rows.train)} and "
            f"{len(rows.test)}; hold out more or less, or record more"
        )
    size = examples.images.shape[1:]
    if size != (settings.rows, settings.cols):
        raise ExamplesUnusable(
            f"expected images of {settings.cols} x {settings.rows}, got {size[1]} x {size[0]}; read the data at that size"
        )
    if settings.channels.of_heights != (examples.references is None) or (examples.reference_of is None) != (
        examples.references is None
    ):
        given = "heights" if examples.references is None else "images with references"
        raise ExamplesUnusable(
            f"expected examples for the channels {settings.channels.value!r}, got {given}; give the others, or ask for other "
            "channels"
        )


def about_point(examples: Examples, point_mm: tuple[float, float, float]) -> Examples:
    """Torques about a point that is given from the one that they are about, as `Wrench.about` moves them."""
    force, torque = examples.wrench[:, :3], examples.wrench[:, 3:]
    moved = torque - np.cross(np.array(point_mm) / 1e3, force)
    return replace(examples, wrench=np.concatenate([force, moved], 1).astype(np.float32))
