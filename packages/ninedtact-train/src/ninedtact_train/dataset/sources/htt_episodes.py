"""Force episodes of the Heterogeneous Tactile Transformer (HTT): one .npz for each press of a probe on a 9DTact.

`tactile_img` (T, 224, 224, 3) 8-bit RGB, `ref_frame` (224, 224, 3) in 0 to 255 or 0 to 1, `6d_force` (T, 6), `ref_force` (6). The
label is `6d_force` − `ref_force`; `probe` and `mode` say what pressed and how (docs/references.md). Signs, axes and the origin of
the torques are not documented: they are taken as they are unless stated, and the checks list pairs where pressing is positive.
An episode may be larger than memory, so its images are read one by one.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from zipfile import ZipExtFile, ZipFile

import cv2
import numpy as np
from jaxtyping import Float64, Shaped, UInt8
from numpy import ndarray as Array

from ninedtact.bounds_and_checked_reading import NPY_READ_ERRORS
from ninedtact.errors import FileFormatError, NinedtactError
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
_LIGHT_BELOW_N = 0.3
_USUAL_ORIGIN_MM = (0.0, 0.0, 0.0)
_LARGEST_SHORT_ARRAY = 1 << 27
"""Largest size in bytes of any array except the images."""


class TransformerEpisodeDamaged(FileFormatError):
    """Raised for an .npz file that is not a force episode or is incomplete."""


@dataclass(frozen=True)
class _NpzArchive:
    """An open .npz file."""

    path: Path
    zip: ZipFile

    @property
    def names(self) -> list[str]:
        return [name.removesuffix(".npy") for name in self.zip.namelist()]

    def read_array(self, name: str) -> Shaped[Array, "..."]:
        """Return a short array; raises `TransformerEpisodeDamaged`."""
        with self._open_member(name) as (file, shape, dtype):
            size = np.prod(shape, dtype=float) * dtype.itemsize
            if size > _LARGEST_SHORT_ARRAY:
                raise self.damage(f"a short array {name}", f"one of shape {shape}")
            return np.frombuffer(self._read_bytes(file, int(size), name), dtype).reshape(shape)

    def iterate_images(self, name: str) -> Iterator[UInt8[Array, "rows cols 3"]]:
        """Yield the images of a long array one by one; raises `TransformerEpisodeDamaged`."""
        with self._open_member(name) as (file, shape, dtype):
            if len(shape) != 4 or shape[3] != 3 or 0 in shape[1:3] or dtype != np.uint8:
                raise self.damage(f"{name} as 8-bit images (T, rows, cols, 3)", f"{dtype} of shape {shape}")
            size = int(np.prod(shape[1:]))
            for _ in range(shape[0]):
                yield np.frombuffer(self._read_bytes(file, size, name), np.uint8).reshape(shape[1:])

    def read_length(self, name: str) -> int:
        """Return the number of entries of an array; raises `TransformerEpisodeDamaged`."""
        with self._open_member(name) as (_, shape, _):
            return shape[0] if shape else 0

    def damage(self, expected: str, got: str) -> TransformerEpisodeDamaged:
        """Return the error that refuses the file."""
        return TransformerEpisodeDamaged(f"expected {expected} in {self.path}, got {got}; copy the file again")

    @contextmanager
    def _open_member(self, name: str) -> Iterator[tuple[ZipExtFile, tuple[int, ...], np.dtype]]:
        """Yield the content, shape and type of an array without Python objects; raises `TransformerEpisodeDamaged`."""
        with self._refuse_damage(name):
            file = self.zip.open(f"{name}.npy")
            assert isinstance(file, ZipExtFile)
            shape, columns_first, dtype = _read_npy_header(file)
        with file:
            if dtype.hasobject or (columns_first and len(shape) > 1):
                raise self.damage(f"plain numbers in {name}", "Python objects" if dtype.hasobject else "columns first")
            yield file, shape, dtype

    def _read_bytes(self, file: ZipExtFile, size: int, name: str) -> bytes:
        with self._refuse_damage(name):
            content = file.read(size)
        if len(content) < size:
            raise self.damage(f"the whole array {name}", "the end of the file")
        return content

    @contextmanager
    def _refuse_damage(self, name: str) -> Iterator[None]:
        """Turn what the libraries raise into `TransformerEpisodeDamaged`."""
        try:
            yield
        except NPY_READ_ERRORS as error:
            reason = (str(error).splitlines() or [type(error).__name__])[0]
            raise self.damage(f"the array {name}", reason) from error


def _read_npy_header(file: ZipExtFile) -> tuple[tuple[int, ...], bool, np.dtype]:
    """Return the shape, whether columns come first, and the type, as the file says."""
    major, _ = np.lib.format.read_magic(file)
    read = np.lib.format.read_array_header_1_0 if major == 1 else np.lib.format.read_array_header_2_0
    shape, columns_first, dtype = read(file)
    return shape, columns_first, dtype


@contextmanager
def _open_npz(path: Path) -> Iterator[_NpzArchive]:
    """Yield an open .npz file; raises `TransformerEpisodeDamaged`."""
    try:
        opened = ZipFile(path)
    except NPY_READ_ERRORS as error:
        raise TransformerEpisodeDamaged(
            f"expected an .npz archive in {path}, got something else or half a file ({error}); copy the file again"
        ) from error
    with opened:
        yield _NpzArchive(path, opened)


@dataclass(frozen=True)
class _EpisodePart(SourcePart):
    """One episode."""

    file: Path
    name: str
    """The path of the episode below the source, without suffix."""
    conventions: SourceConventions

    def items(self) -> Iterator[SourceItem]:
        """Yield the reference image and every image with its wrench."""
        step = 0
        try:
            with _open_npz(self.file) as episode:
                _require_episode(episode)
                reference = self._read_reference(episode)
                yield reference
                forces, probe = self._read_forces(episode), self._read_probe(episode)
                for step, image in enumerate(episode.iterate_images(_IMAGES)):
                    yield self._make_row(step, image, forces[step], probe, reference)
        except NinedtactError as error:
            message = f"{error} (read as far as image {step})"
            yield RejectedItem(PairFault.UNREADABLE, f"{self.source}/{self.name}", message)

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
            reference_id=reference.id,
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

    def _read_reference(self, episode: _NpzArchive) -> ReferenceImage:
        """Return the episode's own reference image; raises `TransformerEpisodeDamaged`."""
        image = episode.read_array(_REFERENCE if _REFERENCE in episode.names else _OLDER_REFERENCE)
        if image.ndim != 3 or image.shape[2] != 3 or image.size == 0 or image.dtype.kind not in "uif":
            raise episode.damage(f"{_REFERENCE} as one RGB image", f"{image.dtype} of shape {image.shape}")
        if image.dtype.kind == "f":
            scale = 255.0 if np.nanmax(image) <= 1.0 else 1.0
            image = np.rint(np.nan_to_num(image) * scale)
        grey = _rgb_to_grey(np.clip(image, 0, 255).astype(np.uint8))
        sensor = self.conventions.sensor_name or self.source
        return ReferenceImage(f"{self.source}/{self.name}", encode_png(grey), sensor)

    def _read_forces(self, episode: _NpzArchive) -> Float64[Array, "steps 6"]:
        """Return the measured wrenches minus their tare; raises `TransformerEpisodeDamaged`."""
        forces = episode.read_array(_FORCES)
        expected = (episode.read_length(_IMAGES), 6)
        if forces.dtype.kind not in "iuf" or forces.shape != expected:
            raise episode.damage(f"{_FORCES} of shape {expected}", f"{forces.dtype} of shape {forces.shape}")
        tare = episode.read_array(_TARE) if _TARE in episode.names else np.zeros(6)
        if tare.dtype.kind not in "iuf" or tare.shape != (6,):
            raise episode.damage(f"{_TARE} of six numbers", f"{tare.dtype} of shape {tare.shape}")
        return forces.astype(float) - tare

    def _read_probe(self, episode: _NpzArchive) -> str:
        """Return the number of the probe that pressed, or else the folder that the episode is in."""
        if "probe" in episode.names:
            number = episode.read_array("probe")
            if number.size == 1 and number.dtype.kind in "iu":
                return f"probe_{int(number.ravel()[0])}"
        return self.name.rpartition("/")[0] or self.name


def _require_episode(episode: _NpzArchive) -> None:
    """Refuse an archive that is not a force episode."""
    names = episode.names
    has_reference = _REFERENCE in names or _OLDER_REFERENCE in names
    if not (_IMAGES in names and _FORCES in names and has_reference):
        raise episode.damage(f"the arrays {_IMAGES}, {_REFERENCE} and {_FORCES}", ", ".join(names) or "none")


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
