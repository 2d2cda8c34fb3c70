"""One image and wrench of the original project, read with suspicion."""

from collections.abc import Iterator
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path
from tokenize import TokenError

import numpy as np
from jaxtyping import Float64, UInt8
from numpy import ndarray as Array

from ninedtact.capture.image_file import read_image
from ninedtact.dataset.generation.pair import png
from ninedtact.dataset.rows import Fault, Item, LeftOut, Row, UntouchedImage
from ninedtact.dataset.sources.source import Statements, Triple
from ninedtact.errors import NinedtactError
from ninedtact.force.deformation import NotAMixedImage, from_mixed_image, grey_of

Grey = UInt8[Array, "rows cols"]
Doubts = list[tuple[Fault, str]]
LOWEST = np.array([-3, -3, -12, -0.2, -0.2, -0.05])
SPAN = np.array([6, 6, 12, 0.4, 0.4, 0.1])
"""Of `_norm.npy`: (wrench - lowest) / span."""
SAME_NORM = 1e-5


class WrenchUnreadable(NinedtactError):
    """A file that does not hold six numbers."""


@dataclass(frozen=True)
class PairFiles:
    """The files of one pair, as far as they are there."""

    object: str
    stem: str
    image: Path | None = None
    mixed: Path | None = None
    wrench: Path | None = None
    norm: Path | None = None

    def items(
        self, source: str, statements: Statements, usual_origin_mm: Triple, given: UntouchedImage | None
    ) -> Iterator[Item]:
        """The untouched image and the row, or why there is none."""
        name = f"{source}/{self.object}/{self.stem}"
        if self.wrench is None:
            only = " (only its _norm.npy)" if self.norm else ""
            yield LeftOut(Fault.MISSING_WRENCH, name, f"expected wrench/{self.object}/{self.stem}.npy, got none{only}")
            return
        if self.image is None and self.mixed is None:
            said = f"expected {self.stem}.png in image/{self.object} or mixed_image/{self.object}, got none"
            yield LeftOut(Fault.MISSING_IMAGE, name, said)
            return
        try:
            yield from self.pair(name, source, statements, usual_origin_mm, given)
        except NinedtactError as trouble:
            yield LeftOut(Fault.UNREADABLE, name, str(trouble))

    def pair(
        self,
        name: str,
        source: str,
        statements: Statements,
        usual_origin_mm: Triple,
        given: UntouchedImage | None,
    ) -> Iterator[Item]:
        """The untouched image and the row; raises what reading does."""
        doubts: Doubts = []
        measured = self.measured(doubts)
        grey, reference = self.images(doubts)
        sensor = statements.sensor or source
        untouched = given if reference is None else untouched_image(reference, source, sensor)
        if untouched:
            yield untouched
        yield Row(
            id=name,
            image=png(grey),
            reference=untouched.id if untouched else None,
            wrench=statements.about_skin(measured, usual_origin_mm),
            object=f"{source}/{self.object}",
            contact=f"{source}/{self.object}",
            step=int(self.stem) if self.stem.isdecimal() and len(self.stem) < 10 else 0,
            time_ns=None,
            sensor=sensor,
            kind="rule",
            source=source,
            mm_per_px=statements.mm_per_px,
            doubts=tuple(doubts),
        )

    def measured(self, doubts: Doubts) -> Float64[Array, "6"]:
        """The wrench as the force/torque sensor gave it, held against its normalised copy."""
        assert self.wrench is not None
        six = read_six(self.wrench)
        if self.norm is not None:
            try:
                off = np.abs((six - LOWEST) / SPAN - read_six(self.norm))
                if np.isfinite(six).all() and not off.max() < SAME_NORM:
                    doubts.append((Fault.OTHER_NORM, f"{self.norm.name} is off by {off.max():.2g} of the range"))
            except WrenchUnreadable as trouble:
                doubts.append((Fault.OTHER_NORM, str(trouble)))
        return six

    def images(self, doubts: Doubts) -> tuple[Grey, Grey | None]:
        """Grey image, and reference where there is one; raises `ImageUnreadable`, `NotAMixedImage`."""
        image = None if self.image is None else grey_of(read_image(self.image), 1.0).grey.astype(np.uint8)
        if self.mixed is None:
            assert image is not None
            return image, None
        mixed = np.ascontiguousarray(read_image(self.mixed))
        try:
            parts = from_mixed_image(mixed, 1.0)
        except NotAMixedImage as trouble:
            if image is None:
                raise
            doubts.append((Fault.OTHER_MIXED, str(trouble)))
            return image, mixed[..., 0].copy()
        grey = (parts.reference - parts.darker + parts.brighter).astype(np.uint8)
        reference = parts.reference.astype(np.uint8)
        if image is not None and not np.array_equal(image, grey):
            doubts.append((Fault.OTHER_MIXED, f"{self.mixed.name} shows another image than its image; image was taken"))
        return (grey if image is None else image), reference


def read_six(path: Path) -> Float64[Array, "6"]:
    """Six numbers of a .npy file, finite or not; raises `WrenchUnreadable`."""
    try:
        numbers = np.load(path, allow_pickle=False)
    except (ValueError, EOFError, TypeError, OverflowError, SyntaxError, TokenError, MemoryError, OSError) as trouble:
        said = (str(trouble).splitlines() or [type(trouble).__name__])[0]
        raise WrenchUnreadable(f"expected six numbers in {path}, got: {said}; copy the file again") from trouble
    if not isinstance(numbers, np.ndarray) or numbers.dtype.kind not in "iuf" or numbers.size != 6:
        got = f"{numbers.dtype} of shape {numbers.shape}" if isinstance(numbers, np.ndarray) else "an archive"
        raise WrenchUnreadable(f"expected six numbers in {path}, got {got}; copy the file again")
    return numbers.astype(float).ravel()


def untouched_image(grey: Grey, source: str, sensor: str) -> UntouchedImage:
    """Named by what it shows: the same skin is stored once."""
    seen = blake2b(grey.tobytes(), digest_size=6).hexdigest()
    return UntouchedImage(f"{source}/{seen}", png(grey), sensor)


def reference_in(path: Path, source: str) -> UntouchedImage:
    """An image of the untouched skin that a person named; raises `ImageUnreadable`."""
    return untouched_image(grey_of(read_image(path), 1.0).grey.astype(np.uint8), source, source)
