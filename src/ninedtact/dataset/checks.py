"""What is looked for in every pair. Findings are listed and counted; only a person drops pairs.

Whether an image is darker where it is touched: means over tiles of 6 x 6 pixels or more, the darkest one below the median
one. In the twin's data untouched skin comes to 0.5 grey levels by its noise, and 2 N to more than 0.8, on every object and
sensor.
"""

from collections import OrderedDict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from hashlib import blake2b
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np
from jaxtyping import UInt8
from numpy import ndarray as Array

from ninedtact.dataset.columns import bytes_of, rows_of, six
from ninedtact.dataset.rows import Fault, Finding, NotAImage, decoded
from ninedtact.errors import NinedtactError

Grey = UInt8[Array, "rows cols"]
Six = tuple[float, float, float, float, float, float]
MOST_TILES, TILE_PX = 40, 6
KEPT_IMAGES = 32
COLUMNS = ("image", "reference", "wrench", "id", "gap_ms")
AXES = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")


class CheckImpossible(NinedtactError):
    """Limits that no pair could meet."""


@dataclass(frozen=True)
class CheckSettings:
    """From where on a pair is worth a look."""

    largest: Six = (6.0, 6.0, 24.0, 0.4, 0.4, 0.1)
    """N and N·m about the skin's centre: twice what the paper collected."""
    pulling_above_n: float = 0.3
    """F_z."""
    gap_ms: float = 20.0
    """From image to wrench."""
    pressed_n: float = 2.0
    """A load that is always seen …"""
    faintest_levels: float = 0.6
    """… by so much darkening at least."""
    untouched_n: float = 0.05
    """A force that is none …"""
    unfelt_levels: float = 6.0
    """… and goes with less darkening than this."""

    def __post_init__(self) -> None:
        limits = (
            *self.largest,
            self.pulling_above_n,
            self.gap_ms,
            self.pressed_n,
            self.faintest_levels,
            self.unfelt_levels,
        )
        if not (min(limits) > 0 and self.untouched_n >= 0):
            raise CheckImpossible(f"expected limits above zero, got {self}; correct them")


class FileCheck(msgspec.Struct):
    """What one file holds, and what is wrong with it by itself."""

    ids: list[str]
    seen: list[str]
    """A digest of each image."""
    findings: list[Finding]


@dataclass
class Untouched:
    """The untouched images by id, as files in memory, the last few decoded."""

    files: Iterable[Path]
    images: OrderedDict[str, Grey] = field(default_factory=OrderedDict, init=False)

    def __post_init__(self) -> None:
        self.contents = {row["reference"]: bytes_of(row["image"]) for file in self.files for row in rows_of(file)}

    def __getitem__(self, name: str | None) -> Grey | None:
        """The image of this id, if it is there and whole."""
        if name is None or name not in self.contents:
            return None
        if name not in self.images:
            try:
                self.images[name] = decoded(self.contents[name])
            except NotAImage:
                return None
            if len(self.images) > KEPT_IMAGES:
                self.images.popitem(last=False)
        return self.images[name]


def checked_file(path: Path, untouched: Untouched, settings: CheckSettings) -> FileCheck:
    """All pairs of one file, each by itself; raises `DataSetDamaged`."""
    check = FileCheck([], [], [])
    for number, row in enumerate(rows_of(path, COLUMNS)):
        name = row.get("id") or f"{path.stem.split('-of-')[0]}-{number:05d}"
        try:
            image = decoded(bytes_of(row["image"]))
        except NotAImage as trouble:
            faults = [(Fault.UNREADABLE, str(trouble))]
            seen = ""
        else:
            faults = list(faults_of(image, untouched[row.get("reference")], row, settings))
            seen = blake2b(image.tobytes(), digest_size=12, salt=f"{image.shape[1]}".encode()).hexdigest()
        check.ids.append(name)
        check.seen.append(seen)
        check.findings += [Finding(fault, name, says, number, path.name) for fault, says in faults]
    return check


