"""One row of a data set, and how many of each kind there are."""

from dataclasses import dataclass
from typing import Literal

import cv2
from jaxtyping import Float32, UInt8
from numpy import ndarray as Array

from ninedtact.dataset.generation.settings import DatasetSettings

Kind = Literal["rule", "light_touch", "no_contact"]
QUICK_PNG = (cv2.IMWRITE_PNG_COMPRESSION, 1)
"""Noise does not compress: more effort would save 4 % and take three times as long."""


@dataclass(frozen=True)
class Pair:
    """One row of the data set."""

    image: bytes
    """PNG, grey."""
    reference: str
    wrench: Float32[Array, "6"]
    object: str
    contact: str
    step: int
    time_ns: int
    sensor: str
    kind: Kind
    mm_per_px: float


def quotas(number: int, settings: DatasetSettings) -> dict[str, int]:
    """How many pairs of each kind a session makes, so that shares hold over all sessions."""
    first = number * settings.pairs_per_session
    end = min(first + settings.pairs_per_session, settings.pairs)
    shares = {"no_contact": settings.shares.no_contact, "light_touch": settings.shares.light_touch}
    counts = {kind: round(share * end) - round(share * first) for kind, share in shares.items()}
    others = min(sum(counts.values()), end - first)
    return {**counts, "rule": end - first - others}


def png(grey: UInt8[Array, "rows cols"]) -> bytes:
    """An image as a file."""
    return bytes(cv2.imencode(".png", grey, QUICK_PNG)[1])
