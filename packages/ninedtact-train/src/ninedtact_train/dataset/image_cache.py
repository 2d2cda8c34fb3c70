"""The images of a data set, decoded once: one file of bytes at the size that a network takes, mapped into memory.

    cache/160x120-<digest>/images.npy          (n, rows, cols) uint8, in the order of the Parquet files
                           references.npy      (m, rows, cols) uint8, in the order of references.parquet
                           stored_shapes.npy   (n, 2) rows and columns that each image was stored with
    cache/files.json                           digests of the Parquet files

The digest is that of the contents of the Parquet files; a file is read again if its size or time has changed. The folder of
decoded images appears whole or not at all.
"""

import os
import shutil
import socket
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from hashlib import blake2b, file_digest
from itertools import accumulate
from pathlib import Path

import cv2
import msgspec
import numpy as np
from jaxtyping import Int32, UInt8
from numpy import ndarray as Array

from ninedtact.atomic_write import FileNotWritten, write_file_atomically
from ninedtact.bounds_and_checked_reading import NPY_READ_ERRORS
from ninedtact.errors import InputError
from ninedtact_train.dataset.folder import REFERENCES_FILE, find_pair_files, make_folder
from ninedtact_train.dataset.parquet_files import (
    DatasetDamaged,
    StoredImageUnreadable,
    decode_stored_image,
    iterate_rows,
    open_parquet_file,
)

_IMAGES, _REFERENCES, _STORED_SHAPES = "images.npy", "references.npy", "stored_shapes.npy"
_KNOWN_FILES = "files.json"
_SMALLEST_PX = 8


class ImageSizeImpossible(InputError):
    """Raised for an image size that no network takes."""


class _KnownFile(msgspec.Struct, frozen=True):
    """A Parquet file as it was when it was last read."""

    size: int
    mtime_ns: int
    digest: str


@dataclass(frozen=True)
class DecodedImages:
    """Memory-mapped images; arrays that are indexed from them are copies."""

    images: UInt8[Array, "n rows cols"]
    references: UInt8[Array, "m rows cols"]
    stored_shapes: Int32[Array, "n 2"]
    """Rows and columns of each image as it is stored in the Parquet file."""


def load_or_decode_images(
    folder: Path, size: tuple[int, int], cache: Path | None = None, threads: int = 1, *, progress: bool = False
) -> DecodedImages:
    """Return all images of a data set at a size (columns, rows); images that are not in the cache are decoded now.

    Raises `DatasetDamaged`, `ImageSizeImpossible` and `FileNotWritten`.
    """
    if min(size) < _SMALLEST_PX:
        raise ImageSizeImpossible(
            f"expected images of at least {_SMALLEST_PX} x {_SMALLEST_PX}, got {size}; give a larger size"
        )
    cache = folder / "cache" if cache is None else cache
    files = [*find_pair_files(folder), folder / REFERENCES_FILE]
    final = cache / f"{size[0]}x{size[1]}-{digest_files_with_cache(files, cache)}"
    decoded = _map_decoded_images(final, size)
    if decoded is None:
        _remove_damaged(final)
        with _new_cache_folder(final) as partial:
            _decode_files(files, partial, size, threads, progress)
        _remove_outdated(final)
        decoded = _map_decoded_images(final, size)
    if decoded is None:
        raise DatasetDamaged(f"expected decoded images in {final}, got damaged files; delete that folder")
    return decoded


def _remove_damaged(folder: Path) -> None:
    """Remove decoded images that cannot be read, so that they are decoded again; raises `FileNotWritten`."""
    try:
        if folder.exists():
            shutil.rmtree(folder)
    except OSError as error:
        raise FileNotWritten(
            f"expected to replace the damaged images in {folder}, got: {error.strerror or error}; delete that folder"
        ) from error


def _map_decoded_images(folder: Path, size: tuple[int, int]) -> DecodedImages | None:
    """Map a folder of decoded images into memory; return None where it is missing or its files do not fit together."""
    names = (_IMAGES, _REFERENCES, _STORED_SHAPES)
    if not all((folder / name).is_file() for name in names):
        return None
    try:
        images, references, shapes = parts = [np.load(folder / name, mmap_mode="r") for name in names]
        sizes = [getattr(part, "offset", 0) + part.nbytes for part in parts]
    except NPY_READ_ERRORS:
        return None
    if sizes != [(folder / name).stat().st_size for name in names]:
        return None
    are_images = all(part.dtype == np.uint8 and part.shape[1:] == size[::-1] for part in (images, references))
    fit = shapes.dtype == np.int32 and shapes.shape == (len(images), 2) if shapes.ndim and images.ndim else False
    return DecodedImages(images, references, shapes) if are_images and fit else None


def digest_files_with_cache(files: Sequence[Path], cache: Path) -> str:
    """Return one digest of the contents of all files; a file is only read if its size or time is not in the cache."""
    try:
        known = msgspec.json.decode((cache / _KNOWN_FILES).read_bytes(), type=dict[str, _KnownFile])
    except (OSError, msgspec.MsgspecError):
        known = {}
    now = {file.name: _known_file(file, known.get(file.name)) for file in files}
    if now != known:
        make_cache_folder(cache)
        write_file_atomically(cache / _KNOWN_FILES, msgspec.json.encode(now))
    return blake2b("".join(now[file.name].digest for file in files).encode(), digest_size=6).hexdigest()


