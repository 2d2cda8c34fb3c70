"""What every source answers: its parts, which become one file each, whoever makes them and in whatever order."""

import os
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, field
from hashlib import blake2b
from pathlib import Path
from typing import ClassVar

import numpy as np
from jaxtyping import Float32, Float64
from numpy import ndarray as Array

from ninedtact.dataset.rows import Item
from ninedtact.errors import NinedtactError
from ninedtact.quantities import Wrench

Triple = tuple[float, float, float]
Axes = tuple[str, str, str]
AXES = ("+x", "+y", "+z")
AS_MEASURED: Axes = ("+x", "+y", "+z")


class SourceUnknown(NinedtactError):
    """A path that holds no pairs of any kind that is read."""


@dataclass(frozen=True)
class Statements:
    """What a person states about sources that do not say it themselves: the original project's folders, HTT's episodes, and
    recordings without their sensor's folder."""

    origin_mm: Triple | None = None
    """Where the torques of their labels are about, in the sensor's frame; None: as each kind of source has it."""
    axes: Axes = AS_MEASURED
    """Which of the measured axes, with which sign, is the sensor's x, y and z."""
    mm_per_px: float | None = None
    """Scale of their images."""
    sensor: str | None = None
    """Which sensor took them; the source's name where nothing is said."""
    reference: Path | None = None
    """Image of the untouched skin, rectified, for a source that stores none."""
    sensor_folder: Path | None = None
    """In place of those that ride along in recordings."""

    def __post_init__(self) -> None:
        require_axes(self.axes)
        if self.mm_per_px is not None and not 0 < self.mm_per_px < 1:
            raise SourceUnknown(f"expected a scale of about 0.05 mm per pixel, got {self.mm_per_px}; correct it")
        if self.origin_mm is not None and not np.isfinite(self.origin_mm).all():
            raise SourceUnknown(f"expected an origin in mm, got {self.origin_mm}; correct it")

    def about_skin(self, measured: Float64[Array, "6"], usual_origin_mm: Triple) -> Float32[Array, "6"]:
        """A measured wrench in the sensor's axes, its torque about the centre of the skin.

        Where the axes mirror, the label is of the skin on the object: forces and torques are reactions both.
        """
        order = ["xyz".index(axis[1]) for axis in self.axes]
        signs = np.array([-1.0 if axis[0] == "-" else 1.0 for axis in self.axes])
        force_n, torque_nm = (signs * part[order] for part in (measured[:3], measured[3:]))
        about_mm = np.array(self.origin_mm or usual_origin_mm)
        with np.errstate(invalid="ignore"):  # what is not finite stays so, and the checks list it
            return Wrench(force_n, torque_nm, about_mm).about(np.zeros(3)).six.astype(np.float32)

    def said(self) -> Iterator[str]:
        """In words."""
        if self.origin_mm is not None:
            yield f"torques of its labels were about ({', '.join(f'{mm:g}' for mm in self.origin_mm)}) mm"
        if self.axes != AS_MEASURED:
            yield f"the sensor's x, y, z are the measured {', '.join(self.axes)}"
        if self.reference is not None:
            yield f"all images are held against one reference, {self.reference.name}"


def axes_of(words: str) -> Axes:
    """What a person wrote, as in "+y,-x,z"; raises `SourceUnknown`."""
    parts = [part.strip() for part in words.split(",")]
    axes = tuple(part if part[:1] in "+-" else f"+{part}" for part in parts)
    require_axes(axes)
    return axes[0], axes[1], axes[2]


def require_axes(axes: tuple[str, ...]) -> None:
    """Refuse what is not each letter once with a sign; raises `SourceUnknown`."""
    if sorted(axis[1:] for axis in axes) != ["x", "y", "z"] or not all(axis[0] in "+-" for axis in axes):
        raise SourceUnknown(
            f"expected three axes such as +x,+y,+z or +y,-x,+z, each letter once, got {','.join(axes)}; correct them"
        )


@dataclass(frozen=True)
class Part(ABC):
    """A piece of a source that becomes one file."""

    source: str

    @abstractmethod
    def items(self) -> Iterator[Item]:
        """All that it holds; every untouched image before the rows that name it."""


@dataclass(frozen=True)
class Source(ABC):
    """Somewhere that holds pairs. Ids are unlike each other within it; several sources are told apart by name."""

    name: str
    path: Path
    statements: Statements = field(default=Statements(), kw_only=True)
    what: ClassVar[str]
    """In words, for the card."""
    warnings: ClassVar[tuple[str, ...]] = ()
    """What a reader of the data must know."""

    @abstractmethod
    def files(self) -> list[Path]:
        """All files that it is read from."""

    @abstractmethod
    def parts(self) -> list[Part]:
        """In order."""

    def said(self) -> Iterator[str]:
        """What a person stated about it, for the card."""
        return iter(())

    def fingerprint(self) -> str:
        """Changes where a file comes, goes or is written anew."""
        digest = blake2b(digest_size=12)
        for file in self.files():
            entry = file.stat()
            digest.update(os.fsencode(file.relative_to(self.root)))
            digest.update(f" {entry.st_size} {entry.st_mtime_ns}\n".encode())
        return digest.hexdigest()

    @property
    def root(self) -> Path:
        """The folder that its files are in."""
        return self.path if self.path.is_dir() else self.path.parent


def name_of(file: Path, root: Path) -> str:
    """A file's path below its source, without suffix."""
    return file.relative_to(root).with_suffix("").as_posix()
