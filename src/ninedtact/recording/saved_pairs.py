"""A pair that was collected: what the camera saw, and the wrench at that moment.

`ninedtact collect` marks pairs in its episode; `episode_pairs.pairs_of` reads them, without those of contacts that were undone.

What an episode's marks say, put together: image, wrench and untouched skin of each pair.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray as Array

from ninedtact.quantities import Wrench
from ninedtact.recording.errors import RecordingUnreadable
from ninedtact.recording.reader import Recording
from ninedtact.recording.ros_messages import EventKind, PairLabel, Topic, image_of

PairKind = Literal["rule", "light_touch", "no_contact"]
"""Why it was saved: the sampling rule kept it; it weighs less than the rule begins with; nothing touches."""
PAIR_KINDS: tuple[PairKind, ...] = get_args(PairKind)
NO_OBJECT = "none"
"""The object of a pair without contact."""


@dataclass(frozen=True)
class ReferenceImages:
    """The skin before a stretch of the session: the reference of the pairs that follow. Taken anew at every tare."""

    id: str
    """Unlike that of any other, in any episode."""
    images: tuple[UInt8[Array, "rows cols 3"], ...]
    """Raw BGR, read-only: all pairs of the stretch share them. To be rectified one by one and averaged."""


@dataclass(frozen=True)
class SavedPair:
    """One raw image and the wrench that the object applied to the skin when it was taken."""

    image: UInt8[Array, "rows cols 3"]
    """Raw BGR, as the camera gave it."""
    wrench: Wrench
    """About the skin's centre, tare taken off; interpolated between the neighbouring samples to the image's stamp."""
    object: str
    """`NO_OBJECT` where nothing touches."""
    contact: str
    """Pairs of one contact are alike: splits keep them together. Unlike any other contact's, in any episode."""
    kind: PairKind
    time_ns: int
    """The image's stamp, monotonic clock of the recording machine."""
    sensor: str
    """Name of the tactile sensor, as in its sensor.toml; its folder is attached to the episode."""
    untouched: ReferenceImages


def read_saved_pairs(recording: Path | str) -> Iterator[SavedPair]:
    """The pairs of an episode that `ninedtact collect` wrote, finished or cut short, without undone contacts.

    Raises `CameraNotFound` where there is no file, and `RecordingUnreadable`.
    """
    with Recording(recording) as episode:
        yield from SavedPairReader(episode).pairs()


class SavedPairReader:
    """The pairs of an open episode."""

    def __init__(self, episode: Recording) -> None:
        self.episode = episode

    def pairs(self) -> Iterator[SavedPair]:
        """In the order of saving, without undone contacts; raises `RecordingUnreadable`."""
        for mark in self.marks:
            yield self.pair(mark)

    @cached_property
    def marks(self) -> list[PairLabel]:
        """What was marked and not undone."""
        events = self.episode.events()
        undone = {event.subject for event in events if event.kind is EventKind.CONTACT_UNDONE}
        return [mark for mark in self.episode.pairs() if mark.contact not in undone]

    def pair(self, mark: PairLabel) -> SavedPair:
        """One pair."""
        kinds = [kind for kind in PAIR_KINDS if kind == mark.kind]
        if not kinds or mark.stamp_ns not in self.places or mark.untouched not in self.skins:
            raise RecordingUnreadable(
                f"expected a pair of {', '.join(PAIR_KINDS)} with its images in {self.episode.path}, got a {mark.kind!r} at "
                f"{mark.stamp_ns} ns; restore the file from a copy"
            )
        return SavedPair(
            image=self.episode.frame(self.places[mark.stamp_ns]).image,
            wrench=mark.wrench,
            object=mark.object,
            contact=mark.contact,
            kind=kinds[0],
            time_ns=mark.stamp_ns,
            sensor=self.episode.session.sensor,
            untouched=self.skins[mark.untouched],
        )

    @cached_property
    def places(self) -> dict[int, np.void]:
        """Where the image of each stamp is."""
        stamps_ns = self.episode.stamps_ns(Topic.IMAGES).tolist()
        return dict(zip(stamps_ns, self.episode.places(Topic.IMAGES), strict=True))

    @cached_property
    def skins(self) -> dict[int, ReferenceImages]:
        """The untouched skin of each tare."""
        messages = self.episode.messages(Topic.UNTOUCHED)
        return {
            number: ReferenceImages(
                f"{self.episode.session.id}-u{number:03d}", tuple(locked(image_of(one.data)) for one in of_tare)
            )
            for number, of_tare in groupby(messages, key=lambda message: message.sequence)
        }


def locked(image: Array) -> Array:
    """The same image, not to be written to."""
    image.flags.writeable = False
    return image
