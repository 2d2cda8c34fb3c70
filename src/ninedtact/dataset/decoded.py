"""The images of a data set, decoded once: one file of bytes at the size that a network wants, mapped into memory.

    cache/160x120-<digest>/images.npy      (n, rows, cols) uint8, in the order of the Parquet files
                           references.npy    (m, rows, cols) uint8, in the order of references.parquet
                           stored.npy        (n, 2) rows and columns that each image was stored with

The digest is of the Parquet files' contents; they are read again where size or time of one has changed. The folder appears whole
or not at all.
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
from ninedtact.dataset.columns import DataSetDamaged, bytes_of, opened, rows_of
from ninedtact.dataset.rows import NotAImage, decoded
from ninedtact.dataset.sources.table import REFERENCES, pair_files
from ninedtact.errors import NinedtactError

IMAGES, UNTOUCHED, STORED, FILES = "images.npy", "references.npy", "stored.npy", "files.json"
SMALLEST_PX = 8


class SizeImpossible(NinedtactError):
    """Images of a size that no network takes."""


class KnownFile(msgspec.Struct, frozen=True):
    """A Parquet file as it was when it was read last."""

    size: int
    mtime_ns: int
    digest: str


@dataclass(frozen=True)
class DecodedImages:
    """Mapped files; what is taken from them is a copy."""

    images: UInt8[Array, "n rows cols"]
    references: UInt8[Array, "m rows cols"]
    stored: Int32[Array, "n 2"]
    """Rows and columns of each image as it is stored."""


def decoded_images(
    folder: Path, size: tuple[int, int], cache: Path | None = None, threads: int = 1, *, progress: bool = False
) -> DecodedImages:
    """All images of a data set, decoded now where they are not yet.

    size: columns and rows. cache: where to keep them, `folder/cache` where nothing is said. Raises `DataSetDamaged`,
    `SizeImpossible` and `FileNotWritten`.
    """
    if min(size) < SMALLEST_PX:
        raise SizeImpossible(f"expected images of at least {SMALLEST_PX} x {SMALLEST_PX}, got {size}; ask for more")
    cache = folder / "cache" if cache is None else cache
    files = [*pair_files(folder), folder / REFERENCES]
    final = cache / f"{size[0]}x{size[1]}-{digest_of(files, cache)}"
    if not (final / STORED).is_file():
        with new_folder(final) as partial:
            decode(files, partial, size, threads, progress)
        remove_others(final)
    return DecodedImages(*(np.load(final / name, mmap_mode="r") for name in (IMAGES, UNTOUCHED, STORED)))


def digest_of(files: Sequence[Path], cache: Path) -> str:
    """Of all contents; files are read that are not known by size and time."""
    known = read_known(cache / FILES)
    now = {file.name: known_file(file, known.get(file.name)) for file in files}
    if now != known:
        make_folder(cache)
        write_file_atomically(cache / FILES, msgspec.json.encode(now))
    return blake2b("".join(now[file.name].digest for file in files).encode(), digest_size=6).hexdigest()


def read_known(path: Path) -> dict[str, KnownFile]:
    """What was noted last time; nothing where it cannot be read."""
    try:
        return msgspec.json.decode(path.read_bytes(), type=dict[str, KnownFile])
    except (OSError, msgspec.MsgspecError):
        return {}


def known_file(file: Path, before: KnownFile | None) -> KnownFile:
    """A file as it is now."""
    entry = file.stat()
    if before and (before.size, before.mtime_ns) == (entry.st_size, entry.st_mtime_ns):
        return before
    with file.open("rb") as content:
        return KnownFile(entry.st_size, entry.st_mtime_ns, file_digest(content, "blake2b").hexdigest()[:32])


def decode(files: Sequence[Path], folder: Path, size: tuple[int, int], threads: int, progress: bool) -> None:
    """Every image into its place; raises `DataSetDamaged`, `OSError`."""
    from tqdm import tqdm

    *pairs, references = files
    counts = [opened(file).metadata.num_rows for file in pairs]
    shape = (size[1], size[0])
    with (
        ArrayFile(folder / IMAGES, (sum(counts), *shape)) as images,
        ArrayFile(folder / UNTOUCHED, (opened(references).metadata.num_rows, *shape)) as untouched,
        ThreadPoolExecutor(max(threads, 1)) as pool,
        tqdm(total=sum(counts), unit="image", disable=not progress) as bar,
    ):
        decode_file(references, untouched, 0)
        begins = [0, *accumulate(counts)]
        jobs = [pool.submit(decode_file, file, images, at) for file, at in zip(pairs, begins, strict=False)]
        try:
            stored = []
            for job in jobs:
                stored.append(job.result())
                bar.update(len(stored[-1]))
        finally:
            pool.shutdown(cancel_futures=True)
    np.save(folder / STORED, np.concatenate(stored))


def decode_file(file: Path, target: "ArrayFile", at: int) -> Int32[Array, "n 2"]:
    """One Parquet file's images from place `at` on; the rows and columns they were stored with."""
    stored = []
    for number, row in enumerate(rows_of(file, ["image"])):
        try:
            image = decoded(bytes_of(row["image"]))
        except NotAImage as trouble:
            raise DataSetDamaged(
                f"{trouble} (row {number} of {file}); or leave it out: ninedtact dataset build --drop --out NEW {file.parent}"
            ) from trouble
        target.put(at + number, resized(image, target.shape[1:]))
        stored.append(image.shape)
    return np.array(stored, np.int32).reshape(-1, 2)


