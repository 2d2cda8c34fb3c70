"""What a data set is made of: a row is one rectified image with its wrench; beside the rows, untouched skin, and what was
left out."""

from dataclasses import dataclass
from enum import StrEnum

import cv2
import msgspec
import numpy as np
from jaxtyping import Float32, UInt8
from numpy import ndarray as Array

from ninedtact.capture.image_file import image_file_fault
from ninedtact.errors import NinedtactError


class Fault(StrEnum):
    """What can be wrong with a pair."""

    MISSING_IMAGE = "missing image"
    MISSING_WRENCH = "missing wrench"
    UNREADABLE = "unreadable"
    NO_REFERENCE = "no reference"
    NOT_FINITE = "not finite"
    OUT_OF_RANGE = "out of range"
    PULLING = "pulling"
    UNSYNCHRONISED = "unsynchronised"
    WRONG_SIZE = "wrong size"
    NOT_DARKER = "not darker"
    UNFELT = "unfelt"
    DUPLICATE_IMAGE = "duplicate image"
    DUPLICATE_ID = "duplicate id"
    OTHER_NORM = "other norm"
    OTHER_MIXED = "other mixed image"


MEANINGS = {
    Fault.MISSING_IMAGE: "a wrench without an image; cannot be a row",
    Fault.MISSING_WRENCH: "an image without a wrench; cannot be a row",
    Fault.UNREADABLE: "a file that is damaged, or is something else; cannot be a row",
    Fault.NO_REFERENCE: "no image of the untouched skin belongs to it",
    Fault.NOT_FINITE: "the wrench holds something that is not a number",
    Fault.OUT_OF_RANGE: "a force or torque larger than this sensor is pressed with",
    Fault.PULLING: "F_z above zero: the object would pull at the skin; the force sensor's axes may be turned",
    Fault.UNSYNCHRONISED: "image and wrench were taken too far apart in time",
    Fault.WRONG_SIZE: "the image has another size than its reference",
    Fault.NOT_DARKER: "the wrench presses hard, and the image is nowhere darker than untouched skin",
    Fault.UNFELT: "the image shows a touch, and the wrench is nothing",
    Fault.DUPLICATE_IMAGE: "the very same image came before",
    Fault.DUPLICATE_ID: "a pair of the same id came before",
    Fault.OTHER_NORM: "the original project's _norm.npy says something else than its .npy",
    Fault.OTHER_MIXED: "the original project's mixed_image shows something else than its image",
}
"""In words, for the card and the report."""


UNUSABLE = frozenset({Fault.UNREADABLE, Fault.NO_REFERENCE, Fault.NOT_FINITE})
"""With these, nothing can be learnt from a pair; with the others it may be a good one."""


class Finding(msgspec.Struct, frozen=True):
    """One thing that is wrong with one pair."""

    fault: Fault
    id: str
    says: str
    row: int | None = None
    """In its file; None where it could not be a row."""
    part: str = ""
    """The file."""


@dataclass(frozen=True)
class Row:
    """One pair of the data set."""

    id: str
    """Unlike all others of the data set."""
    image: bytes
    """PNG, grey."""
    reference: str | None
    wrench: Float32[Array, "6"]
    """About the skin's centre."""
    object: str
    contact: str
    step: int
    time_ns: int | None
    sensor: str
    kind: str
    source: str
    mm_per_px: float | None = None
    gap_ms: float | None = None
    """From image to wrench."""
    doubts: tuple[tuple[Fault, str], ...] = ()
    """What was wrong when it was read."""


@dataclass(frozen=True)
class UntouchedImage:
    """What an image is held against: the skin before it was touched."""

    id: str
    image: bytes
    """PNG, grey."""
    sensor: str


@dataclass(frozen=True)
class LeftOut:
    """What cannot be a row."""

    fault: Fault
    id: str
    says: str


Item = Row | UntouchedImage | LeftOut
"""What a source tells, one after the other; an untouched image before the rows that need it."""


def writable(text: str) -> str:
    """A name or sentence as UTF-8 can hold it: names of files are any bytes."""
    return text.encode(errors="backslashreplace").decode()


class NotAImage(NinedtactError):
    """Bytes that are no grey image of 8 bits."""


def decoded(content: bytes | None) -> UInt8[Array, "rows cols"]:
    """A stored image, its file judged before any decoder sees it; raises `NotAImage`."""
    if not content:
        raise NotAImage("expected an image, got nothing; record it again")
    if fault := image_file_fault(content):
        raise NotAImage(f"expected an image, got {fault}; record it again")
    image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None or image.dtype != np.uint8:
        raise NotAImage("expected an 8-bit image, got damaged data or another depth; record it again")
    if image.ndim == 3:
        image = cv2.cvtColor(image[..., :3], cv2.COLOR_BGR2GRAY)
    return image
