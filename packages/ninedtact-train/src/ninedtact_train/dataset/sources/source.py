"""The interface of a source of pairs: it is cut into parts, each of which becomes one file, in any order and any process."""

import os
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields
from hashlib import blake2b
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
from jaxtyping import Float32, Float64
from msgspec import Meta
from numpy import ndarray as Array

from ninedtact.bounds import require_within_bounds
from ninedtact.capture.frame_source import natural_sort_key
from ninedtact.errors import InputError
from ninedtact.quantities import Wrench
from ninedtact_train.dataset.schema import SourceItem

Point = tuple[float, float, float]
_AS_MEASURED = "+x,+y,+z"


@dataclass(frozen=True)
class SourceConventions:
    """Axes, torque origin, image scale and reference that a person states about sources that do not say them.

    These are the original project's folders, episodes of the tactile transformer, and recordings without a sensor folder.
    """

    origin_mm: Point | None = None
    """Point that the torques of the labels are about; 0 0 -35 for the original project, 0 0 0 for the centre of the skin."""
    axes: str = _AS_MEASURED
    """Measured axes that are the sensor's x, y and z; --axes=-x,-y,-z reverses what the skin applies to the object."""
    mm_per_px: Annotated[float, Meta(gt=0, lt=1)] | None = None
    """Scale of the images of the original project or of the episodes."""
    sensor_name: str | None = None
    """Name of the sensor that took the images of the original project or of the episodes; by default that of the source."""
    reference: Path | None = None
    """Rectified image without contact, for an image/ folder without mixed_image/."""
    sensor: Path | None = None
    """Sensor folder for recordings, in place of the one that they contain."""

    def __post_init__(self) -> None:
        require_within_bounds(self)
        _parse_axes(self.axes)
        if self.origin_mm is not None and not np.isfinite(self.origin_mm).all():
            raise InputError(expected="an origin in mm", got=f"{self.origin_mm}", remedy="correct it")

    def wrench_about_skin(self, measured: Float64[Array, "6"], usual_origin_mm: Point) -> Float32[Array, "6"]:
        """Return a measured wrench in the sensor's axes, with its torque about the centre of the skin.

        Axes that mirror mean that the label is the wrench of the skin on the object: force and torque are both reactions.
        """
        axes = _parse_axes(self.axes)
        order = ["xyz".index(axis[1]) for axis in axes]
        signs = np.array([-1.0 if axis[0] == "-" else 1.0 for axis in axes])
        force_n, torque_nm = (signs * vector[order] for vector in (measured[:3], measured[3:]))
        about_mm = np.array(self.origin_mm or usual_origin_mm)
        with np.errstate(invalid="ignore"):  # values that are not finite stay so, and the checks list them
            return Wrench(force_n, torque_nm, about_mm).about_skin_centre().six.astype(np.float32)

    def stated_options(self) -> Iterator[str]:
        """Yield the options of `ninedtact dataset build` that differ from their defaults."""
        return (f"--{one.name.replace('_', '-')}" for one in fields(self) if getattr(self, one.name) != one.default)

    def statement_lines(self) -> Iterator[str]:
        """Yield what was stated as phrases for the card."""
        if self.origin_mm is not None:
            yield f"torques of its labels were about ({', '.join(f'{mm:g}' for mm in self.origin_mm)}) mm"
        if self.axes != _AS_MEASURED:
            yield f"the sensor's x, y, z are the measured {self.axes}"

    def files(self) -> list[Path]:
        """Return the files that were stated: the reference image, and those of the sensor folder."""
        reference = [] if self.reference is None else [self.reference]
        folder = [] if self.sensor is None else sorted(self.sensor.rglob("*"))
        return [path for path in (*reference, *folder) if path.is_file()]


def _parse_axes(text: str) -> list[str]:
    """Return the axes in a text such as "+y,-x,z"; raises `InputError`."""
    words = [word.strip() for word in text.split(",")]
    axes = [word if word[:1] in "+-" else f"+{word}" for word in words]
    if sorted(axis[1:] for axis in axes) != ["x", "y", "z"]:
        raise InputError(
            expected="three axes such as +x,+y,+z or +y,-x,+z, each letter once",
            got=f"{','.join(axes)}",
            remedy="correct them",
        )
    return axes


@dataclass(frozen=True)
class Source(ABC):
    """A place that holds pairs. Ids are unique within it; the name distinguishes it from other sources."""

    name: str
    path: Path
    conventions: SourceConventions = field(default=SourceConventions(), kw_only=True)
    description: ClassVar[str]
    """The kind of source, for the card."""
    warnings: ClassVar[tuple[str, ...]] = ()
    """What a user of the data must know."""

    @abstractmethod
    def files(self) -> list[Path]:
        """Return all files that the source is read from."""

    @abstractmethod
    def items(self, part: Any) -> Iterator[SourceItem]:
        """Yield all items of one of the parts, a reference image before the rows that name it."""

    def parts(self) -> Sequence[Any]:
        """Return the parts in order, by default the files."""
        return self.files()

    def sensor_folders(self) -> Iterator[tuple[str, dict[str, bytes], Path]]:
        """Yield the name of each sensor whose calibration the source carries, the files of its folder, and where they are."""
        return iter(())

    def simulated_sensors(self) -> list[dict[str, Any]]:
        """Return all parameters of the simulated sensors that the source carries, as `sensors.json` stores them."""
        return []

    def statement_lines(self) -> Iterator[str]:
        """Yield what was stated about the source as phrases for the card."""
        return self.conventions.statement_lines()

    def fingerprint(self) -> str:
        """Return a digest that changes when a file of the source, or one that was stated, is added, removed or written again."""
        digest = blake2b(digest_size=12)
        stated = [(file, file) for file in self.conventions.files()]
        for name, file in [*((file.relative_to(self.root), file) for file in self.files()), *stated]:
            entry = file.stat()
            digest.update(os.fsencode(name))
            digest.update(f" {entry.st_size} {entry.st_mtime_ns}\n".encode())
        return digest.hexdigest()

    @property
    def root(self) -> Path:
        """The folder that the files are in."""
        return self.path if self.path.is_dir() else self.path.parent

    def name_of(self, file: Path) -> str:
        """Return the name of a file among those of all sources: its path below the root, without suffix."""
        return f"{self.name}/{file.relative_to(self.root).with_suffix('').as_posix()}"


def find_files_with_suffix(path: Path, suffix: str) -> list[Path]:
    """Return a file itself, or the files with this suffix in a folder, numbers in counting order."""
    if path.is_file():
        return [path]
    found = (file for file in path.rglob(f"*{suffix}") if not file.name.startswith("."))
    return sorted(found, key=lambda file: (natural_sort_key(file.relative_to(path)), file))