def resized(image: UInt8[Array, "_ _"], shape: tuple[int, ...]) -> UInt8[Array, "rows cols"]:
    """Means over the area of each pixel; interpolated where there are more than before."""
    if image.shape == shape:
        return image
    return np.asarray(cv2.resize(image, (shape[1], shape[0]), interpolation=cv2.INTER_AREA))


class ArrayFile:
    """A .npy file of images that threads fill in any order. Written, not mapped: a full disk is an error, not a crash."""

    def __init__(self, path: Path, shape: tuple[int, int, int]) -> None:
        self.path, self.shape = path, shape
        self.image_bytes = shape[1] * shape[2]

    def __enter__(self) -> "ArrayFile":
        self._file = self.path.open("wb")
        header = {"descr": "|u1", "fortran_order": False, "shape": self.shape}
        np.lib.format.write_array_header_1_0(self._file, header)
        self._file.flush()
        self._begin = self._file.tell()
        os.ftruncate(self._file.fileno(), self._begin + self.shape[0] * self.image_bytes)
        return self

    def put(self, number: int, image: UInt8[Array, "rows cols"]) -> None:
        """One image in its place; raises `OSError`."""
        content, at = image.tobytes(), self._begin + number * self.image_bytes
        while content:
            written = os.pwrite(self._file.fileno(), content, at)
            content, at = content[written:], at + written

    def __exit__(self, *_: object) -> None:
        self._file.close()


@contextmanager
def new_folder(final: Path) -> Iterator[Path]:
    """A folder to fill that appears at `final` when the block ends well; raises `FileNotWritten`."""
    make_folder(final.parent)
    remove_abandoned(final.parent)
    partial = final.parent / f".{final.name}.{socket.gethostname()}.{os.getpid()}.making"
    try:
        partial.mkdir(exist_ok=True)
        yield partial
        if not final.exists():  # another process may have been quicker
            partial.rename(final)
    except OSError as trouble:
        if not (final / STORED).is_file():
            raise FileNotWritten(
                f"expected to write {final}, got: {trouble.strerror or trouble}; free the disk, or name another folder for decoded "
                "images"
            ) from trouble
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def make_folder(path: Path) -> None:
    """With its parents; raises `FileNotWritten`."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as trouble:
        raise FileNotWritten(
            f"expected to make the folder {path}, got: {trouble.strerror or trouble}; name another one for decoded images"
        ) from trouble


def remove_abandoned(cache: Path) -> None:
    """What killed processes of this machine left half made."""
    for folder in cache.glob(f".*.{socket.gethostname()}.*.making"):
        if not is_alive(int(folder.suffixes[-2][1:])):
            shutil.rmtree(folder, ignore_errors=True)


def is_alive(process: int) -> bool:
    """Whether there is such a process."""
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True


def remove_others(final: Path) -> None:
    """Images of this size from before the files changed."""
    for folder in final.parent.glob(f"{final.name.split('-')[0]}-*"):
        if folder != final:
            shutil.rmtree(folder, ignore_errors=True)
