"""The arrays of an .npz archive, the long one read image by image: an episode may be larger than memory."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tokenize import TokenError
from zipfile import BadZipFile, ZipExtFile, ZipFile
from zlib import error as ZlibError

import numpy as np
from jaxtyping import Shaped, UInt8
from numpy import ndarray as Array

from ninedtact.errors import NinedtactError

TROUBLES = (
    BadZipFile,
    ZlibError,
    NotImplementedError,
    RuntimeError,
    ValueError,
    EOFError,
    TypeError,
    OverflowError,
    SyntaxError,
    TokenError,
    MemoryError,
    KeyError,
    OSError,
)
LARGEST_SMALL_ARRAY = 1 << 27
"""Bytes of everything but the images."""


class EpisodeDamaged(NinedtactError):
    """An .npz file that is no force episode, or not a whole one."""


@dataclass(frozen=True)
class Archive:
    """An open .npz file."""

    path: Path
    zip: ZipFile

    @property
    def names(self) -> list[str]:
        """Of its arrays."""
        return [name.removesuffix(".npy") for name in self.zip.namelist()]

    def has(self, name: str) -> bool:
        """Whether there is such an array."""
        return name in self.names

    def array(self, name: str) -> Shaped[Array, "..."]:
        """A short array; raises `EpisodeDamaged`."""
        with self.member(name) as (file, shape, kind):
            size = np.prod(shape, dtype=float) * kind.itemsize
            if size > LARGEST_SMALL_ARRAY:
                raise self.damaged(f"a short array {name}", f"one of shape {shape}")
            return np.frombuffer(self.read(file, int(size), name), kind).reshape(shape)

    def frames(self, name: str) -> Iterator[UInt8[Array, "rows cols 3"]]:
        """The images of a long array, one after the other; raises `EpisodeDamaged`."""
        with self.member(name) as (file, shape, kind):
            if len(shape) != 4 or shape[3] != 3 or kind != np.uint8:
                raise self.damaged(f"{name} as 8-bit images (T, rows, cols, 3)", f"{kind} of shape {shape}")
            size = int(np.prod(shape[1:]))
            for _ in range(shape[0]):
                yield np.frombuffer(self.read(file, size, name), np.uint8).reshape(shape[1:])

    def length(self, name: str) -> int:
        """How many entries it has; raises `EpisodeDamaged`."""
        with self.member(name) as (_, shape, _):
            return shape[0] if shape else 0

    @contextmanager
    def member(self, name: str) -> Iterator[tuple[ZipExtFile, tuple[int, ...], np.dtype]]:
        """One array's content, shape and type; no Python objects; raises `EpisodeDamaged`."""
        with self.trouble_with(name):
            file = self.opened(name)
            shape, columns_first, kind = header_of(file)
        with file:
            if kind.hasobject or (columns_first and len(shape) > 1):
                raise self.damaged(f"plain numbers in {name}", "Python objects" if kind.hasobject else "columns first")
            yield file, shape, kind

    def opened(self, name: str) -> ZipExtFile:
        """The file of an array."""
        file = self.zip.open(f"{name}.npy")
        assert isinstance(file, ZipExtFile)
        return file

    def read(self, file: ZipExtFile, size: int, name: str) -> bytes:
        """So many bytes of an array; raises `EpisodeDamaged`."""
        with self.trouble_with(name):
            content = file.read(size)
        if len(content) < size:
            raise self.damaged(f"the whole array {name}", "the end of the file")
        return content

    @contextmanager
    def trouble_with(self, name: str) -> Iterator[None]:
        """Whatever the library calls it, told as `EpisodeDamaged`."""
        try:
            yield
        except TROUBLES as trouble:
            said = (str(trouble).splitlines() or [type(trouble).__name__])[0]
            raise self.damaged(f"the array {name}", said) from trouble

    def damaged(self, expected: str, got: str) -> EpisodeDamaged:
        """The refusal of the file."""
        return EpisodeDamaged(f"expected {expected} in {self.path}, got {got}; copy the file again")


def header_of(file: ZipExtFile) -> tuple[tuple[int, ...], bool, np.dtype]:
    """Shape, whether columns come first, and type, as the file says."""
    major, _ = np.lib.format.read_magic(file)
    read = np.lib.format.read_array_header_1_0 if major == 1 else np.lib.format.read_array_header_2_0
    shape, columns_first, kind = read(file)
    return shape, columns_first, kind


@contextmanager
def archive(path: Path) -> Iterator[Archive]:
    """An .npz file; raises `EpisodeDamaged`."""
    try:
        opened = ZipFile(path)
    except TROUBLES as trouble:
        raise EpisodeDamaged(
            f"expected an .npz archive in {path}, got something else or half a file ({trouble}); copy the file again"
        ) from trouble
    with opened:
        yield Archive(path, opened)
