"""The training pairs that `ninedtact collect` saved in a recording: raw image, wrench and reference images of each."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Literal, get_args

from jaxtyping import UInt8
from numpy import ndarray as Array

from ninedtact.quantities import Wrench
from ninedtact.recording.errors import RecordingUnreadable

PairKind = Literal["rule", "light_touch", "no_contact"]
"""Why a pair was saved: the sampling rule kept it; its load is below the start of the rule; nothing touches the skin."""
PAIR_KINDS: tuple[PairKind, ...] = get_args(PairKind)


@dataclass(frozen=True)
class TareReferenceImages:
    """The reference images (no contact) of a tare, which belong to the pairs that follow it."""

    id: str
    """Unique over all recordings."""
    images: tuple[UInt8[Array, "rows cols 3"], ...]
    """Raw BGR, read-only, because all pairs after the tare share them. To be rectified one by one and averaged."""


@dataclass(frozen=True)
class RecordedPair:
    """One raw image and the wrench that the object applied to the skin when it was taken."""

    image: UInt8[Array, "rows cols 3"]
    """Raw BGR, as the camera delivered it."""
    wrench: Wrench
    """The wrench about the skin centre, minus the tare; interpolated between the neighbouring samples to the stamp of the image."""
    object: str
    """`NO_OBJECT` where nothing touches."""
    contact: str
    """Pairs of one contact are similar, so splits keep them together. Unique over all recordings."""
    kind: PairKind
    time_ns: int
    """The stamp of the image, monotonic clock of the recording machine."""
    sensor: str
    """Name of the tactile sensor, as in its sensor.toml; its folder is attached to the recording."""
    reference: TareReferenceImages


def read_recorded_pairs(recording: Path | str) -> Iterator[RecordedPair]:
    """Yield the pairs of a recording, finished or cut short, in the order of saving, undone contacts excluded.

    Raises `CameraError` where there is no file, `RecordingUnreadable`, and `RecordingCutShort` after the last pair of a
    recording that has no end.
    """
    from ninedtact.recording.reader import Recording
    from ninedtact.recording.topics_and_messages import Topic

    with Recording(recording) as opened:
        stamps_ns = opened.stamps_ns(Topic.IMAGES).tolist()
        image_positions = dict(zip(stamps_ns, opened.positions(Topic.IMAGES), strict=True))
        frames_of_tares = groupby(opened.frames(Topic.REFERENCE), key=lambda frame: frame.index)
        references = {
            tare: TareReferenceImages(
                f"{opened.metadata.id}-u{tare:03d}", tuple(_read_only(frame.image) for frame in frames)
            )
            for tare, frames in frames_of_tares
        }
        labels = opened.kept_labels()
        for label in labels:
            kind = next((kind for kind in PAIR_KINDS if kind == label.kind), None)
            if kind is None or label.stamp_ns not in image_positions or label.reference not in references:
                raise RecordingUnreadable(
                    expected=f"a pair of {', '.join(PAIR_KINDS)} with its images in {opened.path}",
                    got=f"a {label.kind!r} at {label.stamp_ns} ns",
                    remedy="restore the file from a copy",
                )
            yield RecordedPair(
                image=opened.frame(image_positions[label.stamp_ns]).image,
                wrench=label.wrench,
                object=label.object,
                contact=label.contact,
                kind=kind,
                time_ns=label.stamp_ns,
                sensor=opened.sensor,
                reference=references[label.reference],
            )
        if not opened.is_finished:
            raise opened.missing_end_error(pairs=len(labels))


def _read_only(image: Array) -> Array:
    image.flags.writeable = False
    return image
