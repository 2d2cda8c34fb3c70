"""The images of a data set, decoded once: one file of bytes at the size that a network takes, mapped into memory.

    cache/160x120-<digest>/images.npy          (n, rows, cols) uint8, in the order of the Parquet files
                           references.npy      (m, rows, cols) uint8, in the order of references.parquet
                           stored_shapes.npy   (n, 2) rows and columns that each image was stored with
    cache/files.json                           digests of the Parquet files

The digest is that of the contents of the Parquet files; a file is read again if its size or time has changed. Every file appears
whole or not at all.
"""

import shutil
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from hashlib import blake2b, file_digest
from itertools import islice
from pathlib import Path
from time import time
from typing import Any

import cv2
import msgspec
import numpy as np
from jaxtyping import Int32, UInt8
from numpy import ndarray as Array

from ninedtact.atomic_write import is_partial_file, open_atomic_file, write_file_atomically
from ninedtact.checked_reading import NPY_READ_ERRORS
from ninedtact.errors import FileFormatError, InputError
from ninedtact_train.dataset.folder import REFERENCES_FILE, find_pair_files, make_folder
from ninedtact_train.dataset.parquet_files import (
    StoredImageUnreadable,
    decode_stored_image,
    iterate_rows,
    open_parquet_file,
)

_IMAGES, _REFERENCES, _STORED_SHAPES = "images.npy", "references.npy", "stored_shapes.npy"
_KNOWN_FILES = "files.json"
_SMALLEST_PX = 8
_ABANDONED_AFTER_S = 3600
_IMAGES_PER_GROUP = 256
"""Images that threads decode together; the sizes of their originals are in memory at once."""


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

    Raises `FileFormatError`, `InputError` and `FileNotWritten`.
    """
    if min(size) < _SMALLEST_PX:
        raise InputError(
            expected=f"images of at least {_SMALLEST_PX} x {_SMALLEST_PX}", got=f"{size}", remedy="give a larger size"
        )
    cache = folder / "cache" if cache is None else cache
    files = [*find_pair_files(folder), folder / REFERENCES_FILE]
    final = cache / f"{size[0]}x{size[1]}-{digest_files_with_cache(files, cache)}"
    decoded = _map_decoded_images(final, size)
    if decoded is None:
        make_cache_folder(final)
        _decode_files(files, final, size, threads, progress)
        _remove_outdated(final)
        decoded = _map_decoded_images(final, size)
    if decoded is None:
        raise FileFormatError(expected=f"decoded images in {final}", got="damaged files", remedy="delete that folder")
    return decoded


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
        known = msgspec.json.decode((cache / _KNOWN_FILES).read_bytes(), type=dict[str, tuple[int, int, str]])
    except (OSError, msgspec.MsgspecError):
        known = {}
    now = {}
    for file in files:
        entry, before = file.stat(), known.get(file.name)
        if before is None or before[:2] != (entry.st_size, entry.st_mtime_ns):
            with file.open("rb") as content:
                digest = file_digest(content, "blake2b").hexdigest()[:32]
            before = entry.st_size, entry.st_mtime_ns, digest
        now[file.name] = before
    if now != known:
        make_cache_folder(cache)
        write_file_atomically(cache / _KNOWN_FILES, msgspec.json.encode(now))
    return blake2b("".join(digest for *_, digest in now.values()).encode(), digest_size=6).hexdigest()


def make_cache_folder(path: Path) -> None:
    """Make a folder of the cache; raises `FileNotWritten`."""
    make_folder(path, "name another one for decoded images")


def _decode_files(files: Sequence[Path], folder: Path, size: tuple[int, int], threads: int, progress: bool) -> None:
    from tqdm import tqdm

    *pair_files, references = files
    pairs = sum(open_parquet_file(file).metadata.num_rows for file in pair_files)
    with ThreadPoolExecutor(max(threads, 1)) as pool, tqdm(total=pairs, unit="image", disable=not progress) as bar:
        shapes = _decode_to_array(pair_files, folder / _IMAGES, size, pool, bar.update)
        _decode_to_array([references], folder / _REFERENCES, size, pool, lambda images: None)
    with open_atomic_file(folder / _STORED_SHAPES) as file:
        np.save(file, shapes)


def _decode_to_array(
    files: Sequence[Path],
    target: Path,
    size: tuple[int, int],
    pool: ThreadPoolExecutor,
    on_images: Callable[[int], object],
) -> Int32[Array, "n 2"]:
    """Write the images of some Parquet files as one .npy file; return the rows and columns they were stored with.

    The array is written and not mapped into memory, so that a full disk is an error and not a crash.
    """
    count = sum(open_parquet_file(file).metadata.num_rows for file in files)
    stored_shapes: list[tuple[int, ...]] = []
    with open_atomic_file(target) as array:
        header = {"descr": "|u1", "fortran_order": False, "shape": (count, *size[::-1])}
        np.lib.format.write_array_header_1_0(array, header)
        for file in files:
            places = ((file, number, row["image"]) for number, row in enumerate(iterate_rows(file, ["image"])))
            while group := list(islice(places, _IMAGES_PER_GROUP)):
                for stored_shape, image in pool.map(_decode_image, group, [size] * len(group)):
                    stored_shapes.append(stored_shape)
                    array.write(image.tobytes())
                on_images(len(group))
    return np.array(stored_shapes, np.int32).reshape(-1, 2)


def _decode_image(
    place: tuple[Path, int, Any], size: tuple[int, int]
) -> tuple[tuple[int, ...], UInt8[Array, "rows cols"]]:
    """Return the shape of a stored image and the image at this size: means over the area of each new pixel."""
    file, number, stored = place
    try:
        image = decode_stored_image(stored)
    except StoredImageUnreadable as error:
        raise FileFormatError(
            f"{error} (row {number} of {file}); or leave it out: ninedtact dataset build --drop --out NEW {file.parent}"
        ) from error
    resized = image if image.shape == size[::-1] else cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return image.shape, np.asarray(resized)


def _remove_outdated(final: Path) -> None:
    """Remove images of this size that were decoded before the Parquet files changed, and what killed processes left."""
    for folder in final.parent.glob(f"{final.name.split('-')[0]}-*"):
        if folder != final:
            shutil.rmtree(folder, ignore_errors=True)
    for file in filter(is_partial_file, final.iterdir()):
        if file.stat().st_mtime < time() - _ABANDONED_AFTER_S:  # another process may be at work on it
            file.unlink(missing_ok=True)