def faults_of(
    image: UInt8[Array, "_ _"], reference: UInt8[Array, "_ _"] | None, row: dict[str, Any], settings: CheckSettings
) -> Iterator[tuple[Fault, str]]:
    """What is wrong with one pair."""
    wrench = six(row["wrench"])
    if not np.isfinite(wrench).all():
        yield Fault.NOT_FINITE, f"the wrench is {said(wrench)}"
    else:
        yield from faults_of_wrench(wrench, settings)
    gap_ms = row.get("gap_ms")
    if gap_ms is not None and not abs(gap_ms) <= settings.gap_ms:
        yield Fault.UNSYNCHRONISED, f"{gap_ms:.1f} ms from image to wrench, more than {settings.gap_ms:g} ms"
    if reference is None:
        yield Fault.NO_REFERENCE, f"no whole untouched image is called {row.get('reference')!r}"
    elif reference.shape != image.shape:
        yield Fault.WRONG_SIZE, f"{side(image)}, and its reference {side(reference)}"
    elif np.isfinite(wrench).all():
        yield from faults_between(image, reference, wrench, settings)


def faults_of_wrench(wrench: Array, settings: CheckSettings) -> Iterator[tuple[Fault, str]]:
    """Too large, or of the wrong sign."""
    beyond = np.abs(wrench) > np.array(settings.largest)
    if beyond.any():
        axis = int(np.argmax(beyond))
        unit = "N" if axis < 3 else "N·m"
        yield Fault.OUT_OF_RANGE, f"{AXES[axis]} of {wrench[axis]:.4g} {unit}, beyond {settings.largest[axis]:g} {unit}"
    if wrench[2] > settings.pulling_above_n:
        yield Fault.PULLING, f"Fz of {wrench[2]:+.3g} N; pressing is below zero"


def faults_between(image: Grey, reference: Grey, wrench: Array, settings: CheckSettings) -> Iterator[tuple[Fault, str]]:
    """Image and wrench that tell different things."""
    levels = darkening(image, reference)
    if wrench[2] <= -settings.pressed_n and levels < settings.faintest_levels:
        yield Fault.NOT_DARKER, f"Fz of {wrench[2]:.3g} N, and {levels:.2g} grey levels of darkening"
    if np.abs(wrench[:3]).max() <= settings.untouched_n and levels > settings.unfelt_levels:
        yield Fault.UNFELT, f"a force of nothing, and {levels:.2g} grey levels of darkening"


def darkening(image: Grey, reference: Grey) -> float:
    """By how many grey levels the darkest place is darker than most."""
    change = np.subtract(reference, image, dtype=np.float32)
    grid = tuple(max(1, min(MOST_TILES, side // TILE_PX)) for side in change.shape[::-1])
    tiles = cv2.resize(change, grid, interpolation=cv2.INTER_AREA)
    return float(tiles.max() - np.median(tiles))


def repeated(checks: Iterable[FileCheck], files: Iterable[str]) -> Iterator[Finding]:
    """Images and ids that came before, in the order of the files."""
    ids: dict[str, str] = {}
    images: dict[str, str] = {}
    for check, file in zip(checks, files, strict=True):
        for number, (name, seen) in enumerate(zip(check.ids, check.seen, strict=True)):
            if name in ids:
                says = f"{ids[name]} has the same id"
                yield Finding(Fault.DUPLICATE_ID, name, says, number, file)
            if seen and seen in images:
                says = f"{images[seen]} shows the same, pixel by pixel"
                yield Finding(Fault.DUPLICATE_IMAGE, name, says, number, file)
            ids.setdefault(name, f"row {number} of {file}")
            images.setdefault(seen, name)


def said(wrench: Array) -> str:
    """Six numbers, short."""
    return " ".join(f"{value:.3g}" for value in wrench)


def side(image: Grey) -> str:
    """Columns and rows in words."""
    return f"{image.shape[1]} x {image.shape[0]} pixels"
