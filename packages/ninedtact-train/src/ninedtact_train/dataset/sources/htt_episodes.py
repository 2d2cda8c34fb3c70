"""Force episodes of the Heterogeneous Tactile Transformer (HTT): one .npz for each press of a probe on a 9DTact.

`tactile_img` (T, 224, 224, 3) 8-bit RGB, `ref_frame` (224, 224, 3) in 0 to 255 or 0 to 1, `6d_force` (T, 6), `ref_force` (6). The
label is `6d_force` − `ref_force`; `probe` and `mode` say what pressed and how (docs/references.md). Signs, axes and the origin of
the torques are not documented: they are taken as they are unless stated, and the checks list pairs where pressing is positive.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float64, Shaped, UInt8
from numpy import ndarray as Array

from ninedtact.bounds_and_checked_reading import NPY_READ_ERRORS
from ninedtact.errors import FileFormatError
from ninedtact_train.dataset.fault_report import PairFault
from ninedtact_train.dataset.parquet_files import encode_png
from ninedtact_train.dataset.schema import DatasetRow, ReferenceImage, RejectedItem, SourceItem
from ninedtact_train.dataset.sources.source import (
    Source,
    SourceConventions,
    SourcePart,
    find_files_with_suffix,
    relative_path_without_suffix,
)

EPISODE_SUFFIX = ".npz"
_IMAGES, _FORCES, _REFERENCE, _OLDER_REFERENCE, _TARE = "tactile_img", "6d_force", "ref_frame", "bg_frame", "ref_force"
_ARRAYS = (_IMAGES, _FORCES, _REFERENCE, _OLDER_REFERENCE, _TARE, "probe")
_LIGHT_BELOW_N = 0.3
_USUAL_ORIGIN_MM = (0.0, 0.0, 0.0)


class TransformerEpisodeDamaged(FileFormatError):
    """Raised for an .npz file that is not a force episode or is incomplete."""


@dataclass(frozen=True)
class _Episode:
    """The arrays of one episode; raises `TransformerEpisodeDamaged`."""

    path: Path
    arrays: dict[str, Shaped[Array, "..."]]

    @property
    def images(self) -> UInt8[Array, "steps rows cols 3"]:
        """The images, RGB."""
        images = self.arrays[_IMAGES]
        if images.ndim != 4 or images.shape[3] != 3 or 0 in images.shape[1:3] or images.dtype != np.uint8:
            raise self._damage(f"{_IMAGES} as 8-bit images (T, rows, cols, 3)", images)
        return images

    @property
    def reference(self) -> UInt8[Array, "rows cols"]:
        """The image without contact, grey."""
        image = self.arrays[_REFERENCE if _REFERENCE in self.arrays else _OLDER_REFERENCE]
        if image.ndim != 3 or image.shape[2] != 3 or image.size == 0 or image.dtype.kind not in "uif":
            raise self._damage(f"{_REFERENCE} as one RGB image", image)
        if image.dtype.kind == "f":
            scale = 255.0 if np.nanmax(image) <= 1.0 else 1.0
            image = np.rint(np.nan_to_num(image) * scale)
        return _rgb_to_grey(np.clip(image, 0, 255).astype(np.uint8))

    @property
    def forces(self) -> Float64[Array, "steps 6"]:
        """The measured wrenches minus their tare."""
        forces, tare = self.arrays[_FORCES], self.arrays.get(_TARE, np.zeros(6))
        if forces.dtype.kind not in "iuf" or forces.shape != (len(self.images), 6):
            raise self._damage(f"{_FORCES} of shape {(len(self.images), 6)}", forces)
        if tare.dtype.kind not in "iuf" or tare.shape != (6,):
            raise self._damage(f"{_TARE} of six numbers", tare)
        return forces.astype(float) - tare

    @property
    def probe(self) -> str | None:
        """The name of the probe that pressed; None where the file does not say it."""
        number = self.arrays.get("probe")
        if number is None or number.size != 1 or number.dtype.kind not in "iu":
            return None
        return f"probe_{int(number.ravel()[0])}"

    def _damage(self, expected: str, got: Array) -> TransformerEpisodeDamaged:
        return _episode_damage(self.path, expected, f"{got.dtype} of shape {got.shape}")


def _read_episode(path: Path) -> _Episode:
    """Read the arrays of an episode; raises `TransformerEpisodeDamaged`."""
    try:
        with np.load(path, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in _ARRAYS if name in stored.files}
            names = stored.files
    except NPY_READ_ERRORS as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise _episode_damage(path, "an .npz archive of plain numbers", reason) from error
    if not (_IMAGES in arrays and _FORCES in arrays and (_REFERENCE in arrays or _OLDER_REFERENCE in arrays)):
        raise _episode_damage(path, f"the arrays {_IMAGES}, {_REFERENCE} and {_FORCES}", ", ".join(names) or "none")
    return _Episode(path, arrays)


def _episode_damage(path: Path, expected: str, got: str) -> TransformerEpisodeDamaged:
    return TransformerEpisodeDamaged(expected=f"{expected} in {path}", got=f"{got}", remedy="copy the file again")


@dataclass(frozen=True)
class _EpisodePart(SourcePart):
    """One episode."""

    file: Path
    name: str
    """The path of the episode below the source, without suffix."""
    conventions: SourceConventions

    def items(self) -> Iterator[SourceItem]:
        """Yield the reference image and every image with its wrench."""
        sensor = self.conventions.sensor_name or self.source
        try:
            episode = _read_episode(self.file)
            reference = ReferenceImage(f"{self.source}/{self.name}", encode_png(episode.reference), sensor)
            images, forces = episode.images, episode.forces
        except TransformerEpisodeDamaged as error:
            yield RejectedItem(PairFault.UNREADABLE, f"{self.source}/{self.name}", str(error))
            return
        yield reference
        probe = episode.probe or self.name.rpartition("/")[0] or self.name
        for step, (image, measured) in enumerate(zip(images, forces, strict=True)):
            yield self._make_row(step, image, measured, probe, reference)

    def _make_row(
        self,
        step: int,
        image: UInt8[Array, "rows cols 3"],
        measured: Float64[Array, "6"],
        probe: str,
        reference: ReferenceImage,
    ) -> DatasetRow:
        wrench = self.conventions.wrench_about_skin(measured, _USUAL_ORIGIN_MM)
        return DatasetRow(
            id=f"{self.source}/{self.name}/{step:05d}",
            image=encode_png(_rgb_to_grey(image)),
            reference_id=reference.reference_id,
            wrench=wrench,
            object=f"{self.source}/{probe}",
            contact_id=f"{self.source}/{self.name}",
            step=step,
            time_ns=None,
            sensor=reference.sensor,
            kind="light_touch" if abs(wrench[2]) < _LIGHT_BELOW_N else "stream",
            source=self.source,
            mm_per_px=self.conventions.mm_per_px,
        )


def _rgb_to_grey(image: UInt8[Array, "rows cols 3"]) -> UInt8[Array, "rows cols"]:
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY))


@dataclass(frozen=True)
class TactileTransformerSource(Source):
    """A source of force episodes of the Heterogeneous Tactile Transformer: one, or a folder of them."""

    description = "force episodes of the Heterogeneous Tactile Transformer"
    warnings = (
        "The transformer's episodes are under CC BY-NC. The origin of their torques, their axes and the scale of their images are "
        "not documented: they were taken as they are unless stated.",
    )

    def statement_lines(self) -> Iterator[str]:
        """Yield what was stated about the episodes."""
        return self.conventions.statement_lines()

    def files(self) -> list[Path]:
        """Return the .npz files of all episodes."""
        return find_files_with_suffix(self.path, EPISODE_SUFFIX)

    def parts(self) -> list[SourcePart]:
        """Return one part for each episode."""
        return [
            _EpisodePart(self.name, file, relative_path_without_suffix(file, self.root), self.conventions)
            for file in self.files()
        ]
