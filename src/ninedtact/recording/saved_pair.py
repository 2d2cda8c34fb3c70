"""A pair that was collected: what the camera saw, and the wrench at that moment.

`ninedtact collect` marks pairs in its episode; `episode_pairs.pairs_of` reads them, without those of contacts that were undone.
"""

from dataclasses import dataclass
from typing import Literal, get_args

from jaxtyping import UInt8
from numpy import ndarray as Array

from ninedtact.quantities import Wrench

Kind = Literal["rule", "light_touch", "no_contact"]
"""Why it was saved: the sampling rule kept it; it weighs less than the rule begins with; nothing touches."""
KINDS: tuple[Kind, ...] = get_args(Kind)
NOTHING = "none"
"""The object of a pair without contact."""


@dataclass(frozen=True)
class UntouchedSkin:
    """The skin before a stretch of the session: the reference of the pairs that follow. Taken anew at every tare."""

    id: str
    """Unlike that of any other, in any episode."""
    images: tuple[UInt8[Array, "rows cols 3"], ...]
    """Raw BGR, read-only: all pairs of the stretch share them. To be rectified one by one and averaged."""


@dataclass(frozen=True)
class SavedPair:
    """One raw image and the wrench that the object applied to the skin when it was taken."""

    image: UInt8[Array, "rows cols 3"]
    """Raw BGR, as the camera gave it."""
    wrench: Wrench
    """About the skin's centre, tare taken off; interpolated between the neighbouring samples to the image's stamp."""
    object: str
    """`NOTHING` where nothing touches."""
    contact: str
    """Pairs of one contact are alike: splits keep them together. Unlike any other contact's, in any episode."""
    kind: Kind
    time_ns: int
    """The image's stamp, monotonic clock of the recording machine."""
    sensor: str
    """Name of the tactile sensor, as in its sensor.toml; its folder is attached to the episode."""
    untouched: UntouchedSkin