def _known_file(file: Path, before: _KnownFile | None) -> _KnownFile:
    """Return a file as it is now."""
    entry = file.stat()
    if before and (before.size, before.mtime_ns) == (entry.st_size, entry.st_mtime_ns):
        return before
    with file.open("rb") as content:
        return _KnownFile(entry.st_size, entry.st_mtime_ns, file_digest(content, "blake2b").hexdigest()[:32])


def make_cache_folder(path: Path) -> None:
    """Make a folder of the cache; raises `FileNotWritten`."""
    make_folder(path, "name another one for decoded images")


def _decode_files(files: Sequence[Path], folder: Path, size: tuple[int, int], threads: int, progress: bool) -> None:
    """Decode every image into its place; raises `DatasetDamaged`, `OSError`."""
    from tqdm import tqdm

    *pair_files, references = files
    counts = [open_parquet_file(file).metadata.num_rows for file in pair_files]
    reference_count = open_parquet_file(references).metadata.num_rows
    shape = (size[1], size[0])
    with (
        _ImageArrayFile(folder / _IMAGES, (sum(counts), *shape)) as images,
        _ImageArrayFile(folder / _REFERENCES, (reference_count, *shape)) as reference_images,
        ThreadPoolExecutor(max(threads, 1)) as pool,
        tqdm(total=sum(counts), unit="image", disable=not progress) as bar,
    ):
        _decode_file(references, reference_images, 0)
        begins = [0, *accumulate(counts)]
        jobs = [pool.submit(_decode_file, file, images, at) for file, at in zip(pair_files, begins, strict=False)]
        try:
            stored_shapes = []
            for job in jobs:
                stored_shapes.append(job.result())
                bar.update(len(stored_shapes[-1]))
        finally:
            pool.shutdown(cancel_futures=True)
    np.save(folder / _STORED_SHAPES, np.concatenate(stored_shapes))


def _decode_file(file: Path, target: "_ImageArrayFile", first: int) -> Int32[Array, "n 2"]:
    """Decode the images of one file into places from `first` on; return the rows and columns they were stored with."""
    stored_shapes = []
    for number, row in enumerate(iterate_rows(file, ["image"])):
        try:
            image = decode_stored_image(row["image"])
        except StoredImageUnreadable as error:
            raise DatasetDamaged(
                f"{error} (row {number} of {file}); or leave it out: ninedtact dataset build --drop --out NEW {file.parent}"
            ) from error
        target.write_image(first + number, _resize_by_area(image, target.shape[1:]))
        stored_shapes.append(image.shape)
    return np.array(stored_shapes, np.int32).reshape(-1, 2)


def _resize_by_area(image: UInt8[Array, "_ _"], shape: tuple[int, ...]) -> UInt8[Array, "rows cols"]:
    """Return means over the area of each new pixel; a larger image is interpolated."""
    if image.shape == shape:
        return image
    return np.asarray(cv2.resize(image, (shape[1], shape[0]), interpolation=cv2.INTER_AREA))


class _ImageArrayFile:
    """A .npy file of images that threads fill in any order.

    It is written with system calls and not mapped into memory, so that a full disk is an error and not a crash.
    """

    def __init__(self, path: Path, shape: tuple[int, int, int]) -> None:
        self.path, self.shape = path, shape
        self.image_bytes = shape[1] * shape[2]

    def __enter__(self) -> "_ImageArrayFile":
        self._file = self.path.open("wb")
        header = {"descr": "|u1", "fortran_order": False, "shape": self.shape}
        np.lib.format.write_array_header_1_0(self._file, header)
        self._file.flush()
        self._begin = self._file.tell()
        os.ftruncate(self._file.fileno(), self._begin + self.shape[0] * self.image_bytes)
        return self

    def write_image(self, number: int, image: UInt8[Array, "rows cols"]) -> None:
        """Write one image to its place; raises `OSError`."""
        content, at = image.tobytes(), self._begin + number * self.image_bytes
        while content:
            written = os.pwrite(self._file.fileno(), content, at)
            content, at = content[written:], at + written

    def __exit__(self, *_: object) -> None:
        self._file.close()


@contextmanager
def _new_cache_folder(final: Path) -> Iterator[Path]:
    """Yield a folder to fill, which is renamed to `final` when the block ends without an error; raises `FileNotWritten`."""
    make_cache_folder(final.parent)
    _remove_abandoned(final.parent)
    partial = final.parent / f".{final.name}.{socket.gethostname()}.{os.getpid()}.making"
    try:
        partial.mkdir(exist_ok=True)
        yield partial
        if not final.exists():  # another process may have been quicker
            partial.rename(final)
    except OSError as error:
        if not (final / _STORED_SHAPES).is_file():
            raise FileNotWritten(
                f"expected to write {final}, got: {error.strerror or error}; free the disk, or name another folder for decoded "
                "images"
            ) from error
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def _remove_abandoned(cache: Path) -> None:
    """Remove unfinished files and folders that killed processes of this machine left."""
    for folder in cache.glob(f".*.{socket.gethostname()}.*.making"):
        if not _is_process_alive(int(folder.suffixes[-2][1:])):
            shutil.rmtree(folder, ignore_errors=True)


def _is_process_alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True


def _remove_outdated(final: Path) -> None:
    """Remove images of this size that were decoded before the Parquet files changed."""
    for folder in final.parent.glob(f"{final.name.split('-')[0]}-*"):
        if folder != final:
            shutil.rmtree(folder, ignore_errors=True)
